"""The speeds and force rates of the ramps that a stem slid on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from estimators.motion.recorded_motion import RecordedMotion

_SAME: Final = 0.1  # speeds and rates that differ by less are one
_FEWEST_ROWS: Final = 4  # of a ramp
_OF_LONGEST: Final = 0.01  # of the longest travel


@dataclass(frozen=True, slots=True, eq=False)
class Ramps:
    """Speeds at which the stem slid, m/s, and rates of the force, N/s."""

    speeds_m_per_s: tuple[float, ...]
    rates_n_per_s: tuple[float, ...]


def ramps_of(motion: RecordedMotion) -> Ramps:
    """Return the speeds and force rates of the driven stretches, those that differ by less than 10 % once.

    The few rows that a stem still moves after a corner are no ramp.
    """
    samples = motion.samples
    driven = [one for one in motion.phases.stretches if one.driven and one.last - one.first >= _FEWEST_ROWS]
    travels = [abs(float(samples.position_m[one.last] - samples.position_m[one.first])) for one in driven]
    speeds, rates = [], []
    for stretch, travel_m in zip(driven, travels, strict=True):
        if travel_m < _OF_LONGEST * max(travels):
            continue
        middle = (stretch.first + stretch.last) // 2
        run_s = float(samples.time_s[stretch.last] - samples.time_s[middle])
        speeds.append(abs(float(samples.position_m[stretch.last] - samples.position_m[middle])) / run_s)
        rates.append(abs(float(samples.force_n[stretch.last] - samples.force_n[middle])) / run_s)
    return Ramps(_distinct(speeds), _distinct(rates))


def _distinct(values: list[float]) -> tuple[float, ...]:
    kept: list[float] = []
    for value in sorted(values):
        if value > 0.0 and (not kept or value > (1.0 + _SAME) * kept[-1]):
            kept.append(value)
    return tuple(kept)
