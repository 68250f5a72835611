"""Where to look for a periodic force: its frequency, phase and size by what it does to motion and to breakaways.

In steady motion the stem answers A sin(w t + phi) by |H| A sin(w t + phi + arg H) with H = 1/(k - m w^2 + i w F_v): a
line in the spectrum of the misfit gives all three. Where the stem sticks and slips, each period lets it go or not, its
steps lock to a fraction of the frequency, and no line is left: there the forces at the breakaways tell,
S_a P = k x + F_0 + s F_s - A sin(w t + phi), which is linear in all but w.
Where all steps lock alike, that wave is the same at each of them and is F_s in the balance: discrepancy.locking.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from discrepancy.balance import COLUMNS, Sliding
from discrepancy.observed import Observed, Segment
from discrepancy.pauses import rest_ends
from discrepancy.residuals import paired
from discrepancy.unknowns import SEPARATOR
from discrepancy.waves import highest_of, share_taken
from estimators.motion.recorded_motion import RecordedMotion
from estimators.samples import BoolArray, FloatArray

LOWEST_HZ: Final = 0.3
HIGHEST_HZ: Final = 60.0
# Own choices, from valves with a hidden vibration (docs/diagnosis.md).
_GRID_S: Final = 5.0e-3
_FINER: Final = 8  # frequencies a line's width: the phase at either end of a record is off by pi/8 at most
_APART: Final = 3.0  # line widths between two lines
_FEWEST_BREAKAWAYS: Final = 12
# One frequency of thousands takes half of a dozen forces by chance, and nothing like it of some hundred.
_MANY_BREAKAWAYS: Final = 120
_CLEAR: Final = 0.8
_MOVING_SHARE: Final = 0.3  # of the usual speed
# Causes that bend the balance of forces at the breakaways too, and the strength of each.
_BENDING: Final = {
    "diaphragm_area_change": "slope_per_m",
    "friction_gradient": "gradient_n_per_m",
    "pressure_dependent_friction": "share",
    "spring_hardening": "hardening_n_per_m2",
    "dual_rate_spring": "rate_change_n_per_m",
}


@dataclass(frozen=True, slots=True)
class Line:
    """A periodic misfit a sin(2 pi f t + phase) of the position, m, with t from each record's start."""

    frequency_hz: float
    phase_rad: float
    amplitude_m: float

    @property
    def amplitude_m_per_s(self) -> float:
        """Of the velocity."""
        return 2.0 * math.pi * self.frequency_hz * self.amplitude_m

    def force(self, mass_kg: float, rate_n_per_m: float, viscous_n_s_per_m: float) -> tuple[float, float]:
        """Return amplitude, N, and phase of the force that shakes a sliding stem so."""
        w = 2.0 * math.pi * self.frequency_hz
        stiff = complex(rate_n_per_m - mass_kg * w * w, w * viscous_n_s_per_m)
        return self.amplitude_m * abs(stiff), math.remainder(self.phase_rad + cmath.phase(stiff), math.tau)


@dataclass(frozen=True, slots=True)
class Shaken:
    """A periodic force as the breakaways show it, with the spring, preload and static friction beside it, SI."""

    frequency_hz: float
    phase_rad: float
    force_n: float
    spring_n_per_m: float
    preload_n: float
    static_n: float
    share: float = 0.0  # of the forces that spring and static friction leave, that it takes
    beside: Mapping[str, float] = field(default_factory=dict)  # strengths of causes that bend the balance, by full name


