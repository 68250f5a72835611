"""Causes in the friction."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from typing import Final

import numpy as np

from discrepancy.causes.base import Cause, Fitted, Part, Setting, Values, newtons, with_interval

_PACKING: Final = "Look at packing and stem guide"
# What is added is in F_c and F_s alike, in proportion to each, or in F_c alone: no law says which.
_STATIC_FORM: Final = (Part("static_share"),)


def _asymmetry_starts(_setting: Setting) -> list[Values]:
    return [{"asymmetry": 0.05}]


def _asymmetry_sentence(values: Mapping[str, Fitted], setting: Setting) -> str:
    entry = values["asymmetry"]
    harder, easier = ("opening", "closing") if entry.value > 0.0 else ("closing", "opening")
    more = with_interval(entry, 2.0 * setting.values["F_c"], "N")
    return f"Friction is {more} higher {harder} than {easier}."


ASYMMETRY: Final = Cause(
    "friction_asymmetry",
    "asymmetry",
    (Part("asymmetry"),),
    _asymmetry_starts,
    _asymmetry_sentence,
    f"{_PACKING} for a side load or a lip that points one way.",
    held=lambda _setting: {"viscous_asymmetry": 0.0},
)


def _stribeck_starts(setting: Setting) -> list[Values]:
    """Starts with the breakaway as it is, and a grid of what follows: speed, drop and damping.

    A Karnopp valve mimics a falling friction by a large DV or F_v, so both begin anew.
    """
    own, speed = setting.values, setting.sliding_m_per_s
    static_n, total_n = own["F_c"] * (1.0 + own["d"]), own["F_c"] + own["F_v"] * speed
    starts = []
    for share, drop, viscous in product((0.3, 1.0, 3.0), (0.1, 0.25, 0.5), (0.004, 0.02, 0.1)):
        coulomb_n = static_n / (1.0 + drop)
        viscous_n = viscous * total_n / speed
        starts.append(
            {"speed_m_per_s": share * speed, "F_c": coulomb_n, "d": drop, "F_v": viscous_n, "DV": 0.015 * speed}
        )
    return starts


def _stribeck_sentence(values: Mapping[str, Fitted], setting: Setting) -> str:
    drop = setting.values["F_c"] * setting.values["d"]
    speed = with_interval(values["speed_m_per_s"], 1.0e3, "mm/s")
    return f"Friction falls with speed: it loses most of its excess of {drop:.0f} N over {speed}."


STRIBECK: Final = Cause(
    "stribeck_friction",
    "speed_m_per_s",
    (Part("speed_m_per_s", is_log=True, low=2.0e-4, high=0.5, step=1.0e-3),),
    _stribeck_starts,
    _stribeck_sentence,
    "The stem will stick and slip at low speed: lubricate or change the packing.",
    is_hard=True,
    neutral=None,
)


def _spot_starts(setting: Setting) -> list[Values]:
    return [
        {"rise_n": 0.05 * setting.scale.friction_n, "centre_m": setting.at(share), "width_m": width * setting.swept_m}
        for width, places in ((0.012, 24), (0.035, 12))
        for share in (np.arange(places) + 0.5) / places
    ]


def _spot_sentence(values: Mapping[str, Fitted], setting: Setting) -> str:
    rise, centre, width = values["rise_n"], values["centre_m"].value, values["width_m"].value
    half = 1.18 * width  # at half the rise
    between = f"between {setting.percent(centre - half):.1f} and {setting.percent(centre + half):.1f} % travel"
    if rise.value > 0.0:
        return f"Friction is {newtons(rise)} higher {between}, both ways: a tight spot."
    return f"Friction is {with_interval(rise, 1.0, 'N')} lower {between}, both ways: a worn spot."


LOCAL: Final = Cause(
    "local_friction",
    "rise_n",
    (Part("rise_n"), Part("centre_m", step=1.0e-4), Part("width_m", is_log=True, step=1.0e-3)),
    _spot_starts,
    _spot_sentence,
    "Look at stem and packing there: a bent stem, galling, a deposit.",
    forms=_STATIC_FORM,
)


def _gradient_sentence(values: Mapping[str, Fitted], setting: Setting) -> str:
    entry = values["gradient_n_per_m"]
    sense = "grows" if entry.value > 0.0 else "falls"
    over = with_interval(entry, setting.observed.nameplate.actuator.travel_m, "N")
    return f"Friction {sense} by {over} over the travel."


GRADIENT: Final = Cause(
    "friction_gradient",
    "gradient_n_per_m",
    (Part("gradient_n_per_m"),),
    lambda setting: [{"gradient_n_per_m": 0.03 * setting.scale.friction_n / setting.scale.travel_m}],
    _gradient_sentence,
    "Look at the guide: out of line, or worn at one end.",
    held=lambda setting: {"reference_m": setting.at(0.5)},
    forms=(*_STATIC_FORM, Part("bend_n_per_m2")),
)


def _drift_starts(setting: Setting) -> list[Values]:
    change_n = -0.02 * setting.scale.friction_n
    return [{"change_n": change_n, "time_constant_s": time_s} for time_s in (6.0, 25.0, 120.0, 3000.0)]


def _drift_held(setting: Setting) -> Values:
    """Count the change at the record's end: that is known where the time constant is not."""
    segments = setting.observed.segments
    return {"span_s": max(float(one.time_s[-1] - one.time_s[0]) + one.elapsed_s for one in segments)}


