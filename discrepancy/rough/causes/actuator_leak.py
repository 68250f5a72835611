"""A pressure that stays below what the I/P should give."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Final

import numpy as np
from typing_extensions import override

from discrepancy.rough.causes.base import Fitted
from discrepancy.rough.causes.seen import InputCause, Seen, command_and_pressure_pa
from valve.messages import say
from valve.recording import Recording

_LEAST: Final = 0.01
_MOST: Final = 0.8  # more is a wrong unit
_LEVELS: Final = 20
_SURE: Final = 5.0


class ActuatorLeak(InputCause):
    """The measured pressure is a share of the command."""

    name: ClassVar[str] = "actuator_leak"
    action: ClassVar[str] = say(
        "actuator_leak_action", "Look for a leak in the actuator, its diaphragm and the tubing, and calibrate the I/P."
    )

    @override
    def seen_in(self, recording: Recording) -> Seen | None:
        """Return the share that is missing, by the means at equal commands, rising and falling."""
        known = command_and_pressure_pa(recording)
        if known is None:
            return None
        command_pa, pressure_pa = known
        low_pa, high_pa = float(command_pa.min()), float(command_pa.max())
        edges_pa = np.linspace(low_pa + 0.05 * (high_pa - low_pa), low_pa + 0.9 * (high_pa - low_pa), _LEVELS)
        inside = (command_pa > edges_pa[0]) & (command_pa < edges_pa[-1])
        way = np.gradient(command_pa)[inside]
        pressure_pa, command_pa = pressure_pa[inside], command_pa[inside]
        if not (way > 0.0).any() or not (way < 0.0).any():
            return None
        # a lag shifts both ways against each other
        design = np.column_stack([command_pa, np.ones(command_pa.size), np.sign(way)])
        found, *_ = np.linalg.lstsq(design, pressure_pa, rcond=None)
        leak, offset_pa = 1.0 - float(found[0]), float(found[1])
        left_pa = float(np.std(pressure_pa - design @ found))
        error = left_pa / (float(np.std(command_pa)) * np.sqrt(_LEVELS))
        # a wrong zero is a calibration's, a leak takes a share
        if not _LEAST + _SURE * error < leak < _MOST or abs(offset_pa) > 0.3 * leak * high_pa:
            return None
        return Seen({"leak": Fitted(leak, error, "1")}, None)

    @override
    def told(self, fitted: Mapping[str, Fitted]) -> str:
        """Return what a fitter is told."""
        return say(
            "pressure_below_command",
            "The pressure stays {share} below what the command asks for.",
            share=fitted["leak"].in_words("%"),
        )
