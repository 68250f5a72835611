"""Friction that falls with speed: by the forces of a stem that slides, and by a damped one that sticks all the same."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar, Final

import numpy as np
from typing_extensions import override

from discrepancy.rough.causes.base import Cause, Fitted, FloatArray, Shape, parameter
from discrepancy.rough.causes.seen import Seen, SeenCause, View
from discrepancy.rough.setting import Setting
from discrepancy.rough.simulation import parameters_of, simulated, with_effects
from estimators.engine.laws import LawParameter, Where
from valve.effects.base import Effect
from valve.effects.stribeck_friction import StribeckFriction as StribeckEffect
from valve.errors import ValveError
from valve.extended_valve import ExtendedValve
from valve.messages import Message, say
from valve.parameters import ValveParameters

_SPEEDS: Final = (0.2, 0.35, 0.6, 1.0, 1.7, 3.0, 5.0)  # of the usual speed
_FALLS_OVER: Final = np.geomspace(0.05, 6.0, 17)  # of the usual speed, in a stem that sticks
_DAMPINGS: Final = (1.0, 0.7, 0.5, 0.35, 0.2, 0.1)  # of the critical one, that a plain stem may have instead
_HEAVIEST_KG: Final = 100.0
_CREEPING_M_PER_S: Final = 5.0e-4  # a high limit velocity
_REST_S: Final = 0.04
_AS_MANY: Final = 1.5
_MORE: Final = 3  # rests, that roughness may make
_NEARER: Final = 0.8  # of the error of any plain stem
_AS_NEAR: Final = 1.1


class StribeckFriction(Cause):
    """F_c + dF exp(-(v/v_s)^2) in motion; the breakaway has an F_s of its own."""

    name: ClassVar[str] = "stribeck_friction"
    action: ClassVar[str] = say(
        "stribeck_friction_action", "The stem will stick and slip at low speed: lubricate or change the packing."
    )

    by_slips: ClassVar[bool] = False  # all slips are equally quick

    def natural(self) -> tuple[LawParameter, ...]:
        """An excess of up to twice F_c."""
        setting = self.setting
        return (
            parameter("excess_n", "N", 0.0, 2.0 * setting.friction_n, spread=0.15 * setting.friction_n),
            parameter("speed_m_per_s", "m/s", 0.05 * setting.speed_m_per_s, 20.0 * setting.speed_m_per_s),
        )

    def shapes(self) -> list[Shape]:
        """Speeds about the usual one; none of a stem that creeps, whose friction falls with speed anyway."""
        if self.setting.creeps:
            return []
        return [(share * self.setting.speed_m_per_s,) for share in _SPEEDS]

    def friction_n(self, values: FloatArray, where: Where) -> FloatArray:
        """Return what is left of the excess at this speed."""
        return np.asarray(values[0] * np.exp(-((where.speed_m_per_s / values[1]) ** 2)))

    @override
    def breakaway_n(self, values: FloatArray, where: Where, share: float) -> FloatArray:
        """Return nothing: F_s is free."""
        return np.zeros(where.count)

    @override
    def effect(self, values: FloatArray, short_n: float = 0.0) -> Effect:
        """Return the effect that a simulated valve takes: F_s is already the whole of it."""
        return StribeckEffect(float(values[1]), 0.0)

    def sentence(self, fitted: Mapping[str, Fitted]) -> str:
        """Return what a fitter is told."""
        return _told(fitted)


class SticksAgain(SeenCause):
    """The same cause, of a stem that sticks again and again on slow ramps and slides on quick ones.

    A plain stem that is damped slides on after a breakaway. One with hardly any damping sticks, too, but on quick ramps
    as well. So the stem is simulated under the recorded force, with the friction and without, whatever its damping.
    """

    name: ClassVar[str] = StribeckFriction.name
    action: ClassVar[str] = StribeckFriction.action
    is_last: ClassVar[bool] = True

    def seen(self, view: View) -> Seen | None:
        """Return the excess and its speed where it gives as many rests as there are, and no plain stem is as near."""
        plain = parameters_of(view.null, view.estimate, view.nameplate)
        coulomb, static = view.null.known("F_c"), view.null.known("F_s")
        if not 0.0 < coulomb.value < static.value or plain.spring_rate_n_per_m <= 0.0:
            return None
        rests = _rests(view)
        usual = _simulated(ExtendedValve(plain), view)
        if usual is None or rests < _AS_MANY * usual[0] + _MORE:
            return None
        others = [_simulated(ExtendedValve(one), view) for one in _less_damped(plain, view)]
        least_m = min(one[1] for one in (usual, *others) if one is not None)
        speeds = view.setting.speed_m_per_s * _FALLS_OVER
        tried = [_simulated(with_effects(plain, [StribeckEffect(float(speed))]), view) for speed in speeds]
        errors_m = np.array([math.inf if one is None else one[1] for one in tried])
        best = int(np.argmin(errors_m))
        found = tried[best]
        if found is None or found[1] > _NEARER * least_m or not rests / _AS_MANY < found[0] < rests * _AS_MANY:
            return None
        as_near = np.log(speeds[errors_m < _AS_NEAR * errors_m[best]])
        step = float(np.log(_FALLS_OVER[1] / _FALLS_OVER[0]))
        speed = float(speeds[best])
        fitted = {
            "excess_n": Fitted(static.value - coulomb.value, math.hypot(static.std_error, coulomb.std_error), "N"),
            "speed_m_per_s": Fitted(speed, speed * max(step, 0.5 * float(np.ptp(as_near))), "m/s"),
        }
        return Seen(fitted, StribeckEffect(speed))

    @override
    def sentence(self, fitted: Mapping[str, Fitted], setting: Setting) -> str:
        """Return what a fitter is told."""
        return _told(fitted)


def _told(fitted: Mapping[str, Fitted]) -> Message:
    return say(
        "friction_falls_with_speed",
        "Friction falls with speed, by {excess}, most of it over {speed:.3g mm/s}.",
        excess=fitted["excess_n"].in_words("N"),
        speed=fitted["speed_m_per_s"].value,
    )


def _rests(view: View) -> int:
    time_s = view.reading.time_s
    lasted_s = [float(time_s[one.last] - time_s[one.first]) for one in view.reading.segmentation.rests]
    return sum(one >= _REST_S for one in lasted_s)


def _simulated(valve: ExtendedValve, view: View) -> tuple[int, float] | None:
    """How often the valve's stem rests under the recorded force, and its error, m, root mean square."""
    try:
        time_s, shown_m = simulated(valve, view.reading)
    except ValveError:
        return None
    still = np.concatenate([[False], np.diff(shown_m) == 0.0, [False]])
    edges = np.flatnonzero(np.diff(still.astype(np.int8)))
    lasted_s = time_s[edges[1::2]] - time_s[edges[::2]]
    off_m = shown_m - np.interp(time_s, view.reading.time_s, view.reading.position_m)
    return int((lasted_s >= _REST_S).sum()), float(np.sqrt(np.mean(off_m**2)))


def _less_damped(plain: ValveParameters, view: View) -> list[ValveParameters]:
    """Other plain stems that the recording leaves open: with less F_v, more mass, or a high limit velocity."""
    spring, estimate = plain.spring_rate_n_per_m, view.estimate
    critical = 2.0 * math.sqrt(plain.mass_kg * spring)
    others = [replace(plain, limit_velocity_m_per_s=max(plain.limit_velocity_m_per_s, _CREEPING_M_PER_S))]
    if estimate is None or estimate.value("F_v") is None:
        damped = [share * critical for share in _DAMPINGS]
        others += [
            replace(plain, viscous_friction_n_s_per_m=one) for one in damped if one < plain.viscous_friction_n_s_per_m
        ]
    if view.nameplate.actuator.moving_mass_kg is None and (estimate is None or estimate.value("m") is None):
        masses = [(plain.viscous_friction_n_s_per_m / (2.0 * share)) ** 2 / spring for share in _DAMPINGS]
        others += [replace(plain, mass_kg=one) for one in masses if plain.mass_kg < one < _HEAVIEST_KG]
    return others
