"""Causes in the friction, as columns of the balance of forces."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np
from numba import njit

from discrepancy.force_causes.base import ForceCause, Found, Shape, Values, fitted_value, one_column, swept
from discrepancy.force_causes.fitted import Fitted, with_interval
from discrepancy.force_record import ForceRecord
from estimators.samples import FloatArray
from valve.messages import Message, say

SIDE_LOAD: Final = say("side_load", "Look at packing and stem guide for a side load or a lip that points one way.")
_SPEEDS: Final = (0.02, 0.05, 0.12, 0.3)  # of the usual speed
_SPOT_WIDTHS: Final = (0.012, 0.03, 0.08)  # of the swept range
_SPOT_STEP: Final = 1.25  # widths from one centre to the next
_TIMES_S: Final = (5.0, 20.0, 80.0)
_DEFLECTIONS: Final = (1.0e-4, 3.0e-4, 1.0e-3, 3.0e-3)  # of the swept range
# All of the friction, or nearly so, is carried by the bristles.
_LEAST_CARRIED: Final = 0.3
_MOST_CARRIED: Final = 2.0


def _asymmetry_shapes(_record: ForceRecord, _left: FloatArray) -> Iterator[Shape]:
    yield {}


def _asymmetry_column(record: ForceRecord, _shape: Shape) -> FloatArray:
    return one_column(np.abs(record.velocity))


def _read_asymmetry(values: Values, found: Found, _shape: Shape) -> dict[str, Fitted] | None:
    viscous, (change, error) = values["F_v"][0], found[0]
    if not abs(change) < viscous:
        return None
    return {"viscous_asymmetry": fitted_value(change / viscous, error / viscous, "1")}


def _say_asymmetry(parameters: Mapping[str, Fitted], values: Values) -> Message:
    entry, viscous = parameters["viscous_asymmetry"], values["F_v"][0]
    opening, closing = (viscous * (1.0 + sense * entry.value) for sense in (1.0, -1.0))
    return say(
        "viscous_by_direction",
        "Friction differs by direction: viscous friction is {up:.1f N*s/m} towards larger positions and "
        "{down:.1f N*s/m} back, {apart} apart.",
        up=opening,
        down=closing,
        apart=with_interval(entry, "%", 2.0),
    )


ASYMMETRY: Final = ForceCause(
    "friction_asymmetry", _asymmetry_shapes, _asymmetry_column, _read_asymmetry, _say_asymmetry, SIDE_LOAD
)


def _stribeck_shapes(record: ForceRecord, _left: FloatArray) -> Iterator[Shape]:
    usual = float(np.median(np.abs(record.velocity[record.rows])))
    for share in _SPEEDS:
        yield {"speed_m_per_s": share * usual}


def _stribeck_column(record: ForceRecord, shape: Shape) -> FloatArray:
    return one_column(record.sense * np.exp(-((record.velocity / shape["speed_m_per_s"]) ** 2)))


def _read_stribeck(_values: Values, found: Found, shape: Shape) -> dict[str, Fitted] | None:
    excess, error = found[0]
    if excess <= 0.0:
        return None
    speed = shape["speed_m_per_s"]
    return {
        "excess_n": fitted_value(excess, error, "N"),
        "speed_m_per_s": Fitted(speed, 0.6 * speed, 1.6 * speed, "m/s"),
    }


def _say_stribeck(parameters: Mapping[str, Fitted], _values: Values) -> Message:
    return say(
        "drive_friction_falls_with_speed",
        "Friction falls with speed, by {excess} over about {speed:.1f mm/s}.",
        excess=with_interval(parameters["excess_n"], "N"),
        speed=parameters["speed_m_per_s"].value,
    )


STRIBECK: Final = ForceCause(
    "stribeck_friction",
    _stribeck_shapes,
    _stribeck_column,
    _read_stribeck,
    _say_stribeck,
    say("look_at_lubrication", "The stem will stick and slip at low speed: lubricate or change the packing."),
    {"speed_m_per_s": ""},
)


def _presliding_shapes(record: ForceRecord, _left: FloatArray) -> Iterator[Shape]:
    for share in _DEFLECTIONS:
        yield {"deflection_m": share * swept(record)[1]}


def _presliding_column(record: ForceRecord, shape: Shape) -> FloatArray:
    """Dahl's friction over F_c without the jump: after a turn it comes to the other side within a few deflections."""
    left = np.exp(-np.abs(record.velocity) * record.samples.period_s / shape["deflection_m"])
    built_up = _followed(np.sign(record.velocity), left, float(record.sense[0]))
    return one_column(np.asarray(built_up - record.sense))


@njit(cache=True)
def _followed(sense: FloatArray, left: FloatArray, start: float) -> FloatArray:
    """What follows ``sense``, (n,), and keeps the share ``left``, (n,), of its distance at each row."""
    found = np.empty(sense.size)
    at = start
    for row in range(sense.size):
        at = sense[row] + (at - sense[row]) * left[row]
        found[row] = at
    return found


def _read_presliding(values: Values, found: Found, shape: Shape) -> dict[str, Fitted] | None:
    share = found[0][0] / values["F_c"][0] if values["F_c"][0] > 0.0 else 0.0
    if not _LEAST_CARRIED < share < _MOST_CARRIED:
        return None
    deflection_m = shape["deflection_m"]
    return {"deflection_m": Fitted(deflection_m, 0.5 * deflection_m, 2.0 * deflection_m, "m")}


