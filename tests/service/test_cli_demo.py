"""How the demonstration ends when somebody or something ends it: cleanly, in a sentence, with nothing left behind."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from rich.console import Console

from service.cli import demo, demo_plant

LIMIT_S = 60.0


def processes_in(folder: Path) -> dict[str, int]:
    """Ids of the commands that run on plant files below ``folder``, by name."""
    found = {}
    for entry in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            words = entry.read_bytes().decode(errors="replace").split("\0")
            if any(word.startswith(str(folder)) for word in words) and "service.cli" in words:
                found[words[words.index("service.cli") + 1]] = int(entry.parent.name)
    return found


@contextlib.contextmanager
def demonstration(folder: Path) -> Iterator[subprocess.Popen[str]]:
    """Run ``breakaway demo`` until its first test runs, and see to it that nothing is left of it."""
    environment = {**os.environ, "TMPDIR": str(folder)}
    process = subprocess.Popen(
        [sys.executable, "-m", "service.cli", "demo", "--once"],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        for line in process.stdout:
            if ": running" in line:
                break
        yield process
    finally:
        process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(LIMIT_S)
        process.kill()
        process.communicate()
        left = processes_in(folder)
        for number in left.values():
            os.kill(number, signal.SIGKILL)
    assert left == {}


def test_a_signal_ends_the_demonstration_and_all_that_it_started(quick_path: Path) -> None:
    with demonstration(quick_path) as process:
        assert set(processes_in(quick_path)) == {"simulate", "motion", "serve"}
        process.send_signal(signal.SIGHUP)  # becomes Ctrl-C, as SIGTERM does: test_cli.py sends a command each of them
        _, said = process.communicate(timeout=LIMIT_S)
        assert process.returncode == 1
        assert said == "breakaway: demo: it was ended before its tests were: start it again to see them all\n"
        assert processes_in(quick_path) == {}
        assert list(quick_path.iterdir()) == []


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.long) for name in ("simulate", "motion", "serve")]
)
def test_a_process_that_dies_ends_the_demonstration_in_a_sentence(quick_path: Path, name: str) -> None:
    with demonstration(quick_path) as process:
        os.kill(processes_in(quick_path)[name], signal.SIGKILL)
        _, said = process.communicate(timeout=LIMIT_S)
        assert process.returncode == 1
        assert said.startswith(f"breakaway: demo: breakaway {name} ended by itself with code -9: ")
        assert "Traceback" not in said


@pytest.mark.long
def test_a_port_that_is_taken_in_between_is_replaced(quick_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    free_ports, asked = demo_plant.free_ports, list[float]()
    with socket.socket() as taken, contextlib.ExitStack() as stack:
        taken.bind(("127.0.0.1", 0))  # and no listener: a client that connects to one would wait for its answer

        def unlucky(count: int) -> list[int]:
            asked.append(time.monotonic())
            ports = free_ports(count)
            return [taken.getsockname()[1], *ports[1:]] if len(asked) == 1 else ports

        monkeypatch.setattr(demo_plant, "free_ports", unlucky)
        progress = demo._progress(Console(quiet=True))
        base_url, processes = demo._started(quick_path, progress, stack)
        assert len(asked) == 2
        assert not base_url.endswith(f":{taken.getsockname()[1]}")
        for one in processes:
            one.require_alive()
    assert processes_in(quick_path) == {}