def _drift_sentence(values: Mapping[str, Fitted], _setting: Setting) -> str:
    sense = "rose" if values["change_n"].value > 0.0 else "fell"
    return f"Friction {sense} by {with_interval(values['change_n'], 1.0, 'N')} during the record."


DRIFT: Final = Cause(
    "friction_drift",
    "change_n",
    # a very long time constant is a straight line
    (Part("change_n"), Part("time_constant_s", is_log=True, step=1.0e-3, is_endless=True)),
    _drift_starts,
    _drift_sentence,
    "Exercise the valve and test again; if it goes on, look at packing and lubrication.",
    held=_drift_held,
    forms=_STATIC_FORM,
)


def _pressure_sentence(values: Mapping[str, Fitted], _setting: Setting) -> str:
    return f"Friction grows with the pressure, by {with_interval(values['share'], 100.0, '%')} of the actuator's force."


PRESSURE: Final = Cause(
    "pressure_dependent_friction",
    "share",
    (Part("share"),),
    lambda _setting: [{"share": 0.003}],
    _pressure_sentence,
    "Look at the piston's or diaphragm's seals.",
    forms=_STATIC_FORM,
)


def _dwell_starts(setting: Setting) -> list[Values]:
    return [{"rise_n": 0.1 * setting.scale.friction_n, "time_s": time_s} for time_s in (0.5, 3.0, 20.0)]


def _dwell_sentence(values: Mapping[str, Fitted], _setting: Setting) -> str:
    half = with_interval(values["time_s"], 1.0, "s")
    return f"Breakaway grows with the time at rest, by up to {newtons(values['rise_n'])}, half of it after {half}."


DWELL: Final = Cause(
    "dwell_dependent_breakaway",
    "rise_n",
    (Part("rise_n"), Part("time_s", is_log=True, step=1.0e-3)),
    _dwell_starts,
    _dwell_sentence,
    "Exercise the valve regularly; if it grows, change packing or lubricant.",
    is_shy=True,
)


def _presliding_starts(setting: Setting) -> list[Values]:
    """Starts from the valve as it is, and a grid of deflection and damping with the friction in motion kept.

    Where friction is small beside what yields, a wide DV and a large F_v stand in for it, so both begin anew.
    """
    own, speed, travel_m = setting.values, setting.sliding_m_per_s, setting.scale.travel_m
    total_n = own["F_c"] + own["F_v"] * speed
    anew = {"DV": 0.015 * speed, "first_rise": 0.0, "m": setting.observed.motions[0].moving_mass_kg or own["m"]}
    starts: list[Values] = [{"deflection_m": share * travel_m} for share in (3.0e-4, 1.0e-3, 4.0e-3)]
    for share, viscous in product((1.0e-3, 3.0e-3, 8.0e-3), (0.02, 0.15, 0.4)):
        coulomb_n = (1.0 - viscous) * total_n
        d = max(own["F_c"] * (1.0 + own["d"]) / coulomb_n - 1.0, 0.0)
        viscous_n = viscous * total_n / speed
        starts.append({"deflection_m": share * travel_m, "F_c": coulomb_n, "F_v": viscous_n, "d": d, **anew})
    return starts


def _presliding_sentence(values: Mapping[str, Fitted], _setting: Setting) -> str:
    way = with_interval(values["deflection_m"], 1.0e6, "um")
    return f"The stem gives elastically before it breaks away, by {way} at the static friction."


PRESLIDING: Final = Cause(
    "presliding",
    "deflection_m",
    (Part("deflection_m", step=1.0e-3),),
    _presliding_starts,
    _presliding_sentence,
    "Look at the packing's and the coupling's give: a soft packing or a loose yoke.",
    # without the stem's inertia and the bristles' own damping (docs/effects.md): 0.6 % of what 0.7 mm do (9141), and
    # 2.7 % of 0.45 mm at many rates, which a reading 4 ms late takes (pair 11115)
    law_error=0.03,
    # its bristles carry no mass here: a wide DV takes that up at the ramps' speed, and predicts no other
    widest_limit=0.2,
)


FRICTION: Final = (ASYMMETRY, STRIBECK, LOCAL, GRADIENT, DRIFT, PRESSURE, DWELL, PRESLIDING)
