"""Names that come as data and are read by people: states, sequences, methods, permissives, causes."""

from __future__ import annotations

from typing import Final

from service.words.languages import NAME
from valve.messages import Message
from valve.parameters import PARAMETER_SYMBOLS

#: As they are read in English: the data's own words, with blanks.
NAMES: Final = (
    # states of a test and of a check
    *("named", "likely", "ambiguous", "unexplained", "not assessed"),
    *("queued", "running", "analyzing", "completed", "failed", "stopped", "interrupted"),
    *("planned", "skipped", "missed", "ok", "poor"),
    # labels
    *("as found", "as left", "test", "baseline", "last test"),
    # sequences
    *("triangle", "multi rate", "sine", "steps", "dwell", "small loops", "diagnostic", "separating"),
    # methods
    *("regression", "garcia", "maximum likelihood"),
    # how a recording was taken
    *("polled", "captured", "simulated", "file"),
    # directions, and what a misfit goes with
    *("opening", "closing", "travel", "speed", "time", "time at rest", "force"),
    # parameters
    *(one.meaning for one in PARAMETER_SYMBOLS.values()),
    # causes
    *("friction asymmetry", "stribeck friction", "local friction", "seat friction", "friction gradient"),
    *("friction drift", "pressure dependent friction", "dwell dependent breakaway", "spring preload"),
    *("spring hardening", "dual rate spring", "diaphragm area change", "flow force", "position nonlinearity"),
    *("position backlash", "travel stop low", "travel stop high", "supply saturation", "presliding", "actuator leak"),
    *("positioner dead band", "transducer hysteresis", "transducer lag", "transducer dead time", "position lag"),
    *("breakaway scatter", "vibration"),
    # their parameters
    *("bow", "centre", "change", "dead band", "decay", "deflection", "delay", "excess", "gradient", "half difference"),
    *("hardening", "knee", "lag", "limit", "play", "offset", "rate change", "reference", "rise", "slope", "width"),
    *("time constant", "frequency", "force error", "viscous"),
    # between the members of a list
    *(" and ", " or ", " and none ", " and no "),
    # permissives
    *(
        "device",
        "device number",
        "disk",
        "plant file",
        "loop in manual",
        "no interlock",
        "output",
        "owner",
        "position",
        "stem at rest",
        "watchdog",
        "supply",
        "permit",
    ),
)


def plain(name: str) -> str:
    """Return a name of data as English reads it: ``multi_rate`` as multi rate."""
    return name.replace("_", " ")


def named(name: str) -> Message:
    """Return a name of data as a message, which each language says as it has that name."""
    english = plain(name).replace("{", "{{").replace("}", "}}")
    return Message(NAME, english, {})
