"""Which format of a recording a client gets."""

from __future__ import annotations

from http import HTTPStatus
from typing import Final

from starlette.exceptions import HTTPException

from valve.messages import say

CSV: Final = "text/csv"
PARQUET: Final = "application/vnd.apache.parquet"  # registered with IANA
_PARQUET_NAMES: Final = (PARQUET, "application/x-parquet", "application/parquet")


def _quality(parameters: list[str]) -> float:
    for parameter in parameters:
        name, _, value = parameter.strip().partition("=")
        if name == "q":
            try:
                return min(1.0, max(0.0, float(value)))
            except ValueError:
                return 0.0
    return 1.0


def qualities(accept: str) -> dict[str, float]:
    """Return how much an ``Accept`` header wishes each media type, 0 to 1 (RFC 9110, 12.5.1)."""
    wishes: dict[str, float] = {}
    for wish in accept.split(","):
        name, *parameters = wish.split(";")
        wishes[name.strip().lower()] = _quality(parameters)
    return wishes


def acceptable(accept: str) -> str:
    """Return the format that an ``Accept`` header prefers (RFC 9110, 12.5.1); CSV where it has no preference.

    Raises HTTPException 406 where it takes neither.
    """
    wishes = qualities(accept)
    csv = next((wishes[name] for name in (CSV, "text/*", "*/*") if name in wishes), 0.0)
    parquet = next((wishes[name] for name in (*_PARQUET_NAMES, "application/*", "*/*") if name in wishes), 0.0)
    if max(csv, parquet) == 0.0:
        raise HTTPException(
            HTTPStatus.NOT_ACCEPTABLE,
            say(
                "formats_of_recording",
                "a recording comes as {csv} or {parquet}: accept one of them",
                csv=CSV,
                parquet=PARQUET,
            ),
        )
    return PARQUET if parquet > csv else CSV
