"""Why somebody is refused: not known, not allowed, or too often."""

from __future__ import annotations

from valve.errors import RequestError


class NotSignedInError(RequestError):
    """Nobody known asks: sign in, or send a token."""


class ForbiddenError(RequestError):
    """Whoever asks is known, and may not do this."""


class ThrottledError(RequestError):
    """Too much was asked, or too many sign-ins failed: wait for ``retry_after_s``."""

    def __init__(self, message: str, retry_after_s: float) -> None:
        super().__init__(message)
        self.retry_after_s = retry_after_s
