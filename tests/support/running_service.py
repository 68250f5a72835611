"""A service that really listens, in the test's own event loop."""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Final

import httpx
import uvicorn
from fastapi import FastAPI

from drivers.motion.rig import Rig
from service.config.plant import Plant
from service.http.http_protocol import BoundedHttp
from service.runs.analyst import Analyst
from tests.support.in_process import app_of

#: For a client that speaks plain HTTP alone: it reads no authorities' certificates, which takes it 17 ms.
NO_TLS: Final = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)


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
        async with httpx.AsyncClient(base_url=f"http://{bind}:{port}", timeout=320.0, verify=NO_TLS) as client:
            yield client
    finally:
        server.should_exit = True
        await serving
