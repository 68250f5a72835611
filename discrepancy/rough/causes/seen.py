"""Causes that a recording shows directly, without a fit: a stop, a pressure that cannot follow, a reading that lags."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Final, Protocol

import numpy as np
import numpy.typing as npt
from typing_extensions import override

from discrepancy.rough.causes.base import Fitted
from discrepancy.rough.evidence import Solved
from discrepancy.rough.setting import Setting
from estimators.base import Estimate
from estimators.engine.reading import Reading
from valve.effects.base import Effect
from valve.nameplate import Nameplate
from valve.recording import Recording

FloatArray = npt.NDArray[np.float64]

_FEWEST: Final = 100  # rows


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What a direct cause may look at: the recording with what was read in it, and the healthy fit."""

    recording: Recording
    nameplate: Nameplate
    reading: Reading
    setting: Setting
    null: Solved
    estimate: Estimate | None


def command_and_pressure_pa(recording: Recording) -> tuple[FloatArray, FloatArray] | None:
    """Return command and pressure of the rows that have both, Pa, each of shape (n,).

    None without either, with too few rows, or where one of them stands still.
    """
    command_pa, pressure_pa = recording.command_pa, recording.pressure_pa
    if command_pa is None or pressure_pa is None:
        return None
    known = np.isfinite(command_pa) & np.isfinite(pressure_pa)
    command_pa, pressure_pa = command_pa[known], pressure_pa[known]
    if command_pa.size < _FEWEST or min(np.ptp(command_pa), np.ptp(pressure_pa)) <= 0.0:
        return None
    return command_pa, pressure_pa


@dataclass(frozen=True, slots=True)
class Seen:
    """What was seen: parameters by name, and the effect that a simulated valve takes (None for one of the input).

    ``stem`` has what of the stem is otherwise beside it, by symbol, SI.
    """

    fitted: Mapping[str, Fitted]
    effect: Effect | None
    stem: Mapping[str, float] = field(default_factory=dict)


class SeenCause(Protocol):
    """A cause that is read off the recording."""

    name: ClassVar[str]
    action: ClassVar[str]
    #: Looked for only where the stem shows no other cause: those change the motion that it is read off.
    is_last: ClassVar[bool]
    #: Whether a stem shows it that hardly slides.
    by_slips: ClassVar[bool] = False

    def seen(self, view: View) -> Seen | None:
        """Return what shows the cause, None where nothing does."""
        ...

    def sentence(self, fitted: Mapping[str, Fitted], setting: Setting) -> str:
        """Return what a fitter is told, with numbers."""
        ...


class InputCause(SeenCause, Protocol):
    """A cause that command and pressure show by themselves, whatever the stem does."""

    is_last: ClassVar[bool] = False
    by_slips: ClassVar[bool] = True

    def seen_in(self, recording: Recording) -> Seen | None:
        """Return what shows the cause, None where nothing does."""
        ...

    def told(self, fitted: Mapping[str, Fitted]) -> str:
        """Return what a fitter is told, with numbers."""
        ...

    @override
    def seen(self, view: View) -> Seen | None:
        """Return what shows the cause, None where nothing does."""
        return self.seen_in(view.recording)

    @override
    def sentence(self, fitted: Mapping[str, Fitted], setting: Setting) -> str:
        """Return what a fitter is told, with numbers."""
        return self.told(fitted)
