"""``breakaway demo``: simulated valves and the service as real processes, each valve tested through REST."""

from __future__ import annotations

import asyncio
import contextlib
import json
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Final

import httpx
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from service.cli.demo_plant import DEMO_VALVES, DemoValve, write_demo_plant
from service.cli.demo_tables import print_test
from valve.errors import InternalError
from valve.parameter_sets import PARAMETER_SETS

_START_TIMEOUT_S: Final = 60.0  # a first start compiles the kernels: 6 s on an idle machine, more on a busy one
_TEST_TIMEOUT_S: Final = 120.0
_ENDED: Final = frozenset({"completed", "failed", "stopped", "interrupted"})
# Two of the paper's three cycles: method 2 needs the second, and the demonstration stays short.
_OVERRIDES: Final = {"cycles": 2, "period_s": 20.0}


@contextlib.contextmanager
def _running(arguments: list[str], log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run a breakaway command as a process of its own; its end is asked for, waited for and at last enforced."""
    with log.open("wb") as output:
        command = [sys.executable, "-m", "service.cli", *arguments]
        process = subprocess.Popen(command, stdout=output, stderr=output, start_new_session=True)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)
            try:
                process.wait(10.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


async def _wait_until_healthy(
    client: httpx.AsyncClient, processes: dict[str, tuple[subprocess.Popen[bytes], Path]]
) -> None:
    deadline = time.monotonic() + _START_TIMEOUT_S
    while time.monotonic() < deadline:
        for name, (process, log) in processes.items():
            if process.poll() is not None:
                lines = log.read_text(encoding="utf-8", errors="replace").strip().splitlines() or ["no output"]
                raise InternalError(f"demo: {name} ended with code {process.returncode}: {lines[-1]}")
        with contextlib.suppress(httpx.TransportError):
            if (await client.get("/healthz")).is_success:
                return
        await asyncio.sleep(0.1)
    raise InternalError(f"demo: the service did not answer within {_START_TIMEOUT_S:g} s: look at its log")


async def _run_test(client: httpx.AsyncClient, valve: DemoValve, progress: Progress, task: TaskID) -> dict[str, Any]:
    """Start one test and follow it to its end; the test as ``GET /tests/{id}`` gives it."""
    answer = await client.post("/tests/run", json={"valve": valve.tag, "sequence": "triangle", "overrides": _OVERRIDES})
    if answer.status_code != httpx.codes.ACCEPTED:
        detail = answer.json().get("detail", answer.text)
        raise InternalError(f"demo: {valve.tag} was not started ({answer.status_code}): {detail}")
    deadline = time.monotonic() + _TEST_TIMEOUT_S
    location, said = answer.headers["Location"], ""
    while True:
        test: dict[str, Any] = (await client.get(location)).json()
        progress.update(task, completed=float(test.get("progress") or 0.0), state=test["state"])
        if not progress.console.is_terminal and test["state"] != said:
            said = test["state"]
            progress.console.print(f"{valve.tag}: {said}")
        if test["state"] in _ENDED:
            progress.update(task, completed=1.0 if test["state"] == "completed" else progress.tasks[task].completed)
            return test
        if time.monotonic() > deadline:
            raise InternalError(f"demo: the test of {valve.tag} is still {test['state']} after {_TEST_TIMEOUT_S:g} s")
        await asyncio.sleep(0.25)


async def _run_all(
    base_url: str, processes: dict[str, tuple[subprocess.Popen[bytes], Path]], console: Console
) -> list[dict[str, Any]]:
    """Test every valve of the demonstration at the same time; one object a valve."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=30),
        TextColumn("{task.percentage:>3.0f} %"),
        TextColumn("{task.fields[state]}"),
        TimeElapsedColumn(),
    )
    async with httpx.AsyncClient(base_url=base_url, timeout=10.0) as client:
        with Progress(*columns, console=console) as progress:
            starting = progress.add_task("starting", total=None, state="simulated plant and service")
            await _wait_until_healthy(client, processes)
            progress.remove_task(starting)
            tasks = [
                progress.add_task(f"{valve.tag} {valve.parameter_set:8s} {valve.transport}", total=1.0, state="queued")
                for valve in DEMO_VALVES
            ]
            tests = await asyncio.gather(
                *(_run_test(client, valve, progress, task) for valve, task in zip(DEMO_VALVES, tasks, strict=True))
            )
    return [
        {
            "tag": valve.tag,
            "transport": valve.transport,
            "truth": PARAMETER_SETS[valve.parameter_set].parameters.by_symbol(),
            "test": test,
        }
        for valve, test in zip(DEMO_VALVES, tests, strict=True)
    ]


def demo(
    once: Annotated[bool, typer.Option("--once", help="End after the tests instead of serving on.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object on standard output.")] = False,
) -> None:
    """Test four simulated valves over Modbus TCP and RTU through the service, and print truth beside estimate."""
    console = Console(stderr=as_json)
    with tempfile.TemporaryDirectory(prefix="breakaway-demo-") as name, contextlib.ExitStack() as stack:
        folder = Path(name)
        config = write_demo_plant(folder)
        service = tomllib.loads(config.read_text(encoding="utf-8"))["service"]
        base_url = f"http://{service['bind']}:{service['port']}"
        processes = {
            command: (
                stack.enter_context(_running([command, "--config", str(config)], folder / f"{command}.log")),
                folder / f"{command}.log",
            )
            for command in ("simulate", "serve")
        }
        valves = asyncio.run(_run_all(base_url, processes, console))
        if as_json:
            print(json.dumps({"valves": valves}))
        for valve, made in zip(DEMO_VALVES, valves, strict=True):
            print_test(console, valve, made)
        incomplete = [made["tag"] for made in valves if made["test"]["state"] != "completed"]
        if not once:
            _serve_on(console, base_url, folder, [process for process, _ in processes.values()])
    if incomplete:
        raise InternalError(f"demo: {', '.join(incomplete)} did not complete: the reason stands above")


def _serve_on(console: Console, base_url: str, folder: Path, processes: list[subprocess.Popen[bytes]]) -> None:
    """Keep the processes until the user ends them (Ctrl-C or SIGTERM) or one of them ends by itself."""
    console.print(f"\nThe service goes on at {base_url} (its routes: {base_url}/docs).")
    console.print(f"Its plant, store and logs: {folder} (removed at the end). Ctrl-C ends it.")

    def end(_signal: int, _frame: object) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, end)
    with contextlib.suppress(KeyboardInterrupt):
        while all(process.poll() is None for process in processes):
            time.sleep(0.5)
