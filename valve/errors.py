"""The tree of errors. A branch is what the caller can do about it.

::

    ValveError
    ├── RequestError         correct the request and repeat it
    │   ├── ConfigurationError   plant.toml, a nameplate, a register map
    │   ├── ParameterError       a value that physics does not allow
    │   ├── WaveformError        a test sequence that the valve cannot or must not follow
    │   ├── RecordingError       a recording that cannot be read
    │   ├── NotFoundError        an unknown tag, test or sequence
    │   ├── ElsewhereError       another gateway drives the valve, or has the recording: ask that one
    │   ├── BusyError            the valve or its bus is taken: wait, then repeat
    │   └── PermissiveError      a permissive is missing: do what it says, then repeat
    ├── EquipmentError       look at the valve, its device or the wire
    │   ├── WireError            no answer, or one that does not fit the request
    │   └── DeviceError          the device answers, and says or shows that it cannot
    ├── MeasurementError     repeat the test with other settings
    └── InternalError        report it: a fault of ours
        └── MotionError          the simulated stem's motion could not be followed
"""

from __future__ import annotations

from collections.abc import Iterable

from valve.messages import joined, say


class ValveError(Exception):
    """Root of all errors that breakaway raises on purpose.

    The message names subject, value, limit and remedy in one sentence,
    for example ``FV-101: travel spans 0.4 %, the estimate needs 2 %: repeat with a larger amplitude``.
    """


class RequestError(ValveError):
    """The request cannot be carried out as it stands: correct it and repeat it."""


class ConfigurationError(RequestError):
    """plant.toml, a nameplate or a register map is wrong; nothing was started."""


class ParameterError(RequestError):
    """A value that physics does not allow."""


class WaveformError(RequestError):
    """A test sequence that this valve cannot or must not follow."""


class RecordingError(RequestError):
    """A recording that cannot be read or does not hold what is asked of it."""


class NotFoundError(RequestError):
    """An unknown tag, test or sequence."""


class ElsewhereError(RequestError):
    """Another gateway of the plant has what is asked for: ask that one."""

    def __init__(self, reason: str, gateway: str, url: str) -> None:
        super().__init__(say("elsewhere", "{reason}: repeat the request at {url}", reason=reason, url=url))
        self.gateway = gateway
        self.url = url


class BusyError(RequestError):
    """The valve or its bus is taken: wait, then repeat the request."""


class PermissiveError(RequestError):
    """A permissive is missing, or a bad end was not acknowledged: nothing moved. Do what it says, then repeat."""


class EquipmentError(ValveError):
    """Look at the valve, its device or the wire."""


class WireError(EquipmentError):
    """No answer, or one that does not fit the request."""


class DeviceError(EquipmentError):
    """The device answers, and says or shows that it cannot do what was asked."""


class MeasurementError(ValveError):
    """The measurement cannot give what was asked: repeat the test with other settings."""


class InternalError(ValveError):
    """A fault of ours: report it."""


class MotionError(InternalError):
    """The simulated stem's motion could not be followed."""


def refuse(kind: type[ValveError], faults: Iterable[str]) -> None:
    """Raise ``kind`` with every fault, one a line; nothing happens where all of them are "" or there is none."""
    found = [fault for fault in faults if fault]
    if found:
        raise kind(joined("\n", found))
