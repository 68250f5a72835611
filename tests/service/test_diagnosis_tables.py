"""The diagnosis in words: what a newcomer reads of each verdict."""

from __future__ import annotations

import io
from typing import Any

from rich.console import Console

from service.cli.diagnosis_tables import diagnosis_lines, print_diagnosis

FOUND: dict[str, Any] = {
    "verdict": "ambiguous",
    "message": "",
    "causes": [
        {
            "cause": "local_friction",
            "sentence": "Friction is 210 N higher between 61 and 66 % travel.",
            "action": "Look at the stem there.",
            "parameters": {"rise_n": {"value": 210.0, "ci95": [160.0, 260.0], "unit": "N"}},
            "share_of_misfit": 0.9,
        }
    ],
    "not_told_apart_from": ["presliding"],
    "separating_test": {"sentence": "run the sequence diagnostic (138 s)."},
    "gain": {"held_out": "sine.csv", "rmse_before_m": 3.0e-3, "rmse_after_m": 2.5e-5, "noise_floor_m": 2.0e-5},
    "misfit": {"where": "travel opening explains 60 % of it.", "rms_before_m": 1.0, "rms_after_m": 1.0, "noise_m": 1.0},
    "extended_model": {"parameters": {"F_c": {"value": 1423.4, "ci95": [1420.0, 1426.0], "unit": "N"}}},
}


def test_a_named_cause_is_told_with_what_to_do_what_it_gains_and_what_else_it_could_be() -> None:
    out = io.StringIO()
    print_diagnosis(Console(file=out, width=160), FOUND)
    text = out.getvalue()
    for words in (
        "several causes would explain it",
        "local friction: Friction is 210 N higher between 61 and 66 % travel. What to do: Look at the stem there.",
        "Instead of local friction it could as well be: presliding.",
        "Gain on sine.csv: the simulation misses by 25 um rms with it in the model, by 3 mm without, 100 % of what",
        "To tell them apart: run the sequence diagnostic (138 s).",
        "160 to 260",
        "F_c [N]",
        "1420.0 to 1426.0",
    ):
        assert words in text, words


def test_an_interval_narrower_than_the_instrument_is_not_told_by_its_ends() -> None:
    narrow = {"value": 1423.4, "ci95": [1423.3999, 1423.4001], "unit": "N"}
    cause = {**FOUND["causes"][0], "parameters": {"rise_n": narrow}}
    out = io.StringIO()
    valve = {"parameters": {"F_c": narrow}}
    print_diagnosis(Console(file=out, width=160), {**FOUND, "causes": [cause], "extended_model": valve})
    assert out.getvalue().count("within 0.1 %") == 2
    assert "1423.4" not in out.getvalue()


def test_what_was_held_is_not_told_as_found() -> None:
    held = {"value": 1.0, "ci95": [1.0, 1.0], "unit": "1"}
    cause = {**FOUND["causes"][0], "parameters": {**FOUND["causes"][0]["parameters"], "static_share": held}}
    out = io.StringIO()
    print_diagnosis(Console(file=out, width=160), {**FOUND, "causes": [cause]})
    assert "rise_n" in out.getvalue()
    assert "static_share" not in out.getvalue()


def test_a_healthy_valve_is_one_sentence() -> None:
    lines = diagnosis_lines({**FOUND, "verdict": "none", "causes": [], "not_told_apart_from": [], "gain": None})
    assert lines[0] == "Diagnosis: no fault found."


def test_the_gain_of_a_force_is_told_in_newtons_and_percent() -> None:
    gain = {
        "held_out": "pulses.csv",
        "rmse_before_m": None,
        "rmse_after_m": None,
        "noise_floor_m": None,
        "rmse_before_n": 12.0,
        "rmse_after_n": 10.0,
        "error_before_percent": 5.4,
        "error_after_percent": 4.7,
    }
    (line,) = (one for one in diagnosis_lines({**FOUND, "gain": gain}) if one.startswith("Gain"))
    assert "10 N rms (4.7 %)" in line
    assert "12 N (5.4 %) without" in line
