"""Whether a register map can carry what its own capabilities need: numbers, blocks and bits, whatever the valve."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from drivers.capabilities import Capture, Fence, LiveBlock, Watchdog
from drivers.frames import WRITE_ONE
from drivers.register_map import RegisterMap
from valve.errors import ConfigurationError, ParameterError
from valve.messages import message_of, say

_RUNS: Final = (1, 0xFFFFFFFF)  # what ValveDevice.take_ownership allows
_WORD: Final = (0, 1, 0xFFFF)  # a heartbeat, a CRC


def map_faults(device: RegisterMap) -> tuple[str, ...]:
    """Return, in words, every number that a test writes or compares and a register of the map cannot hold."""
    found = [
        fault
        for check in (device.canary, device.version)
        if check is not None
        for fault in _exact(device, check.register, check.expected)
    ]
    if device.fence is not None:
        found += _fence(device, device.fence)
    if device.watchdog is not None:
        found += _watchdog(device, device.watchdog)
    if device.live is not None:
        found += _live(device, device.live)
    if device.capture is not None:
        found += _capture(device, device.capture)
    if device.write_function == WRITE_ONE:
        found += _one_at_a_time(device)
    return tuple(found)


def _one_at_a_time(device: RegisterMap) -> Iterator[str]:
    """Values that function 6 would have to write in pieces: a device could be caught between two of them."""
    for register in device.registers:
        if register.writable and register.words > 1:
            yield say(
                "register_of_many_words",
                "{register} has {words} registers ({kind}), and write_function 6 writes one at a time: use "
                "write_function = 16, or a register of one word (u16, i16)",
                register=register.name,
                words=register.words,
                kind=register.kind,
            )
    for name, part in (("fence", device.fence), ("watchdog", device.watchdog), ("capture", device.capture)):
        if part is not None:
            yield say(
                "block_written_whole",
                "its {block} is written as a whole, and write_function 6 writes one register at a time: use 16",
                block=name,
            )


def _exact(device: RegisterMap, name: str, *numbers: float) -> Iterator[str]:
    register = device.register(name)
    missing = [one for one in numbers if not register.holds(one) or register.nearest(one) != one]
    if missing:
        yield say(
            "register_must_hold",
            "{register} must hold {numbers:, } exactly and takes {span}",
            register=name,
            numbers=tuple(f"{one:.12g}" for one in missing),
            span=register.span.words,
        )


def _together(device: RegisterMap, *names: str) -> Iterator[str]:
    """Registers that are written in one transaction."""
    try:
        device.block(*names).encode({name: device.register(name).span.greatest for name in names})
    except (ConfigurationError, ParameterError) as error:
        yield say("written_together", "{names:, } are written together: {why}", names=names, why=message_of(error))


def _fence(device: RegisterMap, fence: Fence) -> Iterator[str]:
    for name in (fence.run_number, fence.claim_run):
        yield from _exact(device, name, *_RUNS)
    yield from _exact(device, fence.owner, 0, *_RUNS)
    yield from _exact(device, fence.claim, fence.take, fence.release)
    yield from _together(device, fence.claim_run, fence.claim)


def _watchdog(device: RegisterMap, watchdog: Watchdog) -> Iterator[str]:
    run = () if watchdog.run is None else (watchdog.run,)
    for name in run:
        yield from _exact(device, name, *_RUNS)
    yield from _exact(device, watchdog.timeout, 0)
    yield from _exact(device, watchdog.heartbeat, *_WORD)
    yield from _exact(device, watchdog.state, watchdog.armed, watchdog.tripped)
    yield from _together(device, *run, watchdog.timeout, watchdog.heartbeat, watchdog.safe_value)


def _live(device: RegisterMap, live: LiveBlock) -> Iterator[str]:
    masks = (live.at_safe_mask, live.sensor_fault_mask, live.manual_mask, live.interlock_mask, live.supply_low_mask)
    yield from _exact(device, live.status, *(mask for mask in masks if mask))
    yield from _exact(device, live.check, *_WORD)


def _capture(device: RegisterMap, capture: Capture) -> Iterator[str]:
    yield from _exact(device, capture.run, *_RUNS)
    yield from _exact(device, capture.corner_check, *_WORD)
    yield from _exact(device, capture.control, capture.prepare, capture.start, capture.abort)
    yield from _exact(device, capture.state, capture.states.running, capture.states.done, capture.states.aborted)
    kept = min(device.register(name).span.greatest for name in (capture.wanted, capture.taken, capture.capacity))
    yield from _exact(device, capture.window_index, 0, kept - 1.0)
    settings = (capture.run, capture.control, capture.corner_count, capture.corner_check)
    yield from _together(device, *settings, capture.period, capture.wanted)
