"""Tests as the REST interface shows them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from datetime import datetime
from typing import Annotated, Any, Final

from fastapi import Depends
from pydantic import BaseModel, ConfigDict, Field, JsonValue

from drivers.stands_at import StandsAt, StemVerdict
from service.http.errors import PageReader
from service.model.acknowledgement import needs_acknowledgement
from service.model.run import Label, Run, RunState
from service.model.stands_words import stands_sentence
from service.words.reader import Reader
from valve.messages import TABLE, with_table


async def _reader(page: PageReader) -> Reader:
    return page or Reader()


#: Who reads the pages of the tablet; English and SI where it is no page that asks.
ReaderOf = Annotated[Reader, Depends(_reader)]
_ENGLISH: Final = Reader()
Permit = Annotated[str, Field(min_length=1, max_length=64, description="the work permit, where the valve demands one")]


class RunRequest(BaseModel):
    """What ``POST /tests/run`` takes: a tag, never a host or a register."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, strict=True)
    valve: str = Field(min_length=1, max_length=64, examples=["FV-101"])
    sequence: str | None = Field(
        default=None,
        min_length=1,
        max_length=64,
        description="how the valve moves; by default multi_rate, or triangle where the valve's limits do not allow it",
    )
    overrides: dict[str, JsonValue] = Field(default_factory=dict, examples=[{"cycles": 2, "period_s": 20}])
    label: Annotated[Label, Field(strict=False)] | None = Field(
        default=None, description="what the test stands for beside a repair: as_found or as_left"
    )
    permit: Permit | None = None
    until: dict[str, JsonValue] | None = Field(
        default=None,
        max_length=8,
        examples=[{"F_s": "5 %", "F_c": "2 %"}],
        description="end the sequence, with its usual ramp, at the first turning point at which half of each 95 % "
        "interval is within this share of its value, after at least 4 breakaways; F_s, F_c, k; polled tests alone",
    )


class RunDescription(BaseModel):
    """What ``PATCH /tests/{id}`` takes: what is named changes, null takes it away."""

    model_config = ConfigDict(extra="forbid", strict=True)
    label: Annotated[Label, Field(strict=False)] | None = Field(
        default=None, description="what the test stands for beside a repair"
    )
    work_order: str | None = Field(default=None, max_length=64, pattern=r"^[^\x00-\x1f]*$", examples=["WO-4711"])
    note: str | None = Field(
        default=None, max_length=2000, pattern=r"^[^\x00]*$", examples=["packing was replaced before this test"]
    )


class RecordingLink(BaseModel):
    """Where the raw recording is and what it hashes to."""

    href: str
    sha256: str


class OutOfFamilyView(BaseModel):
    """The breakaway that ended a test, as `limits.end_out_of_family` of its valve asks."""

    breakaway: int = Field(description="which one of the test, from 1")
    time_s: float = Field(description="when, from the start of the recording")
    force_n: float = Field(description="what the stem took when it was seen; it still stuck")
    last_n: float = Field(description="what the breakaway before it took")
    times: float = Field(description="how many times the last one that is")


class EndedEarly(BaseModel):
    """A test that ended as soon as it knew what was asked, or at a breakaway twice the last one."""

    until: dict[str, str] = Field(description="what the test knew; empty where a breakaway ended it")
    saved_s: float = Field(description="of the sequence, less what the way back took longer")
    out_of_family: OutOfFamilyView | None = Field(
        default=None, description="the breakaway that ended it; null where it knew enough"
    )


class StandsView(BaseModel):
    """Where a valve was seen to stand after its motion: signal and stem, each as it was read."""

    sentence: str = Field(description="signal and stem in words, as every page and report says it")
    verdict: StemVerdict = Field(
        description="moving: not looked at yet; there; not_there and unknown (it could not be read) are alarms; "
        "not_judged: plant.toml declares no safe position"
    )
    read_at: datetime
    after_s: float = Field(description="time from the end of the motion to this reading")
    due_s: float = Field(description="when the stem is looked at after the motion")
    safe_pa: float | None
    signal_pa: float | None = Field(description="what the device showed as its output; null where it was not read")
    signal_is_safe: bool | None = Field(description="whether that is the safe value")
    signal_confirmed: bool | None = Field(
        description="whether the safe value was read back when the motion ended; null where nothing was commanded"
    )
    signal_unread: str = Field(description="why there is no signal; empty where there is one")
    stem_m: float | None
    stem_percent: float | None = Field(description="of the rated travel, from the closed end")
    stem_unread: str = Field(description="why there is no position; empty where there is one")
    travel_m: float | None
    safe_position_m: float | None = Field(description="as plant.toml declares it; null where the stem is not judged")
    tolerance_m: float | None


