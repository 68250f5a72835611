"""What a wire and a device can answer instead of what was asked, as typed errors."""

from __future__ import annotations

from typing import Final

from valve.errors import DeviceError, ValveError, WireError
from valve.messages import say


class NoAnswerError(WireError):
    """Nothing came before the deadline; a write may or may not have been carried out."""


class OtherAnswerError(NoAnswerError):
    """Nothing came before the deadline but what was no answer to this request: another device's, a torn frame."""


class BadAnswerError(WireError):
    """Something came that is no answer to this request."""


class GarbledError(BadAnswerError):
    """The device answered this request, and its answer was damaged on the line: no other answer is due."""


class EchoError(BadAnswerError):
    """The line returned our own request."""


class ConnectionLostError(WireError):
    """There is no connection, or it broke while the answer was awaited."""


class CorruptBlockError(WireError):
    """A block whose own check does not fit its words."""


class GatewayPathError(WireError):
    """Exception 0x0A: the gateway has no path to the device."""


class GatewayTargetError(WireError):
    """Exception 0x0B: the device behind the gateway does not answer."""


class RefusedError(DeviceError):
    """The device answered with an exception."""


class IllegalFunctionError(RefusedError):
    """Exception 1: the device does not know the function."""


class IllegalAddressError(RefusedError):
    """Exception 2: the device has no such register."""


class IllegalValueError(RefusedError):
    """Exception 3: the device does not take the value."""


class DeviceFailureError(RefusedError):
    """Exception 4: the device failed at it."""


class AcknowledgedError(RefusedError):
    """Exception 5: accepted, and takes longer; it is not done."""


class DeviceBusyError(RefusedError):
    """Exception 6: busy with something else. A motion is never repeated because of it."""


class StaleSampleError(DeviceError):
    """The device showed the same sample twice: its clock and counter stand still."""


class StandstillError(DeviceError):
    """The stem is not seen to move. The pressure goes back by a ramp: a stem that breaks free late must not slam."""


class NoBreakawayError(StandstillError):
    """The pressure changed by more than a healthy stem needs, and the stem stood."""


class FrozenSensorError(StandstillError):
    """The position shows the very same value although the pressure changes and its noise was seen before."""


_EXCEPTIONS: Final[dict[int, tuple[type[ValveError], str]]] = {
    1: (IllegalFunctionError, say("unknown_function", "it does not know this function: check the register map")),
    2: (IllegalAddressError, say("unknown_register", "it has no such register: check the register map")),
    3: (
        IllegalValueError,
        say("value_not_taken", "it does not take this value: check ranges and signal in plant.toml"),
    ),
    4: (DeviceFailureError, say("device_failed", "it failed at it: look at the device")),
    5: (AcknowledgedError, say("not_done_yet", "it needs longer and has not done it yet: look at the device")),
    6: (DeviceBusyError, say("device_busy", "it is busy: try again later")),
    0x0A: (
        GatewayPathError,
        say("gateway_without_path", "the gateway has no path to it: check the gateway's configuration"),
    ),
    0x0B: (
        GatewayTargetError,
        say("silent_behind_gateway", "it does not answer the gateway: check the line behind the gateway"),
    ),
}


def refusal(subject: str, function: int, code: int) -> ValveError:
    """Return the error that stands for a Modbus exception (Application Protocol 1.1b3, 7)."""
    kind, sentence = _EXCEPTIONS.get(
        code,
        (RefusedError, say("exception_not_in_standard", "the code is not in the standard: see the device's manual")),
    )
    if (function, code) == (16, 1):
        sentence = say(
            "unknown_function_16",
            "it does not know this function: where it knows function 6, say write_function = 6 in its [[maps]]",
        )
    return kind(
        say(
            "modbus_exception",
            "{subject}: exception {exception} to function {function}: {why}",
            subject=subject,
            exception=code,
            function=function,
            why=sentence,
        )
    )
