"""Who may reach the service and how: sign-in, TLS, a proxy, the sequences that operators may run."""

from __future__ import annotations

import re
import socket
import ssl
from pathlib import Path
from typing import Final, Literal

from pydantic import BaseModel, ConfigDict, Field

from service.config.errors import Findings
from service.config.plant import AccessSettings
from service.config.secret_file import secret_fault
from service.model.sequences import SEQUENCES
from valve.messages import say

_HOST: Final = re.compile(r"(?:\*\.)?[A-Za-z0-9](?:[A-Za-z0-9._-]*[A-Za-z0-9])?|\[[0-9A-Fa-f:.]+\]")


def own_names() -> tuple[str, ...]:
    """Return the names of this machine, as it calls itself."""
    name = socket.gethostname().lower()
    return (name,) if "." in name else (name, f"{name}.local")


class AccessSection(BaseModel):
    """The keys of ``[service]`` that say who may reach it."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)
    access: Literal["open", "sign-in"] | None = None
    trusted_network: bool = False
    tls_certificate: str | None = None
    tls_key: str | None = None
    behind_proxy: bool = False
    proxy_addresses: list[str] = Field(default=["127.0.0.1"], min_length=1)
    approved_sequences: list[str] | None = Field(default=None, min_length=1)
    allowed_hosts: list[str] | None = Field(default=None, min_length=1)


def access_settings(
    findings: Findings, section: AccessSection, *, bind: str, loopback: bool, folder: Path
) -> AccessSettings | None:
    """Return what ``[service]`` says of access, or None with its faults noted."""
    before = len(findings)
    # Not resolved: a link that a renewal sets to a new file stays a link.
    certificate = None if section.tls_certificate is None else (folder / section.tls_certificate).absolute()
    tls_key = None if section.tls_key is None else (folder / section.tls_key).absolute()
    _check_tls(findings, certificate, tls_key)
    encrypted = certificate is not None or section.behind_proxy
    reachable = not loopback or section.behind_proxy
    if reachable and not section.trusted_network:
        if section.access == "open":
            findings.add(
                ("service", "access"),
                "open",
                say("proxy_may_move", "whoever reaches the proxy may move valves")
                if loopback
                else say("address_may_move", "whoever reaches {address} may move valves", address=bind),
                say(
                    "sign_in_or_loopback",
                    'say "sign-in", bind to 127.0.0.1, or set service.trusted_network = true where this address is '
                    "reached from this machine alone",
                ),
            )
        elif not encrypted:
            findings.add(
                ("service", "bind"),
                bind,
                say("passwords_unencrypted", "passwords and tokens would cross the network unencrypted"),
                say(
                    "give_tls",
                    "give service.tls_certificate and service.tls_key, set service.behind_proxy = true behind a "
                    "proxy that speaks TLS, or service.trusted_network = true where this address is reached from "
                    "this machine alone",
                ),
            )
    for index, name in enumerate(section.approved_sequences or []):
        if name not in SEQUENCES:
            findings.add(
                ("service", "approved_sequences", index),
                name,
                say("no_sequence_of_name", "no sequence has this name"),
                say("choose_from", "choose from {known:, }", known=tuple(SEQUENCES)),
            )
    for index, host in enumerate(section.allowed_hosts or []):
        if _HOST.fullmatch(host) is None:
            findings.add(
                ("service", "allowed_hosts", index),
                host,
                say("no_host_name", "it is no name of a host, or stands for every one"),
                say(
                    "give_host_names",
                    'give names without scheme and port, such as "valves.example.org", "*.example.org" or "[fd00::5]"',
                ),
            )
    if len(findings) > before:
        return None
    return AccessSettings(
        sign_in=reachable if section.access is None else section.access == "sign-in",
        loopback=loopback,
        tls_certificate=certificate,
        tls_key=tls_key,
        behind_proxy=section.behind_proxy,
        proxy_addresses=tuple(section.proxy_addresses) if section.behind_proxy else (),
        approved_sequences=None if section.approved_sequences is None else frozenset(section.approved_sequences),
        allowed_hosts=own_names() if section.allowed_hosts is None else tuple(section.allowed_hosts),
    )


def _check_tls(findings: Findings, certificate: Path | None, tls_key: Path | None) -> None:
    if (certificate is None) != (tls_key is None):
        missing = "tls_key" if tls_key is None else "tls_certificate"
        findings.add(
            ("service", missing),
            None,
            say("tls_needs_both", "TLS needs a certificate and its key"),
            say("give_both_pem", "give both files, PEM"),
        )
        return
    if certificate is None or tls_key is None:
        return
    fault = secret_fault(tls_key)
    if fault is not None:
        findings.add(("service", "tls_key"), str(tls_key), fault.reason, fault.remedy)
    try:
        ssl.create_default_context(ssl.Purpose.CLIENT_AUTH).load_cert_chain(certificate, tls_key, password="")
    except (OSError, ssl.SSLError) as error:
        reason = error.strerror or type(error).__name__
        findings.add(
            ("service", "tls_certificate"),
            str(certificate),
            say("unusable_with_key", "it cannot be used with {key} ({reason})", key=str(tls_key), reason=reason),
            say("give_certificate_and_key", "give a PEM certificate and its own PEM key without a passphrase"),
        )
