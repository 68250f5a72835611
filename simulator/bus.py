"""The units on one wire, without the wire: whose request it is, and what every unit refuses."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from drivers.registers import MAX_READ_WORDS, MAX_WRITE_WORDS, Table
from simulator.unit import ExceptionCode, Refusal, Unit
from valve.errors import ConfigurationError
from valve.messages import say


class NoSuchUnit(Exception):  # noqa: N818 (an answer of the wire, not a fault of the program)
    """A request for a device id that nobody on this wire has."""


class Bus:
    """The units on one wire, and the simulated clock that they live by. A later unit of the same id is refused."""

    def __init__(self, units: Sequence[Unit], now_s: Callable[[], float]) -> None:
        self._units: dict[int, Unit] = {}
        self._now_s = now_s
        for unit in units:
            if not (0 <= unit.device_id <= 247 or unit.device_id == 255):  # 0 and 255: the one at a network address
                raise ConfigurationError(
                    say(
                        "simulated_device_id_outside",
                        "device id {device_id} is none of 0 to 247 and 255, correct it",
                        device_id=unit.device_id,
                    )
                )
            if unit.device_id in self._units:
                raise ConfigurationError(
                    say(
                        "simulated_device_id_twice",
                        "device id {device_id} stands on one bus twice, change one",
                        device_id=unit.device_id,
                    )
                )
            self._units[unit.device_id] = unit

    def read(self, device_id: int, table: Table, address: int, count: int) -> list[int]:
        """Words of a unit. Raises NoSuchUnit, Refusal or NoAnswer."""
        unit = self._unit(device_id)
        if not 1 <= count <= MAX_READ_WORDS:
            raise Refusal(ExceptionCode.ILLEGAL_VALUE)
        return unit.read(table, address, count, self._now_s())

    def write(self, device_id: int, address: int, words: Sequence[int], most: int = MAX_WRITE_WORDS) -> None:
        """Write words to a unit. Raises as ``read``."""
        unit = self._unit(device_id)
        if not 1 <= len(words) <= most:
            raise Refusal(ExceptionCode.ILLEGAL_VALUE)
        unit.write(address, words, self._now_s())

    def require(self, device_id: int) -> None:
        """Raise NoSuchUnit where no unit has this id."""
        self._unit(device_id)

    def _unit(self, device_id: int) -> Unit:
        unit = self._units.get(device_id)
        if unit is None:
            raise NoSuchUnit(device_id)
        return unit
