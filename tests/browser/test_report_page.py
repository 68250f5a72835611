"""The report as a page: on a phone it is read without scrolling sideways, and its pictures keep readable letters."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from service.model.run import RunState
from service.report.ended import EndedSource
from service.report.source import ReportSource
from service.report.written import report_html
from service.shown.ending import ending_of
from tests.browser.conftest import store_test
from tests.service.test_ended_report import ended
from tests.support.gateway import Gateway
from tests.support.made_analysis import FRICTION_N, made_analysis
from tests.support.nominal_recordings import triangle_test
from tests.support.tablets import LANDSCAPE, PHONE, Tablet
from valve.recording_files import write_parquet

LONG_TAG = "FV-" + 4 * "1234567890" + "ABCDEFG"
SHA256 = "0123456789abcdef" * 4
LEAST_PX = 9.0
# What reaches beyond the screen and stands in no box that scrolls by itself.
BEYOND = """
return [...document.querySelectorAll('main *')].filter((one) => !one.closest('svg, .scroll')
  && one.getBoundingClientRect().right > innerWidth + 0.5).map((one) => one.outerHTML.slice(0, 90));
"""
# The smallest letters of the signature, px; the other pictures have their letters as paths.
LETTERS = """
return Math.min(...[...document.querySelectorAll('figure svg text')].map((one) =>
  parseFloat(getComputedStyle(one).fontSize) * one.getScreenCTM().a));
"""
# Boxes that scroll, and whether a keyboard reaches them.
BOXES = """
return [...document.querySelectorAll('.scroll, figure')].filter((one) => one.scrollWidth > one.clientWidth)
  .map((one) => one.tabIndex === 0 && one.getAttribute('aria-label') !== null);
"""


@pytest.fixture
def phone(browser: Tablet) -> Iterator[Tablet]:
    browser.turn(PHONE)
    yield browser
    browser.turn(LANDSCAPE)


def _head(tag: str) -> tuple[tuple[str, str], ...]:
    return ("Plant", "Mill 2"), ("Tag", tag), ("Serial number", ""), ("Technician", "anna"), ("Work order", "W-17")


def _of_result(tag: str) -> ReportSource:
    permissive = {"name": "loop_in_manual", "met": True, "value": "in manual", "limit": "the loop in manual"}
    analysis: dict[str, Any] = made_analysis(ne107="M")
    facts, before = (("Recording, SHA-256", SHA256),), made_analysis()["signature"]
    return ReportSource(
        tag, "test of today", analysis, facts, baseline=before, permissives=(permissive,), head=_head(tag)
    )


def _without_result(tag: str, folder: Path) -> EndedSource:
    file = folder / "test.parquet"
    write_parquet(triangle_test(0.02, noise_m=2.0e-6), file)
    run = ended(RunState.FAILED, valve=tag)
    facts = (("Recording, SHA-256", SHA256),)
    made = EndedSource(tag, "test of today", "Failed", ending_of(run), str(file), "", {"samples": 800}, facts)
    return replace(made, head=_head(tag))


@pytest.mark.parametrize("tag", ["FV-101", LONG_TAG])
@pytest.mark.parametrize("has_result", [True, False])
def test_a_report_does_not_scroll_sideways_on_a_phone(
    phone: Tablet, tmp_path: Path, tag: str, has_result: bool
) -> None:
    page = tmp_path / "report.html"
    page.write_bytes(report_html(_of_result(tag) if has_result else _without_result(tag, tmp_path)))
    phone.open(page.as_uri())
    assert phone.run(BEYOND) == []
    assert phone.run("return document.documentElement.scrollWidth") <= PHONE[0]
    boxes = phone.run(BOXES)
    assert boxes, "the pictures scroll in their own boxes"
    assert all(boxes), "a keyboard reaches and names each box that scrolls"
    assert not phone.run("return [...document.querySelectorAll('th')].filter((one) => !one.innerText.trim()).length")


def test_the_letters_of_the_signature_are_read_on_a_phone(phone: Tablet, service: Gateway) -> None:
    run = store_test(service, 50.0, FRICTION_N)
    phone.open(f"{service.url}/tests/{run.id}/report?format=html")
    assert phone.run(LETTERS) >= LEAST_PX
    assert phone.run("return document.documentElement.scrollWidth") <= PHONE[0]
    assert phone.run("return document.querySelectorAll('main').length") == 1
    phone.turn(LANDSCAPE)
    assert phone.run(LETTERS) >= LEAST_PX
    assert phone.run(BOXES) == [], "a wide screen shows the whole of each picture"
