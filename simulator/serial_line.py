"""A serial line without hardware: two pseudo-terminals with a bridge between them, which can be pulled.

The master opens the link that stands where its serial port is configured; the slave opens ``device_port``. A
pseudo-terminal carries bytes as fast as they come and knows no parity.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import pty
import termios
import tty
from pathlib import Path
from typing import Final

from valve.errors import ConfigurationError
from valve.messages import message_of, say

_PSEUDO_TERMINALS: Final = Path("/dev/pts")
_CHUNK: Final = 4096


class _Terminal:
    """One pseudo-terminal: ``bridge`` is our end, ``port`` the path that somebody else opens."""

    def __init__(self) -> None:
        self.bridge, self._held_open = pty.openpty()
        # Held open: with nobody on the port a read of our end would fail at once, again and again.
        tty.setraw(self._held_open)
        os.set_blocking(self.bridge, False)
        self.port = os.ttyname(self._held_open)

    def park(self) -> None:
        """Set a speed that nobody asks for.

        A pseudo-terminal drops the parity, and the C library reports a second opening with parity as an error
        unless something else changes: so there is always a change of speed to make.
        """
        attributes = termios.tcgetattr(self._held_open)
        if attributes[4] != termios.B50:
            attributes[4] = attributes[5] = termios.B50
            termios.tcsetattr(self._held_open, termios.TCSANOW, attributes)

    def close(self) -> None:
        os.close(self.bridge)
        os.close(self._held_open)


class SerialLine:
    """A bridged pair of pseudo-terminals with a symbolic link for the master; needs a running event loop.

    Raises ConfigurationError where ``link`` exists and is not a link that a serial line of this kind left behind:
    a real serial port is never touched.
    """

    def __init__(self, link: Path) -> None:
        self.link = link
        self._loop = asyncio.get_running_loop()
        self._device = _Terminal()
        self._master: _Terminal | None = None
        try:
            self.plug()
        except ConfigurationError:
            self._device.close()
            raise
        self._loop.add_reader(self._device.bridge, self._carry_to_master)

    @property
    def device_port(self) -> str:
        """Path that the slave opens."""
        return self._device.port

    @property
    def plugged(self) -> bool:
        """Whether the master's end is there."""
        return self._master is not None

    def plug(self) -> None:
        """Put the master's end in place. Raises ConfigurationError where its link cannot be made."""
        if self._master is not None:
            return
        self._require_free_link()
        master = _Terminal()
        try:
            self.link.unlink(missing_ok=True)
            self.link.symlink_to(master.port)
        except OSError as error:
            master.close()
            raise ConfigurationError(
                say(
                    "serial_link_not_made",
                    "{link}: the serial link cannot be made there ({why})",
                    link=str(self.link),
                    why=error.strerror or message_of(error),
                )
            ) from error
        self._master = master
        self._loop.add_reader(master.bridge, self._carry_to_device)

    def pull(self) -> None:
        """Take the master's end away: whoever has it open sees the line hang up, and the link is gone."""
        if self._master is None:
            return
        self._loop.remove_reader(self._master.bridge)
        if self.link.is_symlink() and self.link.readlink() == Path(self._master.port):
            self.link.unlink()
        self._master.close()
        self._master = None

    def close(self) -> None:
        """Remove the line and its link."""
        self.pull()
        self._loop.remove_reader(self._device.bridge)
        self._device.close()

    def _require_free_link(self) -> None:
        if self.link.is_symlink():
            target = self.link.readlink()
            if target.parent == _PSEUDO_TERMINALS and not target.exists():
                return
            raise ConfigurationError(
                say(
                    "serial_link_taken",
                    "{link}: it is a link to {target} already, and only a dead link of the simulator's own may "
                    "be replaced: stop what serves it, remove the link or choose another serial_port",
                    link=str(self.link),
                    target=str(target),
                )
            )
        if self.link.exists():
            raise ConfigurationError(
                say(
                    "serial_link_is_no_link",
                    "{link}: it exists and is no link of the simulator, which never opens a real serial port: "
                    "choose another serial_port",
                    link=str(self.link),
                )
            )
        if not self.link.parent.is_dir():
            raise ConfigurationError(
                say(
                    "serial_link_without_folder",
                    "{link}: the folder {folder} is not there, make it first",
                    link=str(self.link),
                    folder=str(self.link.parent),
                )
            )

    def _carry_to_master(self) -> None:
        data = self._take(self._device.bridge)
        if self._master is not None:
            self._give(self._master.bridge, data)

    def _carry_to_device(self) -> None:
        if self._master is not None:
            self._give(self._device.bridge, self._take(self._master.bridge))
            self._master.park()

    @staticmethod
    def _take(descriptor: int) -> bytes:
        with contextlib.suppress(BlockingIOError, OSError):
            return os.read(descriptor, _CHUNK)
        return b""

    @staticmethod
    def _give(descriptor: int, data: bytes) -> None:
        # Bytes that nobody takes are lost, as on a wire.
        with contextlib.suppress(BlockingIOError, OSError):
            while data:
                data = data[os.write(descriptor, data) :]
