"""``/recordings/analyze``: a recording that exists already, with its nameplate."""

from __future__ import annotations

import asyncio
import json
import secrets
import shutil
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from functools import partial
from http import HTTPStatus
from pathlib import Path
from typing import Any, Final

from fastapi import APIRouter, Request
from starlette.datastructures import FormData, UploadFile
from starlette.exceptions import HTTPException

from service.access.needs import needs
from service.access.principal import Right
from service.config.nameplates import nameplate_from_mapping, nameplate_from_toml
from service.config.plant import Plant
from service.http.errors import PageReader
from service.http.given import Given
from service.http.problems import PROBLEMS
from service.own_files.mapping import parse_mapping
from service.runs.analyst import Analyst
from service.shown.analysis_summary import summary_of
from service.store.store import Store
from valve.errors import RecordingError, RequestError
from valve.messages import Message, changed, message_of, say, with_table
from valve.nameplate import Nameplate

router = APIRouter(prefix="/recordings", tags=["recordings"], responses=PROBLEMS)

_FILES = {"type": "array", "items": {"type": "string", "format": "binary"}}
_BODY = {
    "required": True,
    "content": {
        "multipart/form-data": {
            "schema": {
                "type": "object",
                "required": ["recording"],
                "properties": {
                    "recording": {
                        **_FILES,
                        "minItems": 1,
                        "description": "CSV, xlsx or Parquet, also gz; several of one valve",
                    },
                    "held_out": {**_FILES, "description": "recordings to measure the gain on; they are not fitted"},
                    "nameplate": {"type": "string", "description": "TOML or JSON, as a field or a file"},
                    "valve": {"type": "string", "description": "tag of a valve of this plant, instead of nameplate"},
                    "map": {
                        "type": "string",
                        "description": "which column is what where the headers leave it open: position_m=Hub [%]",
                    },
                },
            }
        }
    },
}
_MOST_FILES: Final = 16
_LONGEST_NAME: Final = 80
_SINGLE: Final = ("nameplate", "valve", "map")
_PARTS: Final = "one or more recording, any held_out, one nameplate or valve, and at most one map"


@router.post("/analyze", dependencies=[needs(Right.ANALYZE)], openapi_extra={"requestBody": _BODY})
async def analyze_recording(
    request: Request,
    plant: Given[Plant],
    store: Given[Store],
    analyst: Given[Analyst],
    page: PageReader,
) -> dict[str, Any]:
    """Analyse uploaded recordings of one valve: the analysis object. Nothing is kept.

    Uploads wait behind the tests of this plant; 429 where eight wait already. All files of one together may have
    2,000,000 rows.
    """
    if not request.headers.get("content-type", "").lower().startswith("multipart/form-data"):
        raise HTTPException(
            HTTPStatus.UNSUPPORTED_MEDIA_TYPE,
            say("body_no_form", "the body is no multipart/form-data: send the parts recording and nameplate"),
        )
    async with _form(request) as form:
        unknown = sorted(set(form) - {"recording", "held_out", *_SINGLE})
        if unknown or any(len(form.getlist(name)) > 1 for name in _SINGLE):
            raise RequestError(
                say(
                    "parts_unknown",
                    "the parts {unknown} are not {parts}: send these",
                    unknown=str(unknown or sorted(form)),
                    parts=_PARTS,
                )
            )
        nameplate, mapping = await _nameplate(form, plant), _mapping(form)
        recordings, held_out = (_uploads(form, name) for name in ("recording", "held_out"))
        if not recordings:
            raise RequestError(
                say("part_recording_missing", "part recording is missing or no file: attach the CSV or Parquet file")
            )
        token = secrets.token_hex(16)
        kept = {store.uploads / f"{token}.{number}": one for number, one in enumerate([*recordings, *held_out])}
        names = {path: _name(upload) for path, upload in kept.items()}
        paths = list(kept)
        own, tried = paths[: len(recordings)], [(names[path], path) for path in paths[len(recordings) :]]
        if len(own) == 1:
            names[own[0]] = "recording"
        try:
            await asyncio.to_thread(_keep, kept)
            analysis = await analyst.analyze(
                own[0], nameplate, together=own[1:], held_out=tried, upload=True, mapping=mapping
            )
            sent = {path.name: _name(upload) for path, upload in kept.items()}
            for one in analysis["recording"].get("understood", ()):
                one["file"] = sent[one["file"]]
            if not analysis["estimates"]:
                return analysis
            return with_table({**analysis, "summary": summary_of(analysis, page)})
        except RecordingError as error:
            raise RecordingError(changed(message_of(error), partial(_with_names, names))) from error
        finally:
            for path in kept:
                path.unlink(missing_ok=True)


