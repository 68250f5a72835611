"""The analysis object: its shape, that it is true, and that it says what it cannot tell."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from discrepancy.rough.result import Finding, RoughDiagnosis, Verdict
from discrepancy.rough.separating import SeparatingTest
from estimators.base import Outcome, failed
from estimators.registry import ESTIMATORS
from service.analysis.analysis import analyze_recordings, joined, recording_summary
from service.analysis.diagnosis import assess, not_assessed
from service.workers.analysis_process import AnalysisProcess
from tests.support.hidden import hidden
from tests.support.nominal_recordings import NOMINAL, at_rest, recorded, sine_test, triangle_test, with_gaps
from valve.effects import effect_from_values
from valve.errors import RecordingError
from valve.messages import TABLE
from valve.nameplate import Nameplate
from valve.parameters import PARAMETER_SYMBOLS
from valve.recording import Recording
from valve.recording_files import write_csv, write_parquet
from valve.waveform import steps

PLATE = NOMINAL.nameplate
AREA_M2 = 0.06452
CONTRACT_FIGURES = ("friction_mean_n", "friction_max_n", "spring_rate_n_per_m", "bench_set_pa", "dead_band_percent")


@pytest.fixture(scope="module")
def noisy() -> dict[str, Any]:
    return analyze_recordings([triangle_test(noise_m=5.0e-6)], PLATE, held_out=[("sine.csv", sine_test())])


@pytest.fixture
def classic_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the whole motion unfitted and undiagnosed: what is asked then is the same without them."""
    monkeypatch.delitem(ESTIMATORS, "maximum_likelihood")
    monkeypatch.setattr("service.analysis.analysis.assess", lambda *_, **__: not_assessed("of this test"))


SPOT_M = 0.055


@pytest.fixture(scope="module")
def hidden_spot() -> dict[str, Any]:
    """Return the analysis of a valve with a tight spot, made by an integration that the finder does not share."""
    spot = effect_from_values("local_friction", {"rise_n": 150.0, "centre_m": SPOT_M, "width_m": 0.0015})
    made = hidden("nominal", spot, seed=3)
    return analyze_recordings([made.recording], made.nameplate, held_out=[("sine.csv", made.held_out)])


def values(analysis: dict[str, Any], method: str) -> dict[str, float | None]:
    estimate = next(estimate for estimate in analysis["estimates"] if estimate["method"] == method)
    return {symbol: parameter["value"] for symbol, parameter in estimate["parameters"].items()}


def test_the_object_has_what_the_contract_promises(noisy: dict[str, Any]) -> None:
    json.dumps(noisy, allow_nan=False)
    assert noisy["schema"] == "breakaway/analysis/1"
    assert {"samples", "duration_s", "sample_period_s", "gaps", "position_noise_m"} <= set(noisy["recording"])
    assert [estimate["method"] for estimate in noisy["estimates"]][:2] == ["regression", "garcia"]
    for estimate in noisy["estimates"]:
        assert estimate["status"] in ("ok", "poor", "failed")
        assert list(estimate["parameters"]) == list(PARAMETER_SYMBOLS)
        for symbol, parameter in estimate["parameters"].items():
            assert parameter["unit"] == PARAMETER_SYMBOLS[symbol].unit
            assert (parameter["value"] is not None) == parameter["identifiable"]
            assert parameter["value"] is not None or parameter["note"]
    assert noisy["discrepancy"]["verdict"] == "none"
    assert noisy["discrepancy"]["causes"] == []
    assert noisy["discrepancy"]["message"] == "No fault found. Friction is alike all along the travel."
    gain = noisy["discrepancy"]["gain"]
    assert gain["held_out"] == "sine.csv"
    assert gain["rmse_after_m"] == gain["rmse_before_m"]
    assert noisy["health"]["reasons"]


