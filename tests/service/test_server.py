"""How the service's process ends, whatever signals come while it does."""

from __future__ import annotations

import asyncio
import signal
import sys

SERVED = """
import asyncio, contextlib, signal
import uvicorn
from fastapi import FastAPI
from service.server.server import _Server

for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
    signal.signal(number, signal.SIG_DFL)  # whoever started this may ignore them

async def hold():
    try:
        print("moves", flush=True)
        await asyncio.Event().wait()
    except asyncio.CancelledError:
        print("goes to safe", flush=True)
        await asyncio.sleep(1.0)
        print("is safe", flush=True)
        raise

@contextlib.asynccontextmanager
async def lifespan(app):
    app.state.moving = asyncio.ensure_future(hold())
    app.state.polling = Polling()
    yield

class Polling:
    async def change(self):
        await asyncio.Event().wait()

app = FastAPI(lifespan=lifespan)
server = _Server(uvicorn.Config(app, loop="uvloop", port=0, log_config=None), app)
with server.hearing_signals():
    server.run()
print("ended", flush=True)
"""


async def test_no_signal_ends_the_process_while_a_valve_is_still_brought_to_safe() -> None:
    process = await asyncio.create_subprocess_exec(sys.executable, "-c", SERVED, stdout=-1)
    assert process.stdout is not None
    try:
        async with asyncio.timeout(60.0):
            assert await process.stdout.readline() == b"moves\n"
            await asyncio.sleep(0.3)
            process.send_signal(signal.SIGINT)
            assert await process.stdout.readline() == b"goes to safe\n"
            for number in (signal.SIGHUP, signal.SIGTERM, signal.SIGQUIT, signal.SIGINT, signal.SIGINT):
                process.send_signal(number)
                await asyncio.sleep(0.05)
            assert await process.stdout.readline() == b"is safe\n"
            assert await process.stdout.readline() == b"ended\n"
            assert await process.wait() == 0
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
