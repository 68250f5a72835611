"""The actuator force of a recording as a polyline in time, with what is not known of it."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Final, Protocol

from estimators.base import Outcome
from estimators.likelihood.inputs.commanded_path import CommandedPath, commanded_path
from estimators.likelihood.inputs.nuisance import Nuisance
from estimators.likelihood.inputs.pressure_lines import MeasuredPath, measured_path
from estimators.likelihood.inputs.transducer_path import TransducerPath, transducer_path
from estimators.samples import FloatArray
from valve.errors import RecordingError
from valve.nameplate import Nameplate
from valve.recording import Recording

# Methods, diagnosis and its gain ask for the same recordings in turn: one, its held-out ones, and some that are joined.
_KEPT: Final = 6


class InputPath(Protocol):
    """The actuator force, straight between its corners, for given values of its nuisances."""

    @property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """What is to be fitted together with the valve."""
        ...

    @property
    def breaks_s(self) -> FloatArray:
        """Times, shape (b, 2), between which the force is not known and after which the stem is started anew."""
        ...

    def corners(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Corner times, s, that never fall, and force, N, both shape (n,), for these values of the nuisances."""
        ...

    def variations(self, values: FloatArray) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Corners changed by one sigma along each independent direction in which the input is uncertain."""
        ...


@lru_cache(maxsize=_KEPT)
def input_path(recording: Recording, nameplate: Nameplate) -> InputPath | Outcome:
    """Return the actuator force of a recording, or the outcome that says why there is none.

    A measured force or pressure, ``MeasuredPath``, or ``CommandedPath`` where it is the answer to the commands of a
    polled test; without either the command through an I/P, ``TransducerPath``. The last few are kept: a recording
    never changes, so that whoever asks again for this very one with an equal nameplate gets the same path.
    """
    try:
        force_n = recording.actuator_force_n(nameplate)
    except RecordingError:
        return Outcome.NO_DIAPHRAGM_AREA
    if recording.force_n is None and recording.pressure_pa is None:
        return transducer_path(recording, nameplate, force_n)
    commanded = commanded_path(recording, nameplate, force_n)
    return measured_path(recording, force_n) if commanded is None else commanded


__all__ = ["CommandedPath", "InputPath", "MeasuredPath", "Nuisance", "TransducerPath", "input_path"]