def lines(observed: Observed, residual_m: FloatArray, most: int) -> list[Line]:
    """Return the strongest lines in residuals, shape (count,), of the rows in motion, the strongest first."""
    clock_s = slot_clock(observed)
    weight = observed.weight**2 * _moving(observed)
    if not weight.any():
        return []
    weight /= weight.max()
    step_s = max(float(np.median(np.diff(clock_s))), _GRID_S)
    place = np.round(clock_s / step_s).astype(np.int64)
    count = int(place.max()) + 1
    mean_m = float(np.average(residual_m, weights=weight))
    signal = np.bincount(place, weight * (residual_m - mean_m), minlength=count)
    size = _FINER * count
    power = np.abs(np.fft.rfft(signal, size)) ** 2
    frequency_hz = np.fft.rfftfreq(size, step_s)
    # what drifts fills the low frequencies: each line is judged against its neighbours
    wide = _FINER * max(5, count // 200)
    floor = np.convolve(power, np.ones(wide) / wide, mode="same")
    allowed = (frequency_hz > LOWEST_HZ) & (frequency_hz < HIGHEST_HZ)
    allowed[-1] = False  # half the rate of the blocks: no line has two sides there
    contrast = np.where(allowed, power / (floor + 1.0e-300), 0.0)
    found = highest_of(np.asarray(frequency_hz, np.float64), contrast, _APART / (count * step_s), most)
    step_hz = float(frequency_hz[1])
    return [_line(_between(at_hz, step_hz, power), clock_s, residual_m - mean_m, weight) for at_hz in found]


def _between(frequency_hz: float, step_hz: float, power: FloatArray) -> float:
    """Return where the parabola through the power beside a line's highest has its top."""
    place = round(frequency_hz / step_hz)
    before, at, after = power[place - 1 : place + 2]
    bend = before - 2.0 * at + after
    return frequency_hz if bend >= 0.0 else frequency_hz + 0.5 * step_hz * float((before - after) / bend)


def _line(frequency_hz: float, clock_s: FloatArray, residual_m: FloatArray, weight: FloatArray) -> Line:
    turn = 2.0 * math.pi * frequency_hz * clock_s
    columns = np.column_stack([np.sin(turn), np.cos(turn)]) * np.sqrt(weight)[:, None]
    sine, cosine = np.linalg.lstsq(columns, np.sqrt(weight) * residual_m, rcond=None)[0]
    return Line(frequency_hz, math.atan2(float(cosine), float(sine)), math.hypot(float(sine), float(cosine)))


def shaken_breakaways(observed: Observed, most: int, values: Mapping[str, float] | None = None) -> list[Shaken]:
    """Return the periodic forces that bring the forces at the breakaways nearest to a spring and static friction.

    ``values`` are a fit's: what a cause in it bends of the balance is told with the periodic force, for one hides the
    other. None where there are too few breakaways. Their first is left out: it is another than the later ones.
    """
    table = [row for motion in observed.motions for row in _breakaways(motion)[1:]]
    if len(table) < _FEWEST_BREAKAWAYS:
        return []
    time_s, force_n, place_m, sense = np.array(table).T
    rows = Sliding(place_m, np.zeros(place_m.size), sense, force_n, time_s)
    bent, more = [], []
    for cause, strength in _BENDING.items():
        own = {name.removeprefix(cause + SEPARATOR): value for name, value in (values or {}).items()}
        if strength in own:
            bent.append(cause + SEPARATOR + strength)
            more.append(COLUMNS[cause](rows, own))
    base = np.column_stack([place_m, np.ones(place_m.size), sense, *more])
    span_s = float(np.ptp(time_s))
    frequency_hz = np.arange(LOWEST_HZ, HIGHEST_HZ, 1.0 / (_FINER * span_s))
    taken = share_taken(frequency_hz, time_s, base, force_n)
    found = highest_of(frequency_hz, taken, _APART / span_s, most)
    shares = [float(taken[int(np.argmin(np.abs(frequency_hz - at_hz)))]) for at_hz in found]
    told = [
        (_shaken(at_hz, base, force_n, time_s, tuple(bent)), share) for at_hz, share in zip(found, shares, strict=True)
    ]
    return [replace(shaken, share=share) for shaken, share in told if shaken is not None]


def clear_share(observed: Observed, values: Mapping[str, float]) -> float:
    """Return the share of the forces at hundreds of breakaways that one wave takes; 0 where it is no clear one."""
    if sum(len(motion.phases.breakaways) for motion in observed.motions) < _MANY_BREAKAWAYS:
        return 0.0
    return max((one.share for one in shaken_breakaways(observed, 1, values) if one.share > _CLEAR), default=0.0)


def _shaken(
    frequency_hz: float, base: FloatArray, force_n: FloatArray, time_s: FloatArray, bent: tuple[str, ...] = ()
) -> Shaken | None:
    turn = 2.0 * math.pi * frequency_hz * time_s
    columns = np.column_stack([base, np.sin(turn), np.cos(turn)])
    scale = np.linalg.norm(columns, axis=0)
    solved = np.linalg.lstsq(columns / scale, force_n, rcond=1.0e-9)[0] / scale
    (spring, preload_n, static_n), (sine, cosine) = solved[:3], solved[-2:]
    if not (spring > 0.0 and static_n > 0.0):
        return None
    # what the periodic force gives the actuator's need not
    phase_rad = math.atan2(-float(cosine), -float(sine))
    return Shaken(
        frequency_hz,
        phase_rad,
        math.hypot(float(sine), float(cosine)),
        float(spring),
        float(preload_n),
        float(static_n),
        beside={name: float(strength) for name, strength in zip(bent, solved[3:-2], strict=True)},
    )


def _breakaways(motion: RecordedMotion) -> list[tuple[float, float, float, float]]:
    """Times from the record's start, s, forces, N, places, m, and directions of a recording's breakaways."""
    samples = motion.samples
    return [
        (
            float(samples.time_s[one.row] - samples.time_s[0]),
            float(samples.force_n[one.row]),
            one.rest_m,
            one.direction,
        )
        for one in rest_ends(motion)
    ]


def slot_clock(observed: Observed) -> FloatArray:
    """Times of all blocks from the start of the record that each is of, s, shape (count,): the vibration's clock."""
    return np.concatenate([_clock(segment) for segment in observed.segments])


def _clock(segment: Segment) -> FloatArray:
    return np.asarray(segment.time_s - segment.time_s[0] + segment.elapsed_s)


def _moving(observed: Observed) -> FloatArray:
    """1 for the blocks in which the stem moves, 0 for the others, shape (count,)."""
    parts = [np.interp(one.time_s, motion.samples.time_s, motion.phases.velocity) for one, motion in paired(observed)]
    speed = np.abs(np.concatenate(parts))
    is_moving: BoolArray = speed > _MOVING_SHARE * float(np.quantile(speed, 0.75))
    return np.asarray(is_moving, np.float64)
