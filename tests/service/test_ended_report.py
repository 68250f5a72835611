"""A test without a result has a page and a report: why, where the valve stands, what to do, what was recorded."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest

from drivers.stands_at import RestRules, StemVerdict, stands_at
from service.config.plant import Plant
from service.config.settings import load_plant
from service.model.run import Run, RunState, new_run_id
from service.model.stands_words import NOT_CONFIRMED
from service.report.ended import EndedSource, ended_document
from service.report.written import report_html, report_pdf
from service.shown.ending import ending_of
from service.words.reader import Reader
from service.words.units import UnitSystem
from tests.service.test_report import clocks_of, name_plant, words_of
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.nominal_recordings import triangle_test
from tests.support.problem import assert_problem
from tests.support.running_service import running_service
from valve.messages import joined, say
from valve.recording_files import write_parquet

STUCK_OPEN = stands_at(
    RestRules(0.0, 0.002, 10.0, 0.1016), after_s=10.1, safe_pa=0.0, confirmed=True, signal_pa=0.0, stem_m=0.0427
)
STANDS = "Signal 0 kPa, read back. Stem 42.7 mm: 42 % OPEN: it has not closed."
CLOSED = replace(STUCK_OPEN, stem_m=0.0, verdict=StemVerdict.THERE)
RUN = {"valve": "FV-101", "sequence": "triangle"}
BEGAN = datetime(2026, 5, 4, 10, 0, tzinfo=UTC)
STUCK = say(
    "stuck",
    "{tag}: the stem did not break away from {at:.1e m} within {within:.3g Pa}: look at packing, seat and actuator",
    tag="FV-101",
    at=2.0e-6,
    within=7.86e4,
)


def ended(state: RunState = RunState.FAILED, /, **changes: Any) -> Run:
    """Return a test that moved its valve for 8 s and has no result."""
    run = Run(
        id=new_run_id(BEGAN),
        valve="FV-101",
        sequence="triangle",
        state=state,
        created_at=BEGAN,
        started_at=BEGAN + timedelta(seconds=1),
        motion_ended_at=BEGAN + timedelta(seconds=9),
        finished_at=BEGAN + timedelta(seconds=10),
        safe_confirmed=True,
        commanded=True,
        error=STUCK,
        requested_by="anna",
        quality={"samples": 800, "ended": "failed"},
        stands=STUCK_OPEN,
    )
    return replace(run, **changes)


def source(run: Run, **changes: Any) -> EndedSource:
    made = EndedSource("FV-101", "test of today", "Failed", ending_of(run), None, "", {}, ())
    return replace(made, **changes)


REFUSED: dict[str, Any] = {
    "motion_ended_at": None,
    "safe_confirmed": None,
    "quality": None,
    "commanded": False,
    "stands": None,
}
NOTHING: dict[str, Any] = {**REFUSED, "started_at": None}
ENDINGS: dict[str, tuple[Run, str, str, str, bool]] = {
    "stuck": (ended(), "The test of FV-101 failed.", STANDS, "say what you found", True),
    "no safe state": (
        ended(safe_confirmed=False, stands=None, error=f"SAFE STATE NOT CONFIRMED: go and look at the valve; {STUCK}"),
        "The test of FV-101 failed.",
        "SAFE STATE NOT CONFIRMED",
        "Go and look at the valve now",
        True,
    ),
    "refused by the device": (
        ended(**REFUSED),
        "failed before anything moved",
        "stands where it stood before",
        "Remove the reason",
        False,
    ),
    "stopped": (
        ended(RunState.STOPPED, error="stopped by anna", quality={"ended": "stopped"}, stands=CLOSED),
        "was stopped.",
        "Signal 0 kPa, read back. Stem 0 mm: closed, as it should be.",
        "Start the test again when the valve may move.",
        False,
    ),
    "stopped while it waited": (
        ended(RunState.STOPPED, **NOTHING),
        "was stopped before anything moved",
        "stands where it stood before",
        "Start the test again",
        False,
    ),
    "killed": (
        ended(RunState.INTERRUPTED, motion_ended_at=None, quality=None),
        "was interrupted.",
        STANDS,
        "say what you found",
        True,
    ),
    "killed, and nobody looked yet": (
        ended(RunState.INTERRUPTED, motion_ended_at=None, quality=None, safe_confirmed=None, stands=None),
        "was interrupted.",
        "is not known: look at it",
        "say what you found",
        True,
    ),
    "interrupted before anything was commanded": (
        ended(RunState.INTERRUPTED, **REFUSED),
        "was interrupted before anything moved",
        "stands where it stood before",
        "start the test again",
        False,
    ),
    "failed in a way that nobody foresaw, of a version that did not keep what was commanded": (
        ended(**REFUSED | {"commanded": None}),
        "The test of FV-101 failed.",
        "is not known: look at it",
        "Remove the reason",
        False,
    ),
    "not analysed": (
        ended(
            quality={"ended": "completed"},
            stands=CLOSED,
            error="the recording is stored, its analysis failed: too short",
        ),
        "was moved and recorded, but there is no result",
        "closed, as it should be",
        "analyse it again on the page of the test",
        False,
    ),
}


@pytest.mark.parametrize(("run", "headline", "stands", "step", "is_alarm"), ENDINGS.values(), ids=list(ENDINGS))
def test_each_end_says_where_the_valve_stands_and_what_to_do(
    run: Run, headline: str, stands: str, step: str, is_alarm: bool
) -> None:
    ending = ending_of(run)
    assert headline in ending.headline
    assert stands in ending.stands
    assert step in " ".join(ending.steps)
    assert ending.is_alarm == is_alarm
    assert "SAFE STATE" not in ending.why, "it is said where the valve stands"
    assert ending.why[0].isupper()
    assert ending.why.endswith(".")
    cut_off = run.state is RunState.INTERRUPTED and run.commanded is not False
    assert ("without its service" in ending.course) == cut_off


def test_what_was_found_and_done_since_is_told() -> None:
    acknowledged = ended(acknowledged_at=BEGAN, acknowledged_by="tom", acknowledgement="packing eased")
    assert "say what you found" not in " ".join(ending_of(acknowledged).steps)
    later = ended(RunState.COMPLETED, created_at=BEGAN + timedelta(days=1))
    assert "Since then it was asked for again" in ending_of(acknowledged, later=later).stands


def test_where_nobody_signs_in_no_name_is_made_up() -> None:
    ending = ending_of(ended(RunState.STOPPED, error="stopped by local", requested_by="local"))
    assert ending.why == "Stopped by hand."
    assert ending.course.startswith("Asked for at ")


def test_both_forms_tell_the_end_and_draw_what_was_recorded(tmp_path: Path) -> None:
    file = tmp_path / "it.parquet"
    write_parquet(triangle_test(0.02, noise_m=2.0e-6), file)
    quality = {"samples": 800, "gaps": 2, "achieved_rate_hz": 99.8, "missed_slots": 1, "jitter_rms_s": 1.0e-4}
    permissive = {"name": "loop_in_manual", "met": True, "value": "in manual", "limit": "the loop in manual"}
    made = source(
        ended(), file=str(file), quality=quality, permissives=(permissive,), facts=(("Recording, SHA-256", "ab12"),)
    )
    html = report_html(made, "/tests/x/report?format=pdf").decode()
    assert html.count("<svg") == 1
    said = [re.sub(r"\s+", " ", re.sub(r"<svg.*?</svg>|<[^>]+>", " ", html, flags=re.DOTALL))]
    pdf = report_pdf(made)
    assert pdf.startswith(b"%PDF-")
    if shutil.which("pdftotext"):
        said.append(words_of(pdf, tmp_path))
    for text in said:
        for words in (
            "The test of FV-101 failed.",
            "within 78.6 kPa: look at packing, seat and actuator.",
            "Where the valve stands",
            STANDS,
            "breakaway acknowledge FV-101",
            "800, 2 of them missing",
            "loop in manual",
            "ab12",
        ):
            assert words in text, words


def test_a_recording_that_is_gone_or_damaged_leaves_a_report_that_says_so(tmp_path: Path) -> None:
    (tmp_path / "it.parquet").write_bytes(b"PAR1 and no more")
    for file, words in (("it.parquet", "cannot be read"), ("gone.parquet", "there is no such file")):
        document = ended_document(source(ended(), file=str(tmp_path / file)))
        assert words in document["recorded"]
        assert str(tmp_path) not in document["recorded"]
        assert document["pictures"] == {}
    assert ended_document(source(ended()))["recorded"] == "No sample was recorded."
    elsewhere = source(ended(), no_file="Gateway south keeps it.")
    assert ended_document(elsewhere)["recorded"] == "Gateway south keeps it."


def test_an_end_that_is_a_message_tells_what_stands_beside_it_once_and_in_the_units_that_were_chosen() -> None:
    stuck = say("stuck", "{tag}: it did not break away within {swept:.3g Pa}", tag="FV-101", swept=7.86e4)
    sent = say("sent_to_safe", "the valve was sent to its safe value")
    ending = ending_of(ended(error=joined("; ", [NOT_CONFIRMED, stuck, sent])))
    assert ending.why == "It did not break away within 7.86e+04 Pa."
    assert ended_document(source(ended(error=stuck), reader=Reader(UnitSystem.PSI)))["why"].endswith("within 11.4 psi.")
    stopped = say("stopped_by", "stopped by {who}", who="local")
    assert ending_of(ended(RunState.STOPPED, error=joined("; ", [NOT_CONFIRMED, stopped]))).why == "Stopped by hand."


def test_the_report_of_a_bad_end_is_read_in_the_units_that_were_chosen() -> None:
    document = ended_document(source(ended(), reader=Reader(UnitSystem.PSI)))
    assert "11.4 psi" in document["why"]
    assert "Pa" not in document["why"]


async def test_samples_that_a_full_disk_kept_in_the_journal_are_not_called_none(
    plant: Plant, client: httpx.AsyncClient, rig: FakeRig
) -> None:
    rig.break_at = 0.5
    run = (await client.post("/tests/run", json=RUN, headers={"Prefer": "wait=10"})).json()
    said = (await client.get(f"/tests/{run['id']}/report?format=html")).text
    assert "becomes its recording at the next start" in said
    (plant.service.store / "journals" / f"{run['id']}.journal").unlink()
    assert "No sample was recorded." in (await client.get(f"/tests/{run['id']}/report?format=html")).text


async def test_it_is_filed_by_its_identity_and_signed_and_tells_the_plants_time(plant_file: Path, rig: FakeRig) -> None:
    name_plant(plant_file, "Mill 2", "Asia/Kolkata")
    rig.break_at = 0.5
    async with running_service(load_plant(plant_file), rig, FakeAnalyst()) as client:
        run = (await client.post("/tests/run", json=RUN | {"permit": "W-17"}, headers={"Prefer": "wait=10"})).json()
        assert (await client.patch(f"/tests/{run['id']}", json={"note": "supply was off"})).status_code == 200
        html = (await client.get(f"/tests/{run['id']}/report?format=html")).text
    head = dict(re.findall(r"<dt>([^<]*)</dt><dd>([^<]*)</dd>", html))
    assert (head["Plant"], head["Tag"], head["Work order"]) == ("Mill 2", "FV-101", "W-17")
    assert "Serial number" in head
    assert "<span>Signature</span>" in html
    assert "Note:</strong> supply was off" in html
    assert clocks_of(html) == {"IST"}


def test_the_pdf_of_a_bad_end_has_the_head_and_the_place_to_sign_on_its_first_page(tmp_path: Path) -> None:
    if not shutil.which("pdftotext"):
        pytest.skip("pdftotext is not installed")
    file = tmp_path / "it.parquet"
    write_parquet(triangle_test(0.02, noise_m=2.0e-6), file)
    made = source(ended(), file=str(file), head=(("Plant", "Mill 2"), ("Serial number", "")), note="supply was off")
    first = words_of(report_pdf(made), tmp_path).partition("page 1 of 2")[0]
    for words in ("Plant Serial number Mill 2", "Note: supply was off", "Date Name Signature"):
        assert words in first


async def test_a_failed_test_has_a_page_and_a_report_and_a_waiting_one_has_none_yet(
    client: httpx.AsyncClient, rig: FakeRig
) -> None:
    rig.break_at = 0.5
    run = (await client.post("/tests/run", json=RUN, headers={"Prefer": "wait=10"})).json()
    assert run["state"] == "failed"
    page = (await client.get(f"/ui/tests/{run['id']}")).text
    assert f"/tests/{run['id']}/report" in page
    report = await client.get(f"/tests/{run['id']}/report?format=html")
    for words in ("The stem is stuck: look at it", "What to do", "Where the valve stands"):
        assert words in page
        assert words in report.text
    assert (await client.get(f"/tests/{run['id']}/report")).content[:5] == b"%PDF-"
    rig.break_at, rig.duration_s = None, 5.0
    going = (await client.post("/tests/run", json={"valve": "FV-102", "sequence": "triangle"})).json()
    assert_problem(await client.get(f"/tests/{going['id']}/report"), 404, "ask again when it has ended")
