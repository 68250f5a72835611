"""The sizes of one valve and one recording, by which a cause judges what is natural."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from discrepancy.rough.observations import Observations
from estimators.engine.reading import Reading
from valve.nameplate import Nameplate


@dataclass(frozen=True, slots=True)
class Setting:
    """What a cause may depend on, SI.

    ``low_m`` to ``high_m`` is the travel swept, ``duration_s`` the recording's, ``speed_m_per_s`` the usual one in
    motion. k, F_c, F_s and F_0 are rough values. ``preload_n`` is the nameplate's, None where it has no bench set.
    ``late_s`` is how late a damped stem follows the force.
    """

    travel_m: float
    low_m: float
    high_m: float
    duration_s: float
    speed_m_per_s: float
    spring_n_per_m: float
    friction_n: float
    static_n: float
    offset_n: float
    full_force_n: float
    preload_n: float | None
    creeps: bool = False
    late_s: float = 0.0

    @property
    def swept_m(self) -> float:
        """Length of the travel swept, m."""
        return self.high_m - self.low_m

    @property
    def middle_m(self) -> float:
        """Middle of the travel swept, m."""
        return 0.5 * (self.low_m + self.high_m)

    def percent(self, position_m: float) -> float:
        """Position in percent of the rated travel."""
        return 100.0 * position_m / self.travel_m


def nameplate_preload(nameplate: Nameplate) -> float | None:
    """Preload by the bench set, N, None where the nameplate has none."""
    actuator = nameplate.actuator
    if actuator.bench_set_pa is None or actuator.diaphragm_area_m2 is None:
        return None
    return actuator.bench_set_pa[0] * actuator.diaphragm_area_m2


def full_force(nameplate: Nameplate, largest_n: float) -> float:
    """The actuator's force at full signal, N; ``largest_n`` of the recording where the nameplate does not say."""
    actuator, signal = nameplate.actuator, nameplate.signal
    if signal is None or actuator.diaphragm_area_m2 is None:
        return largest_n
    return max(signal.range_pa[1] * actuator.diaphragm_area_m2, 1.0e-9)


def setting_of(rows: Observations, reading: Reading, nameplate: Nameplate, creeping_m_per_s: float = 0.0) -> Setting:
    """Return the sizes of this valve, by least squares of its driven motion; slower than the last it creeps."""
    slide = rows.is_slide
    columns = [np.ones(rows.count), rows.direction * slide, *([rows.travel_m] if rows.has_spring else [])]
    both = np.unique(rows.direction[slide]).size == 2
    # a stem that slides one way only shows its offset by the breakaways
    chosen = slide if both else np.ones(rows.count, np.bool_)
    columns += [] if both else [rows.direction * ~slide]
    found = np.linalg.lstsq(np.column_stack(columns)[chosen], rows.force_n[chosen], rcond=None)[0]
    offset_n, friction_n = float(found[0]), float(found[1])
    spring = float(found[2]) if rows.has_spring else 0.0
    spring = spring if spring > 0.0 else reading.spring_n_per_m
    speeds = np.abs(rows.speed_m_per_s[slide])
    friction_n = max(friction_n, 1.0e-3 * float(np.ptp(rows.force_n)))
    apart = rows.direction * (rows.force_n - spring * rows.travel_m - offset_n)
    static_n = max(float(np.median(apart[~slide])), friction_n) if bool((~slide).any()) else friction_n
    return Setting(
        travel_m=nameplate.actuator.travel_m,
        low_m=float(reading.position_m.min()),
        high_m=float(reading.position_m.max()),
        duration_s=float(reading.time_s[-1] - reading.time_s[0]),
        speed_m_per_s=float(np.median(speeds)),
        spring_n_per_m=spring,
        friction_n=friction_n,
        static_n=static_n,
        offset_n=offset_n,
        full_force_n=full_force(nameplate, float(np.abs(reading.path.force_n).max())),
        preload_n=nameplate_preload(nameplate) if rows.has_spring else None,
        creeps=bool(speeds.min() < creeping_m_per_s),
    )