def _say_presliding(parameters: Mapping[str, Fitted], _values: Values) -> Message:
    return say(
        "friction_builds_up",
        "After a turn friction does not jump to the other side but builds up elastically, over about "
        "{deflection:.0f um}.",
        deflection=parameters["deflection_m"].value,
    )


PRESLIDING: Final = ForceCause(
    "presliding",
    _presliding_shapes,
    _presliding_column,
    _read_presliding,
    _say_presliding,
    say("look_at_give", "Look at the packing's and the coupling's give: a soft packing or a loose yoke."),
    {"deflection_m": ""},
)


def _spot_shapes(record: ForceRecord, _left: FloatArray) -> Iterator[Shape]:
    low_m, swept_m = swept(record)
    for width in _SPOT_WIDTHS:
        spots = math.ceil(1.0 / (_SPOT_STEP * width))
        for number in range(spots):
            yield {"centre_m": low_m + (number + 0.5) / spots * swept_m, "width_m": width * swept_m}


def _spot_column(record: ForceRecord, shape: Shape) -> FloatArray:
    away = (record.samples.position_m - shape["centre_m"]) / shape["width_m"]
    return one_column(record.sense * np.exp(-0.5 * away**2))


def _read_spot(_values: Values, found: Found, shape: Shape) -> dict[str, Fitted] | None:
    centre, width = shape["centre_m"], shape["width_m"]
    return {
        "rise_n": fitted_value(*found[0], "N"),
        "centre_m": Fitted(centre, centre - width, centre + width, "m"),
        "width_m": Fitted(width, 0.5 * width, 2.0 * width, "m"),
    }


def _say_spot(parameters: Mapping[str, Fitted], _values: Values) -> Message:
    rise, at_m = with_interval(parameters["rise_n"], "N"), parameters["centre_m"].value
    if parameters["rise_n"].value > 0.0:
        return say("friction_higher_at", "Friction is {rise} higher about {at:.0f mm}, both ways.", rise=rise, at=at_m)
    return say("friction_lower_at", "Friction is {rise} lower about {at:.0f mm}, both ways.", rise=rise, at=at_m)


SPOT: Final = ForceCause(
    "local_friction",
    _spot_shapes,
    _spot_column,
    _read_spot,
    _say_spot,
    say("look_at_stem_there", "Look at stem and packing there: a bent stem, galling, a deposit."),
    {"centre_m": "width_m", "width_m": ""},
)


def _gradient_shapes(record: ForceRecord, _left: FloatArray) -> Iterator[Shape]:
    low_m, swept_m = swept(record)
    yield {"reference_m": low_m + 0.5 * swept_m}


def _gradient_column(record: ForceRecord, shape: Shape) -> FloatArray:
    return one_column(record.sense * (record.samples.position_m - shape["reference_m"]))


def _read_gradient(_values: Values, found: Found, shape: Shape) -> dict[str, Fitted] | None:
    middle = shape["reference_m"]
    return {"gradient_n_per_m": fitted_value(*found[0], "N/m"), "reference_m": Fitted(middle, middle, middle, "m")}


def _say_gradient(parameters: Mapping[str, Fitted], _values: Values) -> Message:
    a_cm = with_interval(parameters["gradient_n_per_m"], "N", 0.01)
    if parameters["gradient_n_per_m"].value > 0.0:
        return say("friction_grows_a_cm", "Friction grows along the travel, by {change} a cm.", change=a_cm)
    return say("friction_falls_a_cm", "Friction falls along the travel, by {change} a cm.", change=a_cm)


GRADIENT: Final = ForceCause(
    "friction_gradient",
    _gradient_shapes,
    _gradient_column,
    _read_gradient,
    _say_gradient,
    say("look_at_guide", "Look at the guide: out of line, or worn at one end."),
)


def _drift_shapes(_record: ForceRecord, _left: FloatArray) -> Iterator[Shape]:
    for constant_s in _TIMES_S:
        yield {"time_constant_s": constant_s}


def _drift_column(record: ForceRecord, shape: Shape) -> FloatArray:
    return one_column(record.sense * (1.0 - np.exp(-record.time_s / shape["time_constant_s"])))


def _read_drift(_values: Values, found: Found, shape: Shape) -> dict[str, Fitted] | None:
    constant_s = shape["time_constant_s"]
    return {
        "change_n": fitted_value(*found[0], "N"),
        "time_constant_s": Fitted(constant_s, 0.5 * constant_s, 2.0 * constant_s, "s"),
    }


def _say_drift(parameters: Mapping[str, Fitted], _values: Values) -> Message:
    change, constant_s = with_interval(parameters["change_n"], "N"), parameters["time_constant_s"].value
    if parameters["change_n"].value > 0.0:
        return say(
            "friction_rose",
            "Friction rose by up to {change}, with a time constant of about {time:.0f} s.",
            change=change,
            time=constant_s,
        )
    return say(
        "friction_fell",
        "Friction fell by up to {change}, with a time constant of about {time:.0f} s.",
        change=change,
        time=constant_s,
    )


DRIFT: Final = ForceCause(
    "friction_drift",
    _drift_shapes,
    _drift_column,
    _read_drift,
    _say_drift,
    say("exercise_and_repeat", "Exercise the valve and test again; if it goes on, look at packing and lubrication."),
    {"time_constant_s": ""},
)

FRICTION: Final = (ASYMMETRY, STRIBECK, PRESLIDING, SPOT, GRADIENT, DRIFT)
