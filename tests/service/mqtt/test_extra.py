"""MQTT is an extra: who names no broker needs none of its library, and who names one is told what to install."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from service.cli.check import check
from service.config.settings import load_plant
from service.server.server import serve_plant
from tests.service.conftest import PLANT
from valve.errors import ConfigurationError
from valve.messages import message_of, messages_in

SAID = (
    'plant.toml: mqtt.host = "broker.plant": no broker can be told, as the extra mqtt is not installed: run make mqtt '
    "in breakaway's folder, or pip install 'breakaway[mqtt]'"
)


@pytest.fixture
def told_plant(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A plant file that names a broker, where nothing is installed that could speak to it."""
    monkeypatch.setitem(sys.modules, "aiomqtt", None)
    monkeypatch.setattr("service.mqtt.broker.find_spec", lambda _name: None)
    path = tmp_path / "plant.toml"
    path.write_text(PLANT + '\n[mqtt]\nhost = "broker.plant"\n', encoding="utf-8")
    return path


def test_the_service_loads_no_mqtt_before_a_broker_is_named() -> None:
    code = (
        "import sys, service.app, service.server.server;"
        "print([name for name in sys.modules if name.partition('.')[0] in ('aiomqtt', 'paho')])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_service_that_cannot_tell_its_broker_does_not_start(told_plant: Path) -> None:
    with pytest.raises(ConfigurationError) as caught:
        serve_plant(load_plant(told_plant))
    assert str(caught.value) == SAID
    codes = {one.code for one in messages_in(message_of(caught.value))}
    assert {"key_has_value", "mqtt_not_installed", "install_mqtt"} <= codes
    assert not (told_plant.parent / "plant-data").exists()


def test_a_check_tells_of_it_before(told_plant: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ConfigurationError, match="1 fault"):
        check(told_plant)
    assert capsys.readouterr().out == f"{SAID}\n"
