"""Where the pictures of the pages are: an address names all that its picture depends on."""

from __future__ import annotations

from urllib.parse import quote

from service.model.run import Run
from service.shown.history import ValvePast
from service.words.reader import Reader


def trend_address(tag: str, past: ValvePast, reader: Reader) -> str | None:
    """Return where the trend's picture is; None where neither a test nor a day in service has a figure for it."""
    has_days = any(day.figures for day in past.watched)
    if past.latest is None and not has_days:
        return None
    tests = read_as(reader) if past.latest is None else figure_query(past, past.latest, reader)
    days = f"&watched={past.watched[0].judged_at:%Y%m%dT%H%M%S%f}" if has_days else ""
    to = "" if past.latest is None else f"to={past.latest.id}&"
    return f"/ui/figures/valves/{quote(tag)}/trend.svg?{to}{tests}{days}"


def figure_query(past: ValvePast, run: Run, reader: Reader) -> str:
    """Return what else a picture of a test depends on, so that its address changes with it."""
    analysed = "" if run.finished_at is None else f"&of={run.finished_at:%Y%m%dT%H%M%S%f}"
    label = "" if run.label is None else f"&as={run.label.value}"
    clock = "" if reader.zone is None else f"&zone={quote(str(reader.zone))}"
    return f"{read_as(reader)}{clock}{analysed}{label}" + (
        "" if past.baseline is None else f"&baseline={past.baseline.id}"
    )


def read_as(reader: Reader) -> str:
    """Return the part of an address that says in which units and in which language a picture is read."""
    return f"units={reader.system.value}&language={reader.language.value}"
