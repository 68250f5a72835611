"""The test sequences by name: each makes a waveform of a valve's nameplate, its limits and the request's overrides.

Add one by a class and a line in SEQUENCES.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Annotated, Any, Final

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from drivers.addresses import MotionLimits
from service.words.spelling import fault_of
from valve.diagnostic_waveform import diagnostic, one_after_the_other, small_loops
from valve.errors import RequestError, WaveformError
from valve.messages import joined, message_of, say
from valve.nameplate import Nameplate
from valve.waveform import Waveform, dwell, multi_rate_periods, multi_rate_triangle, sine, steps, triangle

# What a test runs that names no sequence, and what it runs where a valve's limits do not allow that.
DEFAULT_SEQUENCE: Final = "multi_rate"
FALLBACK_SEQUENCE: Final = "triangle"
# Of worst cases over valves, sampling and an I/P lag of 0 to 0.3 s the least (tests/bench/benchmarks/sequences.py):
# ramps of 1 s and more, and holds at the turns in which the pressure comes after.
_FASTEST_PERIOD_S: Final = 2.0
_TURN_S: Final = 0.6
_SINE_CORNERS: Final = 1000  # fits the corner table of the reference map (1024), whatever the number of cycles

# The steps, percent of span: where the fine ones begin, their totals, and the large ones. Own choice: published valves
# have a resolution of 0 to 8 % and a dead band of 1.7 to 92 % of it.
_PAST_DEAD_BAND: Final = 58.0
_ONWARD: Final = (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.3)
_BACK: Final = (0.5, 1.0, 1.5, 2.0, 3.0, 4.5, 7.0, 10.0, 15.0, 22.0, 30.0, 40.0, 52.0, 65.0, 80.0, 95.0)
_LARGE: Final = (0.0, 50.0, 100.0, 50.0, 0.0)
_HOLD_S: Final = 4.0  # 5 time constants F_v / k of an overdamped stem, and twice that of rest

_HAIR: Final = 1.0 - 1.0e-9  # of the time, so that rounding does not make it too long

Period = Annotated[float, Field(gt=0.0, le=3600.0)]
Pressure = Annotated[float, Field(ge=-1.0e7, le=1.0e7)]
Span = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Room:
    """What a sequence may use: pressures, Pa, up to which rate, Pa/s, and how long, s."""

    low_pa: float
    high_pa: float
    rate_pa_per_s: float
    longest_s: float


class Sequence(BaseModel):
    """What every sequence takes: the pressures between which it moves, Pa; by default as far as the valve may go."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)
    low_pa: Pressure | None = None
    high_pa: Pressure | None = None

    @abstractmethod
    def waveform(self, room: Room) -> Waveform:
        """Return the waveform in this room. Raises WaveformError."""


class Triangle(Sequence):
    """Up and down at one rate: the paper's test."""

    period_s: Period = 20.0
    cycles: Annotated[int, Field(ge=1, le=1000)] = 3

    def waveform(self, room: Room) -> Waveform:
        """Return the triangular wave."""
        return triangle(self.period_s, self.cycles, room.low_pa, room.high_pa)


class MultiRate(Sequence):
    """One slow triangle, then fast ones at many rates, with short holds at the turns: the most that a minute can tell.

    ``periods_s`` says all ramps. Otherwise the fastest take 2 s there and back, or as long as the limit of the
    pressure's rate asks; name ``fastest_period_s`` where the I/P is slower. They fill ``duration_s``, within
    longest_test_s. ``turn_s`` is the hold at each turn: 0.6 s, with ``periods_s`` none.
    """

    periods_s: Annotated[list[Period], Field(min_length=1, max_length=100)] | None = None
    fastest_period_s: Period | None = None
    duration_s: Annotated[float, Field(ge=10.0, le=3600.0)] = 60.0
    turn_s: Annotated[float, Field(ge=0.0, le=60.0)] | None = None

    def waveform(self, room: Room) -> Waveform:
        """Return the triangles, one a period."""
        if self.periods_s is not None:
            return multi_rate_triangle(self.periods_s, room.low_pa, room.high_pa, turn_s=self.turn_s or 0.0)
        turn_s = _TURN_S if self.turn_s is None else self.turn_s
        return multi_rate_triangle(self._periods_s(room, turn_s), room.low_pa, room.high_pa, turn_s=turn_s)

    def _periods_s(self, room: Room, turn_s: float) -> tuple[float, ...]:
        # 1e-6 longer, so that rounding does not make it too fast
        allowed_s = 2.0 * (room.high_pa - room.low_pa) / room.rate_pa_per_s * (1.0 + 1.0e-6)
        fastest_s = max(_FASTEST_PERIOD_S, allowed_s) if self.fastest_period_s is None else self.fastest_period_s
        return multi_rate_periods(fastest_s, duration_s=min(self.duration_s, room.longest_s), turn_s=turn_s)


