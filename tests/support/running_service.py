"""A service that really listens, in the test's own event loop."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import httpx
import uvicorn
from fastapi import FastAPI

from drivers.motion.rig import Rig
from service.config.settings import Plant
from service.http.http_protocol import BoundedHttp
from service.runs.analyst import Analyst
from tests.support.in_process import app_of


@asynccontextmanager
async def running_service(plant: Plant, rig: Rig | None, analyst: Analyst | None) -> AsyncIterator[httpx.AsyncClient]:
    """Serve a plant on a free port and hand out a client of it."""
    async with running_application(app_of(plant, rig=rig, analyst=analyst)) as client:
        yield client


@asynccontextmanager
async def running_application(app: FastAPI, bind: str = "127.0.0.1") -> AsyncIterator[httpx.AsyncClient]:
    """Serve an application on a free port and hand out a client of it."""
    config = uvicorn.Config(app, host=bind, port=0, log_config=None, lifespan="on", ws="none", http=BoundedHttp)
    server = uvicorn.Server(config)
    serving = asyncio.create_task(server.serve())
    while not server.started:
        if serving.done():
            await serving
            raise RuntimeError("the service did not start")
        await asyncio.sleep(0.005)
    port = server.servers[0].sockets[0].getsockname()[1]
    try:
        async with httpx.AsyncClient(base_url=f"http://{bind}:{port}", timeout=320.0) as client:
            yield client
    finally:
        server.should_exit = True
        await serving
