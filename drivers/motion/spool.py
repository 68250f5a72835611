"""The ends of motions on disk, until whoever asked for them has stored them.

``ID.end`` is JSON: the order, how the motion ended, and what its texts were made of. ``ID.npz`` holds the channels of
its recording.
Both are whole and forced onto the disk when ``write`` returns.
"""

from __future__ import annotations

import io
import json
import os
from dataclasses import fields
from pathlib import Path
from typing import Any, Final
from zipfile import BadZipFile

import numpy as np
import structlog

from drivers.motion.orders import Left, MotionEnd, Order
from drivers.motion.synced import sync_folder
from drivers.motion.wire_format import error_of, of_json, to_json
from drivers.outcome import Ended, PlayOutcome
from drivers.stands_at import StandsAt
from valve.errors import InternalError, NotFoundError
from valve.messages import message_of, restored, say, with_table
from valve.recording import Provenance, Recording

_LOG = structlog.get_logger(__name__)
_SUFFIX: Final = ".end"
_OUTCOME: Final = ("safe_confirmed", "writes", "commanded", "why_unsafe", "ended_early_s")
_CHANNELS: Final = tuple(field.name for field in fields(Recording) if field.name != "provenance")


class Spool:
    """Ends of motions in a folder. All methods block."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def write(self, order: Order, end: MotionEnd) -> None:
        """Keep how a motion ended. Raises OSError."""
        self._folder.mkdir(parents=True, exist_ok=True)
        recording = end.outcome.recording
        if recording is not None:
            data = io.BytesIO()
            channels = {name: getattr(recording, name) for name in _CHANNELS}
            np.savez(data, **{name: channel for name, channel in channels.items() if channel is not None})
            self._keep(self.path(order.run_id, ".npz"), data.getvalue())
        about = {"order": to_json(order), **end_to_json(end)}
        self._keep(self.path(order.run_id, _SUFFIX), json.dumps(with_table(about)).encode())

    def path(self, run_id: str, suffix: str) -> Path:
        """Return where something of a motion is kept."""
        return self._folder / f"{run_id}{suffix}"

    def _keep(self, path: Path, data: bytes) -> None:
        part = path.with_name(f".{path.name}.part")
        with part.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
        sync_folder(self._folder)

    def read(self, run_id: str) -> MotionEnd:
        """Return how a motion ended. Raises NotFoundError where nothing is kept of it, InternalError."""
        try:
            said = restored(json.loads(self.path(run_id, _SUFFIX).read_bytes()))
            recording = self.recording(run_id, said) if said["recording"] is not None else None
        except FileNotFoundError:
            raise NotFoundError(
                say("motion_of_test_unknown", "test {test}: the motion process knows nothing of it", test=run_id)
            ) from None
        except (OSError, ValueError, KeyError, EOFError, BadZipFile) as error:
            raise InternalError(
                say(
                    "end_of_motion_unreadable",
                    "test {test}: the end of its motion cannot be read ({why})",
                    test=run_id,
                    why=message_of(error),
                )
            ) from error
        return end_of_json(said, recording)

    def recording(self, run_id: str, said: dict[str, Any]) -> Recording:
        """Return the recording whose end was ``said``. Raises OSError, ValueError, EOFError, BadZipFile."""
        with np.load(self.path(run_id, ".npz")) as channels:
            return Recording(**dict(channels), provenance=of_json(Provenance, said["recording"]))

    def all(self) -> tuple[Left, ...]:
        """Return the motions whose end is kept."""
        found = []
        for path in sorted(self._folder.glob(f"*{_SUFFIX}")):
            try:
                said = json.loads(path.read_bytes())
                found.append(Left(of_json(Order, said["order"]), ended=True))
            except (OSError, ValueError, KeyError, InternalError) as error:
                _LOG.error("end of a motion cannot be read", file=path.name, error=str(error))
        return tuple(found)

    def tidy(self) -> None:
        """Remove what a write that was cut off left."""
        torn = [*self._folder.glob(".*.part")]
        torn += [one for one in self._folder.glob("*.npz") if not one.with_suffix(_SUFFIX).exists()]
        for path in torn:
            try:
                path.unlink(missing_ok=True)
            except OSError as error:
                _LOG.warning("torn end of a motion not removed", file=path.name, error=str(error))

    def remove(self, run_id: str) -> None:
        """Remove what is kept of a motion's end, as far as the disk lets that be; the next start finds the rest."""
        for suffix in (_SUFFIX, ".npz"):
            try:
                self.path(run_id, suffix).unlink(missing_ok=True)
            except OSError as error:
                _LOG.warning("end of a motion not removed", test=run_id, error=str(error))


def end_to_json(end: MotionEnd) -> dict[str, Any]:
    """Return an end without the recording's channels."""
    outcome = end.outcome
    return {
        **{name: getattr(outcome, name) for name in _OUTCOME},
        "ended": outcome.ended.value,
        "error": None if outcome.error is None else to_json(outcome.error),
        "notes": list(outcome.notes),
        "stands": None if outcome.stands is None else to_json(outcome.stands),
        "recording": None if outcome.recording is None else to_json(outcome.recording.provenance),
        "entry_pa": end.entry_pa,
        "faults": list(end.faults),
        "stopped": end.stopped,
        "early": None if end.early is None else dict(end.early),
    }


def end_of_json(said: dict[str, Any], recording: Recording | None) -> MotionEnd:
    """Return the end that ``end_to_json`` wrote, with its recording."""
    outcome = PlayOutcome(
        recording,
        Ended(said["ended"]),
        error=None if said["error"] is None else error_of(said["error"]),
        notes=tuple(said["notes"]),
        stands=None if said["stands"] is None else of_json(StandsAt, said["stands"]),
        **{name: said[name] for name in _OUTCOME},
    )
    return MotionEnd(outcome, said["entry_pa"], tuple(said["faults"]), said["stopped"], said.get("early"))
