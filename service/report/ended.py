"""The report of a test without a result: what happened, where it left the valve, what to do, what was recorded."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from service.figures.canvas import svg_text
from service.figures.trace import trace_picture
from service.report.document import JITTER, RATE, SIGN, jitter_words, permissive_row, samples_words
from service.shown.ending import Ending
from service.shown.results import rate_words
from service.shown.words import SAMPLES
from service.words.reader import Reader
from valve.errors import RecordingError
from valve.messages import Message, changed, message_of, say
from valve.recording_files import read_recording

_NO_SAMPLE: Final = say("no_sample_recorded", "No sample was recorded.")


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
    reader: Reader = field(default_factory=Reader)
    valve: tuple[tuple[str, str], ...] = ()
    head: tuple[tuple[str, str], ...] = ()
    note: str = ""


def ended_document(source: EndedSource) -> dict[str, Any]:
    """Return the report: every text as it is read, and the recording's picture as SVG that needs no other file."""
    ending, reader = source.ending, source.reader
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
        "sign": SIGN,
        "sampling": [{"name": name, "value": value} for name, value in _sampling(source.quality)],
        "permissives": [permissive_row(one) for one in source.permissives],
    }
    told = {
        key: [{"name": reader.shown(name), "value": reader.shown(value)} for name, value in rows]
        for key, rows in (("facts", source.facts), ("valve", source.valve), ("head", source.head))
    }
    return {
        **reader.all_told(document),
        **told,
        "note": source.note,
        "pictures": {} if picture is None else {"trace": picture},
    }


def _trace(source: EndedSource) -> tuple[dict[str, str] | None, str]:
    """Return the picture of what was recorded, and what it shows in words; None where nothing can be read."""
    if source.file is None:
        return None, source.no_file or _NO_SAMPLE
    try:
        picture = trace_picture(read_recording(source.file), source.reader)
    except (OSError, RecordingError) as error:
        return None, say(
            "stored_unreadable",
            "A recording is stored and cannot be read: {reason}",
            reason=_reason(error, source.file),
        )
    words = {"title": picture.title, "description": picture.description}
    return {"svg": svg_text(picture, text_as_paths=True), **words}, picture.description


def _reason(error: OSError | RecordingError, file: str) -> str:
    if isinstance(error, OSError):
        return error.strerror or say("unknown_reason", "unknown")
    it = say("it", "it")
    return changed(
        message_of(error), lambda one: one if isinstance(one, Message) else it if one == file else one.replace(file, it)
    )


def _sampling(quality: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    if quality.get("samples"):
        yield SAMPLES, samples_words(quality["samples"], quality.get("gaps", 0))
    if quality.get("achieved_rate_hz") is not None:
        yield RATE, rate_words({**quality, "rate_hz": quality["achieved_rate_hz"]})
    if quality.get("jitter_rms_s") is not None:
        yield JITTER, jitter_words(quality["jitter_rms_s"], quality.get("largest_period_s"))
