"""Tests as the REST interface shows them."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, JsonValue

from service.runs.acknowledgement import needs_acknowledgement
from service.runs.run import Label, Run, RunState

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


class RecordingLink(BaseModel):
    """Where the raw recording is and what it hashes to."""

    href: str
    sha256: str


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
    error: str = Field(description="why the test did not complete; empty where it did")
    safe_confirmed: bool | None = Field(description="whether the valve's safe value was read back after the motion")
    recording: RecordingLink | None
    software: str
    href: str


class RunView(RunSummary):
    """One test with all that is known of it."""

    run_number: int
    permissives: dict[str, Any] | None = Field(description="what had to hold before the motion, as it was read then")
    needs_acknowledgement: bool = Field(description="whether it bars the next test of the valve until acknowledged")
    acknowledged_at: datetime | None
    acknowledged_by: str | None
    acknowledgement: str | None
    quality: dict[str, Any] | None = Field(description="achieved rate, jitter and missed slots of the recording")
    analysis: dict[str, Any] | None = Field(description="the analysis object, breakaway/analysis/1, once completed")


class RunPage(BaseModel):
    """Tests, newest first, and where the older ones are."""

    tests: list[RunSummary]
    next: str | None


def _shared(run: Run) -> dict[str, Any]:
    href = f"/tests/{run.id}"
    link = None
    if run.recording_sha256 is not None:
        link = RecordingLink(href=f"{href}/recording", sha256=run.recording_sha256)
    names = RunSummary.model_fields.keys() - {"recording", "href"}
    return {name: getattr(run, name) for name in names} | {"recording": link, "href": href}


def summary(run: Run) -> RunSummary:
    """Return a test as it stands in a list."""
    return RunSummary(**_shared(run))


def view(run: Run) -> RunView:
    """Return a test with all that is known of it."""
    return RunView(
        **_shared(run),
        run_number=run.number,
        permissives=run.permissives,  # type: ignore[arg-type]  # a read-only mapping is copied
        needs_acknowledgement=needs_acknowledgement(run),
        acknowledged_at=run.acknowledged_at,
        acknowledged_by=run.acknowledged_by,
        acknowledgement=run.acknowledgement,
        quality=run.quality,  # type: ignore[arg-type]
        analysis=run.analysis,  # type: ignore[arg-type]
    )
