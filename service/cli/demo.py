"""``breakaway demo``: simulated valves and the service as real processes, each valve tested through REST."""

from __future__ import annotations

import asyncio
import contextlib
import json
import shutil
import sys
import tempfile
import time
import tomllib
from pathlib import Path
from typing import Annotated, Any, Final

import httpx
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from service.cli.demo_plant import DEMO_VALVES, DemoValve, write_demo_plant
from service.cli.demo_processes import DemoProcess, demo_processes, wait_until_ready
from service.cli.demo_tables import print_legend, print_test
from service.cli.signals import ended_by_signals
from service.cli.truths import read_truths
from valve.errors import InternalError, MeasurementError, ValveError
from valve.messages import say
from valve.parameter_sets import PARAMETER_SETS

_STARTS: Final = 3
_LAST_MOMENT_S: Final = 2.0
_TEST_TIMEOUT_S: Final = 600.0  # 40 s of motion, then the analyses: half a minute on idle cores, many on busy ones
_TRUTH_WAIT_S: Final = 30.0  # a plant that is busy with other valves looks at this one a few seconds after its test
_ENDED: Final = frozenset({"completed", "failed", "stopped", "interrupted"})
# The paper's three cycles, faster: six breakaways, and the demonstration stays short.
_OVERRIDES: Final = {"cycles": 3, "period_s": 12.0}


def demo(
    once: Annotated[bool, typer.Option("--once", help="End after the tests instead of serving on.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object on standard output.")] = False,
) -> None:
    """Test six simulated valves over Modbus TCP and RTU through the service, and print truth beside estimate.

    Then the service stays up, so that you can look around, until Ctrl-C ends it. Nothing of it is left behind.
    """
    console = Console(stderr=as_json)
    with tempfile.TemporaryDirectory(prefix="breakaway-demo-") as name, ended_by_signals():
        try:
            with _progress(console) as progress, contextlib.ExitStack() as stack:
                base_url, processes = _started(Path(name), progress, stack)
                valves = asyncio.run(_run_all(base_url, processes, progress))
                progress.stop()
                if as_json:
                    print(json.dumps({"valves": valves}), flush=True)
                for valve, made in zip(DEMO_VALVES, valves, strict=True):
                    print_test(console, valve, made)
                print_legend(console)
                if not once:
                    _serve_on(console, base_url, processes)
        except KeyboardInterrupt:
            raise MeasurementError(
                say("demo_ended_early", "demo: it was ended before its tests were: start it again to see them all")
            ) from None
    incomplete = [made["tag"] for made in valves if made["test"]["state"] != "completed"]
    if incomplete:
        raise InternalError(
            say("demo_incomplete", "demo: {tags:, } did not complete: the reason stands above", tags=tuple(incomplete))
        )


def _progress(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(bar_width=30),
        TextColumn("{task.percentage:>3.0f} %"),
        TextColumn("{task.fields[state]}"),
        TimeElapsedColumn(),
        console=console,
    )


def _started(folder: Path, progress: Progress, stack: contextlib.ExitStack) -> tuple[str, list[DemoProcess]]:
    """Start plant and service, with other ports where somebody took one in between; they end with ``stack``."""
    starting = progress.add_task("starting", total=None, state="simulated plant and service")
    attempt = 1
    while True:
        config = write_demo_plant(folder)
        service = tomllib.loads(config.read_text(encoding="utf-8"))["service"]
        base_url = f"http://{service['bind']}:{service['port']}"
        with contextlib.ExitStack() as attempted:
            processes = attempted.enter_context(demo_processes(config))
            try:
                asyncio.run(wait_until_ready(base_url, processes, len(DEMO_VALVES)))
            except ValveError as error:
                if attempt == _STARTS or "in use" not in str(error):
                    raise
                attempt += 1
                continue
            stack.enter_context(attempted.pop_all())
        progress.remove_task(starting)
        return base_url, processes


async def _run_all(base_url: str, processes: list[DemoProcess], progress: Progress) -> list[dict[str, Any]]:
    """Test every valve of the demonstration at the same time; one object a valve."""
    async with httpx.AsyncClient(base_url=base_url, timeout=10.0) as client:
        tasks = [
            progress.add_task(f"{valve.tag} {valve.parameter_set:8s} {valve.transport}", total=1.0, state="queued")
            for valve in DEMO_VALVES
        ]
        tests = [
            asyncio.create_task(_run_test(client, valve, processes, progress, task))
            for valve, task in zip(DEMO_VALVES, tasks, strict=True)
        ]
        try:
            done = await asyncio.gather(*tests)
        except httpx.TransportError as error:
            await _require_alive(processes)
            raise InternalError(
                say(
                    "demo_service_silent",
                    "demo: the service no longer answers ({kind}): report it",
                    kind=type(error).__name__,
                )
            ) from error
        finally:
            for test in tests:
                test.cancel()
    truths = [await _truth(processes[0], valve, test) for valve, test in zip(DEMO_VALVES, done, strict=True)]
    return [
        {
            "tag": valve.tag,
            "transport": valve.transport,
            "truth": truth,
            "test": test,
        }
        for valve, test, truth in zip(DEMO_VALVES, done, truths, strict=True)
    ]


