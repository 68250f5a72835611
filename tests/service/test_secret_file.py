"""A password's file is read where its owner alone may read it, and no message holds what stands in it."""

from __future__ import annotations

from pathlib import Path

import pytest

from service.config.plant import MqttSettings
from service.config.secret_file import read_secret
from valve.errors import ConfigurationError


@pytest.mark.parametrize(
    ("content", "mode", "reason"),
    [
        (b"hush\n", 0o640, r"others may read it \(mode 0640\): chmod 600"),
        (b"\xffhush", 0o600, r"it cannot be read \(it is no text\)"),
        (b" \n", 0o600, "it is empty: write the password into it"),
    ],
)
def test_a_file_that_cannot_be_a_secret_is_refused_without_its_content(
    tmp_path: Path, content: bytes, mode: int, reason: str
) -> None:
    file = tmp_path / "password"
    file.write_bytes(content)
    file.chmod(mode)
    with pytest.raises(ConfigurationError, match=rf"mqtt\.password_file: {reason}") as caught:
        read_secret(file, "mqtt.password_file")
    assert "hush" not in str(caught.value)


def test_a_brokers_password_is_looked_at_again_when_it_is_read(tmp_path: Path) -> None:
    file = tmp_path / "password"
    settings = MqttSettings("127.0.0.1", 1883, "breakaway", "b", file)
    with pytest.raises(ConfigurationError, match="cannot be read"):
        settings.password()
    file.write_text("hush\n")
    file.chmod(0o600)
    assert settings.password() == "hush"
    file.chmod(0o644)
    with pytest.raises(ConfigurationError, match="chmod 600"):
        settings.password()
