"""HTTP on the wire: uvicorn on httptools, with a limit to the size of a request's head, which that leaves open."""

from __future__ import annotations

from typing import Any, Final

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

LONGEST_HEAD_BYTES: Final = 64 * 1024  # uvicorn's own limit where it reads by h11


class BoundedHttp(HttpToolsProtocol):
    """A connection; one whose request line and headers do not end in time is answered 400 and closed."""

    def __init__(self, *args: Any, **settings: Any) -> None:
        super().__init__(*args, **settings)
        self._in_head = False
        self._head_bytes = 0

    def data_received(self, data: bytes) -> None:
        """Take what came; a head that goes on from the piece before is counted."""
        went_on = self._in_head
        super().data_received(data)
        if not self._in_head or self.transport.is_closing():
            return
        self._head_bytes = len(data) + (self._head_bytes if went_on else 0)
        if self._head_bytes > LONGEST_HEAD_BYTES:
            self.send_400_response(f"The request's head is longer than {LONGEST_HEAD_BYTES // 1024} KiB: send less.")

    def on_message_begin(self) -> None:
        """Begin a request."""
        self._in_head = True
        super().on_message_begin()

    def on_headers_complete(self) -> None:
        """Begin its body."""
        self._in_head = False
        super().on_headers_complete()
