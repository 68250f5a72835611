"""Does a simulated plant keep real time? 200 valves in one process, asked by another."""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import select
import socket
import subprocess
import sys
import tempfile
import time
import tty
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
import uvloop
from rich.table import Table

from tests.support.simulated_plants import (
    CAPTURE,
    CAPTURE_STATE,
    CLAIM,
    CORNERS,
    INDEX,
    LIVE,
    LIVE_WORDS,
    RUN_NUMBER,
    START,
    TAKEN,
    WINDOW,
    WINDOW_WORDS,
    TcpMaster,
    capture_words,
    claim_words,
    corner_words,
    crc,
    f32,
    number,
    payload,
    read_pdu,
    read_write_pdu,
    u32,
    write_pdu,
)
from valve.waveform import triangle

VALVES: Final = 200
PORTS: Final = 10
RATE_HZ: Final = 10.0  # each valve is commanded and read so often
POLLING_S: Final = 10.0
CAPTURE_S: Final = 10.0
SAMPLES: Final = 60_001
HIGH_PA: Final = 82737.0


def _plant(folder: Path, valves: int, ports: list[int], serial: bool) -> Path:
    text = '[service]\nstore = "store"\n'
    for i, port in enumerate(ports):
        text += f'[[buses]]\nname = "bus-{i}"\nkind = "modbus_tcp"\nhost = "127.0.0.1"\nport = {port}\n'
    if serial:
        text += f'[[buses]]\nname = "line"\nkind = "modbus_rtu"\nserial_port = "{folder}/line"\n'
    places = [(f"bus-{i % len(ports)}", i // len(ports) + 1) for i in range(valves)]
    for i, (bus, device) in enumerate([*places, *([("line", 1)] if serial else [])]):
        chosen = ("vendor", "nominal", "rough")[i % 3]
        text += f"""
[[valves]]
tag = "V-{i}"
safe_value_pa = 0.0
actuator = {{ diaphragm_area_m2 = 0.06452, travel_m = 0.1016 }}
signal = {{ range_ma = [4.0, 20.0], range_pa = [0.0, {HIGH_PA}] }}
limits = {{ pressure_pa = [0.0, {HIGH_PA}], pressure_rate_pa_per_s = 30000.0, longest_test_s = 300.0 }}
acquisition = {{ mode = "captured", period_s = 0.1 }}
command = {{ bus = "{bus}", device_id = {device}, map = "reference" }}
simulation = {{ parameter_set = "{chosen}", position_noise_m = 2.0e-6, pressure_noise_pa = 5.0 }}
"""
    path = folder / "plant.toml"
    path.write_text(text)
    return path


@contextlib.contextmanager
def _simulated(valves: int, ports: int, *, speed: float = 1.0, serial: bool = False) -> Iterator[tuple[int, list[str]]]:
    """Run ``breakaway simulate`` as a process of its own; its id and its addresses."""
    sockets = [socket.create_server(("127.0.0.1", 0)) for _ in range(ports)]
    free = [int(listener.getsockname()[1]) for listener in sockets]
    for listener in sockets:
        listener.close()
    with tempfile.TemporaryDirectory() as name:
        path = _plant(Path(name), valves, free, serial)
        command = [sys.executable, "-m", "service.cli", "simulate", "--config", str(path), "--speed", str(speed)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            try:
                assert process.stdout is not None
                addresses = [process.stdout.readline().split(": ")[0] for _ in range(ports + serial)]
                yield process.pid, addresses
            finally:
                process.terminate()
                process.wait(10.0)


def _cpu_s(process_id: int) -> float:
    """Processor time that a process has used, s."""
    fields = Path(f"/proc/{process_id}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


async def _poll(master: TcpMaster, units: list[int], end_s: float, lateness: list[float], every_s: float) -> None:
    """Command and read each unit in one transaction, in turn, until the end; ``every_s`` 0: as fast as it goes."""
    loop = asyncio.get_running_loop()
    turn, start_s = 0, loop.time()
    while loop.time() < end_s:
        for place, unit in enumerate(units):
            due_s = start_s + (turn + place / len(units)) * every_s
            if due_s > loop.time():
                await asyncio.sleep(due_s - loop.time())
            pressure_pa = HIGH_PA * (0.5 + 0.5 * math.sin(0.3 * turn + unit))
            command = u32(unit) + f32(pressure_pa)
            sent_s = loop.time()
            await master.ask(read_write_pdu(LIVE, LIVE_WORDS, RUN_NUMBER, command), unit)
            lateness.append(loop.time() - (due_s if every_s else sent_s))
        turn += 1


async def _polled(process_id: int, masters: list[TcpMaster], units: list[int]) -> list[list[str]]:
    rows = []
    for label, every_s, length_s in (("at 10 Hz each", 1.0 / RATE_HZ, POLLING_S), ("as fast as it goes", 0.0, 4.0)):
        lateness: list[float] = []
        begun_s, cpu_s = time.monotonic(), _cpu_s(process_id)
        end_s = asyncio.get_running_loop().time() + length_s
        await asyncio.gather(*(_poll(master, units, end_s, lateness, every_s) for master in masters))
        passed_s = time.monotonic() - begun_s
        late_ms = np.percentile(lateness, [50, 99, 100]) * 1e3
        rows.append(
            [
                f"{VALVES} valves commanded and read, {label}",
                f"{len(lateness) / passed_s:.0f}",
                f"{len(lateness) / passed_s / VALVES:.1f}",
                f"{late_ms[0]:.1f} / {late_ms[1]:.1f} / {late_ms[2]:.0f}",
                f"{100 * (_cpu_s(process_id) - cpu_s) / passed_s:.0f} %",
            ]
        )
    return rows


async def _prepare(master: TcpMaster, unit: int, run: int, period_s: float, cycles: int) -> list[int]:
    """Own a device and put a triangle into its table; the words that start it, to be sampled each ms."""
    waveform = triangle(period_s, cycles, 0.0, HIGH_PA)
    corners = corner_words(list(waveform.time_s), list(waveform.pressure_pa))
    await master.ask(write_pdu(CLAIM, claim_words(run)), unit)
    await master.ask(write_pdu(CORNERS, corners), unit)
    return capture_words(run, START, corners, 1000, round(waveform.duration_s * 1000) + 1)


async def _captured(process_id: int, masters: list[TcpMaster], units: list[int]) -> list[str]:
    """All valves capture at 1 ms at once and are looked at twice a second."""
    places = [(master, unit) for master in masters for unit in units]
    starts = [await _prepare(master, unit, unit, CAPTURE_S, 1) for master, unit in places]
    begun_s, cpu_s = time.monotonic(), _cpu_s(process_id)
    for (master, unit), words in zip(places, starts, strict=True):
        await master.ask(write_pdu(CAPTURE, words), unit)
    slowest_s, running, looks = 0.0, len(places), 0
    while running and time.monotonic() < begun_s + 3 * CAPTURE_S:
        await asyncio.sleep(0.5)
        running = 0
        for master, unit in places:
            sent_s = time.monotonic()
            state = (await master.ask(read_pdu(3, CAPTURE_STATE, 1), unit))[0]
            slowest_s, looks = max(slowest_s, time.monotonic() - sent_s), looks + 1
            running += state == 1
    passed_s, used_s = time.monotonic() - begun_s, _cpu_s(process_id) - cpu_s
    taken = sum([number(await master.ask(read_pdu(3, TAKEN, 2), unit)) for master, unit in places])
    return [
        f"{len(places)} captures at 1 ms at once, {CAPTURE_S:g} s",
        f"{passed_s:.1f} s",
        f"{taken} of {len(places) * round(CAPTURE_S * 1000 + 1)}",
        f"{slowest_s * 1e3:.0f} ms",
        f"{100 * used_s / passed_s:.0f} %",
    ]


async def _upload_tcp(address: str) -> float:
    master = await TcpMaster.connect(address)
    await master.ask(write_pdu(CAPTURE, await _prepare(master, 1, 1, 20.0, 3)))
    for _ in range(100):
        if (await master.ask(read_pdu(3, CAPTURE_STATE, 1)))[0] != 1:
            break
        await asyncio.sleep(0.1)
    begun_s = time.monotonic()
    for index in range(0, SAMPLES, 40):
        words = await master.ask(read_write_pdu(WINDOW, WINDOW_WORDS, INDEX, u32(index)))
        assert number(words) == index
    passed_s = time.monotonic() - begun_s
    await master.close()
    return passed_s


def _ask_serial(port: int, pdu: bytes, answer_bytes: int) -> list[int]:
    frame = b"\x01" + pdu
    os.write(port, frame + crc(frame).to_bytes(2, "little"))
    answer = b""
    while len(answer) < answer_bytes and select.select([port], [], [], 5.0)[0]:
        answer += os.read(port, 512)
    return payload(pdu, answer[1:-2])


def _upload_rtu(path: str) -> float:
    port = os.open(path, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(port)
    waveform = triangle(20.0, 3, 0.0, HIGH_PA)
    corners = corner_words(list(waveform.time_s), list(waveform.pressure_pa))
    for address, words in (
        (CLAIM, claim_words(1)),
        (CORNERS, corners),
        (CAPTURE, capture_words(1, START, corners, 1000, SAMPLES)),
    ):
        _ask_serial(port, write_pdu(address, words), 8)
    while _ask_serial(port, read_pdu(3, CAPTURE_STATE, 1), 7)[0] == 1:
        time.sleep(0.2)
    begun_s = time.monotonic()
    for index in range(0, SAMPLES, 40):
        words = _ask_serial(port, read_write_pdu(WINDOW, WINDOW_WORDS, INDEX, u32(index)), 5 + 2 * WINDOW_WORDS)
        assert number(words) == index
    passed_s = time.monotonic() - begun_s
    os.close(port)
    return passed_s


async def _load() -> tuple[list[list[str]], list[str]]:
    with _simulated(VALVES, PORTS) as (process_id, addresses):
        masters = [await TcpMaster.connect(address) for address in addresses]
        units = list(range(1, VALVES // PORTS + 1))
        for master in masters:
            for unit in units:
                await master.ask(write_pdu(CLAIM, claim_words(unit)), unit)
        polled = await _polled(process_id, masters, units)
        captured = await _captured(process_id, masters, units)
        for master in masters:
            await master.close()
    return polled, captured


def run() -> list[Table]:
    """Measure polling, simultaneous captures and upload, in about 30 s."""
    polled, captured = uvloop.run(_load())
    polling = Table("simulator: polling", "reads/s", "Hz a valve", "late ms 50 / 99 / 100 %", "CPU of one core")
    for row in polled:
        polling.add_row(*row)
    capturing = Table("simulator: capture", "took", "samples taken", "slowest look", "CPU of one core")
    capturing.add_row(*captured)
    uploading = Table(f"simulator: upload of {SAMPLES} samples x 3", "s", "registers/s")
    with _simulated(1, 1, speed=30.0, serial=True) as (_, addresses):
        for label, passed_s in (
            ("Modbus TCP", uvloop.run(_upload_tcp(addresses[0]))),
            ("RTU over a pseudo-terminal", _upload_rtu(addresses[1])),
        ):
            uploading.add_row(label, f"{passed_s:.2f}", f"{3 * SAMPLES / passed_s:.0f}")
    return [polling, capturing, uploading]
