"""Logs: one JSON object a line on standard error, ours and the libraries' alike."""

from __future__ import annotations

import contextlib
import io
import logging
import sys
from typing import Final, TextIO, cast

import structlog

# What these say below a level is their own business: a failed connection and a torn form are said by us, once.
_QUIET: Final = {
    "alembic": logging.WARNING,
    "asyncio": logging.WARNING,
    "httpx": logging.WARNING,
    "pymodbus": logging.CRITICAL,
    "python_multipart": logging.CRITICAL,
    "uvicorn": logging.WARNING,
}


class _Unfailing(io.TextIOBase):
    """Standard error; what it no longer takes is lost: a closed terminal must not end what brings a valve to safe."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write as far as that is possible."""
        with contextlib.suppress(OSError, ValueError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """Flush as far as that is possible."""
        with contextlib.suppress(OSError, ValueError):
            self._stream.flush()


def log_as_json() -> None:
    """Send every log of this process to standard error as JSON."""
    stream = cast("TextIO", _Unfailing(sys.stderr))
    shared: list[structlog.typing.Processor] = [
        structlog.stdlib.add_log_level,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
        structlog.processors.format_exc_info,
    ]
    structlog.configure(
        processors=[*shared, structlog.processors.JSONRenderer()],
        logger_factory=structlog.PrintLoggerFactory(stream),
        wrapper_class=structlog.make_filtering_bound_logger(logging.INFO),
        cache_logger_on_first_use=True,
    )
    handler = logging.StreamHandler(stream)
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=[structlog.stdlib.add_logger_name, *shared],
            processors=[
                structlog.stdlib.ProcessorFormatter.remove_processors_meta,
                structlog.processors.JSONRenderer(),
            ],
        )
    )
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)
    for name, level in _QUIET.items():
        logging.getLogger(name).setLevel(level)
