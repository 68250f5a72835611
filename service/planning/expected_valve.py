"""What is expected of a valve before a test: its parameters, its sensor's noise and its wire's sample period."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from drivers.addresses import Mode, ValveWiring
from drivers.maps import register_map
from estimators.planned_scatter import PackingScatter
from service.config.plant import PlantValve
from valve.errors import RequestError
from valve.messages import say
from valve.nameplate import Action
from valve.parameters import PARAMETER_SYMBOLS, ValveParameters, parameters_from_symbols

# A valve that nobody has tested, own choices: packing friction of a tenth of the span, 15 % more to break away, and
# mass, damping and DV in the proportions of Romano & Garcia's nominal valve (21 kg/m2, 1.15, 1.5 % of 10 mm/s).
_COULOMB_SHARE: Final = 0.10
_STATIC_RATIO: Final = 1.15
_MASS_KG_PER_M2: Final = 21.0
_DAMPING_RATIO: Final = 1.15
_LIMIT_SHARE: Final = 0.015
_RAMP_S: Final = 10.0
_NOISE_M: Final = 20.0e-6  # a common position transmitter on 100 mm of travel
_LAG_S: Final = 0.1  # of an I/P with a small volume behind it, as maximum likelihood starts from
# Which method's value is taken first.
_METHODS: Final = ("maximum_likelihood", "garcia", "regression")


@dataclass(frozen=True, slots=True)
class ExpectedValve:
    """Parameters with the symbols that were assumed, and the sampling; each with where it comes from, in words."""

    parameters: ValveParameters
    assumed: tuple[str, ...]
    parameters_from: str
    sample_period_s: float
    sample_period_from: str
    noise_m: float
    noise_from: str
    pressure_measured: bool
    lag_s: float
    scatter: PackingScatter


def expected_valve(
    valve: PlantValve,
    last_test: Mapping[str, Any] | None,
    *,
    why_none: str = "",
    noise_m: float | None = None,
    lag_s: float | None = None,
) -> ExpectedValve:
    """Return what is expected of this valve; ``last_test`` is its last completed test as the REST interface has it.

    What the test did not give, and all without one (``why_none`` says why), is assumed from the nameplate.
    Raises RequestError for a valve without spring or diaphragm area.
    """
    values = _assumed_values(valve)
    known: dict[str, float] = {}
    analysis: Mapping[str, Any] = (last_test or {}).get("analysis") or {}
    for method in _METHODS:
        for estimate in analysis.get("estimates", []):
            if estimate["method"] == method:
                given = {symbol: estimate["parameters"][symbol]["value"] for symbol in PARAMETER_SYMBOLS}
                known = {**{symbol: value for symbol, value in given.items() if value is not None}, **known}
    values |= known
    values["F_s"] = max(values["F_s"], values["F_c"])
    assumed = tuple(symbol for symbol in PARAMETER_SYMBOLS if symbol not in known)
    if last_test is None:
        source = say(
            "assumed_from_nameplate", "assumed from the nameplate and typical friction ({why_none})", why_none=why_none
        )
    else:
        source = say("from_test", "test {number}", number=last_test["id"])
        if assumed:
            source = say("from_test_assumed", "{test}; assumed: {symbols:, }", test=source, symbols=assumed)
    period_s, period_from = _sample_period(valve.wiring, last_test)
    noise_from: str = say("given", "given")
    if noise_m is None:
        measured_m = (analysis.get("recording") or {}).get("position_noise_m")
        # no sensor is without noise: 0 is a simulation, or one that did not change
        noise_m, noise_from = (
            (_NOISE_M, say("assumed", "assumed"))
            if measured_m in {None, 0.0}
            else (measured_m, say("last_test", "last test"))
        )
    return ExpectedValve(
        parameters_from_symbols(values),
        assumed,
        source,
        period_s,
        period_from,
        noise_m,
        noise_from,
        measures_pressure(valve.wiring),
        _LAG_S if lag_s is None else lag_s,
        _scatter(analysis),
    )


def _scatter(analysis: Mapping[str, Any]) -> PackingScatter:
    """Return how the valve's friction varies as its last test says, else as a usual packing's does."""
    usual = PackingScatter()
    for method in _METHODS:
        for estimate in analysis.get("estimates", []):
            shares = {symbol: _share(estimate["parameters"][symbol]) for symbol in ("F_s", "F_c")}
            if estimate["method"] == method and shares["F_s"] is not None and shares["F_c"] is not None:
                # a test gives roughness and wander in one figure: they are shared out as in a usual packing
                whole = math.hypot(usual.roughness, usual.wander)
                rough, wander = (shares["F_c"] * part / whole for part in (usual.roughness, usual.wander))
                return PackingScatter(
                    shares["F_s"], rough, wander, say("valve_in_last_test", "the valve in its last test")
                )
    return usual


def _share(parameter: Mapping[str, Any]) -> float | None:
    """Scatter of a parameter over its value; None where either is unknown."""
    value, scatter = parameter.get("value"), parameter.get("scatter")
    return None if not value or scatter is None else float(scatter / abs(value))


def measures_pressure(wiring: ValveWiring) -> bool:
    """Whether a test of this valve records the pressure: at a point of its own, or in the command's device."""
    if wiring.pressure is not None:
        return True
    if wiring.command.map is None:
        return False
    return register_map(wiring.command.map, wiring.maps).own_pressure is not None


