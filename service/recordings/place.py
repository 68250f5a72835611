"""Where the recording of a test stands: in the folder of the gateway that made it, and nowhere else."""

from __future__ import annotations

from pathlib import Path

from service.config.settings import Plant
from service.model.run import Run
from service.store.store import Store
from valve.errors import ElsewhereError, NotFoundError


def recording_of(run: Run, plant: Plant, store: Store) -> Path:
    """Return the file of a test's recording.

    Raises ElsewhereError with the address of the gateway that has it, NotFoundError where there is none.
    """
    if run.recording_file is None:
        raise NotFoundError(f"test {run.id} has no recording (it is {run.state.value}): choose another test")
    path = store.recording_path(run.id)
    if path.is_file():
        return path
    if run.gateway in ("", plant.service.gateway):
        raise NotFoundError(f"test {run.id}: {path.name} is no longer in the store: restore it from a backup")
    made = f"test {run.id}: gateway {run.gateway} made the recording and keeps it"
    if run.gateway not in plant.gateways:
        raise NotFoundError(f"{made}, and plant.toml does not say where that is: add it to [[gateways]]")
    raise ElsewhereError(made, run.gateway, plant.gateways[run.gateway])
