"""What each cause adds to the balance of forces of a drive without a spring: one column for each start."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit

from discrepancy.causes.base import Fitted, strongest_frequencies, with_interval
from discrepancy.force_record import ForceRecord
from discrepancy.registry import CAUSES
from estimators.samples import FloatArray

# Values of a fit by name: BASE's, and a coefficient for each column of a cause.
Columns = Callable[[ForceRecord], FloatArray]
_SPEEDS: Final = (0.02, 0.05, 0.12, 0.3)  # of the usual speed
_SPOTS: Final = 16
_SPOT_WIDTHS: Final = (0.03, 0.08)  # of the swept range
_TIMES_S: Final = (5.0, 20.0, 80.0)
_DEFLECTIONS: Final = (1.0e-4, 3.0e-4, 1.0e-3, 3.0e-3)  # of the swept range
_SLOWEST_HZ: Final = 1.5  # slower than that it is the motion itself
_PERIODS: Final = 1.0  # of sampling: a delay between the channels that every record may have


@dataclass(frozen=True, slots=True, eq=False)
class ForceStart:
    """A cause with its shape fixed: its columns (n, q) of a record, unfiltered, and what is known of the shape."""

    cause: str
    shape: Mapping[str, float]
    columns: Columns


Values = Mapping[str, tuple[float, float]]  # value and standard error
Reader = Callable[[Values, tuple[tuple[float, float], ...], Mapping[str, float]], dict[str, Fitted] | None]


@dataclass(frozen=True, slots=True)
class ForceCause:
    """A cause as a force: its starts, what its coefficients mean (None where they are not physical), its sentence."""

    name: str
    starts: Callable[[ForceRecord, FloatArray], Iterator[ForceStart]]
    read: Reader
    sentence: Callable[[Mapping[str, Fitted], Values], str]

    @property
    def action(self) -> str:
        """What a fitter does about it."""
        return CAUSES[self.name].action


def fitted_value(value: float, error: float, unit: str) -> Fitted:
    """Return a value with its 95 % interval."""
    return Fitted(value, value - 1.96 * error, value + 1.96 * error, unit)


def _swept(record: ForceRecord) -> tuple[float, float]:
    position_m = record.samples.position_m[record.rows]
    return float(position_m.min()), float(np.ptp(position_m))


def _usual_speed(record: ForceRecord) -> float:
    return float(np.median(np.abs(record.velocity[record.rows])))


def _one(column: FloatArray) -> FloatArray:
    return np.asarray(column[:, None])


def _asymmetry_starts(_record: ForceRecord, _left: FloatArray) -> Iterator[ForceStart]:
    yield ForceStart("friction_asymmetry", {}, lambda record: _one(np.abs(record.velocity)))


def _read_asymmetry(
    values: Values, found: tuple[tuple[float, float], ...], _shape: Mapping[str, float]
) -> dict[str, Fitted] | None:
    viscous, (change, error) = values["F_v"][0], found[0]
    if not abs(change) < viscous:
        return None
    return {"viscous_asymmetry": fitted_value(change / viscous, error / viscous, "1")}


def _say_asymmetry(parameters: Mapping[str, Fitted], values: Values) -> str:
    entry, viscous = parameters["viscous_asymmetry"], values["F_v"][0]
    opening, closing = (viscous * (1.0 + sense * entry.value) for sense in (1.0, -1.0))
    return (
        f"Friction differs by direction: viscous friction is {opening:.1f} N s/m towards larger positions and "
        f"{closing:.1f} N s/m back, {with_interval(entry, 200.0, '%')} apart."
    )


def _stribeck_starts(record: ForceRecord, _left: FloatArray) -> Iterator[ForceStart]:
    usual = _usual_speed(record)
    for share in _SPEEDS:
        speed = share * usual
        yield ForceStart(
            "stribeck_friction",
            {"speed_m_per_s": speed},
            lambda record, speed=speed: _one(record.sense * np.exp(-((record.velocity / speed) ** 2))),  # type: ignore[misc]
        )


def _read_stribeck(
    _values: Values, found: tuple[tuple[float, float], ...], shape: Mapping[str, float]
) -> dict[str, Fitted] | None:
    excess, error = found[0]
    if excess <= 0.0:
        return None
    speed = shape["speed_m_per_s"]
    return {
        "excess_n": fitted_value(excess, error, "N"),
        "speed_m_per_s": Fitted(speed, 0.6 * speed, 1.6 * speed, "m/s"),
    }


def _say_stribeck(parameters: Mapping[str, Fitted], _values: Values) -> str:
    return (
        f"Friction falls with speed, by {with_interval(parameters['excess_n'], 1.0, 'N')} over about "
        f"{1.0e3 * parameters['speed_m_per_s'].value:.1f} mm/s."
    )


def _presliding_starts(record: ForceRecord, _left: FloatArray) -> Iterator[ForceStart]:
    swept_m = _swept(record)[1]
    for share in _DEFLECTIONS:
        deflection_m = share * swept_m
        yield ForceStart(
            "presliding",
            {"deflection_m": deflection_m},
            lambda record, deflection_m=deflection_m: _one(_built_up(record, deflection_m) - record.sense),  # type: ignore[misc]
        )


def _built_up(record: ForceRecord, deflection_m: float) -> FloatArray:
    """Dahl's friction over F_c, shape (n,): after a turn it comes to the other side within a few deflections."""
    left = np.exp(-np.abs(record.velocity) * record.samples.period_s / deflection_m)
    return np.asarray(_followed(np.sign(record.velocity), left, float(record.sense[0])))


