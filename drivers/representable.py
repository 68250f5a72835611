"""Whether the devices of a valve can hold every value that its tests write to them or wait for; nothing is opened.

A value that a register cannot take is found here, when a plant is read, and not in mid-stroke.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from drivers.addresses import Mode, ValveWiring
from drivers.capture_buffer import CORNER_PRESSURE, CORNER_TIME
from drivers.course import Course
from drivers.map_faults import map_faults
from drivers.observable import Misfit, shows, takes, unobservable
from drivers.registers import Register
from drivers.wiring import Unit, Wired
from valve.messages import say
from valve.waveform import Waveform

_FEWEST_STEPS: Final = 20  # of the output between the limits: reading back allows two, a tenth of all there is
_WATCH_PERIOD_S: Final = 0.1  # between two looks at a device that plays by its own clock


def misfits(wiring: ValveWiring, wired: Wired) -> tuple[Misfit, ...]:
    """Return everything that a test of this valve would write, or compare, and that its devices cannot hold."""
    unit = wired.command.unit
    found = [
        Misfit(
            ("command", "map"), unit.map.name, fault, say("correct_map_or_choose", "correct the map, or choose another")
        )
        for fault in map_faults(unit.map)
    ]
    found += _pressures(wiring, wired)
    found += _place_of_command(wired)
    found += _watchdog(wiring, wired)
    if wiring.acquisition.mode is Mode.CAPTURED:
        found += _capture(wiring, wired)
    found += unobservable(wiring, wired)
    return tuple(found)


def waveform_misfit(wiring: ValveWiring, wired: Wired, waveform: Waveform) -> str:
    """Return why the device could not be handed this waveform, with what it takes; "" where it can."""
    unit = wired.command.unit
    capture = unit.map.capture
    if wiring.acquisition.mode is not Mode.CAPTURED or capture is None:
        return ""
    period = unit.map.register(capture.period)
    course = Course(waveform, period.nearest(wiring.acquisition.period_s))
    for count, name in ((course.waveform.time_s.size, capture.corner_count), (course.samples, capture.wanted)):
        register = unit.map.register(name)
        if not register.holds(float(count)):
            return say(
                "count_and_takes",
                "it has {count:g} for {what}, {takes}",
                count=count,
                what=name,
                takes=takes(register, unit),
            )
    return ""


# ---- pressures


def _pressures(wiring: ValveWiring, wired: Wired) -> Iterator[Misfit]:
    limits, safe_pa = wiring.limits, wiring.safe_value_pa
    command = wired.command.register
    scaling = say("correct_scaling_of_command", "correct signal and quantity of the command")
    reason = next(filter(None, (_output_fault(value_pa, wiring, wired) for value_pa in limits.pressure_pa)), "")
    if reason:
        yield Misfit(
            ("limits", "pressure_pa"),
            list(limits.pressure_pa),
            reason,
            say("keep_limits_inside", "keep the limits inside that, or {scaling}", scaling=scaling),
        )
    if safe_pa != "entry":
        reason = _output_fault(safe_pa, wiring, wired)
        if reason:
            remedy = say(
                "choose_safe_value_inside", 'choose a safe value inside that or "entry", or {scaling}', scaling=scaling
            )
            yield Misfit(("safe_value_pa",), safe_pa, reason, remedy)
    span_pa = limits.pressure_pa[1] - limits.pressure_pa[0]
    step_pa = max(command.resolution, wired.readback.register.resolution)
    if step_pa * _FEWEST_STEPS > span_pa:
        yield Misfit(
            ("limits", "pressure_pa"),
            list(limits.pressure_pa),
            say(
                "output_too_coarse",
                "the output has {steps:.3g} steps of {step:.4g Pa} between them, reading it back needs {fewest}",
                steps=span_pa / step_pa,
                step=step_pa,
                fewest=_FEWEST_STEPS,
            ),
            say("widen_limits", "widen the limits, or {scaling}", scaling=scaling),
        )


def _output_fault(value_pa: float, wiring: ValveWiring, wired: Wired) -> str:
    """Return why the output cannot be sent to a pressure and seen there."""
    for signal in (wired.command, wired.readback):
        if not signal.register.holds(value_pa):
            return (takes if signal is wired.command else shows)(signal.register, signal.unit)
    shown_pa = wired.readback.register.nearest(wired.command.register.nearest(value_pa))
    tolerance_pa = wired.tolerance_pa(wiring.limits)
    if abs(shown_pa - value_pa) > tolerance_pa:
        return say(
            "readback_too_coarse",
            "{register} of {map} would show {shown:.9g Pa}, which is further off than the "
            "{tolerance:.3g Pa} that are believed",
            register=wired.readback.register.name,
            map=wired.readback.unit.map.name,
            shown=shown_pa,
            tolerance=tolerance_pa,
        )
    return ""


def _place_of_command(wired: Wired) -> Iterator[Misfit]:
    """A fenced command stands behind the run number; capture and watchdog know no scaling but the map's own."""
    unit, register = wired.command.unit, wired.command.register
    fence, own = unit.map.fence, unit.map.register(wired.command.register.name)
    if fence is not None:
        number = unit.map.register(fence.run_number)
        if (register.table, register.address) != (number.table, number.address + number.words):
            yield Misfit(
                ("command", "register"),
                register.name,
                say(
                    "command_not_behind_number",
                    "map {map} takes a command only directly behind {register}, in {wanted}",
                    map=unit.map.name,
                    register=number.name,
                    wanted=_behind(unit, number),
                ),
                say("leave_register_out", "leave register out"),
            )
    if (own.scale, own.offset) != (register.scale, register.offset) and (unit.map.watchdog or unit.map.capture):
        yield Misfit(
            ("command", "quantity"),
            None,
            say(
                "own_command_not_scaled",
                "map {map} has {register} in {unit} as its watchdog's safe value and its capture, which "
                "would not be scaled with it",
                map=unit.map.name,
                register=own.name,
                unit=own.unit,
            ),
            say("leave_signal_out", "leave signal and quantity out, and let the device count Pa"),
        )


