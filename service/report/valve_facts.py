"""What is known of a valve before it is measured, and how far a test may go: the nameplate in words."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from drivers.addresses import MotionLimits, ValveWiring
from drivers.stands_at import RestRules
from service.config.settings import PlantValve
from service.config.valves import Identity
from service.figures.signature import Frame
from service.health.changes import allowed
from service.health.judge import facts_of
from service.model.health_limits import HealthLimits
from service.model.past_test import PastTest
from service.words.units import UnitSystem, quantity
from valve.nameplate import Action, Nameplate

_ACTIONS: Final = {Action.SPRING: "spring-opposed", Action.DOUBLE: "double-acting, no spring"}

_IDENTITY: Final = {
    "description": "Description",
    "area": "Area",
    "service": "Service",
    "manufacturer": "Manufacturer",
    "model": "Model",
    "serial_number": "Serial number",
}


def identity_facts(identity: Identity) -> Iterator[tuple[str, str]]:
    """Yield name and value of what the plant file says of a valve in words."""
    for name, words in _IDENTITY.items():
        value = getattr(identity, name)
        if value is not None:
            yield words, value


def class_facts(valve: PlantValve) -> Iterator[tuple[str, str]]:
    """Yield name and value of the class that a valve's acceptance limits come from; nothing without one."""
    if valve.limits_class:
        yield "Class of its limits", valve.limits_class


def nameplate_facts(nameplate: Nameplate, system: UnitSystem) -> Iterator[tuple[str, str]]:
    """Yield name and value of what the nameplate says; what it does not say is left out."""
    actuator, signal = nameplate.actuator, nameplate.signal
    yield "Rated travel", quantity(actuator.travel_m, "m", system)
    yield "Action", _ACTIONS[actuator.action]
    if actuator.diaphragm_area_m2 is not None:
        yield "Diaphragm area", quantity(actuator.diaphragm_area_m2, "m2", system)
    if actuator.moving_mass_kg is not None:
        yield "Moving mass", quantity(actuator.moving_mass_kg, "kg", system)
    if actuator.bench_set_pa is not None:
        rate = nameplate.nominal_spring_rate_n_per_m
        implied = "" if rate is None else f", a spring rate of {quantity(rate, 'N/m', system)}"
        yield "Bench set", _between(actuator.bench_set_pa, system) + implied
    if signal is not None:
        low_ma, high_ma = signal.range_ma
        yield "Signal", f"{low_ma:g} to {high_ma:g} mA for {_between(signal.range_pa, system)}"


def frame_of(valve: PlantValve | None, baseline: PastTest | None) -> Frame:
    """Return what the signature is drawn into: what the plant file says of a valve, and what it is allowed."""
    if valve is None:
        return Frame()
    was = None if baseline is None else baseline.figures.get("friction_mean_n")
    up_n, down_n = (None, None) if was is None else allowed("friction_mean_n", was, valve.health, facts_of(valve))
    return Frame(
        valve.nameplate.actuator.travel_m,
        valve.nameplate.actuator.bench_set_pa,
        valve.health.bench_set_percent,
        valve.health.travel_end_percent,
        valve.wiring.limits.position_m,
        valve.health.friction_share_percent,
        (
            None if was is None or down_n is None else was.value - down_n,
            None if was is None or up_n is None else was.value + up_n,
        ),
    )


def wiring_facts(wiring: ValveWiring, health: HealthLimits, system: UnitSystem) -> Iterator[tuple[str, str]]:
    """Yield name and value of the safe value, of what a test may do to the valve and of how far it may change."""
    yield "Safe value", safe_value_words(wiring.safe_value_pa, system)
    yield "Stem at the safe value", safe_position_words(wiring.rest, system)
    yield "A test may use", _limits(wiring.limits, system)
    if wiring.limits.position_m is not None:
        low, high = (quantity(end_m, "m", system) for end_m in wiring.limits.position_m)
        yield "The stem may be", f"between {low} and {high}"
    acquisition = wiring.acquisition
    yield "Acquisition", f"{acquisition.mode.value}, a sample each {1e3 * acquisition.period_s:.4g} ms"
    allowed = (
        f"friction {health.friction_up_percent:g} % up and {health.friction_down_percent:g} % down, spring rate "
        f"{health.spring_rate_percent:g} %, bench set {health.bench_set_percent:g} % of the pressure's span, travel "
        f"{health.travel_lost_percent:g} % of the rated one"
    )
    yield "May change by", allowed


def safe_value_words(safe_value_pa: float | str, system: UnitSystem) -> str:
    """Return where a valve goes however its test ends."""
    if isinstance(safe_value_pa, str):
        return {"entry": "the pressure before the test"}.get(safe_value_pa, safe_value_pa)
    return quantity(safe_value_pa, "Pa", system)


def safe_position_words(rules: RestRules, system: UnitSystem) -> str:
    """Return where the stem should stand at the safe value, and when that is looked at."""
    when = f"looked at {rules.after_s:g} s after the motion"
    if rules.position_m is None:
        return f"no position is declared: told, not judged; {when}"
    position, tolerance = (quantity(length_m, "m", system) for length_m in (rules.position_m, rules.tolerance_m))
    return f"{position}, give or take {tolerance}; {when}"


def _limits(limits: MotionLimits, system: UnitSystem) -> str:
    steps = "steps too" if limits.steps_allowed else "no steps"
    rate = quantity(limits.pressure_rate_pa_per_s, "Pa/s", system)
    return f"{_between(limits.pressure_pa, system)}, changes of {rate}, {steps}; {limits.longest_test_s:g} s at most"


def _between(span_pa: tuple[float, float], system: UnitSystem) -> str:
    return f"{quantity(span_pa[0], 'Pa', system)} to {quantity(span_pa[1], 'Pa', system)}"
