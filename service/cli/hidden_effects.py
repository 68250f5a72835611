"""``[[valves.simulation.effects]]``: what a simulated valve hides, from the plant file."""

from __future__ import annotations

from service.config.errors import Findings, Key
from service.words.spelling import nearest
from valve.effects import EFFECTS, Effect, ValveScale, effect_from_values
from valve.errors import ParameterError, ValveError
from valve.extended_valve import ExtendedValve
from valve.messages import say
from valve.parameters import ValveParameters

# Sizes of no valve in particular: what depends on a valve's own is checked where it is built.
_ANY_VALVE = ExtendedValve(ValveParameters(1.0, 1.0, 1.0, 1.0, 1.0, 1.0))
_ANY_SCALE = ValveScale(1.0, 1.0, 1.0, 1.0)


def check_effect(given: dict[str, str | float], key: Key, findings: Findings) -> None:
    """Note what is wrong with one ``[[valves.simulation.effects]]``."""
    cause = given.get("cause")
    if not isinstance(cause, str) or cause not in EFFECTS:
        known = ", ".join(EFFECTS)
        if cause is None:
            findings.add(
                key,
                given,
                say("cause_is_missing", "its cause is missing"),
                say("choose_one_of_known", "choose one of {known}", known=known),
            )
            return
        close = nearest(str(cause), EFFECTS)
        remedy = f"write {close}" if close else say("choose_one_of_known", "choose one of {known}", known=known)
        findings.add((*key, "cause"), cause, say("this_cause_unknown", "this cause is unknown"), remedy)
        return
    for name, value in given.items():
        if name != "cause" and isinstance(value, str):
            findings.add(
                (*key, name),
                value,
                say("must_be_number", "it must be a number"),
                say("give_plain_number", "give a number without quotes and unit"),
            )
            return
    try:
        hidden_effect(given, _ANY_SCALE).apply(_ANY_VALVE)
    except ValveError as error:
        findings.add_error(key, error)


def hidden_effect(given: dict[str, str | float], scale: ValveScale) -> Effect:
    """Return an effect from its parameters, or from ``strength`` and what of its shape is given."""
    cause = str(given["cause"])
    values = {name: float(value) for name, value in given.items() if name not in {"cause", "strength"}}
    if "strength" not in given:
        return effect_from_values(cause, values)
    strengths = [entry.name for entry in EFFECTS[cause].parameters if entry.is_strength and entry.typical != 0.0]
    both = sorted(set(strengths) & set(values))
    if both:
        raise ParameterError(
            say(
                "strength_and_parameter",
                "{cause}: {parameter} and strength are both given: leave one out",
                cause=cause,
                parameter=both[0],
            )
        )
    return EFFECTS[cause].of_strength(float(given["strength"]), scale, **values)
