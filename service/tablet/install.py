"""What makes an application serve the tablet."""

from __future__ import annotations

from typing import Final

from fastapi import FastAPI
from fastapi.staticfiles import StaticFiles
from starlette.responses import Response
from starlette.types import Scope

from service.tablet.figure_routes import router as figure_routes
from service.tablet.rendering import STATIC
from service.tablet.routes import router
from service.tablet.script import script, script_language
from service.tablet.valve_pages import router as valve_pages
from service.tablet.visitor import SignInNeededError, to_sign_in

_KEEP: Final = "public, max-age=31536000, immutable"  # an address carries the hash of what is behind it


class _Static(StaticFiles):
    async def get_response(self, path: str, scope: Scope) -> Response:
        """Return a file that a browser may keep."""
        language = script_language(path)
        if language is not None:
            response = Response(script(language), media_type="text/javascript")
        else:
            response = await super().get_response(path, scope)
        response.headers["Cache-Control"] = _KEEP if b"v=" in scope["query_string"] else "no-cache"
        response.headers["X-Content-Type-Options"] = "nosniff"
        return response


def install_tablet(app: FastAPI) -> None:
    """Add the pages, their pictures, script and style to an application."""
    app.add_exception_handler(SignInNeededError, to_sign_in)
    app.router.routes.extend((*figure_routes.routes, *router.routes, *valve_pages.routes))
    app.mount("/ui/static", _Static(directory=STATIC), name="static")
