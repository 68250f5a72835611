"""What is wrong with the data of a recording, as a sentence and as an entry of the analysis object."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from valve.messages import Message, say

BoolArray = npt.NDArray[np.bool_]
FloatArray = npt.NDArray[np.float64]

#: How each channel is called, and the unit that its values are told in.
SHOWN: Final = {
    "position_m": (say("position", "position"), "mm"),
    "pressure_pa": (say("channel_pressure", "pressure"), "kPa"),
    "command_pa": (say("command", "command"), "kPa"),
    "force_n": (say("force", "force"), "N"),
}
#: Where there is one recording, nothing says which.
NOWHERE: Final = say("nowhere", "")


def place_of(name: str) -> Message:
    """Return of which recording something is; nothing where the name is ""."""
    return say("of_recording", " of {name}", name=name) if name else NOWHERE


@dataclass(frozen=True, slots=True)
class DataFault:
    """A fault of one channel (or of ``time_s``), how many samples were left out for it, and what it is in words.

    ``reason`` is one of drop_outs, spike, frozen, clipped, held_values, exception_report, stamp_jitter, own_clock,
    from_vacuum and far_origin. ``parameters`` are figures of it, in SI by their unit.
    """

    channel: str
    reason: str
    samples: int
    sentence: str
    parameters: Mapping[str, tuple[float, str]] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Return the entry of ``recording.remarks``."""
        return {
            "fault": self.reason,
            "channel": self.channel,
            "samples": self.samples,
            "sentence": self.sentence,
            "parameters": {name: {"value": value, "unit": unit} for name, (value, unit) in self.parameters.items()},
        }

    def left_out_json(self) -> dict[str, Any]:
        """Return the entry of ``recording.left_out``."""
        return {
            "channel": self.channel,
            "reason": self.reason,
            "samples": self.samples,
            "sentence": self.sentence,
        }


def runs(flags: BoolArray) -> list[tuple[int, int]]:
    """Return first and one past the last of each run of True in ``flags``, shape (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return [(int(first), int(last)) for first, last in zip(edges[::2], edges[1::2], strict=True)]


def off_line(time_s: FloatArray, values: FloatArray) -> FloatArray:
    """Return how far each value lies below the line through its two neighbours in time, shape (n - 2,).

    ``time_s``, ``values``: shape (n,), in any unit.
    """
    share = (time_s[1:-1] - time_s[:-2]) / (time_s[2:] - time_s[:-2])
    return np.asarray(values[:-2] + share * (values[2:] - values[:-2]) - values[1:-1])
