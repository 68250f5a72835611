"""Where simulated devices are met: a TCP port, with or without TLS, or a serial line."""

from __future__ import annotations

import ssl
from dataclasses import dataclass
from pathlib import Path

from valve.errors import ConfigurationError
from valve.messages import message_of, say


@dataclass(frozen=True, slots=True)
class TcpListener:
    """A TCP port; 0 means any free one. With a certificate it speaks Modbus/TCP Security (TLS).

    With ``client_ca_file`` only clients with a certificate of that authority get in.
    """

    host: str = "127.0.0.1"
    port: int = 0
    certificate_file: Path | None = None
    key_file: Path | None = None
    client_ca_file: Path | None = None


@dataclass(frozen=True, slots=True)
class RtuListener:
    """A serial line that does not exist: the master opens ``link_path``, which leads to a pseudo-terminal."""

    link_path: Path


Listener = TcpListener | RtuListener


def tls_context(listener: TcpListener) -> ssl.SSLContext:
    """Return the context of a listener with a certificate. Raises ConfigurationError where a file cannot be read."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    assert listener.certificate_file is not None
    try:
        context.load_cert_chain(listener.certificate_file, listener.key_file)
        if listener.client_ca_file is not None:
            context.load_verify_locations(listener.client_ca_file)
            context.verify_mode = ssl.CERT_REQUIRED
    except (OSError, ssl.SSLError) as error:
        raise ConfigurationError(
            say(
                "simulator_certificate_unreadable",
                "{file}: the TLS certificate, its key or the authority cannot be read ({why}): correct the file names",
                file=str(listener.certificate_file),
                why=message_of(error),
            )
        ) from error
    return context
