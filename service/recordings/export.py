"""Tests out of the store as files: CSV, Parquet or MAT, each with what is known of the test."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping
from dataclasses import asdict
from datetime import datetime
from enum import StrEnum
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.io import savemat

from service.model.run import Run
from service.model.stands_words import where_it_stands
from valve.errors import NotFoundError, RecordingError
from valve.messages import say
from valve.recording_files import file_sha256, read_recording, recording_columns, write_csv

SCHEMA: Final = "breakaway/export/1"


class ExportFormat(StrEnum):
    """How a recording is written."""

    CSV = "csv"
    PARQUET = "parquet"
    MAT = "mat"


def export_test(run: Run, recordings: Path, folder: Path, form: ExportFormat) -> list[Path]:
    """Write a test's recording and beside it ``ID.json`` with all that is known of the test; return both paths.

    Raises NotFoundError where the recording is not here, RecordingError where it is not what was hashed when it was
    stored: nothing is written then.
    """
    source = checked_recording(run, recordings)
    target = folder / f"{run.id}.{form.value}"
    _WRITERS[form](run, source, target)
    about = folder / f"{run.id}.json"
    about.write_text(json.dumps(metadata(run), indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return [target, about]


def checked_recording(run: Run, recordings: Path) -> Path:
    """Return where the recording stands, read and found to be what was stored. Raises as ``export_test``."""
    if run.recording_file is None:
        raise NotFoundError(
            say(
                "nothing_to_export",
                "test {test} has no recording ({state}): choose another test",
                test=run.id,
                state=run.state.value,
            )
        )
    path = recordings / run.recording_file
    if not path.is_file():
        where = (
            say("export_at_gateway", "gateway {gateway} made it: export it there", gateway=run.gateway)
            if run.gateway
            else say("restore_from_backup", "restore it from a backup")
        )
        raise NotFoundError(
            say(
                "recording_file_missing",
                "test {test}: {path} does not exist: {where}",
                test=run.id,
                path=str(path),
                where=where,
            )
        )
    found = file_sha256(path)
    if found != run.recording_sha256:
        raise RecordingError(
            say(
                "recording_changed",
                "test {test}: {path} has the SHA-256 {found}, it was stored with {stored}: it was changed or is "
                "damaged; restore it from a backup",
                test=run.id,
                path=str(path),
                found=found,
                stored=str(run.recording_sha256),
            )
        )
    return path


def metadata(run: Run) -> dict[str, Any]:
    """Return what is known of a test as JSON."""
    values = asdict(run) | {"state": run.state.value, "label": None if run.label is None else run.label.value}
    values["stands"] = None if run.stands is None else {**run.stands.to_json(), "sentence": where_it_stands(run)}
    values["run_number"] = values.pop("number")
    values = {name: value.isoformat() if isinstance(value, datetime) else value for name, value in values.items()}
    return {"schema": SCHEMA, "test": values}


def _csv(_run: Run, source: Path, target: Path) -> None:
    write_csv(read_recording(source), target)


def _parquet(_run: Run, source: Path, target: Path) -> None:
    shutil.copyfile(source, target)  # bit by bit: its hash stays


def _mat(run: Run, source: Path, target: Path) -> None:
    """Columns as vectors under their names with units, the test as a struct; what MAT cannot say is JSON in a text."""
    known = metadata(run)["test"]
    plain = {name: value for name, value in known.items() if isinstance(value, (str, int, float, bool)) and value != ""}
    nested = {f"{name}_json": json.dumps(value) for name, value in known.items() if isinstance(value, Mapping)}
    columns = {name: np.asarray(values)[:, None] for name, values in recording_columns(read_recording(source)).items()}
    content = {**columns, "test": {**plain, **nested}, "schema": SCHEMA}
    savemat(target, content, do_compression=True, long_field_names=True)


_WRITERS: Final[Mapping[ExportFormat, Callable[[Run, Path, Path], None]]] = {
    ExportFormat.CSV: _csv,
    ExportFormat.PARQUET: _parquet,
    ExportFormat.MAT: _mat,
}
