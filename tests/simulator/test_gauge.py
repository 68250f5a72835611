from __future__ import annotations

import re
from pathlib import Path

import pytest

from simulator.assembly import SimulatedPlant, reference_unit
from simulator.clock import ManualClock
from simulator.gauge import GaugeListener, answer_form
from simulator.listeners import TcpListener
from tests.support.simulated_plants import RtuMaster, valve
from valve.errors import ConfigurationError

PATTERN = r"^(?P<value>[-+]?\d+\.\d+)\s*mm"


async def test_a_gauge_answers_its_request_with_the_stems_position_and_nothing_else(tmp_path: Path) -> None:
    clock, link = ManualClock(), tmp_path / "gauge"
    plant = SimulatedPlant(
        [valve("A")], {TcpListener(): [reference_unit(1, "A")]}, clock, {GaugeListener(link, "?\r", PATTERN): "A"}
    )
    await plant.start()
    assert plant.addresses[1] == str(link)
    plant.valves["A"].ask(6.0e4)
    clock.advance(5.0)
    master = RtuMaster(link)
    master.send(b"!\r")
    assert await master.receive(1, 0.1) == b""
    master.send(b"?")
    master.send(b"\r")
    text = (await master.receive(13, 1.0)).decode()
    found = re.search(PATTERN, text)
    assert found is not None
    assert text.endswith("mm\r\n")
    assert float(found["value"]) == pytest.approx(plant.valves["A"].stem.position_m * 1e3, abs=0.002)
    assert float(found["value"]) > 10.0
    master.close()
    await plant.stop()
    assert not link.is_symlink()


def test_a_pattern_that_no_known_answer_fits_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="reads no answer"):
        answer_form(GaugeListener(Path("line"), "?", r"POS=(?P<value>\d+)"))
    assert answer_form(GaugeListener(Path("line"), "?", r"^(?P<value>-?\d+\.\d+)$", unit="um")) == "{value:.4f}"
