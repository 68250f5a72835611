"""Estimates of a test while it runs: for who watches, and for a test that ends once it knows what was asked."""

from __future__ import annotations

import asyncio
import sys
from bisect import bisect_right
from collections.abc import Callable, Coroutine, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
import structlog

from drivers.outcome import SampleBlock
from service.model.family_rule import event_of, event_words
from service.model.until import is_met, read_until, until_words
from service.runs.live import LiveRun
from service.runs.out_of_family import OutOfFamily
from service.workers.analysis_process import AnalysisProcess
from valve.errors import ValveError
from valve.messages import say
from valve.nameplate import Nameplate
from valve.waveform import Waveform

_LOG = structlog.get_logger(__name__)
_AT_LEAST_EVERY_S: Final = 5.0
WORKER: Final = (sys.executable, "-m", "service.runs.estimate_worker")
_LIMIT_S: Final = 20.0  # of processor time; most take 0.1 s, and the first of a kind is compiled


def turns_s(waveform: Waveform) -> tuple[float, ...]:
    """Return when the command turns, s from the start of the waveform: where each ramp before a turn ends.

    A hold at a turn comes after it.
    """
    rise_pa = np.diff(waveform.pressure_pa)
    moving = np.flatnonzero(rise_pa != 0.0)
    sense = np.sign(rise_pa[moving])
    last = moving[:-1][sense[:-1] != sense[1:]]
    return tuple(waveform.time_s[last + 1].tolist())


class Estimator(Protocol):
    """Estimates what a running test shows, somewhere else than on the event loop."""

    async def estimate(self, journal: Path, nameplate: Nameplate) -> dict[str, Any] | None:
        """Return the estimate of the samples in a journal, None where they are too few. Raises ValveError."""


class EstimateWorker(AnalysisProcess):
    """One worker process for the estimates of all tests that run; started anew where it ended."""

    def __init__(self, *, command: Sequence[str] = WORKER, limit_s: float = _LIMIT_S) -> None:
        super().__init__(time_limit_s=limit_s, command=command)

    async def estimate(self, journal: Path, nameplate: Nameplate) -> dict[str, Any] | None:
        """Return what the journal of a running test shows so far; None where it holds too little.

        Raises InternalError where the worker crashed or took too long.
        """
        async with self._turn:
            answer = await self._attempt({"journal": str(journal), "nameplate": asdict(nameplate)}, None)
        found = answer["so_far"]
        return None if found is None else dict(found)


class LiveEstimates:
    """The estimates of one polled test: at each turning point of its command, and at least every 5 s.

    One at a time: a turning point that is passed meanwhile is looked at when the last is back. ``enough`` is set where
    an estimate that was asked for at a turning point knows what the test is to know, and, where ``ends_out_of_family``,
    at a breakaway twice the last one: then ``because`` has it. One that ``joins`` does so amid a test: the turning
    points before count as judged. All methods belong to the event loop, and none waits.
    """

    def __init__(
        self,
        live: LiveRun,
        waveform: Waveform,
        *,
        nameplate: Nameplate,
        journal: Path,
        estimator: Estimator,
        spawn: Callable[[Coroutine[Any, Any, None]], object],
        ends_out_of_family: bool = False,
        joins: bool = False,
    ) -> None:
        self.enough = asyncio.Event()
        self.because: dict[str, float] | None = None
        self._ends_out_of_family = ends_out_of_family
        self._live = live
        self._until = read_until(live.run.valve, live.run.until)
        self._turns_s = turns_s(waveform)
        self._nameplate = nameplate
        self._journal = journal
        self._estimator = estimator
        self._spawn = spawn
        self._family = OutOfFamily(nameplate.actuator.travel_m)
        self._asked_s = 0.0
        self._passed = 0  # turning points
        self._judged = None if joins else 0  # of them, when the last estimate was asked for
        self._is_under_way = False
        self._is_over = False

    def samples(self, block: SampleBlock) -> None:
        """Hear of samples that are in the journal; those of a device that plays by itself say too little."""
        if self._is_over or not block.recorded or block.sent_s is None:
            return
        notice = self._family.notice(block)
        if notice is not None:
            _LOG.warning("out of family", test=self._live.run.id, valve=self._live.run.valve, **notice)
            self._live.events.append("notice", notice)
            if self._ends_out_of_family and not self.enough.is_set():
                self._end_out_of_family(event_of(notice))
        now_s = float(block.time_s[-1])
        self._passed = bisect_right(self._turns_s, now_s)
        if self._judged is None:
            self._judged = self._passed
        if not self._is_under_way and (self._passed > self._judged or now_s - self._asked_s >= _AT_LEAST_EVERY_S):
            at_turn, self._judged = self._passed > self._judged, self._passed
            self._asked_s, self._is_under_way = now_s, True
            self._spawn(self._estimate(at_turn))

    def end(self) -> None:
        """The sequence is over: nothing more is asked for, and what is still under way changes nothing."""
        self._is_over = True

    def _end_out_of_family(self, event: dict[str, float]) -> None:
        self.because = event
        self.enough.set()
        _LOG.warning("test ends out of family", test=self._live.run.id, valve=self._live.run.valve, **event)
        sentence = say("ends_out_of_family", "The test ends early by its limits: {event}.", event=event_words(event))
        self._live.events.append("notice", {"kind": "out_of_family", **event, "sentence": sentence})

    async def _estimate(self, at_turn: bool) -> None:
        found: dict[str, Any] | None = None
        try:
            found = await self._estimator.estimate(self._journal, self._nameplate)
        except ValveError as error:  # the test goes on without
            _LOG.warning("no estimate so far", test=self._live.run.id, error=str(error))
        finally:
            self._is_under_way = False
        if found is None or self._is_over or self._live.events.closed:
            return
        self._family.know(found["family"])
        self._live.events.append("estimate", {name: found[name] for name in ("time_s", "breakaways", "parameters")})
        if at_turn and self._until is not None and is_met(self._until, found) and not self.enough.is_set():
            self.enough.set()
            _LOG.info("test knows enough", test=self._live.run.id, valve=self._live.run.valve, time_s=found["time_s"])
            sentence = say("ends_as_it_knows", "The test knows {asked}: it ends early.", asked=until_words(self._until))
            self._live.events.append("notice", {"kind": "enough", "time_s": found["time_s"], "sentence": sentence})