async def _truth(simulated: DemoProcess, valve: DemoValve, test: dict[str, Any]) -> dict[str, Any]:
    """Return what a completed test is judged by, as the plant told it; of another what the valve was made with.

    The longest record is the test's: there may be one of the way to its start.
    """
    is_complete = test["state"] == "completed"
    deadline = time.monotonic() + (_TRUTH_WAIT_S if is_complete else 0.0)
    while True:
        told = [truth for truth in read_truths(simulated.truths) if truth.tag == valve.tag]
        if told:
            swept_m = test["analysis"]["recording"].get("position_range_m") if is_complete else None
            longest = max(told, key=lambda truth: truth.duration_s)
            return {**valve.true_parameters(longest.parameters, swept_m), "cause": valve.cause}
        if time.monotonic() >= deadline:
            break
        await asyncio.sleep(0.2)
    if is_complete:
        raise InternalError(
            say(
                "demo_truth_missing",
                "demo: the plant did not tell the truth about {tag} in {wait:g} s: report it",
                tag=valve.tag,
                wait=_TRUTH_WAIT_S,
            )
        )
    return {**PARAMETER_SETS[valve.parameter_set].parameters.by_symbol(), "cause": valve.cause}


async def _require_alive(processes: list[DemoProcess]) -> None:
    """Say which process has ended; its connections break a moment before its end is known."""
    deadline = time.monotonic() + _LAST_MOMENT_S
    while time.monotonic() < deadline:
        for one in processes:
            one.require_alive()
        await asyncio.sleep(0.05)


async def _run_test(
    client: httpx.AsyncClient, valve: DemoValve, processes: list[DemoProcess], progress: Progress, task: TaskID
) -> dict[str, Any]:
    """Start one test and follow it to its end; the test as ``GET /tests/{id}`` gives it."""
    answer = await client.post("/tests/run", json={"valve": valve.tag, "sequence": "triangle", "overrides": _OVERRIDES})
    if answer.status_code != httpx.codes.ACCEPTED:
        await _require_alive(processes)
        detail = answer.json().get("detail", answer.text)
        raise InternalError(
            say(
                "demo_not_started",
                "demo: {tag} was not started ({status}): {detail}",
                tag=valve.tag,
                status=answer.status_code,
                detail=detail,
            )
        )
    deadline = time.monotonic() + _TEST_TIMEOUT_S
    location, said = answer.headers["Location"], ""
    while time.monotonic() < deadline:
        for one in processes:
            one.require_alive()
        test: dict[str, Any] = (await client.get(location)).json()
        progress.update(task, completed=test["progress"], state=test["state"])
        if not progress.console.is_terminal and test["state"] != said:
            said = test["state"]
            progress.console.print(f"{valve.tag}: {said}")
        if test["state"] in _ENDED:
            return test
        await asyncio.sleep(0.25)
    raise InternalError(
        say(
            "demo_test_too_long",
            "demo: the test of {tag} did not end within {limit:g} s: end what else keeps this machine busy, and "
            "start it again",
            tag=valve.tag,
            limit=_TEST_TIMEOUT_S,
        )
    )


def _own_command() -> str:
    """How this command is called again from here: by its name where the shell finds it, else by its path."""
    own = Path(sys.executable).with_name("breakaway")
    found = shutil.which(own.name)
    if found is not None and Path(found).absolute() == own.absolute():
        return own.name
    here = Path.cwd()
    return str(own.relative_to(here) if own.is_relative_to(here) else own)


def _serve_on(console: Console, base_url: str, processes: list[DemoProcess]) -> None:
    """Keep the processes until the user ends them (Ctrl-C, SIGTERM), or one of them ends by itself: InternalError."""
    console.print(
        say(
            "demo_addresses",
            "\nThe tablet: {url}/ (in a browser on this machine); the routes: {url}/docs",
            url=base_url,
        ),
        soft_wrap=True,
    )
    console.print(f"Try: {_own_command()} run {DEMO_VALVES[0].tag} --url {base_url}", soft_wrap=True, highlight=False)
    console.print("Ctrl-C ends it; plant, store and logs are removed then.")
    with contextlib.suppress(KeyboardInterrupt):
        while True:
            for one in processes:
                one.require_alive()
            time.sleep(0.5)
