"""The report of a test without a result: what happened, where it left the valve, what to do, what was recorded."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from service.figures.canvas import svg_text
from service.figures.trace import trace_picture
from service.report.document import jitter_words, permissive_row
from service.shown.ending import Ending
from service.words.sentences import all_in_units
from service.words.units import UnitSystem
from valve.errors import RecordingError
from valve.recording_files import read_recording

_NO_SAMPLE: Final = "No sample was recorded."


@dataclass(frozen=True, slots=True)
class EndedSource:
    """What the report of a test without a result is made of; all of it plain, so that another process can draw it.

    ``head`` is what identifies valve and work on the first page, ``note`` what somebody noted of the test. ``file`` is
    the recording, None where there is none here, for the reason ``no_file``. ``quality`` is the run's own.
    """

    tag: str
    subject: str
    state: str
    ending: Ending
    file: str | None
    no_file: str
    quality: Mapping[str, Any]
    facts: tuple[tuple[str, str], ...]
    permissives: tuple[Mapping[str, Any], ...] = ()
    system: UnitSystem = field(default=UnitSystem.SI)
    valve: tuple[tuple[str, str], ...] = ()
    head: tuple[tuple[str, str], ...] = ()
    note: str = ""


def ended_document(source: EndedSource) -> dict[str, Any]:
    """Return the report: every text as it is read, and the recording's picture as SVG that needs no other file."""
    ending = source.ending
    picture, recorded = _trace(source)
    document = {
        "tag": source.tag,
        "subject": source.subject,
        "state": source.state,
        "is_alarm": ending.is_alarm,
        "headline": ending.headline,
        "why": ending.why,
        "course": ending.course,
        "stands": ending.stands,
        "steps": list(ending.steps),
        "recorded": recorded,
        "sampling": [{"name": name, "value": value} for name, value in _sampling(source.quality)],
        "permissives": [permissive_row(one) for one in source.permissives],
    }
    told = {
        key: [{"name": name, "value": value} for name, value in rows]
        for key, rows in (("facts", source.facts), ("valve", source.valve), ("head", source.head))
    }
    return {
        **all_in_units(document, source.system),
        **told,
        "note": source.note,
        "pictures": {} if picture is None else {"trace": picture},
    }


def _trace(source: EndedSource) -> tuple[dict[str, str] | None, str]:
    """Return the picture of what was recorded, and what it shows in words; None where nothing can be read."""
    if source.file is None:
        return None, source.no_file or _NO_SAMPLE
    try:
        picture = trace_picture(read_recording(source.file), source.system)
    except (OSError, RecordingError) as error:
        reason = (error.strerror or "unknown") if isinstance(error, OSError) else str(error).replace(source.file, "it")
        return None, f"A recording is stored and cannot be read: {reason}"
    words = {"title": picture.title, "description": picture.description}
    return {"svg": svg_text(picture, text_as_paths=True), **words}, picture.description


def _sampling(quality: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    if quality.get("samples"):
        yield "Samples", f"{quality['samples']}, {quality.get('gaps', 0)} of them missing"
    if quality.get("achieved_rate_hz") is not None:
        yield "Rate achieved", f"{quality['achieved_rate_hz']:.4g} Hz, {quality['missed_slots']} slots missed"
    if quality.get("jitter_rms_s") is not None:
        longest_s = quality.get("largest_period_s")
        longest = "" if longest_s is None else f", longest period {1e3 * longest_s:.4g} ms"
        yield "Jitter", f"{jitter_words(quality['jitter_rms_s'])}{longest}"
