"""The report of a test, as HTML and as PDF: the same words and numbers, nothing from elsewhere."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from service.cli import main
from service.config.settings import load_plant
from service.figures.signature import Frame
from service.figures.trend import Trend, TrendPoint
from service.health.changes import ValveFacts
from service.model.health_limits import HealthLimits
from service.report.before_after import before_after
from service.report.document import document_of
from service.report.source import ReportSource
from service.report.valve_facts import nameplate_facts
from service.report.written import report_html, report_pdf
from service.words.languages import Language
from service.words.reader import Reader
from service.words.units import UnitSystem
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.made_analysis import ACTION, FRICTION_N, MISSING, made_analysis
from tests.support.nominal_recordings import NAMEPLATE_TOML, triangle_test
from tests.support.problem import assert_problem
from tests.support.running_service import running_service
from valve.nameplate import Action, Actuator, Nameplate, Signal
from valve.recording_files import file_sha256, write_parquet

RUN = {"valve": "FV-101", "sequence": "triangle"}
SHA256 = "0123456789abcdef" * 4


def source(**others: Any) -> ReportSource:
    analysis = made_analysis(ne107="M")
    facts = (("Recording, SHA-256", SHA256), ("Software", "breakaway 0"))
    permissive = {"name": "loop_in_manual", "met": True, "value": "in manual", "limit": "the loop in manual"}
    return ReportSource("FV-101", "test of today", analysis, facts, None, (), (permissive,), **others)


def name_plant(file: Path, name: str, zone: str) -> None:
    named = f'[service]\nplant = "{name}"\nzone = "{zone}"\n'
    text = file.read_text(encoding="utf-8").replace("[service]\n", named, 1)
    file.write_text(text, encoding="utf-8")


def clocks_of(text: str) -> set[str]:
    return set(re.findall(r"\d{4}-\d\d-\d\d \d\d:\d\d(?::\d\d)? ([A-Z]{2,5})\b", text))


def words_of(pdf: bytes, folder: Path) -> str:
    (folder / "report.pdf").write_bytes(pdf)
    found = subprocess.run(["pdftotext", "-layout", folder / "report.pdf", "-"], capture_output=True, check=True)
    # a checksum may break between any two of its digits
    return re.sub(r"\s+", " ", found.stdout.decode().replace("\u200b", ""))


def test_page_one_says_what_a_supervisor_needs() -> None:
    summary = document_of(source())["summary"]
    assert (summary["verdict"], summary["state"]) == ("FV-101 needs maintenance.", "M")
    assert summary["reasons"] == ["Friction rose by 0 % since the baseline (limit 20 %): look at the packing."]
    assert summary["actions"] == [ACTION]
    assert summary["key_figures"][0] == {"name": "Friction", "value": "612.0 ± 2.0 N", "beside": ""}


def test_page_one_has_the_note_on_a_nameplate_that_is_wrong_and_no_sentence_twice() -> None:
    note = "The moving mass is 2 times the nameplate's 1.36 kg. Check both."
    analysis = made_analysis(ne107="N") | {"notes": [note]}
    reason = "Causes were not looked for. Too few samples."
    analysis["discrepancy"] = {"verdict": "not_assessed", "message": "Too few samples."}
    analysis["health"]["reasons"] = [reason]
    summary = document_of(ReportSource("FV-1", "x", analysis, ()))["summary"]
    assert summary["actions"] == [note]
    assert (summary["reasons"], summary["diagnosis"]) == ([reason], "")


def test_both_forms_say_the_same(tmp_path: Path) -> None:
    html = re.sub(r"\s+", " ", re.sub(r"<svg.*?</svg>|<[^>]+>", " ", report_html(source()).decode(), flags=re.DOTALL))
    pdf = report_pdf(source())
    assert pdf.startswith(b"%PDF-")
    said = [html]
    if shutil.which("pdftotext"):
        said.append(words_of(pdf, tmp_path))
    for text in said:
        for words in ("FV-101 needs maintenance.", "612.0 ± 2.0 N", SHA256, "loop in manual", "52.50 ± 0.53 N/mm"):
            assert words in text, words
        assert "not identifiable" in text
        assert MISSING in text
        assert "1.00 mm rms without the cause and by 0.0300 mm rms with it" in text


def test_the_page_loads_nothing_and_its_pictures_do_not_share_ids() -> None:
    text = report_html(source()).decode()
    assert not re.findall(r'(?:src|href|url)\s*[=(]\s*"?(?:https?:)?//(?!www\.w3\.org)', text)
    assert "<script" not in text
    assert text.count("<svg") == 4
    ids = re.findall(r'\bid="([^"]+)"', text)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'(?:href="#|url\(#)([^")]+)', text)) <= set(ids)


def test_what_an_analysis_does_not_have_is_left_out_of_the_report() -> None:
    bare = {
        "schema": "breakaway/analysis/1",
        "recording": {"samples": 10},
        "estimates": [],
        "discrepancy": {"verdict": "not_assessed", "message": "too short"},
        "health": {"ne107": None, "reasons": ["not assessed"]},
    }
    text = report_html(ReportSource("FV-9", "x", bare, ())).decode()
    assert "FV-9 was measured; its health was not assessed." in text
    assert "<svg" not in text
    assert report_pdf(ReportSource("FV-9", "x", bare, ())).startswith(b"%PDF-")


def test_text_of_an_analysis_is_never_markup() -> None:
    analysis = made_analysis(ne107="M")
    analysis["discrepancy"]["causes"][0]["action"] = "<script>alert(1)</script> #panic() *x* $y$"
    evil = ReportSource("FV-<b>", "#eval()", analysis, ())
    assert "<script>" not in report_html(evil).decode()
    assert report_pdf(evil).startswith(b"%PDF-")


def test_a_cause_that_takes_no_misfit_has_no_share_of_it(tmp_path: Path) -> None:
    analysis = made_analysis(ne107="M")
    analysis["discrepancy"]["causes"][0]["share_of_misfit"] = 0.0  # a constant load
    made = ReportSource("FV-1", "x", analysis, ())
    assert "of the misfit." not in report_html(made).decode()
    pdf = report_pdf(made)
    assert pdf.startswith(b"%PDF-")
    if shutil.which("pdftotext"):
        assert "of the misfit." not in words_of(pdf, tmp_path)


def test_the_report_is_read_in_the_units_that_were_chosen() -> None:
    assert (
        document_of(source(reader=Reader(UnitSystem.PSI)))["summary"]["key_figures"][0]["value"] == "137.58 ± 0.45 lbf"
    )


def test_a_report_is_read_in_the_language_of_its_reader(tmp_path: Path) -> None:
    made = source(reader=Reader(language=Language.GERMAN))
    html, pdf = report_html(made).decode(), report_pdf(made)
    assert '<html lang="de">' in html
    said = [html]
    if shutil.which("pdftotext"):
        said.append(words_of(pdf, tmp_path))
    for text in said:
        for words in ("FV-101 braucht Wartung.", "Warum", "Was zu tun ist", "Diagnose", "Signatur"):
            assert words in text, words
        assert "What to do" not in text


def test_what_somebody_wrote_is_not_translated() -> None:
    made = source(
        reader=Reader(UnitSystem.PSI, language=Language.GERMAN), note="Valves moved 3 mm", head=(("x", "Why"),)
    )
    document = document_of(made)
    assert (document["note"], document["head"]) == ("Valves moved 3 mm", [{"name": "x", "value": "Why"}])


def test_a_test_that_nothing_explains_says_what_to_do_next(tmp_path: Path) -> None:
    analysis = made_analysis(ne107="M")
    analysis["discrepancy"] |= {"verdict": "unexplained", "causes": [], "gain": None}
    made = ReportSource("FV-1", "x", analysis, (), sequence="triangle")
    (said,) = document_of(made)["summary"]["actions"]
    assert said.startswith("Repeat with the sequence diagnostic")
    assert "stem, packing and seat where the misfit is largest" in said, "travel explains nine tenths of it"
    assert "captures" in said, "it was polled"
    page = report_html(made).decode()
    assert page.count("Repeat with the sequence diagnostic") == 2
    if shutil.which("pdftotext"):
        assert "Repeat with the sequence diagnostic" in words_of(report_pdf(made), tmp_path)
    again = document_of(replace(made, sequence="diagnostic"))["diagnosis"]["next"]
    assert again.startswith("Repeat the sequence diagnostic: what comes again")
    analysis["discrepancy"]["pictures"]["explained"] = {"travel": 0.3, "time": 0.2}
    assert "look" not in document_of(made)["diagnosis"]["next"], "no coordinate explains most of it"


def test_a_column_for_the_baseline_stands_only_where_there_is_one(tmp_path: Path) -> None:
    html = report_html(source()).decode()
    assert 'scope="col">baseline' not in html
    against = replace(source(), baseline={"friction_mean_n": 590.0})
    html = report_html(against).decode()
    assert 'scope="col">baseline' in html
    assert "590 N" in html
    for made, is_told in ((source(), False), (against, True)):
        pdf = report_pdf(made)
        assert pdf.startswith(b"%PDF-")
        if shutil.which("pdftotext"):
            assert ("590 N" in words_of(pdf, tmp_path)) == is_told


def test_page_one_draws_the_signature_and_the_pictures_of_the_misfit_stand_behind_it() -> None:
    document = document_of(source())
    assert document["front"] == ["signature"]
    html = report_html(source()).decode()
    first, behind = html.split("For the engineer")
    assert (first.count("<svg"), behind.count("<svg")) == (1, 3)
    bare = made_analysis(ne107="M")
    bare["signature"]["curve"] = None
    trend = Trend("friction_mean_n", "friction", "N", (TrendPoint(datetime.now(UTC), 600.0),))
    without = replace(source(), analysis=bare, trends=(trend,))
    assert document_of(without)["front"] == ["trend", "coordinate"]
    assert document_of(ReportSource("FV-1", "x", bare | {"discrepancy": None}, ()))["front"] == []


def test_page_one_identifies_valve_and_work_draws_the_signature_as_vectors_and_leaves_room_to_sign(
    tmp_path: Path,
) -> None:
    head = (("Plant", "Mill 2"), ("Area", "Boiler 3"), ("Tag", "FV-101"), ("Technician", ""), ("Work order", "W-17"))
    made = replace(source(), head=head, frame=Frame(0.1016))
    html = report_html(made).decode()
    first = html.split("For the engineer")[0]
    for words in ("Mill 2", "Boiler 3", "W-17", "Technician", ">Signature</span>", "rated travel"):
        assert words in first, words
    pdf = report_pdf(made)
    assert b"/Subtype /Image" not in pdf, "pictures are vectors"
    if shutil.which("pdftotext"):
        (tmp_path / "report.pdf").write_bytes(pdf)
        command = ["pdftotext", "-l", "1", "-layout", str(tmp_path / "report.pdf"), "-"]
        page_one = subprocess.run(command, capture_output=True, check=True).stdout.decode()
        for words in ("Mill 2", "Boiler 3", "W-17", "Technician", "Name", "Signature", "rated travel"):
            assert words in page_one, words
    assert ">Signature</span>" not in report_html(source()).decode(), "what no service tested is not signed for"


def test_before_and_after_stand_beside_each_other_with_what_passes() -> None:
    before, after = made_analysis(900.0), made_analysis(FRICTION_N)
    check = {"name": "dead_band", "meaning": "dead band", "unit": "percent", "limit": 20.0}
    after["health"]["acceptance"]["checks"] = [check | {"value": 22.4, "met": False}]
    facts = ValveFacts(0.1016, 82_737.0, 82_737.0)
    rows = {row.name: row for row in before_after(before, after, HealthLimits(), facts, Reader())}
    friction, dead_band = rows["Friction, mean"], rows["Dead band"]
    assert (friction.before, friction.after) == ("900.0 ± 2.0 N", "612.0 ± 2.0 N")
    assert friction.change.startswith("−288")
    assert "−32 %" in friction.change
    assert ";" not in friction.change
    assert friction.verdict == "pass", "a repair that lowers friction is no failure"
    assert (dead_band.limit, dead_band.verdict) == ("at most 20.0 %", "FAIL")
    assert rows["Bench set, low end"].change == "+0 kPa", "no share of what may be zero"
    assert rows["Spring rate"].verdict == "–", "nothing is asked of it without a baseline"
    made = replace(source(), before="as found 2026-11-20", before_after=tuple(rows.values()))
    text = report_html(made).decode()
    assert "Before: as found 2026-11-20" in text
    assert "<strong>FAIL</strong>" in text
    assert report_pdf(made).startswith(b"%PDF-")


def test_of_a_valve_whose_friction_scatters_friction_is_drawn_along_the_travel() -> None:
    analysis = made_analysis(ne107="M")
    curves = [
        {
            "coordinate": "travel_m",
            "direction": way,
            "at": [0.0, 0.02, 0.04],
            "force_n": [-10.0, 0.0, 30.0],
            "ci95": [[-15.0, -5.0], [-5.0, 5.0], [20.0, 40.0]],
        }
        for way in ("opening", "closing")
    ]
    analysis["discrepancy"] |= {"pictures": None, "latent_friction": curves, "gain": None, "gains": []}
    document = document_of(ReportSource("FV-1", "x", analysis, ()))
    assert "opening -10 to 30 N" in document["pictures"]["friction"]["description"]


def test_the_nameplate_is_told_in_the_units_that_were_chosen() -> None:
    plate = Nameplate(
        "FV-1",
        Actuator(0.1016, 0.06452, moving_mass_kg=1.36, bench_set_pa=(20_684.0, 103_421.0)),
        Signal((4.0, 20.0), (0.0, 82_737.0)),
    )
    assert dict(nameplate_facts(plate, Reader(UnitSystem.PSI))) == {
        "Rated travel": "4.000 in",
        "Action": "spring-opposed",
        "Diaphragm area": "100.0 in²",
        "Moving mass": "2.998 lb",
        "Bench set": "3.000 psi to 15.00 psi, a spring rate of 300.0 lbf/in",
        "Signal": "4 to 20 mA for 0 psi to 12.00 psi",
    }
    double = Nameplate("FV-1", Actuator(0.05, action=Action.DOUBLE))
    assert dict(nameplate_facts(double, Reader())) == {
        "Rated travel": "50.00 mm",
        "Action": "double-acting, no spring",
    }


async def test_the_service_gives_pdf_or_html_as_it_is_asked(plant_file: Path) -> None:
    class Found(FakeAnalyst):
        async def analyze(self, *args: Any, **others: Any) -> dict[str, Any]:
            await super().analyze(*args, **others)
            return made_analysis()

    name_plant(plant_file, "Mill 2", "Asia/Kolkata")
    async with running_service(load_plant(plant_file), FakeRig(), Found()) as client:
        order = {**RUN, "label": "as_left", "permit": "W-17"}
        run = (await client.post("/tests/run", json=order, headers={"Prefer": "wait=10"})).json()
        address = f"/tests/{run['id']}/report"
        pdf = await client.get(address)
        assert (pdf.headers["content-type"], pdf.content[:5]) == ("application/pdf", b"%PDF-")
        html = await client.get(address, headers={"Accept": "text/html,*/*;q=0.8"})
        assert html.headers["content-type"].startswith("text/html")
        assert html.headers["content-security-policy"].startswith("default-src 'none'")
        assert run["recording"]["sha256"] in html.text
        assert "loop in manual" in html.text
        pairs = dict(re.findall(r'<th scope="row">([^<]*)</th><td class="mark">([^<]*)</td>', html.text))
        assert (pairs["Label"], pairs["Work permit"]) == ("as left", "W-17")
        head = dict(re.findall(r"<dt>([^<]*)</dt><dd>([^<]*)</dd>", html.text))
        assert (head["Plant"], head["Tag"], head["Work order"]) == ("Mill 2", "FV-101", "W-17")
        assert (pairs["Safe value"], pairs["Diaphragm area"]) == ("0 kPa", "645.2 cm²")
        assert pairs["A test may use"].startswith("0 kPa to 82.74 kPa, changes of ")
        assert re.search(r"test of \d{4}-\d\d-\d\d \d\d:\d\d IST, triangle, as left", html.text)
        assert clocks_of(html.text) == {"IST"}, "the plant's clock, not this machine's"
        linked = re.search(r'href="(/tests/[^"]+)"', html.text)
        assert linked is not None
        assert (await client.get(linked.group(1).replace("&amp;", "&"))).content[:5] == b"%PDF-"
        assert (await client.get(address, headers={"Accept": "image/png"})).status_code == 406
        assert_problem(await client.get("/tests/20260101T000000Z-00000000/report"), 404, "unknown")
        queued = (await client.post("/tests/run", json=RUN)).json()
        assert_problem(await client.get(f"/tests/{queued['id']}/report"), 404, "ask again when it has ended")


def test_the_command_writes_the_report_of_a_recording(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    write_parquet(triangle_test(0.02, noise_m=2.0e-6), tmp_path / "triangle.parquet")
    (tmp_path / "fv.toml").write_text(NAMEPLATE_TOML)

    def call(*arguments: str) -> int:
        monkeypatch.setattr(
            sys, "argv", ["breakaway", "analyze", "triangle.parquet", "--nameplate", "fv.toml", *arguments]
        )
        try:
            main()
        except SystemExit as end:
            return end.code if isinstance(end.code, int) else 0
        return 0

    assert call("--report", "report.txt") == 1
    assert "name it x.pdf or x.html" in capsys.readouterr().err
    assert call("--report", "report.html") == 0
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert file_sha256(tmp_path / "triangle.parquet") in text
    assert "FV-101 was measured; its health was not assessed." in text
    assert "Rated travel" in text


def test_the_report_of_a_healthy_valve_begins_with_that_no_fault_was_found_and_says_it_once() -> None:
    analysis = made_analysis(ne107="N")
    healthy = analysis | {"discrepancy": {"verdict": "none", "message": "No fault found.", "causes": []}}
    summary = document_of(replace(source(), analysis=healthy))["summary"]
    assert summary["verdict"].endswith(": no fault found.")
    assert not summary["diagnosis"]
    small = analysis["discrepancy"]["causes"][0] | {"effect_percent_of_span": 0.1}
    seen = analysis | {"discrepancy": analysis["discrepancy"] | {"causes": [small]}}
    summary = document_of(replace(source(), analysis=seen))["summary"]
    assert not summary["diagnosis"]
    assert small["action"] not in summary["actions"]


def test_a_figure_has_the_digits_of_its_interval_wherever_it_stands() -> None:
    analysis = made_analysis(ne107="N")
    analysis["signature"] |= {"dead_band_percent": 1.794, "bench_set_pa": [10.0, 82_700.0]}
    intervals = {
        "dead_band_percent": {"ci95": [1.52, 2.07]},
        "bench_set_pa": {"ci95": [[-12.0, 32.0], [82_680, 82_720]]},
    }
    for known, dead_band, closed_end in (
        (intervals, "1.79 ± 0.28 %", "0.010 ± 0.022 kPa"),
        ({}, "1.794 %", "0 kPa"),
    ):
        analysis["signature"]["intervals"] = known
        document = document_of(replace(source(), analysis=analysis))
        key = {row["name"]: row["value"] for row in document["summary"]["key_figures"]}
        figures = {row["name"]: row["value"] for row in document["figures"]}
        assert key["Dead band"] == figures["Dead band"] == dead_band
        assert figures["Bench set, closed end"] == closed_end
