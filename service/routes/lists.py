"""What the routes that list have in common: no query key that they do not know, instants in UTC, CSV if asked for."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from typing import Annotated, Any, Final, Literal
from urllib.parse import urlencode

from fastapi import Depends, Query, Request, Response
from fastapi.dependencies.models import Dependant
from fastapi.exceptions import RequestValidationError
from pydantic import AfterValidator

from service.config.plant import Plant
from service.routes.recording_formats import CSV, qualities
from service.words.spelling import nearest, unknown_key
from valve.messages import say

_JSON: Final = "application/json"
#: For ``responses`` of a route: what its OpenAPI entry says beside JSON.
OR_CSV: Final[dict[int | str, dict[str, Any]]] = {
    200: {"content": {CSV: {"schema": {"type": "string"}}}, "description": "JSON, or CSV as Accept or format asks"}
}


def _keys(needed: Dependant) -> list[str]:
    own = [one.alias for one in needed.query_params]
    return own + [key for inner in needed.dependencies for key in _keys(inner)]


async def known_keys_only(request: Request) -> None:  # a thread for this would be one of those that read
    """Refuse a query key that the route does not know: a filter with a slip in it would list everything.

    Raises RequestValidationError that names each, and those that are known.
    """
    known = _keys(request.scope["route"].dependant)
    unknown = [key for key in dict.fromkeys(request.query_params) if key not in known]
    if unknown:
        raise RequestValidationError(
            [{"type": "unknown_key", "loc": ("query", key[:80]), "msg": _unknown(key, known)} for key in unknown]
        )


def _unknown(key: str, known: Sequence[str]) -> str:
    if not known:
        return say("no_key_known", "this key is unknown, none is known here")
    close = nearest(key, known)
    if close is None:
        return unknown_key(key, known)
    return say(
        "key_meant_of_known",
        "this key is unknown, did you mean {close}?; known here are {known:, }",
        close=close,
        known=tuple(known),
    )


#: For ``dependencies`` of a route, behind the right that it needs.
KNOWN_KEYS: Final = Depends(known_keys_only)


def in_utc(instant: datetime | None) -> datetime | None:
    """Return an instant in UTC, taken for UTC where it names no zone. Raises ValueError where there is none."""
    if instant is None:
        return None
    try:
        return instant.replace(tzinfo=UTC) if instant.tzinfo is None else instant.astimezone(UTC)
    except OverflowError as error:
        raise ValueError("there is no such instant in UTC") from error


Since = Annotated[
    datetime | None,
    Query(description="asked for at this instant or later (ISO 8601; UTC where it names no zone)"),
    AfterValidator(in_utc),
]
Until = Annotated[datetime | None, Query(description="asked for before this instant"), AfterValidator(in_utc)]
Areas = Annotated[
    list[Annotated[str, Query(max_length=200, pattern=r"^[^\x00]*$")]] | None,
    Query(description="of one of these areas, as the plant file says it now"),
]
Form = Annotated[Literal["json", "csv"] | None, Query(alias="format", description="stands above Accept")]


def _of_no_area(area: str, told: str) -> str:
    return say("no_valve_of_area", "no valve is of {area}; {told}", area=repr(area[:80]), told=told)


def tags_of_areas(plant: Plant, areas: Sequence[str]) -> list[str]:
    """Return the tags of the valves of these areas, sorted; of all where none is asked for.

    Raises RequestValidationError that names those of the plant where one is unknown: a slip would list nothing.
    """
    by_tag = {tag: valve.identity.area for tag, valve in plant.valves.items()}
    known = sorted({area for area in by_tag.values() if area is not None})
    unknown = [area for area in dict.fromkeys(areas) if area not in known]
    if unknown:
        told = (
            say("known_here", "known here are {known:, }", known=tuple(known))
            if known
            else say("no_areas", "plant.toml gives no valve an area")
        )
        raise RequestValidationError(
            [{"type": "unknown_area", "loc": ("query", "area"), "msg": _of_no_area(area, told)} for area in unknown]
        )
    return sorted(tag for tag, area in by_tag.items() if not areas or area in areas)


def wants_csv(request: Request, form: str | None) -> bool:
    """Whether a list is asked for as CSV: by ``format``, or where ``Accept`` prefers it to JSON."""
    if form is not None:
        return form == "csv"
    wishes = qualities(request.headers.get("accept", "*/*"))
    as_csv = next((wishes[name] for name in (CSV, "text/*") if name in wishes), 0.0)
    as_json = next((wishes[name] for name in (_JSON, "application/*", "*/*") if name in wishes), 0.0)
    return as_csv > as_json


def next_page(path: str, query: Mapping[str, Any]) -> str:
    """Return the address of the following page with the filters of this one."""
    given = {key: value for key, value in query.items() if value is not None and value != []}
    told = {key: value.isoformat() if isinstance(value, datetime) else value for key, value in given.items()}
    return f"{path}?{urlencode(told, doseq=True)}"


def csv_answer(
    columns: Sequence[str], rows: Iterable[Sequence[object]], name: str, following: str | None = None
) -> Response:
    """Return rows as a file of comma-separated values (RFC 4180, UTF-8), SI, an empty cell where nothing is known.

    ``following`` is the next page: it stands in the header ``Link`` (RFC 8288).
    """
    out = io.StringIO()
    writer = csv.writer(out)
    writer.writerow(columns)
    writer.writerows([_cell(value) for value in row] for row in rows)
    headers = {"Content-Disposition": f'attachment; filename="{name}.csv"', "Vary": "Accept"}
    if following is not None:
        headers["Link"] = f'<{following}>; rel="next"'
    return Response(out.getvalue(), media_type=CSV, headers=headers)


def _cell(value: object) -> object:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, datetime):
        return value.astimezone(UTC).isoformat()
    return value


def dated(word: str) -> str:
    """Return the name of a list's file: what it is, and today, UTC."""
    return f"{word}_{datetime.now(UTC):%Y-%m-%d}"
