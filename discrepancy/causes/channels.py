"""Causes between the command and the pressure, and between the stem and its reading."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from discrepancy.causes.base import Cause, Fitted, Part, Setting, Values, with_interval
from discrepancy.commanded import DEAD_TIME_S, LAG_S
from discrepancy.observed import Observed

_DELAYS: Final = ("transducer_lag.lag_s", "transducer_dead_time.delay_s", "position_lag.lag_s")
_LEAST_S: Final = 0.01  # an I/P's own


def _command_only(observed: Observed) -> bool:
    return observed.command_only


def _commanded(setting: Setting, parameter: str) -> list[Values]:
    """Return the start of a delay of any kind, its ``parameter``, s, with maximum likelihood's valve beside it.

    The plain valve of a command that comes late is another one altogether: damping and mass stand in for the delay, and
    no way from there leads down. All that the command comes late by is given to one cause, as far as none has it yet.
    """
    values = dict(setting.observed.commanded)
    late_s = values.pop(LAG_S, 0.0) + values.pop(DEAD_TIME_S, 0.0)
    late_s -= sum(setting.values.get(name, 0.0) for name in _DELAYS)
    return [{parameter: late_s, **values}] if late_s > _LEAST_S else []


def _late(name: str, parameter: str, said: str, action: str) -> Cause:
    """Return the cause of a pressure that comes late by ``parameter``, s, which ``said`` tells."""

    def starts(setting: Setting) -> list[Values]:
        return [{parameter: late_s} for late_s in (0.05, 0.3)] + _commanded(setting, parameter)

    def sentence(values: Mapping[str, Fitted], _setting: Setting) -> str:
        return said.format(with_interval(values[parameter], 1.0, "s"))

    return Cause(name, parameter, (Part(parameter, step=1.0e-3),), starts, sentence, action, is_visible=_command_only)


TRANSDUCER_LAG: Final = _late(
    "transducer_lag",
    "lag_s",
    "The pressure lags the command by {}.",
    "Look at the I/P's supply, its filter and the tubing; a booster shortens it.",
)

DEAD_TIME: Final = _late(
    "transducer_dead_time",
    "delay_s",
    "The pressure follows the command {} late.",
    "Look for long tubing or a slow device between the command and the actuator.",
)


def _saturation_sentence(values: Mapping[str, Fitted], setting: Setting) -> str:
    area_m2 = setting.observed.nameplate.actuator.diaphragm_area_m2
    if area_m2 is None:
        return f"The actuator's force does not rise above {with_interval(values['limit_n'], 1.0, 'N')}."
    return f"The pressure does not rise above {with_interval(values['limit_n'], 1.0e-3 / area_m2, 'kPa')}."


SATURATION: Final = Cause(
    "supply_saturation",
    "limit_n",
    (Part("limit_n"),),
    lambda setting: [{"limit_n": share * setting.scale.full_force_n} for share in (0.98, 0.93, 0.8, 0.6)],
    _saturation_sentence,
    "Look at the air supply's pressure and its regulator.",
    is_visible=_command_only,
    neutral=None,
)


def _leak_sentence(values: Mapping[str, Fitted], _setting: Setting) -> str:
    return f"The pressure stays {with_interval(values['leak'], 100.0, '%')} below what the command asks for."


LEAK: Final = Cause(
    "actuator_leak",
    "leak",
    (Part("leak"),),
    lambda _setting: [],
    _leak_sentence,
    "Look for a leak in the actuator, its diaphragm and the tubing, and calibrate the I/P.",
    # of a command alone it is a share of k, F_0 and the frictions: only a measured pressure shows it
    is_visible=lambda _observed: False,
)


def _play_sentence(values: Mapping[str, Fitted], _setting: Setting) -> str:
    return f"The position reading has {with_interval(values['play_m'], 1.0e6, 'um')} of lost motion."


BACKLASH: Final = Cause(
    "position_backlash",
    "play_m",
    (Part("play_m", step=1.0e-3),),
    lambda setting: [{"play_m": share * setting.scale.travel_m} for share in (0.001, 0.005, 0.02)],
    _play_sentence,
    "Look at the linkage between stem and position sensor: a worn pin, a loose clamp.",
    is_shy=True,
)


def _bow_sentence(values: Mapping[str, Fitted], setting: Setting) -> str:
    entry = values["bow_m"]
    sense = "too much" if entry.value > 0.0 else "too little"
    share = with_interval(entry, 100.0 / setting.observed.nameplate.actuator.travel_m, "%")
    return f"The position reads up to {share} of the travel {sense} in the middle of the span."


BOW: Final = Cause(
    "position_nonlinearity",
    "bow_m",
    (Part("bow_m"),),
    lambda setting: [{"bow_m": 0.004 * setting.scale.travel_m}],
    _bow_sentence,
    "Put the sensor's lever square to the stem at mid travel, or linearise the sensor.",
    # a sensor is set at both ends of the rated travel: from there on what is straight in the reading is no bow
    held=lambda setting: {"span_m": setting.scale.travel_m, "low_m": 0.0},
    forms=(Part("skew"), Part("ends")),
)


def _reading_lag_sentence(values: Mapping[str, Fitted], _setting: Setting) -> str:
    return f"The position reading lags by {with_interval(values['lag_s'], 1.0e3, 'ms')}."


def _reading_lag_starts(setting: Setting) -> list[Values]:
    """A lag beside the damping as it is, and in its place: on ramps L looks like k L of F_v.

    Where the stem starts and stops a lag looks like mass too, so that in its place the nameplate's mass begins anew.
    """
    viscous, late_s = setting.values["F_v"], setting.values["F_v"] / setting.values["k"]
    mass_kg = setting.observed.motions[0].moving_mass_kg or setting.values["m"]
    instead = [{"lag_s": share * late_s, "F_v": (1.0 - share) * viscous, "m": mass_kg} for share in (0.3, 0.6, 0.9)]
    own = {"F_v": viscous, "m": setting.values["m"]}
    return [{"lag_s": 0.01, **own}, {"lag_s": 0.1, **own}, *instead, *_commanded(setting, "lag_s")]


READING_LAG: Final = Cause(
    "position_lag",
    "lag_s",
    (Part("lag_s", step=1.0e-3),),
    _reading_lag_starts,
    _reading_lag_sentence,
    "Take the filter out of the position transmitter, or tell its time constant.",
    is_shy=True,
    neutral=None,
)

CHANNELS: Final = (TRANSDUCER_LAG, DEAD_TIME, SATURATION, LEAK, BACKLASH, BOW, READING_LAG)
