"""Templates into pages: the Jinja2 environment, the headers of every page, and the units that the browser keeps."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, tzinfo
from functools import cache
from http import HTTPStatus
from pathlib import Path
from typing import Annotated, Any, Final

from fastapi import Depends, Request
from fastapi.responses import HTMLResponse
from jinja2 import Environment, pass_context

from service.config.plant import Plant
from service.http.given import Given
from service.model.requester import person_of
from service.model.stands_words import NOT_CONFIRMED
from service.runs.motion_watch import MotionWatch
from service.tablet.script import script, script_language, script_name
from service.tablet.visitor import Visitor
from service.words.languages import Language
from service.words.names import named
from service.words.plant_clock import instant_words
from service.words.reader import Reader
from service.words.sentences import as_clause, as_heading, as_sentence, together, without
from service.words.templates import templates_in
from service.words.units import UnitSystem
from valve.errors import NotFoundError
from valve.messages import Message, message_of

_HERE: Final = Path(__file__).parent
STATIC: Final = _HERE / "static"
UNITS_COOKIE: Final = "breakaway-units"
LANGUAGE_COOKIE: Final = "breakaway-language"
_KEPT_S: Final = 365 * 86400
# No script, style or picture from anywhere else, none inside the page, and nobody frames it.
CONTENT_SECURITY: Final = (
    "default-src 'self'; object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
_HEADERS: Final = {
    "Content-Security-Policy": CONTENT_SECURITY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",
    "Cache-Control": "no-store",
}


@pass_context
def _told(context: Mapping[str, Any], value: Any) -> Any:
    """A message is read as the visitor of the page reads it."""
    return context["s"](value) if isinstance(value, Message) else value


@cache
def environment(language: Language) -> Environment:
    """Return what makes the pages in a language."""
    made = templates_in(_HERE / "templates", language, _told)
    made.filters["moment"] = moment
    made.filters["sentence"] = as_sentence
    made.filters["clause"] = as_clause
    made.filters["heading"] = as_heading
    made.filters["without"] = without
    made.filters["together"] = together
    made.filters["named"] = lambda name: name if isinstance(name, Message) else named(name)
    made.filters["person"] = person_of
    made.filters["duration"] = duration
    made.filters["attribute_json"] = lambda value: json.dumps(value, allow_nan=False, separators=(",", ":"))
    made.globals["static"] = static_address
    made.globals["not_confirmed"] = NOT_CONFIRMED
    made.globals["languages"] = list(Language)
    made.globals["script_name"] = script_name(language)
    return made


def compile_templates() -> None:
    """Compile every template, so that no page is the first of its kind."""
    for language in Language:
        pages = environment(language)
        for name in pages.list_templates():
            pages.get_template(name)


@cache
def static_address(name: str) -> str:
    """Return the address of a static file, which changes with its content: a browser may keep it for ever."""
    language = script_language(name)
    content = (STATIC / name).read_bytes() if language is None else script(language)
    digest = hashlib.sha256(content).hexdigest()[:12]
    return f"/ui/static/{name}?v={digest}"


def reader_of(request: Request, zone: tzinfo | None) -> Reader:
    """Return who reads: the units and the language that this browser keeps, or else likes best, and the plant's clock.

    What the address asks for stands above both.
    """
    asked, kept = request.query_params, request.cookies
    language = Language.of(asked.get("language") or kept.get(LANGUAGE_COOKIE))
    return Reader(
        UnitSystem.of(asked.get("units") or kept.get(UNITS_COOKIE)),
        zone,
        language or Language.wished(request.headers.get("Accept-Language")),
    )


@pass_context
def moment(context: Mapping[str, Any], at: datetime | None) -> str:
    """Return an instant by the plant's clock, with its zone; a dash for none."""
    return instant_words(at, context["zone"])


def duration(seconds: float | None) -> str:
    """Return a time span in words, such as ``1 min 5 s``."""
    if seconds is None:
        return "–"
    whole = round(seconds)
    hours, rest = divmod(whole, 3600)
    minutes, rest = divmod(rest, 60)
    if hours:
        return f"{hours} h {minutes} min"
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"


@dataclass(frozen=True, slots=True)
class Pages:
    """Shows pages to the browser of one request, with what stands on every page of its plant."""

    request: Request
    plant: Plant
    watch: MotionWatch

    @property
    def reader(self) -> Reader:
        """Who reads the page."""
        return reader_of(self.request, self.plant.zone)

    def show(
        self, template: str, visitor: Visitor | None, values: Mapping[str, Any], status: int = HTTPStatus.OK
    ) -> HTMLResponse:
        """Return a page. The units stand in a cookie, so that the switch is kept in the browser."""
        reader = self.reader
        shown = {
            "visitor": visitor,
            "units": reader.system,
            "unit_systems": list(UnitSystem),
            "q": reader.quantity,
            "m": reader.measured,
            "u": reader.unit,
            "s": lambda sentence: reader.told(sentence if isinstance(sentence, str) else str(sentence)),
            "zone": self.plant.zone,
            "plant_alarms": () if visitor is None else self.watch.alarms,
            "now": datetime.now(UTC),
            "path": self.request.url.path,
            **values,
        }
        response = HTMLResponse(
            environment(reader.language).get_template(template).render(shown), status, dict(_HEADERS)
        )
        for name, cookie, known in (("units", UNITS_COOKIE, UnitSystem), ("language", LANGUAGE_COOKIE, Language)):
            chosen = self.request.query_params.get(name)
            if chosen in list(known):
                response.set_cookie(cookie, chosen, max_age=_KEPT_S, samesite="strict", path="/")
        return response

    def missing(self, visitor: Visitor, error: NotFoundError) -> HTMLResponse:
        """Return the page for what is not there."""
        return self.show("missing.html", visitor, {"reason": message_of(error)}, HTTPStatus.NOT_FOUND)


async def _pages(request: Request, plant: Given[Plant], watch: Given[MotionWatch]) -> Pages:
    return Pages(request, plant, watch)


PagesOf = Annotated[Pages, Depends(_pages)]
