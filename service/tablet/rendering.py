"""Templates into pages: the Jinja2 environment, the headers of every page, and the units that the browser keeps."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from http import HTTPStatus
from pathlib import Path
from typing import Annotated, Any, Final

from fastapi import Depends, Request
from fastapi.responses import HTMLResponse
from jinja2 import Environment, FileSystemLoader, StrictUndefined, pass_context

from service.config.settings import Plant
from service.http.given import Given
from service.model.requester import person_of
from service.runs.motion_watch import MotionWatch
from service.tablet.script import NAME, script
from service.tablet.visitor import Visitor
from service.words.plant_clock import by_the_plants_clock, instant_words
from service.words.sentences import as_sentence, in_units
from service.words.units import UnitSystem, measured, quantity, shown_unit
from valve.errors import NotFoundError

_HERE: Final = Path(__file__).parent
STATIC: Final = _HERE / "static"
UNITS_COOKIE: Final = "breakaway-units"
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


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(_HERE / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        auto_reload=False,  # else each template's file is looked at with every page
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["moment"] = moment
    environment.filters["sentence"] = as_sentence
    environment.filters["person"] = person_of
    environment.filters["duration"] = duration
    environment.filters["attribute_json"] = lambda value: json.dumps(value, allow_nan=False, separators=(",", ":"))
    environment.globals["static"] = static_address
    return environment


def compile_templates() -> None:
    """Compile every template, so that no page is the first of its kind."""
    environment = _environment()
    for name in environment.list_templates():
        environment.get_template(name)


@cache
def static_address(name: str) -> str:
    """Return the address of a static file, which changes with its content: a browser may keep it for ever."""
    content = script() if name == NAME else (STATIC / name).read_bytes()
    digest = hashlib.sha256(content).hexdigest()[:12]
    return f"/ui/static/{name}?v={digest}"


def units_of(request: Request) -> UnitSystem:
    """Return the units that this browser keeps."""
    return UnitSystem.of(request.query_params.get("units") or request.cookies.get(UNITS_COOKIE))


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
    def system(self) -> UnitSystem:
        """The units that the browser keeps."""
        return units_of(self.request)

    def show(
        self, template: str, visitor: Visitor | None, values: Mapping[str, Any], status: int = HTTPStatus.OK
    ) -> HTMLResponse:
        """Return a page. The units stand in a cookie, so that the switch is kept in the browser."""
        system, zone = self.system, self.plant.zone
        shown = {
            "visitor": visitor,
            "units": system,
            "unit_systems": list(UnitSystem),
            "q": lambda value, unit, digits=4: quantity(value, unit, system, digits),
            "m": lambda value, ci95, unit: measured(value, ci95, unit, system),
            "u": lambda unit: shown_unit(unit, system),
            "s": lambda sentence: by_the_plants_clock(in_units(str(sentence), system), zone),
            "zone": zone,
            "plant_alarms": () if visitor is None else self.watch.alarms,
            "now": datetime.now(UTC),
            "path": self.request.url.path,
            **values,
        }
        response = HTMLResponse(_environment().get_template(template).render(shown), status, dict(_HEADERS))
        chosen = self.request.query_params.get("units")
        if chosen in list(UnitSystem):
            response.set_cookie(UNITS_COOKIE, chosen, max_age=365 * 86400, samesite="strict", path="/")
        return response

    def missing(self, visitor: Visitor, error: NotFoundError) -> HTMLResponse:
        """Return the page for what is not there."""
        return self.show("missing.html", visitor, {"reason": str(error)}, HTTPStatus.NOT_FOUND)


async def _pages(request: Request, plant: Given[Plant], watch: Given[MotionWatch]) -> Pages:
    return Pages(request, plant, watch)


PagesOf = Annotated[Pages, Depends(_pages)]