@njit(cache=True)
def _followed(sense: FloatArray, left: FloatArray, start: float) -> FloatArray:
    """What follows ``sense``, (n,), and keeps the share ``left``, (n,), of its distance at each row."""
    found = np.empty(sense.size)
    at = start
    for row in range(sense.size):
        at = sense[row] + (at - sense[row]) * left[row]
        found[row] = at
    return found


def _read_presliding(
    values: Values, found: tuple[tuple[float, float], ...], shape: Mapping[str, float]
) -> dict[str, Fitted] | None:
    share = found[0][0] / values["F_c"][0] if values["F_c"][0] > 0.0 else 0.0
    # all of the friction, or nearly so, is carried by the bristles
    if not _LEAST_CARRIED < share < _MOST_CARRIED:
        return None
    deflection_m = shape["deflection_m"]
    return {"deflection_m": Fitted(deflection_m, 0.5 * deflection_m, 2.0 * deflection_m, "m")}


_LEAST_CARRIED: Final = 0.3
_MOST_CARRIED: Final = 2.0


def _say_presliding(parameters: Mapping[str, Fitted], _values: Values) -> str:
    return (
        "After a turn friction does not jump to the other side but builds up elastically, over about "
        f"{1.0e6 * parameters['deflection_m'].value:.0f} um."
    )


def _spot_starts(record: ForceRecord, _left: FloatArray) -> Iterator[ForceStart]:
    low_m, swept_m = _swept(record)
    for width in _SPOT_WIDTHS:
        for number in range(_SPOTS):
            centre_m, width_m = low_m + (number + 0.5) / _SPOTS * swept_m, width * swept_m
            yield ForceStart(
                "local_friction",
                {"centre_m": centre_m, "width_m": width_m},
                lambda record, at=centre_m, width_m=width_m: _one(  # type: ignore[misc]
                    record.sense * np.exp(-0.5 * ((record.samples.position_m - at) / width_m) ** 2)
                ),
            )


def _read_spot(
    _values: Values, found: tuple[tuple[float, float], ...], shape: Mapping[str, float]
) -> dict[str, Fitted] | None:
    centre, width = shape["centre_m"], shape["width_m"]
    return {
        "rise_n": fitted_value(*found[0], "N"),
        "centre_m": Fitted(centre, centre - width, centre + width, "m"),
        "width_m": Fitted(width, 0.5 * width, 2.0 * width, "m"),
    }


def _say_spot(parameters: Mapping[str, Fitted], _values: Values) -> str:
    sense = "higher" if parameters["rise_n"].value > 0.0 else "lower"
    at = 1.0e3 * parameters["centre_m"].value
    return f"Friction is {with_interval(parameters['rise_n'], 1.0, 'N')} {sense} about {at:.0f} mm, both ways."


def _gradient_starts(record: ForceRecord, _left: FloatArray) -> Iterator[ForceStart]:
    low_m, swept_m = _swept(record)
    middle_m = low_m + 0.5 * swept_m
    yield ForceStart(
        "friction_gradient",
        {"reference_m": middle_m},
        lambda record: _one(record.sense * (record.samples.position_m - middle_m)),
    )


def _read_gradient(
    _values: Values, found: tuple[tuple[float, float], ...], shape: Mapping[str, float]
) -> dict[str, Fitted] | None:
    middle = shape["reference_m"]
    return {"gradient_n_per_m": fitted_value(*found[0], "N/m"), "reference_m": Fitted(middle, middle, middle, "m")}


