"""The test sequences by name: each makes a waveform of a valve's nameplate, its limits and the request's overrides.

Add one by a class and a line in SEQUENCES.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Annotated, Any, Final

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from drivers.addresses import MotionLimits
from valve.errors import RequestError
from valve.nameplate import Nameplate
from valve.waveform import Waveform, dwell, multi_rate_triangle, sine, steps, triangle

DEFAULT_SEQUENCE: Final = "triangle"
_SINE_CORNERS: Final = 1000  # fits the corner table of the reference map (1024), whatever the number of cycles

Period = Annotated[float, Field(gt=0.0, le=3600.0)]
Pressure = Annotated[float, Field(ge=-1.0e7, le=1.0e7)]
Span = tuple[float, float]


class Sequence(BaseModel):
    """What every sequence takes: the pressures between which it moves, Pa; by default as far as the valve may go."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)
    low_pa: Pressure | None = None
    high_pa: Pressure | None = None

    @abstractmethod
    def waveform(self, low_pa: float, high_pa: float) -> Waveform:
        """Return the waveform between these pressures. Raises WaveformError."""


class Triangle(Sequence):
    """Up and down at one rate: the paper's test."""

    period_s: Period = 20.0
    cycles: Annotated[int, Field(ge=1, le=1000)] = 3

    def waveform(self, low_pa: float, high_pa: float) -> Waveform:
        """Return the triangular wave."""
        return triangle(self.period_s, self.cycles, low_pa, high_pa)


class MultiRate(Sequence):
    """Triangles at several rates, slow ones first: they tell friction that depends on speed."""

    periods_s: Annotated[list[Period], Field(min_length=1, max_length=100)] = [40.0, 20.0, 10.0]

    def waveform(self, low_pa: float, high_pa: float) -> Waveform:
        """Return the triangles, one a period."""
        return multi_rate_triangle(self.periods_s, low_pa, high_pa)


class Sine(Sequence):
    """A sine from its trough."""

    period_s: Period = 20.0
    cycles: Annotated[float, Field(ge=0.25, le=50.0)] = 3.0

    def waveform(self, low_pa: float, high_pa: float) -> Waveform:
        """Return the sine as straight lines."""
        return sine(
            self.period_s, self.cycles, low_pa, high_pa, corners_per_period=2 * int(_SINE_CORNERS / self.cycles / 2.0)
        )


class Steps(Sequence):
    """Levels held one after the other, in percent of the span; only where the valve's limits allow steps."""

    levels_percent: Annotated[list[Annotated[float, Field(ge=0.0, le=100.0)]], Field(min_length=2, max_length=200)] = [
        0.0,
        25.0,
        50.0,
        75.0,
        100.0,
        75.0,
        50.0,
        25.0,
        0.0,
    ]
    hold_s: Period = 5.0

    def waveform(self, low_pa: float, high_pa: float) -> Waveform:
        """Return the staircase."""
        return steps([low_pa + (high_pa - low_pa) * level / 100.0 for level in self.levels_percent], self.hold_s)


class Dwell(Sequence):
    """Triangles that rest half-way for longer and longer: they tell friction that grows with rest."""

    period_s: Period = 20.0
    dwells_s: Annotated[list[Period], Field(min_length=1, max_length=50)] = [1.0, 3.0, 10.0]

    def waveform(self, low_pa: float, high_pa: float) -> Waveform:
        """Return the triangles with their rests."""
        return dwell(self.period_s, low_pa, high_pa, self.dwells_s)


SEQUENCES: Final[dict[str, type[Sequence]]] = {
    "triangle": Triangle,
    "multi_rate": MultiRate,
    "sine": Sine,
    "steps": Steps,
    "dwell": Dwell,
}


def build_waveform(name: str, overrides: Mapping[str, Any], nameplate: Nameplate, limits: MotionLimits) -> Waveform:
    """Return the waveform of the sequence ``name`` for this valve.

    Raises RequestError for an unknown sequence or override, WaveformError where the sequence contradicts itself.
    """
    if name not in SEQUENCES:
        raise RequestError(f"sequence {name[:64]!r} is unknown: choose one of {', '.join(SEQUENCES)}")
    try:
        sequence = SEQUENCES[name].model_validate(dict(overrides))
    except ValidationError as error:
        known = ", ".join(SEQUENCES[name].model_fields)
        reasons = "; ".join(
            f"{'.'.join(str(part) for part in one['loc'])[:80]}: {one['msg'][0].lower()}{one['msg'][1:]}"
            for one in error.errors(include_url=False, include_input=False)[:10]
        )
        raise RequestError(f"overrides of sequence {name}: {reasons}: correct them; it knows {known}") from None
    low_pa, high_pa = limits.pressure_pa
    if nameplate.signal is not None:
        low_pa, high_pa = max(low_pa, nameplate.signal.range_pa[0]), min(high_pa, nameplate.signal.range_pa[1])
    return sequence.waveform(
        low_pa if sequence.low_pa is None else sequence.low_pa,
        high_pa if sequence.high_pa is None else sequence.high_pa,
    )