class RunSummary(BaseModel):
    """One test in a list."""

    id: str
    valve: str
    sequence: str
    overrides: dict[str, Any]
    label: Label | None = Field(description="what the test stands for beside a repair; null for a check")
    state: RunState
    progress: float = Field(ge=0.0, le=1.0)
    created_at: datetime
    started_at: datetime | None
    motion_ended_at: datetime | None
    finished_at: datetime | None
    error: str = Field(description="why the test did not complete, or repeating its analysis failed; else empty")
    commanded: bool | None = Field(
        description="whether anything was sent that can move the valve; null while that is open, or was never kept"
    )
    safe_confirmed: bool | None = Field(
        description="whether the valve's safe value was read back after the motion: the signal alone, `stands` has both"
    )
    stands: StandsView | None = Field(description="where the motion left the valve; null while it moves")
    recording: RecordingLink | None
    software: str
    href: str


class RunView(RunSummary):
    """One test with all that is known of it."""

    run_number: int
    until: Mapping[str, str] | None = Field(description="what the test was to know to end before its sequence does")
    ended_early: EndedEarly | None = Field(description="null where the sequence was played to its end")
    permissives: Mapping[str, Any] | None = Field(description="what had to hold before the motion, as it was read then")
    needs_acknowledgement: bool = Field(description="whether it bars the next test of the valve until acknowledged")
    acknowledged_at: datetime | None
    acknowledged_by: str | None
    acknowledgement: str | None
    note: str | None = Field(description="what somebody noted of the test")
    work_order: str | None
    described_at: datetime | None = Field(description="when label, work order or note were changed last")
    described_by: str | None
    quality: Mapping[str, Any] | None = Field(description="achieved rate, jitter and missed slots of the recording")
    analysis: Mapping[str, Any] | None = Field(description="the analysis object, breakaway/analysis/1, once completed")
    messages: Mapping[str, Any] = Field(
        description="what the sentences above were made of, by their text: code, template and values in SI; those of "
        "the analysis are in it"
    )


class RunPage(BaseModel):
    """Tests, newest first, and where the older ones are."""

    tests: list[RunSummary]
    next: str | None


def _shared(run: Run, reader: Reader = _ENGLISH) -> dict[str, Any]:
    href = f"/tests/{run.id}"
    link = None
    if run.recording_sha256 is not None:
        link = RecordingLink(href=f"{href}/recording", sha256=run.recording_sha256)
    names = RunSummary.model_fields.keys() - {"recording", "href", "stands"}
    shown = {name: getattr(run, name) for name in names}
    return shown | {"recording": link, "href": href, "stands": stands_view(run.stands, reader)}


def stands_view(stands: StandsAt | None, reader: Reader = _ENGLISH) -> StandsView | None:
    """Return where a valve stands; the sentence as ``reader`` reads it, every number SI."""
    if stands is None:
        return None
    sentence = reader.told(stands_sentence(stands))
    return StandsView(**asdict(stands), stem_percent=stands.stem_percent, sentence=sentence)


def summary(run: Run) -> RunSummary:
    """Return a test as it stands in a list."""
    return RunSummary(**_shared(run))


def view(run: Run, reader: Reader = _ENGLISH) -> RunView:
    """Return a test with all that is known of it; where its valve stands is said as ``reader`` reads it."""
    return RunView(
        **_shared(run, reader),
        run_number=run.number,
        until=run.until,
        ended_early=None if run.ended_early is None else EndedEarly(**run.ended_early),
        permissives=run.permissives,
        needs_acknowledgement=needs_acknowledgement(run),
        acknowledged_at=run.acknowledged_at,
        acknowledged_by=run.acknowledged_by,
        acknowledgement=run.acknowledgement,
        note=run.note,
        work_order=run.work_order,
        described_at=run.described_at,
        described_by=run.described_by,
        quality=run.quality,
        analysis=run.analysis,
        messages=_messages(run),
    )


def _messages(run: Run) -> Mapping[str, Any]:
    told = {"error": run.error, "permissives": run.permissives, "quality": run.quality}
    return with_table(told).get(TABLE) or {}