@pytest.mark.parametrize("method", ["regression", "garcia"])
def test_spring_rate_and_friction_of_the_nominal_valve_come_out(noisy: dict[str, Any], method: str) -> None:
    found, truth = values(noisy, method), NOMINAL.parameters.by_symbol()
    for symbol in ("k", "F_c", "F_s"):
        assert found[symbol] == pytest.approx(truth[symbol], rel=0.02), symbol


def test_the_recording_is_described(noisy: dict[str, Any]) -> None:
    recording = noisy["recording"]
    assert recording["samples"] == 20_001
    assert recording["duration_s"] == pytest.approx(20.0)
    assert recording["sample_period_s"] == pytest.approx(0.001)
    assert recording["gaps"] == 0
    assert recording["position_noise_m"] == pytest.approx(5.0e-6, rel=0.05)
    assert recording["channels"] == ["pressure_pa", "position_m"]
    assert recording["sampling"]["rate_hz"] == pytest.approx(1000.0, rel=1e-3)
    assert recording["sampling"]["missed_slots"] == 0


@pytest.mark.usefixtures("classic_alone")
def test_gaps_are_counted_and_do_not_reach_into_the_noise() -> None:
    recording = analyze_recordings([with_gaps(triangle_test(noise_m=5.0e-6))], PLATE)["recording"]
    assert recording["gaps"] == 2
    assert recording["sampling"]["missed_slots"] == 21
    assert recording["position_noise_m"] == pytest.approx(5.0e-6, rel=0.05)


def test_the_diagnosis_has_its_pictures_and_they_are_small(hidden_spot: dict[str, Any]) -> None:
    found = hidden_spot["discrepancy"]
    assert found["verdict"] == "named"
    assert [one["cause"] for one in found["causes"]] == ["local_friction"]
    assert found["gain"]["held_out"] == "sine.csv"
    assert found["gain"]["rmse_after_m"] < 0.3 * found["gain"]["rmse_before_m"]
    drawn = found["pictures"]
    assert len(json.dumps(drawn)) < 60_000
    over_time = {name: np.array(values) for name, values in drawn["time"].items()}
    before_m = over_time["measured_m"] - over_time["before_m"]
    after_m = over_time["measured_m"] - over_time["after_m"]
    assert np.sqrt(np.mean(after_m**2)) < 0.3 * np.sqrt(np.mean(before_m**2))
    # both ways friction is higher about the spot, and the cause's part lies there
    for way, sense in (("opening", 1.0), ("closing", -1.0)):
        (curve,) = (one for one in drawn["coordinates"] if (one["coordinate"], one["direction"]) == ("travel", way))
        place = np.array(curve["x"])
        part_n = sense * np.array(curve["part_n"])
        near = np.abs(place - SPOT_M) < 0.004
        assert part_n[near].max() > np.median(part_n[~near]) + 80.0
        assert np.median(np.abs(np.array(curve["misfit_n"]) - np.array(curve["part_n"]))) < 5.0
    assert found["misfit"]["rms_after_m"] < 0.3 * found["misfit"]["rms_before_m"]


def test_the_loop_is_drawn_at_the_same_positions_for_both_ways(noisy: dict[str, Any]) -> None:
    drawn = noisy["signature"]["loop"]
    opening, closing = np.array(drawn["pressure_opening_pa"]), np.array(drawn["pressure_closing_pa"])
    assert len(drawn["position_m"]) == opening.size == closing.size == 200
    width_n = AREA_M2 * np.median(opening - closing) / 2.0
    assert width_n == pytest.approx(noisy["signature"]["friction_mean_n"], rel=0.01)


def test_a_fault_of_the_diagnosis_leaves_the_estimates(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_arguments: Any, **_named: Any) -> None:
        raise ZeroDivisionError("a fault")

    monkeypatch.setattr("service.analysis.diagnosis.diagnose", broken)
    monkeypatch.delitem(ESTIMATORS, "maximum_likelihood")
    analysis = analyze_recordings([triangle_test(0.002, noise_m=5.0e-6)], PLATE)
    assert values(analysis, "regression")["k"] is not None
    assert analysis["discrepancy"]["verdict"] == "not_assessed"
    assert "ZeroDivisionError: a fault" in analysis["discrepancy"]["message"]


