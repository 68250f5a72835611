"""What is known of a valve before it is measured, and how far a test may go: the nameplate in words."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from drivers.addresses import MotionLimits, ValveWiring
from drivers.stands_at import RestRules
from service.config.plant import Identity, PlantValve
from service.figures.signature import Frame
from service.health.changes import allowed, facts_of
from service.model.health_limits import HealthLimits
from service.model.past_test import PastTest
from service.words.names import named
from service.words.reader import Reader
from service.words.sentences import together
from valve.messages import say
from valve.nameplate import Action, Nameplate

_ACTIONS: Final = {
    Action.SPRING: say("spring_opposed", "spring-opposed"),
    Action.DOUBLE: say("double_acting", "double-acting, no spring"),
}

DESCRIPTION: Final = say("fact_description", "Description")
AREA: Final = say("fact_area", "Area")
SERIAL_NUMBER: Final = say("fact_serial_number", "Serial number")
_IDENTITY: Final = {
    "description": DESCRIPTION,
    "area": AREA,
    "service": say("fact_service", "Service"),
    "manufacturer": say("fact_manufacturer", "Manufacturer"),
    "model": say("fact_model", "Model"),
    "serial_number": SERIAL_NUMBER,
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
        yield say("fact_class", "Class of its limits"), valve.limits_class


def nameplate_facts(nameplate: Nameplate, reader: Reader) -> Iterator[tuple[str, str]]:
    """Yield name and value of what the nameplate says; what it does not say is left out."""
    actuator, signal = nameplate.actuator, nameplate.signal
    yield say("fact_rated_travel", "Rated travel"), reader.quantity(actuator.travel_m, "m")
    yield say("fact_action", "Action"), _ACTIONS[actuator.action]
    if actuator.diaphragm_area_m2 is not None:
        yield say("fact_diaphragm_area", "Diaphragm area"), reader.quantity(actuator.diaphragm_area_m2, "m2")
    if actuator.moving_mass_kg is not None:
        yield say("fact_moving_mass", "Moving mass"), reader.quantity(actuator.moving_mass_kg, "kg")
    if actuator.bench_set_pa is not None:
        rate = nameplate.nominal_spring_rate_n_per_m
        implied = None if rate is None else say("a_spring_rate", "a spring rate of {k}", k=reader.quantity(rate, "N/m"))
        yield (
            say("fact_bench_set", "Bench set"),
            together([_between(actuator.bench_set_pa, reader), implied or ""], ", "),
        )
    if signal is not None:
        low_ma, high_ma = signal.range_ma
        span = _between(signal.range_pa, reader)
        yield (
            say("fact_signal", "Signal"),
            say("signal_for", "{low:g} to {high:g} mA for {span}", low=low_ma, high=high_ma, span=span),
        )


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


def wiring_facts(wiring: ValveWiring, health: HealthLimits, reader: Reader) -> Iterator[tuple[str, str]]:
    """Yield name and value of the safe value, of what a test may do to the valve and of how far it may change."""
    yield say("fact_safe_value", "Safe value"), safe_value_words(wiring.safe_value_pa, reader)
    yield say("fact_safe_position", "Stem at the safe value"), safe_position_words(wiring.rest, reader)
    yield say("fact_test_may_use", "A test may use"), _limits(wiring.limits, reader)
    if wiring.limits.position_m is not None:
        low, high = (reader.quantity(end_m, "m") for end_m in wiring.limits.position_m)
        yield (
            say("fact_stem_may_be", "The stem may be"),
            say("stem_between", "between {low} and {high}", low=low, high=high),
        )
    acquisition = wiring.acquisition
    yield (
        say("fact_acquisition", "Acquisition"),
        say(
            "sample_each",
            "{mode}, a sample each {period:.4g ms}",
            mode=named(acquisition.mode.value),
            period=acquisition.period_s,
        ),
    )
    allowed = say(
        "may_change_by",
        "friction {up:g} % up and {down:g} % down, spring rate {spring:g} %, bench set {bench:g} % of the pressure's "
        "span, travel {travel:g} % of the rated one",
        up=health.friction_up_percent,
        down=health.friction_down_percent,
        spring=health.spring_rate_percent,
        bench=health.bench_set_percent,
        travel=health.travel_lost_percent,
    )
    yield say("fact_may_change_by", "May change by"), allowed


def safe_value_words(safe_value_pa: float | str, reader: Reader) -> str:
    """Return where a valve goes however its test ends."""
    if isinstance(safe_value_pa, str):
        return say("pressure_before", "the pressure before the test") if safe_value_pa == "entry" else safe_value_pa
    return reader.quantity(safe_value_pa, "Pa")


def safe_position_words(rules: RestRules, reader: Reader) -> str:
    """Return where the stem should stand at the safe value, and when that is looked at."""
    when = say("looked_at_after", "looked at {after:g} s after the motion", after=rules.after_s)
    if rules.position_m is None:
        return say("no_safe_position", "no position is declared: told, not judged; {when}", when=when)
    position, tolerance = (reader.quantity(length_m, "m") for length_m in (rules.position_m, rules.tolerance_m))
    return say(
        "give_or_take",
        "{position}, give or take {tolerance}; {when}",
        position=position,
        tolerance=tolerance,
        when=when,
    )


def _limits(limits: MotionLimits, reader: Reader) -> str:
    return say(
        "a_test_may_use",
        "{span}, changes of {rate}, {steps}; {longest:g} s at most",
        span=_between(limits.pressure_pa, reader),
        rate=reader.quantity(limits.pressure_rate_pa_per_s, "Pa/s"),
        steps=say("steps_too", "steps too") if limits.steps_allowed else say("fact_no_steps", "no steps"),
        longest=limits.longest_test_s,
    )


def _between(span_pa: tuple[float, float], reader: Reader) -> str:
    low, high = (reader.quantity(end_pa, "Pa") for end_pa in span_pa)
    return say("low_to_high", "{low} to {high}", low=low, high=high)