def _with_names(names: Mapping[Path, str], text: str) -> str:
    """Return a text with the senders' names of its files; the text of a message has none of its own."""
    if not isinstance(text, Message):
        for path, name in names.items():
            text = text.replace(str(path), name)
    return text


def _uploads(form: FormData, name: str) -> list[UploadFile]:
    found = form.getlist(name)
    if not all(isinstance(part, UploadFile) for part in found):
        raise RequestError(
            say("part_missing", "part {name} is missing or no file: attach the CSV or Parquet file", name=name)
        )
    return [part for part in found if isinstance(part, UploadFile)]


@asynccontextmanager
async def _form(request: Request) -> AsyncIterator[FormData]:
    try:
        form = await request.form(max_files=_MOST_FILES, max_fields=6)
    except HTTPException as error:
        if error.status_code != HTTPStatus.BAD_REQUEST:
            raise
        reason = str(error.detail).rstrip(".")
        raise RequestError(
            say(
                "form_unreadable",
                "the body cannot be read as multipart/form-data ({reason}): send the parts recording and nameplate",
                reason=reason,
            )
        ) from None
    try:
        yield form
    finally:
        await form.close()


def _name(upload: UploadFile) -> str:
    """Name of a file as its sender has it, short and without what is not printed."""
    name = Path(upload.filename or "").name
    return "".join(letter for letter in name if letter.isprintable())[:_LONGEST_NAME] or "unnamed"


def _keep(uploads: Mapping[Path, UploadFile]) -> None:
    for path, upload in uploads.items():
        with path.open("xb") as file:
            shutil.copyfileobj(upload.file, file)


def _mapping(form: FormData) -> dict[str, str]:
    text = form.get("map", "")
    if not isinstance(text, str):
        raise RequestError(say("map_is_file", "part map is a file: send it as a field, such as position_m=Hub [%]"))
    return parse_mapping(text)


async def _nameplate(form: FormData, plant: Plant) -> Nameplate:
    part, tag = form.get("nameplate"), form.get("valve")
    if isinstance(tag, str) and tag and not part:
        if tag not in plant.valves:
            raise RequestError(
                say(
                    "no_valve_of_tag",
                    "valve {tag}: this plant has none of this tag: send a nameplate",
                    tag=repr(tag[:_LONGEST_NAME]),
                )
            )
        return plant.valves[tag].nameplate
    if tag and part:
        raise RequestError(say("nameplate_and_valve", "parts nameplate and valve are both there: send one of them"))
    if part is None:
        raise RequestError(
            say(
                "nameplate_missing",
                "part nameplate is missing: send the nameplate as TOML or JSON, or a tag as part valve",
            )
        )
    data = await part.read() if isinstance(part, UploadFile) else part.encode("utf-8", "surrogatepass")
    if not data.lstrip().startswith(b"{"):
        return nameplate_from_toml(data, "nameplate")
    try:
        mapping = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise RequestError(
            say("nameplate_no_json", "nameplate: it is no JSON: {why}: correct it", why=message_of(error))
        ) from error
    return nameplate_from_mapping(mapping, "nameplate")
