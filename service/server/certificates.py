"""The service's own certificate: one that was renewed on disk is taken up by the next connection, without a restart."""

from __future__ import annotations

import asyncio
import ssl
from pathlib import Path
from typing import Any, Final

import structlog

from service.config.secret_file import secret_fault
from valve.errors import ConfigurationError
from valve.messages import say

_LOG = structlog.get_logger(__name__)
_LOOK_S: Final = 10.0  # certificates are renewed days before they end
_Signature = tuple[tuple[int, int, int], ...]


def context_of(certificate: Path, tls_key: Path) -> ssl.SSLContext:
    """Return what a server needs to show this certificate.

    Raises ConfigurationError where the key may be read by others, or the two files do not fit each other.
    """
    fault = secret_fault(tls_key)
    if fault is not None:
        raise ConfigurationError(
            say(
                "key_file_fault",
                "{key}: {reason}: {remedy}",
                key=str(tls_key),
                reason=fault.reason,
                remedy=fault.remedy,
            )
        )
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    try:
        context.load_cert_chain(certificate, tls_key, password="")
    except (OSError, ssl.SSLError) as error:
        reason = error.strerror or type(error).__name__
        raise ConfigurationError(
            say(
                "certificate_unusable",
                "{certificate}: it cannot be used with {key} ({reason}): give a PEM certificate and its own PEM key "
                "without a passphrase",
                certificate=str(certificate),
                key=str(tls_key),
                reason=reason,
            )
        ) from error
    return context


class Certificates:
    """Shows the newest usable certificate on every connection that begins; those that are open go on with theirs.

    Certificate and key are two files: while only one of them is new they do not fit, and the former pair stays.
    """

    def __init__(self, certificate: Path, tls_key: Path, *, look_s: float = _LOOK_S) -> None:
        self._files = (certificate, tls_key)
        self._look_s = look_s
        self._seen = self._signature()
        self._context: ssl.SSLContext | None = None

    def show_on(self, listening: ssl.SSLContext) -> None:
        """Let connections that begin on a listening socket have the newest certificate instead of its first one."""
        listening.sni_callback = self._choose

    def _choose(self, connection: Any, _name: str | None, _listening: ssl.SSLContext) -> None:
        # The ssl module's way to another certificate: called for each handshake, with a server's name or without.
        if self._context is not None:
            connection.context = self._context

    def look(self) -> bool:
        """Take up files that are not those that were seen last; whether they are shown from now on. Blocks."""
        found = self._signature()
        if found == self._seen:
            return False
        self._seen = found
        try:
            self._context = context_of(*self._files)
        except ConfigurationError as error:
            _LOG.error("the new certificate is not taken up, the former one stays", error=str(error))
            return False
        _LOG.info("new certificate taken up", file=str(self._files[0]))
        return True

    async def keep_fresh(self) -> None:
        """Look again and again, until cancelled."""
        while True:
            await asyncio.sleep(self._look_s)
            await asyncio.to_thread(self.look)

    def _signature(self) -> _Signature:
        """Time, size and number of each file; a link counts as what it points to, as certbot's do."""
        found = []
        for path in self._files:
            try:
                about = path.stat()
                found.append((about.st_mtime_ns, about.st_size, about.st_ino))
            except OSError:
                found.append((0, 0, 0))
        return tuple(found)
