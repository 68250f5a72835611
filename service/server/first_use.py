"""What a first request would make on the event loop, where every polled valve would wait for it: made before."""

from __future__ import annotations

import mimetypes

import anyio
from fastapi import FastAPI

from service.tablet.rendering import compile_templates


def use_once(app: FastAPI) -> None:
    """Make what is made once and kept: it takes 0.3 s of a processor, and no valve may wait so long for a slot.

    The OpenAPI document takes 150 ms in one go, the list of valves' templates 28, the library behind the first live
    view 25. Called before the service listens and before it moves anything.
    """
    app.openapi()
    compile_templates()
    mimetypes.init()
    anyio.run(anyio.sleep, 0)  # it loads its side for asyncio with its first use
