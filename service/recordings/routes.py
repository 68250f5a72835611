"""``/recordings/analyze``: a recording that exists already, with its nameplate."""

from __future__ import annotations

import asyncio
import json
import secrets
import shutil
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from http import HTTPStatus
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Request
from starlette.datastructures import FormData, UploadFile
from starlette.exceptions import HTTPException

from service.nameplates import nameplate_from_mapping, nameplate_from_toml
from service.parts import Parts, parts_of
from service.problems import PROBLEMS
from valve.errors import RecordingError, RequestError
from valve.nameplate import Nameplate

router = APIRouter(prefix="/recordings", tags=["recordings"], responses=PROBLEMS)

_BODY = {
    "required": True,
    "content": {
        "multipart/form-data": {
            "schema": {
                "type": "object",
                "required": ["recording", "nameplate"],
                "properties": {
                    "recording": {"type": "string", "format": "binary", "description": "CSV or Parquet"},
                    "nameplate": {"type": "string", "description": "TOML or JSON, as a field or a file"},
                },
            }
        }
    },
}


@router.post("/analyze", openapi_extra={"requestBody": _BODY})
async def analyze_recording(request: Request, parts: Annotated[Parts, Depends(parts_of)]) -> dict[str, Any]:
    """Analyse an uploaded recording: the analysis object. Nothing is kept."""
    if not request.headers.get("content-type", "").lower().startswith("multipart/form-data"):
        raise HTTPException(
            HTTPStatus.UNSUPPORTED_MEDIA_TYPE,
            "the body is no multipart/form-data: send the parts recording and nameplate",
        )
    async with _form(request) as form:
        unknown = sorted(set(form) - {"recording", "nameplate"})
        if unknown or len(form.multi_items()) != len(form):
            raise RequestError(
                f"the parts {unknown or sorted(form)} are not one recording and one nameplate: send these"
            )
        nameplate = await _nameplate(form)
        upload = form.get("recording")
        if not isinstance(upload, UploadFile):
            raise RequestError("part recording is missing or no file: attach the CSV or Parquet file")
        path = parts.store.uploads / f"{secrets.token_hex(16)}.upload"
        try:
            await asyncio.to_thread(_keep, upload, path)
            return await parts.analyst.analyze(path, nameplate)
        except RecordingError as error:
            raise RecordingError(str(error).replace(str(path), "recording")) from error
        finally:
            path.unlink(missing_ok=True)


@asynccontextmanager
async def _form(request: Request) -> AsyncIterator[FormData]:
    try:
        form = await request.form(max_files=4, max_fields=4)
    except HTTPException as error:
        if error.status_code != HTTPStatus.BAD_REQUEST:
            raise
        reason = str(error.detail).rstrip(".")
        raise RequestError(
            f"the body cannot be read as multipart/form-data ({reason}): send the parts recording and nameplate"
        ) from None
    try:
        yield form
    finally:
        await form.close()


def _keep(upload: UploadFile, path: Path) -> None:
    with path.open("xb") as file:
        shutil.copyfileobj(upload.file, file)


async def _nameplate(form: FormData) -> Nameplate:
    part = form.get("nameplate")
    if part is None:
        raise RequestError("part nameplate is missing: send the nameplate as TOML or JSON")
    data = await part.read() if isinstance(part, UploadFile) else part.encode("utf-8", "surrogatepass")
    if not data.lstrip().startswith(b"{"):
        return nameplate_from_toml(data, "nameplate")
    try:
        mapping = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise RequestError(f"nameplate: it is no JSON: {error}: correct it") from error
    return nameplate_from_mapping(mapping, "nameplate")
