"""Where the recording of a test stands: in the folder of the gateway that made it, and nowhere else."""

from __future__ import annotations

from pathlib import Path

from service.config.plant import Plant
from service.model.run import Run
from service.store.store import Store
from valve.errors import ElsewhereError, NotFoundError
from valve.messages import say


def recording_of(run: Run, plant: Plant, store: Store) -> Path:
    """Return the file of a test's recording.

    Raises ElsewhereError with the address of the gateway that has it, NotFoundError where there is none.
    """
    if run.recording_file is None:
        raise NotFoundError(
            say(
                "no_recording_of_test",
                "test {test} has no recording (it is {state}): choose another test",
                test=run.id,
                state=run.state.value,
            )
        )
    path = store.recording_path(run.id)
    if path.is_file():
        return path
    if run.gateway in ("", plant.service.gateway):
        raise NotFoundError(
            say(
                "recording_not_in_store",
                "test {test}: {file} is no longer in the store: restore it from a backup",
                test=run.id,
                file=path.name,
            )
        )
    made = say(
        "gateway_keeps_it",
        "test {test}: gateway {gateway} made the recording and keeps it",
        test=run.id,
        gateway=run.gateway,
    )
    if run.gateway not in plant.gateways:
        raise NotFoundError(
            say(
                "gateway_not_declared",
                "{made}, and plant.toml does not say where that is: add it to [[gateways]]",
                made=made,
            )
        )
    raise ElsewhereError(made, run.gateway, plant.gateways[run.gateway])