class Sine(Sequence):
    """A sine from its trough."""

    period_s: Period = 20.0
    cycles: Annotated[float, Field(ge=0.25, le=50.0)] = 3.0

    def waveform(self, room: Room) -> Waveform:
        """Return the sine as straight lines."""
        corners = 2 * int(_SINE_CORNERS / self.cycles / 2.0)
        return sine(self.period_s, self.cycles, room.low_pa, room.high_pa, corners_per_period=corners)


def _step_levels() -> tuple[float, ...]:
    """Levels in percent: up by more than the dead band, fine steps onward, to the top, growing steps back, large ones.

    Steps add up until the stem moves, so each list is of totals since it last did. A stem with F_s = 50 % of span
    and a dead band of 92 % (the roughest published valve) still answers.
    """
    levels = [0.0, _PAST_DEAD_BAND]
    levels += [_PAST_DEAD_BAND + total for total in _ONWARD]
    levels += [100.0]
    levels += [100.0 - total for total in _BACK]
    return (*levels, *_LARGE)


class Steps(Sequence):
    """Levels held one after the other, in percent of the span; only where the valve's limits allow steps.

    By default fine steps that bracket resolution and dead band, then large ones for T63, T86 and overshoot, both ways.
    ``hold_s`` is 4 s, or as long as longest_test_s leaves for each level.
    """

    levels_percent: Annotated[list[Annotated[float, Field(ge=0.0, le=100.0)]], Field(min_length=2, max_length=200)] = (
        Field(default_factory=lambda: list(_step_levels()))
    )
    hold_s: Period | None = None

    def waveform(self, room: Room) -> Waveform:
        """Return the staircase."""
        span_pa = room.high_pa - room.low_pa
        hold_s = self.hold_s
        if hold_s is None:
            hold_s = min(_HOLD_S, room.longest_s * _HAIR / len(self.levels_percent))
        return steps([room.low_pa + span_pa * level / 100.0 for level in self.levels_percent], hold_s)


class Dwell(Sequence):
    """Triangles that rest half-way for longer and longer: they tell friction that grows with rest."""

    period_s: Period = 20.0
    dwells_s: Annotated[list[Period], Field(min_length=1, max_length=50)] = [1.0, 3.0, 10.0]

    def waveform(self, room: Room) -> Waveform:
        """Return the triangles with their rests."""
        return dwell(self.period_s, room.low_pa, room.high_pa, self.dwells_s)


class Diagnostic(Sequence):
    """Slow and fast triangles, ramps that rest, small loops: all that names a cause, in 138 s.

    ``fast_s`` are the periods of the fast triangles, ``dwells_s`` the rests (each has a triangle of its own),
    ``swings`` the loops to either side of the middle, in shares of the range. Fast ramps are slower where the limit of
    the pressure's rate asks for it, and all is shortened to longest_test_s.
    """

    slow_s: Period = 20.0
    fast_s: Annotated[list[Period], Field(min_length=1, max_length=20)] = [8.0, 5.0, 3.1, 2.3, 2.7]
    dwells_s: Annotated[list[Period], Field(min_length=1, max_length=20)] = [0.5, 8.0]
    swings: Annotated[list[Annotated[float, Field(gt=0.0, le=0.5)]], Field(min_length=1, max_length=20)] = [
        0.35,
        0.23,
        0.16,
    ]

    def waveform(self, room: Room) -> Waveform:
        """Return the parts one after the other."""
        return diagnostic(
            room.low_pa,
            room.high_pa,
            rate_pa_per_s=room.rate_pa_per_s,
            longest_s=room.longest_s,
            slow_s=self.slow_s,
            fast_s=self.fast_s,
            dwells_s=self.dwells_s,
            swings=self.swings,
        )


class SmallLoops(Sequence):
    """One triangle, then loops about the middle of the range, each smaller than the last: they tell lost motion."""

    period_s: Period = 16.0
    loop_s: Period = 12.0
    swings: Annotated[list[Annotated[float, Field(gt=0.0, le=0.5)]], Field(min_length=1, max_length=50)] = [
        0.35,
        0.23,
        0.16,
    ]

    def waveform(self, room: Room) -> Waveform:
        """Return the triangle and the loops, with the way there and back."""
        whole = triangle(self.period_s, 1, room.low_pa, room.high_pa)
        loops = small_loops(room.low_pa, room.high_pa, self.swings, self.loop_s, lead_s=self.loop_s / 2.0)
        return one_after_the_other("small_loops", [whole, loops])


