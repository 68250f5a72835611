"""How strong a hidden effect is drawn, and which waveforms and channels can show it.

A strength is a number in the unit that its cause's line names. The smallest is what a prototype named, or where it
named none an own choice of the same order; the largest is ten times that.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Final

import numpy as np

from valve.effects import EFFECTS, Effect, ValveScale

LARGEST: Final = 10.0  # times the smallest
MEDIUM: Final = math.sqrt(10.0)  # up to here a strength is a medium one, beyond it a large one


class Acquired(StrEnum):
    """What is written down of the force."""

    CAPTURED = "captured"  # command and measured pressure at 1 ms, by the device's own clock
    GAUGED = "gauged"  # the same with a noisy gauge
    COMMAND = "command"  # 1 ms, the command alone
    POLLED = "polled"  # command and pressure every 20 ms, with jitter and gaps
    FORCE = "force"  # a measured force, 1 ms, on a drive without a spring


class Expected(StrEnum):
    """What an honest answer to a case is."""

    NAMED = "named"  # the cause, or a set with it
    SET = "set"  # a set with it, or nothing: its rival is the same physics, so that naming it alone is a guess
    HIDDEN = "hidden"  # nothing, or a set with it; large ones may be seen, so that naming it is right as well
    NONE = "none"
    UNEXPLAINED = "unexplained"


@dataclass(frozen=True, slots=True)
class Swept:
    """What the test sweeps of a healthy valve: travels at its ends, m, the speed of the ramp, and the valve's sizes."""

    low_m: float
    high_m: float
    speed_m_per_s: float
    duration_s: float
    scale: ValveScale

    @property
    def range_m(self) -> float:
        """Swept travel, m."""
        return self.high_m - self.low_m


Fill = Callable[[float, Swept, np.random.Generator], dict[str, float]]


@dataclass(frozen=True, slots=True)
class Hidden:
    """How a cause is hidden: from a strength to the parameters of its effect."""

    cause: str
    smallest: float
    unit: str
    fill: Fill
    has_sign: bool = False  # either sign is natural
    waveforms: frozenset[str] | None = None  # that can show it; None: any
    acquired: frozenset[Acquired] | None = None  # with which it is visible; None: any
    springless: bool = False  # whether a drive without a spring can have it

    def effect(self, strength: float, swept: Swept, rng: np.random.Generator, *, other_law: bool = False) -> Effect:
        """The effect at this strength, its shape drawn; ``other_law``: of another form than the usual one."""
        sign = float(rng.choice((-1.0, 1.0))) if self.has_sign else 1.0
        values: Any = self.fill(sign * strength, swept, rng)
        if other_law:
            values = {**values, **OTHER_LAWS[self.cause](sign * strength, swept, rng)}
        return EFFECTS[self.cause](**values)


def expected(
    cause: str, waveforms: tuple[str, ...], acquired: Acquired, *, bench_set_known: bool = True, stiction: bool = True
) -> Expected:
    """What can be asked for where this cause alone is hidden; ``stiction``: F_s is above F_c."""
    hidden = STRENGTHS[cause]
    if cause == "spring_preload" and not bench_set_known:
        return Expected.SET
    if cause == "friction_asymmetry" and acquired is not Acquired.FORCE and not stiction:
        # F_c (1 +- a) is a preload of a F_c more, which only a bench set that is trusted tells from another preload
        return Expected.HIDDEN if bench_set_known else Expected.SET
    if cause == "friction_asymmetry" and not bench_set_known:
        return Expected.HIDDEN  # F_s (1 +- a) shifts by more than F_c (1 +- a): a part of it can be seen
    if hidden.waveforms is not None and not hidden.waveforms & set(waveforms):
        return Expected.HIDDEN
    if hidden.acquired is not None and acquired not in hidden.acquired:
        return Expected.HIDDEN
    return Expected.NAMED


_RICH: Final = frozenset(("two_rates", "dwells", "small_loops", "diagnostic"))
_RESTING: Final = frozenset(("dwells", "diagnostic"))
_WITH_BOTH: Final = frozenset((Acquired.CAPTURED, Acquired.GAUGED, Acquired.POLLED))


def _place(swept: Swept, rng: np.random.Generator, least: float, most: float) -> float:
    return swept.low_m + float(rng.uniform(least, most)) * swept.range_m


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


def _drift(strength: float, swept: Swept, rng: np.random.Generator) -> dict[str, float]:
    constant_s = float(rng.uniform(10.0, 60.0))
    reached = 1.0 - math.exp(-swept.duration_s / constant_s)
    return {"change_n": strength * swept.scale.friction_n / reached, "time_constant_s": constant_s}