def _assumed_values(valve: PlantValve) -> dict[str, float]:
    nameplate, actuator = valve.nameplate, valve.nameplate.actuator
    if actuator.action is not Action.SPRING or actuator.diaphragm_area_m2 is None:
        raise RequestError(
            say(
                "plan_needs_spring",
                "{tag}: a plan needs a spring and a diaphragm area: this valve's nameplate has actuator.action "
                "{action} and diaphragm_area_m2 {area}",
                tag=nameplate.tag,
                action=actuator.action.value,
                area=str(actuator.diaphragm_area_m2),
            )
        )
    low_pa, high_pa = valve.wiring.limits.pressure_pa if nameplate.signal is None else nameplate.signal.range_pa
    area_m2, span_n = actuator.diaphragm_area_m2, actuator.diaphragm_area_m2 * (high_pa - low_pa)
    k = nameplate.nominal_spring_rate_n_per_m or span_n / actuator.travel_m
    m = actuator.moving_mass_kg or _MASS_KG_PER_M2 * area_m2
    preload_n = nameplate.nominal_preload_n
    return {
        "m": m,
        "k": k,
        "F_v": 2.0 * _DAMPING_RATIO * math.sqrt(k * m),
        "F_c": _COULOMB_SHARE * span_n,
        "F_s": _STATIC_RATIO * _COULOMB_SHARE * span_n,
        "DV": _LIMIT_SHARE * span_n / k / _RAMP_S,
        "F_0": area_m2 * low_pa if preload_n is None else preload_n,
    }


def _sample_period(wiring: ValveWiring, last_test: Mapping[str, Any] | None) -> tuple[float, str]:
    """Time between samples, s: as the line kept it, as the device can keep it, or as it is asked for."""
    asked_s, mode = wiring.acquisition.period_s, wiring.acquisition.mode
    kept_s = ((last_test or {}).get("quality") or {}).get("median_period_s")
    if mode is Mode.POLLED:
        if kept_s:
            return kept_s, say("polled_as_in_last_test", "polled, as in the last test")
        return asked_s, say("polled_as_configured", "polled, as configured")
    device = register_map(wiring.command.map, wiring.maps) if wiring.command.map is not None else None
    if device is None or device.capture is None:
        return asked_s, say("captured_as_configured", "captured, as configured")
    register = device.register(device.capture.period)
    return register.decode(register.encode(asked_s)), say("captured_by_device", "captured by the device")