SEQUENCES: Final[dict[str, type[Sequence]]] = {
    "triangle": Triangle,
    "multi_rate": MultiRate,
    "sine": Sine,
    "steps": Steps,
    "dwell": Dwell,
    "small_loops": SmallLoops,
    "diagnostic": Diagnostic,
}


@dataclass(frozen=True, slots=True)
class Choice:
    """The sequence that a test runs, its waveform, and why it is not the usual one ("" where it is)."""

    name: str
    waveform: Waveform
    reason: str = ""


def choose_waveform(
    name: str | None, overrides: Mapping[str, Any], nameplate: Nameplate, limits: MotionLimits
) -> Choice:
    """Return the sequence ``name`` for this valve; without a name the usual one, where the limits allow it.

    Overrides without a name choose the triangle where only that knows them (``cycles``, ``period_s``).
    Raises RequestError and WaveformError as ``build_waveform``.
    """
    if name is not None:
        return Choice(name, build_waveform(name, overrides, nameplate, limits))
    foreign = sorted(set(overrides) - set(SEQUENCES[DEFAULT_SEQUENCE].model_fields))
    if foreign and set(overrides) <= set(SEQUENCES[FALLBACK_SEQUENCE].model_fields):
        waveform = build_waveform(FALLBACK_SEQUENCE, overrides, nameplate, limits)
        return Choice(
            FALLBACK_SEQUENCE,
            waveform,
            say(
                "belongs_to_sequence",
                "{override} belongs to sequence {sequence}",
                override=foreign[0],
                sequence=FALLBACK_SEQUENCE,
            ),
        )
    try:
        return Choice(DEFAULT_SEQUENCE, build_waveform(DEFAULT_SEQUENCE, overrides, nameplate, limits))
    except WaveformError as error:
        if overrides:
            raise
        waveform = build_waveform(FALLBACK_SEQUENCE, {}, nameplate, limits)
        return Choice(
            FALLBACK_SEQUENCE,
            waveform,
            say(
                "limits_do_not_allow",
                "the valve's limits do not allow {sequence}: {why}",
                sequence=DEFAULT_SEQUENCE,
                why=message_of(error),
            ),
        )


@lru_cache(maxsize=8192)  # a plant's valves: what they may do is asked with every look at one
def default_of(nameplate: Nameplate, limits: MotionLimits) -> tuple[str | None, str]:
    """Return the sequence of a test that names none, or None, and why it is not the usual one."""
    try:
        choice = choose_waveform(None, {}, nameplate, limits)
    except WaveformError as error:
        return None, message_of(error)
    return choice.name, choice.reason


def build_waveform(name: str, overrides: Mapping[str, Any], nameplate: Nameplate, limits: MotionLimits) -> Waveform:
    """Return the waveform of the sequence ``name`` for this valve.

    Raises RequestError for an unknown sequence or override, WaveformError where the sequence contradicts itself.
    """
    if name not in SEQUENCES:
        raise RequestError(
            say(
                "sequence_unknown",
                "sequence {sequence} is unknown: choose one of {known:, }",
                sequence=repr(name[:64]),
                known=tuple(SEQUENCES),
            )
        )
    try:
        sequence = SEQUENCES[name].model_validate(dict(overrides))
    except ValidationError as error:
        known = list(SEQUENCES[name].model_fields)
        found = error.errors(include_url=False)[:10]
        reasons = joined("; ", [fault_of(one, known) for one in found])
        told = say(
            "overrides_wrong", "overrides of sequence {sequence}: {why}: correct them", sequence=name, why=reasons
        )
        if ", ".join(known) not in reasons:
            told = say("overrides_known", "{fault}; it knows {known:, }", fault=told, known=tuple(known))
        raise RequestError(told) from None
    room = room_of(nameplate, limits)
    room = replace(
        room,
        low_pa=room.low_pa if sequence.low_pa is None else sequence.low_pa,
        high_pa=room.high_pa if sequence.high_pa is None else sequence.high_pa,
    )
    return sequence.waveform(room)


def room_of(nameplate: Nameplate, limits: MotionLimits) -> Room:
    """Return what a sequence may use of this valve: as far as limits and signal go."""
    low_pa, high_pa = limits.pressure_pa
    if nameplate.signal is not None:
        low_pa, high_pa = max(low_pa, nameplate.signal.range_pa[0]), min(high_pa, nameplate.signal.range_pa[1])
    return Room(low_pa, high_pa, limits.pressure_rate_pa_per_s, limits.longest_test_s)