def _say_gradient(parameters: Mapping[str, Fitted], _values: Values) -> str:
    sense = "grows" if parameters["gradient_n_per_m"].value > 0.0 else "falls"
    return f"Friction {sense} along the travel, by {with_interval(parameters['gradient_n_per_m'], 0.01, 'N')} a cm."


def _drift_starts(_record: ForceRecord, _left: FloatArray) -> Iterator[ForceStart]:
    for constant_s in _TIMES_S:
        yield ForceStart(
            "friction_drift",
            {"time_constant_s": constant_s},
            lambda record, constant_s=constant_s: _one(record.sense * (1.0 - np.exp(-record.time_s / constant_s))),  # type: ignore[misc]
        )


def _read_drift(
    _values: Values, found: tuple[tuple[float, float], ...], shape: Mapping[str, float]
) -> dict[str, Fitted] | None:
    constant_s = shape["time_constant_s"]
    return {
        "change_n": fitted_value(*found[0], "N"),
        "time_constant_s": Fitted(constant_s, 0.5 * constant_s, 2.0 * constant_s, "s"),
    }


def _say_drift(parameters: Mapping[str, Fitted], _values: Values) -> str:
    sense = "rose" if parameters["change_n"].value > 0.0 else "fell"
    return (
        f"Friction {sense} by up to {with_interval(parameters['change_n'], 1.0, 'N')}, with a time constant of about "
        f"{parameters['time_constant_s'].value:.0f} s."
    )


def _lag_starts(record: ForceRecord, _left: FloatArray) -> Iterator[ForceStart]:
    yield ForceStart(
        "position_lag", {"period_s": record.samples.period_s}, lambda record: np.empty((record.samples.count, 0))
    )


def _read_lag(
    values: Values, _found: tuple[tuple[float, float], ...], shape: Mapping[str, float]
) -> dict[str, Fitted] | None:
    (jerk, error), mass = values["jerk"], values["m"][0]
    if not (mass > 0.0 and jerk - 4.0 * error > _PERIODS * shape["period_s"] * mass):
        return None
    return {"lag_s": fitted_value(jerk / mass, error / mass, "s")}


def _say_lag(parameters: Mapping[str, Fitted], _values: Values) -> str:
    return f"The position reading lags by {with_interval(parameters['lag_s'], 1.0e3, 'ms')}."


def _vibration_starts(record: ForceRecord, left: FloatArray) -> Iterator[ForceStart]:
    for frequency_hz in strongest_frequencies(record.time_s, left, 6):
        if frequency_hz < _SLOWEST_HZ:
            continue
        yield ForceStart(
            "vibration",
            {"frequency_hz": frequency_hz},
            lambda record, turn=2.0 * np.pi * frequency_hz: np.column_stack(  # type: ignore[misc]
                [np.sin(turn * record.time_s), np.cos(turn * record.time_s)]
            ),
        )


def _read_vibration(
    _values: Values, found: tuple[tuple[float, float], ...], shape: Mapping[str, float]
) -> dict[str, Fitted] | None:
    # the force that shakes stands on the other side of the balance
    (sine, error), (cosine, _) = found
    hertz, phase = shape["frequency_hz"], float(np.arctan2(-cosine, -sine))
    return {
        "force_n": fitted_value(float(np.hypot(sine, cosine)), error, "N"),
        "frequency_hz": Fitted(hertz, hertz, hertz, "Hz"),
        "phase_rad": Fitted(phase, phase, phase, "rad"),
    }


def _say_vibration(parameters: Mapping[str, Fitted], _values: Values) -> str:
    force = with_interval(parameters["force_n"], 1.0, "N")
    return f"A periodic force of {force} shakes the drive at {parameters['frequency_hz'].value:.2f} Hz."


FORCE_CAUSES: Final[dict[str, ForceCause]] = {
    entry.name: entry
    for entry in (
        ForceCause("friction_asymmetry", _asymmetry_starts, _read_asymmetry, _say_asymmetry),
        ForceCause("stribeck_friction", _stribeck_starts, _read_stribeck, _say_stribeck),
        ForceCause("presliding", _presliding_starts, _read_presliding, _say_presliding),
        ForceCause("local_friction", _spot_starts, _read_spot, _say_spot),
        ForceCause("friction_gradient", _gradient_starts, _read_gradient, _say_gradient),
        ForceCause("friction_drift", _drift_starts, _read_drift, _say_drift),
        ForceCause("position_lag", _lag_starts, _read_lag, _say_lag),
        ForceCause("vibration", _vibration_starts, _read_vibration, _say_vibration),
    )
}
