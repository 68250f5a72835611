"""Whether what is compared with a measurement can ever be shown: contacts, numbers, limits of what is measured."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

from drivers.addresses import ValveWiring
from drivers.permissive_rules import Contact
from drivers.registers import Kind, Register
from drivers.wiring import Signal, Unit, Wired
from valve.messages import say

Ends = tuple[float, float]

_LEAST_SEEN: Final = 0.05  # of the limits, by a pressure sensor; below it the unit is another
_LARGEST_CURRENT_A: Final = 0.021  # above it a transmitter reports a failure (NAMUR NE 43)


@dataclass(frozen=True, slots=True)
class Misfit:
    """A value of ``[[valves]]`` that a device cannot hold: where it stands, why, and what to do."""

    key: tuple[str, ...]
    value: object
    reason: str
    remedy: str


def takes(register: Register, unit: Unit) -> str:
    """Return what a register can hold, in words."""
    return say(
        "register_takes",
        "{register} of {map} ({device}) takes {span}",
        register=register.name,
        map=unit.map.name,
        device=unit.subject,
        span=register.span.words,
    )


def shows(register: Register, unit: Unit) -> str:
    """Return what a register can show, in words."""
    return say(
        "register_shows",
        "{register} of {map} ({device}) shows {span}",
        register=register.name,
        map=unit.map.name,
        device=unit.subject,
        span=register.span.words,
    )


def unobservable(wiring: ValveWiring, wired: Wired) -> Iterator[Misfit]:
    """Find every value that is compared with a measurement which could never reach it, or never leave it."""
    rules, unit = wiring.permissives, wired.command.unit
    if rules.device_number is not None and unit.map.number is not None:
        register = unit.map.register(unit.map.number)
        if not register.holds(rules.device_number) or register.nearest(rules.device_number) != rules.device_number:
            yield Misfit(
                ("permissives", "device_number"),
                rules.device_number,
                takes(register, unit),
                say("correct_no_device_shows", "correct it: no device could ever show it"),
            )
    for name, contact in (("manual", wired.manual), ("interlock", wired.interlock)):
        if contact is not None:
            yield from _contact(("permissives", name), contact.unit, contact.contact)
    yield from _spans(wiring, wired)


def _contact(key: tuple[str, ...], unit: Unit, contact: Contact) -> Iterator[Misfit]:
    """A contact that could never say yes, or never no."""
    register = unit.map.register(contact.register)
    if contact.bit is not None:
        counts = register.kind is not Kind.F32 and (register.scale, register.offset) == (1.0, 0.0)
        if not counts:
            reason = say(
                "measurement_without_bits",
                "{register} of {map} is a measurement in {unit}, it has no bits",
                register=register.name,
                map=unit.map.name,
                unit=register.unit,
            )
            yield Misfit(
                (*key, "bit"),
                contact.bit,
                reason,
                say("give_above_or_below", "give above or below, or the register of the contact"),
            )
        elif contact.bit >= 16 * register.words:
            reason = say(
                "register_has_bits",
                "{register} of {map} has bits 0 to {words}",
                register=register.name,
                map=unit.map.name,
                words=16 * register.words - 1,
            )
            yield Misfit((*key, "bit"), contact.bit, reason, say("choose_one_of_them", "choose one of them"))
        return
    span = register.span
    greatest = min(span.greatest, _LARGEST_CURRENT_A) if register.unit == "A" else span.greatest
    shown = say(
        "register_shows_between",
        "{register} of {map} ({device}) shows {least:.6g} to {most:.6g} {unit}",
        register=register.name,
        map=unit.map.name,
        device=unit.subject,
        least=span.least,
        most=greatest,
        unit=span.unit,
    )
    if contact.above is not None and not span.least <= contact.above < greatest:
        never = "no" if contact.above < span.least else "yes"
        yield Misfit(
            (*key, "above"),
            contact.above,
            say("would_never_say", "{shown}: it would never say {never}", shown=shown, never=never),
            _threshold(register),
        )
    if contact.below is not None and not span.least < contact.below <= greatest:
        never = "no" if contact.below > greatest else "yes"
        yield Misfit(
            (*key, "below"),
            contact.below,
            say("would_never_say", "{shown}: it would never say {never}", shown=shown, never=never),
            _threshold(register),
        )


def _threshold(register: Register) -> str:
    return say("give_value_inside", "give a value inside that, in {unit}", unit=register.unit)


def _spans(wiring: ValveWiring, wired: Wired) -> Iterator[Misfit]:
    """Limits of what is measured that no measurement could ever keep."""
    rules, limits, unit = wiring.permissives, wiring.limits, wired.command.unit
    position, pressure = wired.position, wired.pressure
    if isinstance(position, Signal):
        named = ((("permissives", "position_m"), rules.position_m), (("limits", "position_m"), limits.position_m))
        for key, span_m in named:
            yield from _kept(key, span_m, position.register, position.unit)
        rest = wiring.rest
        if rest.position_m is not None:
            near_m = (rest.position_m - rest.tolerance_m, rest.position_m + rest.tolerance_m)
            for one in _kept(("safe_position_m",), near_m, position.register, position.unit):
                yield replace(one, value=rest.position_m)
        yield from _steps(wiring, position)
    if pressure is not None and wiring.pressure is not None:
        (low_pa, high_pa), shown = limits.pressure_pa, pressure.register.span
        if min(high_pa, shown.greatest) - max(low_pa, shown.least) < _LEAST_SEEN * (high_pa - low_pa):
            quantity, register = wiring.pressure.quantity, takes(pressure.register, pressure.unit)
            yield Misfit(
                ("pressure", "quantity"),
                None if quantity is None else list(quantity),
                say(
                    "next_to_nothing_of_limits",
                    "{register}, next to nothing of {limits}, {low:g in Pa} to {high:g Pa}",
                    register=register,
                    limits="limits.pressure_pa",
                    low=low_pa,
                    high=high_pa,
                ),
                say("write_quantity_in_pa", "write quantity in Pa"),
            )
    if rules.supply_pa is None:
        return
    live = unit.map.live
    if wired.supply is not None:
        yield from _kept(("permissives", "supply_pa"), rules.supply_pa, wired.supply.register, wired.supply.unit)
    elif live is None or live.supply is None:
        yield Misfit(
            ("permissives", "supply_pa"),
            list(rules.supply_pa),
            say("map_shows_no_supply", "map {map} shows no air supply", map=unit.map.name),
            say("name_supply_or_remove_limits", "say by permissives.supply where it is measured, or remove the limits"),
        )


def _steps(wiring: ValveWiring, position: Signal) -> Iterator[Misfit]:
    """Distances that a single step of the position's register is more than."""
    step_m = position.register.resolution * (1.0 - 1.0e-9)
    rest = wiring.rest
    named = (
        (("permissives", "still_m"), wiring.permissives.still_m),
        (("limits", "band_m"), wiring.limits.band_m),
        (("safe_position_tolerance_m",), None if rest.position_m is None else rest.tolerance_m),
    )
    for key, distance_m in named:
        if distance_m is not None and distance_m < step_m:
            reason = say(
                "one_step_is_more",
                "{register} of {map} shows {span}: one step is more",
                register=position.register.name,
                map=position.unit.map.name,
                span=position.register.span.words,
            )
            yield Misfit(key, distance_m, reason, say("give_a_step_or_more", "give a step or more"))


def _kept(key: tuple[str, ...], span: Ends | None, register: Register, unit: Unit) -> Iterator[Misfit]:
    if span is None:
        return
    shown = register.span
    if span[1] < shown.least or span[0] > shown.greatest:
        reason = shows(register, unit)
        yield Misfit(
            key,
            list(span),
            reason,
            say("correct_limits_or_scaling", "correct the limits, or signal and quantity of that register"),
        )
