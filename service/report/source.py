"""What a report is made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from service.figures.signature import Frame, Layer
from service.figures.trend import Trend
from service.report.before_after import BeforeAfter
from service.words.reader import Reader


@dataclass(frozen=True, slots=True)
class ReportSource:
    """A test's result with what stands around it; all of it plain, so that another process can draw it.

    ``facts`` are the provenance: names and values. ``baseline`` is the signature that figures are held against,
    ``frame`` what the signature is drawn into and ``behind`` the tests that it is drawn over. ``valve`` is its
    nameplate and limits as names and values, ``sequence`` the one that the test played, None where unknown.
    ``stands`` is where the test left the valve, "" where no service tested it, ``alarm`` what is wrong with that.
    ``head`` is what identifies valve and work on the first page, ``before_after`` the test beside the one called
    ``before``, ``note`` what somebody noted of it.
    """

    tag: str
    subject: str
    analysis: Mapping[str, Any]
    facts: tuple[tuple[str, str], ...]
    baseline: Mapping[str, Any] | None = None
    trends: tuple[Trend, ...] = ()
    permissives: tuple[Mapping[str, Any], ...] = ()
    comparison: tuple[str, ...] = ()
    reader: Reader = field(default_factory=Reader)
    valve: tuple[tuple[str, str], ...] = ()
    sequence: str | None = None
    stands: str = ""
    alarm: str = ""
    frame: Frame = field(default_factory=Frame)
    behind: tuple[Layer, ...] = ()
    head: tuple[tuple[str, str], ...] = ()
    before: str = ""
    before_after: tuple[BeforeAfter, ...] = ()
    note: str = ""
