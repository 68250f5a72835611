from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import httpx
from fastapi import FastAPI, Request

from service.http.body_limits import UPLOAD_PATH, BodyLimit, BodyLimits
from service.http.errors import install_error_handlers


def _app() -> FastAPI:
    app = FastAPI()
    app.add_middleware(BodyLimits, body=BodyLimit(2048, 0.2), upload=BodyLimit(8192, 5.0))
    install_error_handlers(app)

    @app.post("/small")
    @app.post(UPLOAD_PATH)
    async def count(request: Request) -> int:
        return len(await request.body())

    return app


def _client() -> httpx.AsyncClient:
    return httpx.AsyncClient(transport=httpx.ASGITransport(_app()), base_url="http://x")


async def test_a_body_up_to_the_limit_passes_and_a_byte_more_does_not() -> None:
    async with _client() as client:
        assert (await client.post("/small", content=b"x" * 2048)).json() == 2048
        answer = await client.post("/small", content=b"x" * 2049)
        assert answer.status_code == 413
        assert answer.headers["content-type"] == "application/problem+json"
        assert "2 KiB" in answer.json()["detail"]


async def test_uploads_have_their_own_limit() -> None:
    async with _client() as client:
        assert (await client.post(UPLOAD_PATH, content=b"x" * 8192)).json() == 8192
        assert (await client.post(UPLOAD_PATH, content=b"x" * 8193)).status_code == 413


async def test_a_body_that_comes_too_slowly_is_cut() -> None:
    async def slow() -> AsyncIterator[bytes]:
        yield b"x"
        await asyncio.sleep(30.0)
        yield b"x"

    async with _client() as client:
        answer = await client.post("/small", content=slow())
        assert answer.status_code == 408
        assert "0.2 s" in answer.json()["detail"]