@pytest.mark.parametrize("sequence", ["multi_rate", None])
def test_a_scattering_valve_is_told_the_test_that_separates_its_causes(
    monkeypatch: pytest.MonkeyPatch, sequence: str | None
) -> None:
    cause = Finding("spring_hardening", "It hardens.", "Look.", {})
    undecided: Any = object()
    found = RoughDiagnosis(Verdict.AMBIGUOUS, "", (cause,), ("friction_drift",), undecided=undecided)
    separating = None if sequence is None else SeparatingTest(sequence, {}, 60.0, ("one", "another"), 34.0)
    monkeypatch.setattr("service.analysis.diagnosis.diagnose", lambda *_, **__: found)
    monkeypatch.setattr("service.analysis.diagnosis.find_separating_test", lambda *_: separating)
    told = assess([triangle_test(0.002)], PLATE, [failed("maximum_likelihood", Outcome.NOT_EXPLAINED)])
    assert told["verdict"] == "ambiguous"
    assert told["separating_test"] == (None if separating is None else separating.to_json())
    assert ("No sequence" in told["message"]) == (sequence is None)


def test_several_recordings_are_diagnosed_side_by_side(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def assess(recordings: list[Recording], *_arguments: Any, **_named: Any) -> dict[str, Any]:
        asked.append(len(recordings))
        return not_assessed("of this test")

    monkeypatch.setattr("service.analysis.analysis.assess", assess)
    analyze_recordings([at_rest(), at_rest()], PLATE)
    assert asked == [2]


def test_a_recording_at_20_hz_claims_no_mass_that_is_not_there() -> None:
    analysis = analyze_recordings([triangle_test(0.05, noise_m=5.0e-6)], PLATE)
    for estimate in analysis["estimates"]:
        mass = estimate["parameters"]["m"]
        if mass["value"] is None:
            assert not mass["identifiable"]
            assert mass["note"]
        else:
            # what the slips leave between the samples may tell it, within its interval
            assert mass["ci95"][0] <= NOMINAL.parameters.mass_kg <= mass["ci95"][1]


def test_a_valve_that_never_moved_gives_reasons_and_no_number() -> None:
    analysis = analyze_recordings([at_rest()], PLATE, held_out=[("sine.csv", sine_test())])
    for estimate in analysis["estimates"]:
        assert estimate["status"] == "failed"
        assert "never moved" in estimate["message"]
        assert all(parameter["value"] is None for parameter in estimate["parameters"].values())
    figures = analysis["signature"]
    for name in CONTRACT_FIGURES:
        assert figures[name] is None
        assert "never moved" in figures["notes"][name]
    assert analysis["held_out"][0]["rmse_m"] == dict.fromkeys(("regression", "garcia", "maximum_likelihood"))


def test_one_sample_is_described_and_no_more() -> None:
    analysis = analyze_recordings([Recording(np.zeros(1), np.zeros(1), force_n=np.zeros(1))], PLATE)
    assert analysis["recording"]["sampling"] is None
    assert analysis["recording"]["sample_period_s"] is None
    assert analysis["recording"]["position_noise_m"] is None
    assert {estimate["status"] for estimate in analysis["estimates"]} == {"failed"}


def test_the_signature_is_measured_with_intervals(noisy: dict[str, Any]) -> None:
    figures, truth = noisy["signature"], NOMINAL.parameters
    speed = 82737.0 * AREA_M2 / 5.0 / truth.spring_rate_n_per_m
    friction_n = truth.coulomb_friction_n + truth.viscous_friction_n_s_per_m * speed
    assert figures["from"] == "measured on the recording"
    for name, true in (
        ("friction_mean_n", friction_n),
        ("friction_max_n", friction_n),
        ("spring_rate_n_per_m", truth.spring_rate_n_per_m),
    ):
        assert figures[name] == pytest.approx(true, rel=5.0e-4)
        low, high = figures["intervals"][name]["ci95"]
        assert low <= true <= high
    low_pa, high_pa = figures["bench_set_pa"]
    assert low_pa == pytest.approx(0.0, abs=20.0)
    assert high_pa == pytest.approx(truth.spring_rate_n_per_m * 0.1016 / AREA_M2, abs=20.0)
    assert figures["dead_band_percent"] == pytest.approx(58.8, abs=0.2)
    assert len(figures["curve"]["up"]["travel_m"]) + len(figures["curve"]["down"]["travel_m"]) <= 200
    assert figures["steps"] is None


@pytest.mark.usefixtures("classic_alone")
def test_a_sine_shows_no_branches_and_takes_the_figures_from_the_parameters() -> None:
    analysis = analyze_recordings([sine_test(0.005)], PLATE)
    figures = analysis["signature"]
    known = [one for one in analysis["estimates"] if one["parameters"]["k"]["value"] is not None]
    assert figures["friction_max_n"] is None
    assert "uniform" in figures["notes"]["friction_max_n"]
    if known:
        assert figures["intervals"]["spring_rate_n_per_m"]["from"].startswith("the parameters by")
        assert figures["spring_rate_n_per_m"] in [one["parameters"]["k"]["value"] for one in known]


@pytest.mark.usefixtures("classic_alone")
def test_a_step_test_has_its_times_and_no_friction() -> None:
    levels_pa = [82737.0 * share for share in (0.0, 0.5, 0.52, 0.6, 0.7, 0.3, 0.1)]
    figures = analyze_recordings([recorded(steps(levels_pa, 2.0), 0.002, 5.0e-6)], PLATE)["signature"]
    assert figures["friction_max_n"] is None
    assert "steps" in figures["notes"]["friction_max_n"]
    # what a method that fits the whole motion may have found is no figure of a loop
    assert figures["intervals"].get("friction_mean_n", {}).get("from") != "measured on the recording"
    assert figures["steps"]["summary"]["count"] == 6
    # 11.7 ms of F_v / k and 1 ms for the mass
    assert figures["steps"]["summary"]["t63_s"] == pytest.approx(0.0125, abs=0.002)


def test_the_held_out_recording_is_predicted_by_what_was_estimated(noisy: dict[str, Any], classic_alone: None) -> None:
    true = triangle_test(noise_m=5.0e-6)
    assert true.pressure_pa is not None
    wrong = replace(true, pressure_pa=1.2 * true.pressure_pa)
    misled = analyze_recordings([wrong], PLATE, held_out=[("sine.csv", sine_test())])
    tried = noisy["held_out"][0]
    assert tried["file"] == "sine.csv"
    for method in ("regression", "garcia"):
        rmse_m = tried["rmse_m"][method]
        assert rmse_m < 1.0e-3  # of 0.08 m; what is left is a slip that comes one sample early or late
        assert rmse_m < 0.2 * misled["held_out"][0]["rmse_m"][method]
        assert "DV" in tried["notes"][method]


@pytest.mark.usefixtures("classic_alone")
def test_a_held_out_recording_with_a_gap_in_its_input_gives_a_reason() -> None:
    holed = sine_test()
    assert holed.pressure_pa is not None
    pressure_pa = holed.pressure_pa.copy()
    pressure_pa[10] = np.nan
    holed = replace(holed, pressure_pa=pressure_pa)
    tried = analyze_recordings([triangle_test()], PLATE, held_out=[("holed.csv", holed)])["held_out"][0]
    assert tried["rmse_m"]["regression"] is None
    assert "is missing in 1 of 8001 samples" in tried["notes"]["regression"]


def test_progress_rises_from_0_to_1_and_names_what_goes_on() -> None:
    told: list[tuple[float, str]] = []
    analyze_recordings([at_rest()], PLATE, progress=lambda share, phase: told.append((share, phase)))
    shares = [share for share, _ in told]
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    assert any("estimating" in phase for _, phase in told)


@pytest.mark.usefixtures("classic_alone")
def test_several_recordings_are_analysed_as_one_with_a_gap_between() -> None:
    first, second = triangle_test(0.002), triangle_test(0.002)
    whole = joined([first, second])
    assert whole.samples == 2 * first.samples
    assert np.diff(whole.time_s).max() == pytest.approx(0.02)
    found = values(analyze_recordings([first, second], PLATE), "regression")
    assert found["k"] == pytest.approx(NOMINAL.parameters.spring_rate_n_per_m, rel=0.02)


def test_recordings_that_do_not_fit_together_are_refused() -> None:
    first = triangle_test(0.002)
    second = Recording(first.time_s, first.position_m, force_n=np.zeros(first.samples))
    with pytest.raises(RecordingError, match="recording 2 has the channels force_n, position_m and the first pressure"):
        joined([first, second])
    with pytest.raises(RecordingError, match="no recording"):
        joined([])


async def test_the_real_worker_analyses_a_stored_recording_as_this_process_does(tmp_path: Any) -> None:
    recording = triangle_test(0.002, noise_m=5.0e-6)
    write_parquet(recording, tmp_path / "a.parquet")
    write_csv(recording, tmp_path / "bad.csv")
    (tmp_path / "bad.csv").write_text((tmp_path / "bad.csv").read_text().replace("position_m", "position_mm"))
    shares: list[float] = []
    async with AnalysisProcess() as pool:
        with pytest.raises(RecordingError, match=r"bad\.csv: unknown column 'position_mm'"):
            await pool.analyze(tmp_path / "bad.csv", PLATE)
        analysis = await pool.analyze(tmp_path / "a.parquet", PLATE, lambda share, _phase: shares.append(share))
    here = json.loads(json.dumps(analyze_recordings([recording], PLATE)))
    # the worker keeps one thread of linear algebra: an iterated fit differs in its last digits
    for theirs, ours in zip(analysis.pop("estimates"), here.pop("estimates"), strict=True):
        assert (theirs["method"], theirs["status"]) == (ours["method"], ours["status"])
        for symbol, parameter in ours["parameters"].items():
            found = theirs["parameters"][symbol]["value"]
            assert (found is None) == (parameter["value"] is None), symbol
            assert found is None or found == pytest.approx(parameter["value"], rel=1.0e-6, abs=1.0e-6), symbol
    theirs, ours = analysis.pop("discrepancy"), here.pop("discrepancy")
    assert theirs["verdict"] == ours["verdict"] == "none"
    assert theirs["message"].code == "no_fault"
    assert theirs["message"] in analysis.pop(TABLE)
    assert theirs["misfit"]["rms_before_m"] == pytest.approx(ours["misfit"]["rms_before_m"], rel=1.0e-3)
    assert analysis == here
    assert shares[-1] == 1.0


def test_a_nameplate_without_an_area_gives_reasons() -> None:
    bare = Nameplate("FV-101", replace(PLATE.actuator, diaphragm_area_m2=None))
    for estimate in analyze_recordings([triangle_test(0.002)], bare)["estimates"]:
        assert estimate["status"] == "failed"
        assert "diaphragm" in estimate["message"]


def test_a_quiet_sensor_has_at_least_the_noise_of_its_resolution() -> None:
    step_m = 1.6e-6
    time_s = np.linspace(0.0, 4.0, 4001, dtype=np.float64)
    position_m = np.round(np.linspace(0.0, 1.0e-4, time_s.size) / step_m) * step_m
    summary = recording_summary(Recording(time_s, position_m, pressure_pa=time_s))
    assert summary["position_noise_m"] == pytest.approx(step_m / np.sqrt(12.0))
