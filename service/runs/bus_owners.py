"""One owner a bus: who may use which bus and which valve now."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Final

from drivers.motion.orders import Locks
from valve.errors import BusyError
from valve.messages import say

#: How long nightly checks leave a bus to somebody whom one of them kept waiting: time to press the button again.
COURTESY_S: Final = 60.0


@dataclass(frozen=True, slots=True)
class Claim:
    """A valve and its buses, taken by one run.

    Where the valve ``rests``, its buses were given back. ``awaited`` are those that are needed once more, to look at
    the stem: no scheduled test takes one until then, and nobody does once the look ``is_due``.
    """

    run_id: str
    tag: str
    buses: frozenset[str]
    scheduled: bool = False
    awaited: frozenset[str] = frozenset()
    is_due: bool = False
    rests: bool = False


class BusOwners:
    """Claims of this process, in memory, and by ``locks`` of this process among others: ``lock`` takes these.

    People go first: who was refused because a scheduled test used a bus finds it free afterwards, for a minute.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic, locks: Locks | None = None) -> None:
        self._clock = clock
        self._locks = locks
        self._claims: dict[str, Claim] = {}
        self._kept_free: dict[str, float] = {}  # by bus: until when no scheduled test takes it

    def claim(self, run_id: str, tag: str, buses: Iterable[str], *, scheduled: bool = False) -> Claim:
        """Take a valve and its buses in this process. Raises BusyError where one of them is taken here."""
        wanted = Claim(run_id, tag, frozenset(buses), scheduled)
        user, reason = self._in_the_way(wanted)
        if reason:
            if user is not None and user.scheduled and not scheduled:
                self._kept_free |= dict.fromkeys(wanted.buses, math.inf)
                reason = say(
                    "nightly_leave_bus",
                    "{why}; nightly checks leave the bus to you for {time:.0f s} after it",
                    why=reason,
                    time=COURTESY_S,
                )
            raise BusyError(_of(tag, reason))
        if not scheduled:
            for bus in wanted.buses:
                self._kept_free.pop(bus, None)
        self._claims[run_id] = wanted
        return wanted

    async def lock(self, claim: Claim) -> None:
        """Take the buses of a claim among the processes too. Raises BusyError where another has one."""
        if self._locks is not None:
            await self._locks.take_aside(claim.buses)

    def why_not_scheduled(self, tag: str, buses: Iterable[str]) -> str:
        """Return why a scheduled test of a valve has to wait now; "" where it may start."""
        return self._in_the_way(Claim("", tag, frozenset(buses), scheduled=True))[1]

    def in_use(self, tag: str, buses: Iterable[str]) -> str:
        """Return which test uses a valve or one of its buses; "" where none does."""
        return self._in_the_way(Claim("", tag, frozenset(buses)))[1]

    def _in_the_way(self, wanted: Claim) -> tuple[Claim | None, str]:
        for claim in self._claims.values():
            if claim.run_id == wanted.run_id:
                continue
            if claim.tag == wanted.tag:
                if claim.rests:
                    return claim, say(
                        "stem_may_move_after",
                        "its stem may still move after test {test}: wait until it was looked at",
                        test=claim.run_id,
                    )
                return claim, say(
                    "test_uses_valve", "test {test} uses this valve: wait for its end or stop it", test=claim.run_id
                )
            goes_first = not wanted.is_due and (
                wanted.scheduled or claim.is_due
            )  # two looks do not wait for each other
            for bus in sorted(claim.awaited & wanted.buses if goes_first else ()):
                return None, say(
                    "bus_awaited",
                    "on its bus {bus} the stem of {valve} is looked at first: wait some seconds",
                    bus=bus,
                    valve=claim.tag,
                )
            for bus in sorted(claim.buses & wanted.buses):
                return claim, (
                    say(
                        "bus_used_by_test",
                        "its bus {bus} is used by test {test} of {valve}: wait for its end or stop it",
                        bus=bus,
                        test=claim.run_id,
                        valve=claim.tag,
                    )
                )
        if wanted.scheduled:
            for bus in sorted(wanted.buses):
                if self._kept_free.get(bus, -math.inf) > self._clock():
                    return None, say(
                        "bus_kept_free",
                        "its bus {bus} is kept free for somebody who asked for it: people go first",
                        bus=bus,
                    )
        return None, ""

    def rest(self, claim: Claim, awaited: Iterable[str]) -> None:
        """Give the buses back and keep the valve: its stem is to be looked at, on these buses."""
        held = self._claims.get(claim.run_id)
        if held is not None:
            self._claims[claim.run_id] = replace(
                held, buses=frozenset(), awaited=frozenset(awaited), is_due=False, rests=True
            )
            self._give_back(held.buses)

    async def look(self, claim: Claim) -> None:
        """Take the awaited buses of a valve that rests; they are next. Raises BusyError where one is taken yet."""
        resting = self._claims[claim.run_id]
        self._claims[claim.run_id] = resting = replace(resting, is_due=True)
        looking = replace(resting, buses=resting.awaited, scheduled=False)
        reason = self._in_the_way(looking)[1]
        if reason:
            raise BusyError(_of(claim.tag, reason))
        self._claims[claim.run_id] = looking
        try:
            await self.lock(looking)
        except BaseException:
            self._claims[claim.run_id] = resting
            raise

    def release(self, claim: Claim) -> None:
        """Give valve and buses back; nothing happens where it was done already."""
        held = self._claims.pop(claim.run_id, None)
        if held is not None:
            self._give_back(held.buses)

    def _give_back(self, buses: frozenset[str]) -> None:
        if self._locks is not None:
            self._locks.give_back(buses)
        for bus in buses & self._kept_free.keys():
            self._kept_free[bus] = self._clock() + COURTESY_S

    def holder(self, tag: str) -> str | None:
        """Return the id of the run that this valve is kept for, if any."""
        return next((claim.run_id for claim in self._claims.values() if claim.tag == tag), None)

    def tester(self, tag: str) -> str | None:
        """Return the id of the run that tests this valve, if any: not of one whose stem is only to be looked at."""
        return next((one.run_id for one in self._claims.values() if one.tag == tag and not one.rests), None)


def _of(tag: str, reason: str) -> str:
    return say("valve_and_why", "{tag}: {why}", tag=tag, why=reason)