STRENGTHS: Final[dict[str, Hidden]] = {
    entry.cause: entry
    for entry in (
        Hidden("friction_asymmetry", 0.047, "of F_c", lambda s, _w, _r: {"asymmetry": s}, True, springless=True),
        Hidden(
            "stribeck_friction",
            0.05,
            "of F_c that friction falls by more",
            lambda s, w, r: {"excess_n": s * w.scale.friction_n, "speed_m_per_s": _log(r, 0.3, 3.0) * w.speed_m_per_s},
            springless=True,
        ),
        Hidden(
            "local_friction",
            0.05,
            "of F_c",
            lambda s, w, r: {
                "rise_n": s * w.scale.friction_n,
                "centre_m": _place(w, r, 0.2, 0.8),
                "width_m": float(r.uniform(0.01, 0.04)) * w.scale.travel_m,
            },
        ),
        Hidden(
            "friction_gradient",
            0.05,
            "of F_c over travel",
            lambda s, w, _r: {
                "gradient_n_per_m": s * w.scale.friction_n / w.scale.travel_m,
                "reference_m": (w.low_m + w.high_m) / 2.0,
            },
            True,
        ),
        Hidden("friction_drift", 0.023, "of F_c over the record", _drift, True, springless=True),
        Hidden(
            "pressure_dependent_friction",
            0.05,
            "of F_c at full pressure",
            lambda s, w, _r: {"share": s * w.scale.friction_n / w.scale.full_force_n},
        ),
        Hidden(
            "dwell_dependent_breakaway",
            0.1,
            "of F_c after a long rest",
            lambda s, w, r: {"rise_n": s * w.scale.friction_n, "time_s": float(r.uniform(0.5, 5.0))},
            waveforms=_RESTING,
        ),
        Hidden("presliding", 90.0e-6, "m", lambda s, _w, _r: {"deflection_m": s}),
        Hidden(
            "spring_preload",
            0.004,
            "of full force",
            lambda s, w, _r: {"offset_n": s * w.scale.full_force_n},
            True,
        ),
        Hidden(
            "spring_hardening",
            0.007,
            "of the spring's force over travel",
            lambda s, w, _r: {"hardening_n_per_m2": 2.0 * s * w.scale.spring_rate_n_per_m / w.scale.travel_m},
        ),
        Hidden(
            "dual_rate_spring",
            0.034,
            "of k",
            lambda s, w, r: {"rate_change_n_per_m": s * w.scale.spring_rate_n_per_m, "knee_m": _place(w, r, 0.3, 0.7)},
        ),
        Hidden(
            "diaphragm_area_change",
            0.012,
            "over travel",
            lambda s, w, _r: {"slope_per_m": s / w.scale.travel_m, "reference_m": (w.low_m + w.high_m) / 2.0},
            True,
        ),
        Hidden(
            "travel_stop_low",
            0.012,
            "of the swept range",
            lambda s, w, _r: {"position_m": w.low_m + s * w.range_m},
        ),
        Hidden(
            "travel_stop_high",
            0.012,
            "of the swept range",
            lambda s, w, _r: {"position_m": w.high_m - s * w.range_m},
        ),
        Hidden(
            "flow_force",
            0.006,
            "of full force",
            lambda s, w, r: {
                "force_n": s * w.scale.full_force_n,
                "decay_m": float(r.uniform(0.15, 0.4)) * w.scale.travel_m,
            },
            True,
        ),
        Hidden("transducer_lag", 0.05, "s", lambda s, _w, _r: {"lag_s": s}),
        Hidden("transducer_dead_time", 0.03, "s", lambda s, _w, _r: {"delay_s": s}),
        Hidden(
            "supply_saturation",
            0.012,
            "of the swept range",
            lambda s, w, _r: {
                "limit_n": w.scale.full_force_n - s * w.range_m * w.scale.spring_rate_n_per_m,
            },
        ),
        Hidden("actuator_leak", 0.005, "of the pressure", lambda s, _w, _r: {"leak": s}, acquired=_WITH_BOTH),
        Hidden(
            "position_backlash",
            0.002,
            "of travel",
            lambda s, w, _r: {"play_m": s * w.scale.travel_m},
            waveforms=_RICH,
        ),
        Hidden(
            "position_gain",
            0.01,
            "of the reading",
            lambda s, _w, _r: {"error": s},
            True,
            waveforms=frozenset(),
        ),
        Hidden(
            "position_nonlinearity",
            0.004,
            "of travel",
            lambda s, w, _r: {"bow_m": s * w.scale.travel_m, "span_m": w.scale.travel_m},
            True,
        ),
        Hidden("position_lag", 0.013, "s", lambda s, _w, _r: {"lag_s": s}, springless=True),
        Hidden(
            "vibration",
            0.002,
            "of full force",
            lambda s, w, r: {
                "force_n": s * w.scale.full_force_n,
                "frequency_hz": float(r.uniform(2.0, 30.0)),
                "phase_rad": float(r.uniform(-3.0, 3.0)),
            },
            springless=True,
        ),
    )
}


def _other_share(rng: np.random.Generator) -> dict[str, float]:
    """In F_c alone, or in proportion to F_c and F_s of the usual valve; the usual law has both rise alike."""
    return {"static_share": float(rng.choice((0.0, 1.2)))}


# What an effect of the same strength is where it obeys another law: straight over time, bent over travel, a sine.
OTHER_LAWS: Final[dict[str, Fill]] = {
    "local_friction": lambda _s, _w, r: _other_share(r),
    "friction_gradient": lambda s, w, r: {
        **_other_share(r),
        "bend_n_per_m2": float(r.choice((-1.0, 0.0, 1.0))) * s * w.scale.friction_n / w.scale.travel_m**2,
    },
    "friction_drift": lambda s, w, r: {
        **_other_share(r), "change_n": s * w.scale.friction_n, "time_constant_s": 1.0e5, "span_s": w.duration_s
    },
    "pressure_dependent_friction": lambda _s, _w, r: _other_share(r),
    "spring_hardening": lambda s, w, _r: {
        "hardening_n_per_m2": 0.0, "bend_n_per_m3": 4.0 * s * w.scale.spring_rate_n_per_m / w.scale.travel_m**2
    },
    "position_nonlinearity": lambda _s, _w, _r: {"ends": -0.22},
}  # fmt: skip
STOPS: Final = ("travel_stop_low", "travel_stop_high")


def drawn_factor(rng: np.random.Generator, *, large: bool) -> float:
    """A strength in units of its cause's smallest: medium ones up to MEDIUM, large ones from there to LARGEST."""
    low, high = (MEDIUM, LARGEST) if large else (1.0, MEDIUM)
    return _log(rng, low, high)
