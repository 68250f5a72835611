"""``[mqtt]`` in plant.toml: the broker that is told of results and states."""

from __future__ import annotations

import ipaddress
import ssl
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final

from pydantic import BaseModel, ConfigDict, Field

from service.config.errors import Findings
from service.config.plant import MqttSettings
from service.config.secret_file import secret_fault
from valve.messages import say

_PLAIN_PORT: Final = 1883  # both as registered with IANA
_TLS_PORT: Final = 8883


class MqttSection(BaseModel):
    """``[mqtt]`` as it stands in the file."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)
    host: Annotated[str, Field(min_length=1, max_length=253)]
    port: Annotated[int, Field(ge=1, le=65535)] | None = None
    username: Annotated[str, Field(min_length=1, max_length=128)] | None = None
    password_file: Annotated[str, Field(min_length=1)] | None = None
    tls: bool = False
    ca_file: Annotated[str, Field(min_length=1)] | None = None
    prefix: Annotated[str, Field(pattern=r"^[^+#/$\x00][^+#\x00]*[^+#/\x00]$|^[^+#/$\x00]$", max_length=100)] = (
        "breakaway"
    )


def mqtt_settings(findings: Findings, raw: Mapping[str, Any] | None, folder: Path) -> MqttSettings | None:
    """Return what the file says of the broker; None where it names none or a fault was noted."""
    section = None if raw is None else findings.model(MqttSection, dict(raw), ("mqtt",))
    if section is None:
        return None
    before = len(findings)
    password = None if section.password_file is None else (folder / section.password_file).resolve()
    authority = None if section.ca_file is None else (folder / section.ca_file).resolve()
    if (section.username is None) != (password is None):
        missing = "username" if section.username is None else "password_file"
        findings.add(
            ("mqtt", missing),
            None,
            say("name_and_password", "a sign-in needs a name and a password"),
            say("both_keys_or_neither", "give both keys, or neither"),
        )
    fault = None if password is None else secret_fault(password)
    if fault is not None:
        findings.add(("mqtt", "password_file"), str(password), fault.reason, fault.remedy)
    if section.username is not None and not section.tls and not _is_loopback(section.host):
        findings.add(
            ("mqtt", "tls"),
            False,
            say(
                "password_unencrypted", "the password would cross the network to {host} unencrypted", host=section.host
            ),
            say("tls_true", "tls = true"),
        )
    if authority is not None:
        if not section.tls:
            findings.add(
                ("mqtt", "ca_file"),
                section.ca_file,
                say("no_tls_to_prove", "there is no TLS that it could prove"),
                say("tls_true", "tls = true"),
            )
        _check_authority(findings, authority)
    if len(findings) > before:
        return None
    port = section.port or (_TLS_PORT if section.tls else _PLAIN_PORT)
    return MqttSettings(section.host, port, section.prefix, section.username, password, section.tls, authority)


def _check_authority(findings: Findings, path: Path) -> None:
    try:
        ssl.create_default_context(cafile=path)
    except (OSError, ssl.SSLError) as error:
        reason = error.strerror or type(error).__name__
        findings.add(
            ("mqtt", "ca_file"),
            str(path),
            say("unusable_because", "it cannot be used ({reason})", reason=reason),
            say("give_certificate", "give a PEM certificate"),
        )


def _is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
