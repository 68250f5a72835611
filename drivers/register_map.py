"""Register maps: what one kind of device keeps where, who it proves to be, and what it can do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from drivers.capabilities import Capture, Fence, LiveBlock, Role, Watchdog
from drivers.registers import MAX_READ_WORDS, Block, Register, Table
from valve.errors import ConfigurationError
from valve.messages import say


@dataclass(frozen=True, slots=True)
class GoldenFrame:
    """A request and its answer on a serial line, CRC included, as the manual prints them, with what they mean."""

    request: bytes
    answer: bytes
    values: dict[str, float]
    source: str


@dataclass(frozen=True, slots=True)
class Canary:
    """A register whose value proves which device answers, or (``differs``) which one does not."""

    register: str
    expected: float
    differs: bool = False

    def accepts(self, value: float) -> bool:
        """Whether this value is one that the device would show."""
        return (value != self.expected) if self.differs else (value == self.expected)


@dataclass(frozen=True, slots=True)
class RegisterMap:
    """What one kind of device keeps where. ``source`` cites the manual page.

    ``roles`` names the register that serves a role where the wiring names none; ``readbacks`` tells for a command
    register where the device shows what it really asks for, ``statuses`` for a measured one where the device says by 0
    that it is a measurement. ``write_function`` is 6 for a device that takes one register at a time and does not know
    function 16. Raises ConfigurationError where registers overlap, share a name, or a name stands for none.
    """

    name: str
    source: str
    registers: tuple[Register, ...]
    canary: Canary | None = None
    golden: tuple[GoldenFrame, ...] = ()
    version: Canary | None = None
    roles: Mapping[Role, str] = field(default_factory=dict)
    readbacks: Mapping[str, str] = field(default_factory=dict)
    statuses: Mapping[str, str] = field(default_factory=dict)
    fence: Fence | None = None
    watchdog: Watchdog | None = None
    live: LiveBlock | None = None
    capture: Capture | None = None
    has_read_write: bool = False  # function 23
    write_function: Literal[6, 16] = 16
    is_positioner: bool = False  # its command is a position of the stem
    number: str | None = None  # where it shows the number that its installer gave it

    def __post_init__(self) -> None:
        taken: dict[tuple[Table, int], str] = {}
        names: set[str] = set()
        for register in self.registers:
            if register.name in names:
                raise ConfigurationError(
                    say(
                        "register_twice",
                        "register map {map}: {register} stands in it twice, rename one",
                        map=self.name,
                        register=register.name,
                    )
                )
            names.add(register.name)
            for address in range(register.address, register.address + register.words):
                other = taken.setdefault((register.table, address), register.name)
                if other != register.name:
                    raise ConfigurationError(
                        say(
                            "registers_overlap",
                            "register map {map}: {other} and {register} overlap at {table} address {address}, move one",
                            map=self.name,
                            other=other,
                            register=register.name,
                            table=register.table,
                            address=address,
                        )
                    )
        mentioned = [check.register for check in (self.canary, self.version) if check is not None]
        mentioned += [] if self.number is None else [self.number]
        for pairs in (self.readbacks, self.statuses):
            mentioned += [*pairs, *pairs.values()]
        for name in (*mentioned, *self.roles.values()):
            self.register(name)

    def register(self, name: str) -> Register:
        """Return the register of this name. Raises ConfigurationError where there is none."""
        for register in self.registers:
            if register.name == name:
                return register
        known = tuple(register.name for register in self.registers)
        raise ConfigurationError(
            say(
                "register_unknown",
                "register map {map}: no register {register}; there are {known:, }",
                map=self.name,
                register=repr(name),
                known=known,
            )
        )

    @property
    def own_pressure(self) -> Register | None:
        """Where the device shows the actuator's pressure in Pa by itself; None where a valve must say what it means."""
        name = self.roles.get(Role.PRESSURE)
        register = None if name is None else self.register(name)
        return register if register is not None and register.unit == "Pa" else None

    def block(self, *names: str) -> Block:
        """Return the one transaction that covers these registers.

        Raises ConfigurationError where they stand in different tables or too far apart.
        """
        chosen = tuple(self.register(name) for name in names)
        tables = {register.table for register in chosen}
        if len(tables) != 1:
            raise ConfigurationError(
                say(
                    "registers_of_tables",
                    "register map {map}: {registers:, } stand in different tables",
                    map=self.name,
                    registers=tuple(names),
                )
            )
        start = min(register.address for register in chosen)
        words = max(register.address + register.words for register in chosen) - start
        if words > MAX_READ_WORDS:
            raise ConfigurationError(
                say(
                    "registers_too_far_apart",
                    "register map {map}: {registers:, } span {words} words, one read carries {most}",
                    map=self.name,
                    registers=tuple(names),
                    words=words,
                    most=MAX_READ_WORDS,
                )
            )
        return Block(chosen, start, words, tables.pop())