def _behind(unit: Unit, number: Register) -> str:
    wanted = (number.table, number.address + number.words)
    return next(
        (one.name for one in unit.map.registers if (one.table, one.address) == wanted),
        say("no_register", "no register"),
    )


# ---- watchdog and capture


def _watchdog(wiring: ValveWiring, wired: Wired) -> Iterator[Misfit]:
    unit, timeout_s = wired.command.unit, wiring.watchdog.timeout_s
    if timeout_s is None:
        return
    key, watchdog = ("watchdog", "timeout_s"), unit.map.watchdog
    if watchdog is None:
        reason = say("no_watchdog_in_map", "map {map} has no watchdog", map=unit.map.name)
        yield Misfit(key, timeout_s, reason, say("say_waived", 'say watchdog.waived = "why" to go without'))
        return
    register = unit.map.register(watchdog.timeout)
    if not register.holds(timeout_s):
        yield Misfit(key, timeout_s, takes(register, unit), say("choose_time_inside", "choose a time inside that"))
    elif register.nearest(timeout_s) <= 0.0:
        reason = say("takes_and_zero_is_off", "{takes}, and 0 is off", takes=takes(register, unit))
        yield Misfit(
            key, timeout_s, reason, say("choose_or_more", "choose {least:g s} or more", least=register.resolution)
        )
    else:
        yield from _feeding(wiring, timeout_s)
    yield from _driven_by_device(wiring, wired, unit.map.register(watchdog.safe_value))


def _feeding(wiring: ValveWiring, timeout_s: float) -> Iterator[Misfit]:
    sampling = wiring.acquisition
    is_polled = sampling.mode is Mode.POLLED
    apart_s = sampling.period_s if is_polled else _WATCH_PERIOD_S
    if timeout_s <= apart_s:
        named = (
            "acquisition.period_s"
            if is_polled
            else say("look_of_capturing_device", "the look at a device that captures")
        )
        yield Misfit(
            ("watchdog", "timeout_s"),
            timeout_s,
            say(
                "watchdog_would_trip",
                "it is fed every {time:g s} ({what}) and would trip in between",
                time=apart_s,
                what=named,
            ),
            say("choose_longer_time", "choose a longer time; a lost answer or two must fit into it"),
        )


def _driven_by_device(wiring: ValveWiring, wired: Wired, register: Register) -> Iterator[Misfit]:
    """Pressures that the device drives by itself: its watchdog's safe value, a capture's corners."""
    safe_pa, unit = wiring.safe_value_pa, wired.command.unit
    pressures = (*wiring.limits.pressure_pa, *(() if safe_pa == "entry" else (safe_pa,)))
    tolerance_pa = wired.tolerance_pa(wiring.limits)
    for value_pa in pressures:
        if not register.holds(value_pa) or abs(register.nearest(value_pa) - value_pa) > tolerance_pa:
            key = ("safe_value_pa",) if value_pa == safe_pa else ("limits", "pressure_pa")
            yield Misfit(
                key, value_pa, takes(register, unit), say("choose_pressure_inside", "choose a pressure inside that")
            )


def _capture(wiring: ValveWiring, wired: Wired) -> Iterator[Misfit]:
    unit, period_s = wired.command.unit, wiring.acquisition.period_s
    capture = unit.map.capture
    if capture is None:
        reason = say("no_capture_in_map", "map {map} has no capture buffer", map=unit.map.name)
        yield Misfit(
            ("acquisition", "mode"),
            str(Mode.CAPTURED),
            reason,
            say("say_mode", 'say mode = "{polled}"', polled=Mode.POLLED),
        )
        return
    period, key = unit.map.register(capture.period), ("acquisition", "period_s")
    if not period.holds(period_s) or period.nearest(period_s) <= 0.0:
        yield Misfit(
            key,
            period_s,
            takes(period, unit),
            say("choose_period_inside", "choose a period of at least one step, inside that"),
        )
    else:
        wanted = unit.map.register(capture.wanted)
        samples = wiring.limits.longest_test_s / period.nearest(period_s) + 1.0
        if not wanted.holds(samples):
            reason = say(
                "longest_test_samples",
                "a test of {limit} would have {samples:.4g} samples, {takes}",
                limit="limits.longest_test_s",
                samples=samples,
                takes=takes(wanted, unit),
            )
            yield Misfit(
                key, period_s, reason, say("choose_longer_period", "choose a longer period, or a shorter longest test")
            )
    if not CORNER_TIME.holds(wiring.limits.longest_test_s):
        yield Misfit(
            ("limits", "longest_test_s"),
            wiring.limits.longest_test_s,
            say(
                "corner_times_count",
                "a device that captures counts {span} from the start of a test",
                span=CORNER_TIME.span.words,
            ),
            say("choose_time_inside", "choose a time inside that"),
        )
    yield from _driven_by_device(wiring, wired, CORNER_PRESSURE)
