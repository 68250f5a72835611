"""Causes in the spring, the diaphragm, the stops and what else pushes the stem."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np

from discrepancy.causes.base import Cause, Fitted, Part, Setting, Values, strongest_frequencies, with_interval
from discrepancy.locking import locked_forces, locked_share
from discrepancy.shaking import clear_share, lines, shaken_breakaways

_SEEN_NOISES: Final = 4.0  # that a stem must have moved to be seen to
_MOST_STATIC: Final = 5.0  # of F_c, as far as a fit's d goes
_LEAST_EXCESS: Final = 0.02  # of F_c


def _hardening_sentence(values: Mapping[str, Fitted], setting: Setting) -> str:
    entry = values["hardening_n_per_m2"]
    travel_m = setting.observed.nameplate.actuator.travel_m
    share = with_interval(entry, 100.0 * travel_m / setting.values["k"], "%")
    return f"The spring's rate {'rises' if entry.value > 0.0 else 'falls'} by {share} over the travel."


HARDENING: Final = Cause(
    "spring_hardening",
    "hardening_n_per_m2",
    (Part("hardening_n_per_m2"),),
    lambda setting: [{"hardening_n_per_m2": 0.02 * setting.values["k"] / setting.scale.travel_m}],
    _hardening_sentence,
    "Look at the actuator's spring: coils that close, a wrong spring.",
    held=lambda setting: {"middle_m": setting.at(0.5)},
    forms=(Part("bend_n_per_m3"),),
)


def _knee_starts(setting: Setting) -> list[Values]:
    return [
        {"rate_change_n_per_m": 0.03 * setting.values["k"], "knee_m": setting.at(share)}
        for share in (0.2, 0.35, 0.5, 0.65, 0.8)
    ]


def _knee_sentence(values: Mapping[str, Fitted], setting: Setting) -> str:
    entry = values["rate_change_n_per_m"]
    share = with_interval(entry, 100.0 / setting.values["k"], "%")
    sense = "stiffer" if entry.value > 0.0 else "softer"
    return f"The spring is {share} {sense} beyond {setting.percent(values['knee_m'].value):.1f} % travel."


KNEE: Final = Cause(
    "dual_rate_spring",
    "rate_change_n_per_m",
    (Part("rate_change_n_per_m"), Part("knee_m", step=1.0e-4)),
    _knee_starts,
    _knee_sentence,
    "Look at the actuator's springs: a second spring that meets, a broken one, coils that close.",
)


def _area_sentence(values: Mapping[str, Fitted], setting: Setting) -> str:
    entry = values["slope_per_m"]
    share = with_interval(entry, 100.0 * setting.observed.nameplate.actuator.travel_m, "%")
    return f"The diaphragm's effective area {'grows' if entry.value > 0.0 else 'shrinks'} by {share} over the travel."


AREA: Final = Cause(
    "diaphragm_area_change",
    "slope_per_m",
    (Part("slope_per_m"),),
    lambda setting: [{"slope_per_m": -0.02 / setting.scale.travel_m}],
    _area_sentence,
    "Usual in rolling diaphragms within a few percent; beyond, look at the diaphragm and its plate.",
    held=lambda setting: {"reference_m": setting.at(0.5)},
)


def _flow_starts(setting: Setting) -> list[Values]:
    return [
        {"force_n": 0.005 * setting.scale.full_force_n, "decay_m": share * setting.scale.travel_m}
        for share in (0.06, 0.15, 0.35, 0.8)
    ]


def _flow_sentence(values: Mapping[str, Fitted], setting: Setting) -> str:
    entry = values["force_n"]
    sense = "opens" if entry.value > 0.0 else "closes"
    where = 100.0 * values["decay_m"].value / setting.observed.nameplate.actuator.travel_m
    return (
        f"A force on the plug of {with_interval(entry, 1.0, 'N')} at the seat {sense} the valve; "
        f"it falls to a third over {where:.0f} % travel."
    )


FLOW: Final = Cause(
    "flow_force",
    "force_n",
    (Part("force_n"), Part("decay_m", is_log=True, step=1.0e-3)),
    _flow_starts,
    _flow_sentence,
    "Compare with the line's pressure drop; test without flow if it should not be there.",
)


def _low_stop_starts(setting: Setting) -> list[Values]:
    lowest = float(np.quantile(setting.observed.position_m, 0.01))
    return [{"position_m": lowest + share * setting.swept_m} for share in (0.0, 0.002, 0.01)]


def _high_stop_starts(setting: Setting) -> list[Values]:
    highest = float(np.quantile(setting.observed.position_m, 0.99))
    return [{"position_m": highest - share * setting.swept_m} for share in (0.0, 0.002, 0.01)]


def _stop_sentence(values: Mapping[str, Fitted], setting: Setting) -> str:
    at = with_interval(values["position_m"], 1.0e3, "mm")
    return f"The stem runs into a stop at {at}, {setting.percent(values['position_m'].value):.1f} % travel."


LOW_STOP: Final = Cause(
    "travel_stop_low",
    "position_m",
    (Part("position_m"),),
    _low_stop_starts,
    _stop_sentence,
    "Look at the seat and at what may lie on it, and at the stroke's adjustment.",
    held=lambda _setting: {"rate_n_per_m": 0.0},
    neutral=None,
    is_quick=True,
    is_end=True,
)
HIGH_STOP: Final = Cause(
    "travel_stop_high",
    "position_m",
    (Part("position_m"),),
    _high_stop_starts,
    _stop_sentence,
    "Look at the limit screw or handwheel and at what may lie in the body.",
    held=lambda _setting: {"rate_n_per_m": 0.0},
    neutral=None,
    is_quick=True,
    is_end=True,
)


def _locked_starts(setting: Setting, anew: Values) -> list[Values]:
    """Starts for steps that lock to a periodic force, by when each of them begins; friction in motion begins anew."""
    own = setting.values
    # the first breakaway is helped as the others are
    first_n = own["F_c"] * (1.0 + own["d"]) + own["first_rise"]
    return [
        {
            "force_n": one.force_n,
            "frequency_hz": one.frequency_hz,
            "phase_rad": one.phase_rad,
            "k": one.spring_n_per_m,
            "F_0": one.preload_n,
            **_static(one.static_n, own),
            "F_v": own["F_v"],
            "first_rise": first_n + one.force_n - one.static_n,
            **anew,
        }
        for one in locked_forces(setting.observed, _seen_late(setting, anew["m"]), own)
    ]


def _static(static_n: float, own: Mapping[str, float]) -> Values:
    """Return the unknowns of this static friction, with F_c as it is; anew where that is next to nothing beside it."""
    if static_n > _MOST_STATIC * own["F_c"]:
        return {"F_c": static_n, "d": 0.0}
    return {"d": max(static_n / own["F_c"] - 1.0, 0.0)}


def _seen_late(setting: Setting, mass_kg: float) -> float:
    """Return how long after it a breakaway is seen, s: when the excess of static friction has moved the stem enough."""
    own, observed = setting.values, setting.observed
    excess_n = max(own["F_c"] * own["d"], _LEAST_EXCESS * own["F_c"])
    return (
        math.sqrt(2.0 * _SEEN_NOISES * observed.noise_m * mass_kg / excess_n)
        + 0.5 * observed.motions[0].samples.period_s
    )


def _vibration_starts(setting: Setting) -> list[Values]:
    """Starts by the lines in the misfit, by the forces at the breakaways, and by the steps' own frequency."""
    observed, own = setting.observed, setting.values
    starts: list[Values] = []
    # a heavy stem and a wide band of rest may stand in for what shakes
    anew = {"DV": 0.015 * setting.sliding_m_per_s, "m": observed.motions[0].moving_mass_kg or own["m"]}
    static_n = own["F_c"] * (1.0 + own["d"])
    for line in lines(observed, setting.residual_m, 3):
        force_n, phase_rad = line.force(own["m"], own["k"], own["F_v"])
        linear = {"force_n": force_n, "frequency_hz": line.frequency_hz, "phase_rad": phase_rad}
        start = {**linear, **anew}
        # the breakaways that were seen had the force's help, and the stops its speed
        start["d"] = (static_n + force_n) / own["F_c"] - 1.0
        start["DV"] = max(own["DV"] - line.amplitude_m_per_s, start["DV"])
        starts += [linear, start]
    balanced = [
        {
            "force_n": shaken.force_n,
            "frequency_hz": shaken.frequency_hz,
            "phase_rad": shaken.phase_rad,
            "k": shaken.spring_n_per_m,
            "F_0": shaken.preload_n,
            **_static(shaken.static_n, own),
            **anew,
            **shaken.beside,
        }
        for shaken in shaken_breakaways(observed, 3, own)
    ]
    # steps that lock hide the line and all but a constant of the forces: what tells them goes first
    locked = _locked_starts(setting, anew)
    starts = [*locked, *starts, *balanced]
    # where each period of the force lets the stem slip, its steps show the frequency better than the misfit
    time_s = observed.time_s
    found = strongest_frequencies(time_s, np.gradient(observed.position_m, time_s), 2)
    force_n = 0.002 * setting.scale.full_force_n
    starts += [
        {"force_n": force_n, "frequency_hz": frequency_hz, "phase_rad": phase_rad}
        for frequency_hz in found
        for phase_rad in (-2.3, -0.8, 0.8, 2.3)
    ]
    return starts


def _vibration_promise(setting: Setting) -> float:
    """Return what a clear wave takes of the forces at hundreds of breakaways, or of when some dozens of them came."""
    observed = setting.observed
    mass_kg = observed.motions[0].moving_mass_kg or setting.values["m"]
    late_s = _seen_late(setting, mass_kg)
    return max(clear_share(observed, setting.values), locked_share(observed, late_s, setting.values))


def _vibration_sentence(values: Mapping[str, Fitted], _setting: Setting) -> str:
    force = with_interval(values["force_n"], 1.0, "N")
    return f"A periodic force of {force} shakes the stem at {values['frequency_hz'].value:.2f} Hz."


VIBRATION: Final = Cause(
    "vibration",
    "force_n",
    (Part("force_n"), Part("frequency_hz", is_log=True, step=1.0e-6), Part("phase_rad", low=-7.0, high=7.0)),
    _vibration_starts,
    _vibration_sentence,
    "Look for what shakes at this frequency: a pump, flow past the plug, a loose bracket.",
    promise=_vibration_promise,
    is_slow=True,
    is_periodic=True,
)

FORCES: Final = (HARDENING, KNEE, AREA, LOW_STOP, HIGH_STOP, FLOW, VIBRATION)
