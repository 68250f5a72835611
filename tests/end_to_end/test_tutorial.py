"""docs/tutorial.md as it stands: its files are written, its commands run, on a simulated valve."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from service.cli.demo_plant import free_ports

TUTORIAL = Path(__file__).resolve().parents[2] / "docs" / "tutorial.md"
LONG_VARIABLE = "BREAKAWAY_LONG_TESTS"  # a whole test and its analysis: a minute or two
_BLOCK = re.compile(r"^<!-- (\w+)(?:: (.+?))? -->\n```\w+\n(.*?)^```$", re.MULTILINE | re.DOTALL)
# Bounds for what hangs: on a busy machine a command takes many times its seconds.
_COMMAND_S = 900.0
_READY_S = 300.0


@dataclass
class _Reader:
    """Somebody who does what the tutorial says, in a folder of their own, on ports that are free."""

    folder: Path
    ports: dict[str, str]
    environment: dict[str, str]
    running: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)

    def meant(self, text: str) -> str:
        for written, free in self.ports.items():
            text = text.replace(written, free)
        return text

    def file(self, name: str, text: str) -> None:
        (self.folder / name).write_text(text, encoding="utf-8")

    def append(self, name: str, text: str) -> None:
        self.file(name, (self.folder / name).read_text(encoding="utf-8") + text)

    def run(self, _: str, script: str) -> str:
        command = ["bash", "-euo", "pipefail", "-c", script]
        done = subprocess.run(
            command,
            cwd=self.folder,
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=_COMMAND_S,
            check=False,
        )
        assert done.returncode == 0, f"{script}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
        assert done.stdout.strip(), f"{script} said nothing"
        return done.stdout

    def long(self, _: str, script: str) -> None:
        if os.environ.get(LONG_VARIABLE):
            self.run("", script)

    def until(self, wanted: str, script: str) -> None:
        ends_s = time.monotonic() + _COMMAND_S
        while not re.search(wanted, said := self.run("", script)):
            assert time.monotonic() < ends_s, said
            time.sleep(2.0)  # each look starts a command

    def start(self, place: str, script: str) -> None:
        name = place.rpartition("/")[2]
        log = (self.folder / f"{name}.log").open("ab")
        with log:
            command = ["bash", "-c", f"exec {script.strip()}"]
            process = subprocess.Popen(command, cwd=self.folder, env=self.environment, stdout=log, stderr=log)
        self.running[place] = process
        ends_s = time.monotonic() + _READY_S
        while True:
            assert process.poll() is None, (self.folder / f"{name}.log").read_text(encoding="utf-8")[-2000:]
            if not place.isdigit() and (self.folder / place).exists():
                return
            with contextlib.suppress(OSError, ValueError):
                socket.create_connection(("127.0.0.1", int(place)), 1.0).close()
                return
            assert time.monotonic() < ends_s, f"{script} does not listen"
            time.sleep(0.1)

    def restart(self, port: str, script: str) -> None:
        _end(self.running.pop(port))
        self.start(port, script)


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(300.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


@contextlib.contextmanager
def _reader(folder: Path) -> Iterator[_Reader]:
    device, service = (str(port) for port in free_ports(2))
    environment = {
        **os.environ,
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "BREAKAWAY_URL": f"http://127.0.0.1:{service}",
    }
    reader = _Reader(folder, {"5020": device, "8321": service}, environment)
    try:
        yield reader
    finally:
        for process in reversed(reader.running.values()):
            _end(process)


@pytest.mark.long
@pytest.mark.skipif(shutil.which("curl") is None, reason="curl is not installed")
def test_the_tutorial_leads_from_a_plant_file_to_the_first_nightly_check(tmp_path: Path) -> None:
    blocks = _BLOCK.findall(TUTORIAL.read_text(encoding="utf-8"))
    assert [kind for kind, _, _ in blocks].count("run") >= 6
    with _reader(tmp_path) as reader:
        # the service's own port, which the reader's file leaves at its default
        blocks[0] = (*blocks[0][:2], blocks[0][2].replace('store = "store"\n', 'store = "store"\nport = 8321\n'))
        for kind, argument, text in blocks:
            {
                "file": reader.file,
                "append": reader.append,
                "run": reader.run,
                "long": reader.long,
                "start": reader.start,
                "restart": reader.restart,
                "until": reader.until,
            }[kind](reader.meant(argument), reader.meant(text))
        assert list((tmp_path / "first").glob("*.csv"))
        assert reader.running.keys() == {*reader.ports.values(), "store/motion.sock"}
