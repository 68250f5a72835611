"""The signature and the step test on a terminal: units that people read, and each reason once."""

from __future__ import annotations

import math
from io import StringIO
from typing import Any

import pytest
from rich.console import Console

from estimators.signature.measure import measure_signature
from estimators.steps.response import step_figures
from service.cli.signature_tables import print_signature
from service.words.plain_numbers import plus_minus
from tests.support.nominal_recordings import NOMINAL, at_rest, recorded, triangle_test
from valve.recording import Recording
from valve.waveform import steps

PLATE = NOMINAL.nameplate


def printed(recording: Recording) -> str:
    signature: dict[str, Any] = measure_signature(recording, PLATE).to_json()
    signature["steps"] = step_figures(recording, PLATE)
    console = Console(width=100, record=True, file=StringIO())
    print_signature(console, signature)
    return console.export_text()


@pytest.mark.parametrize(
    ("value", "half_width", "text"),
    [
        (1429.6228, 0.0143, "1430"),
        (52539.35, 153.0, "52540 ± 150"),
        (0.0123456, 0.0009, "0.01235 ± 0.00090"),
        (-0.03, 2.0, "0.0 ± 2.0"),
        (58.746, None, "58.7"),
        (0.0, None, "0"),
        (50.7091, 0.0042, "50.7"),
        (50.7091, 1.24, "50.7 ± 1.2"),
        (509.58, 0.72, "509.6 ± 0.7"),
        (1423.4, None, "1423"),
        (math.inf, None, "inf"),
        (math.nan, 1.0, "nan"),
        (1.0, math.inf, "1.000"),
        (3.0, 0.0, "3.00"),
    ],
)
def test_a_number_shows_as_many_digits_as_are_known(value: float, half_width: float | None, text: str) -> None:
    assert plus_minus(value, half_width) == text


def test_the_figures_stand_in_newtons_kilopascals_and_percent() -> None:
    out = printed(triangle_test(0.002, noise_m=5.0e-6))
    friction = next(line for line in out.splitlines() if "friction, mean" in line)
    assert " N " in friction
    assert "±" not in friction, "its interval is narrower than any instrument"
    assert "26.9 " in friction
    for words in ("N/mm", "kPa", "mid-line at 0 and 100 % travel", "100 % is 82.74 kPa", "mm of travel", "2 cycles"):
        assert words in " ".join(out.split())
    assert "…" not in out
    assert "hysteresis: less than the dead band, and no contradiction" in " ".join(out.split())
    rough = printed(triangle_test(0.002, noise_m=5.0e-4))
    assert "±" in next(line for line in rough.splitlines() if "friction, mean" in line)


def test_a_step_test_says_what_was_resolved() -> None:
    levels_pa = [82737.0 * share / 100.0 for share in (0.0, 45.0, 50.0, 51.0, 54.0, 60.0, 30.0, 0.0)]
    out = printed(recorded(steps(levels_pa, 2.0), 0.01, 5.0e-6))
    assert "of which moved nothing" in out
    assert "Resolution: between 4.99 and 6 % of span" in out
    assert "T63" in out
    assert "Signature (" not in out  # no table without a figure
    assert "…" not in out
    rough = printed(triangle_test(0.002, noise_m=5.0e-4))
    assert "±" in next(line for line in rough.splitlines() if "friction, mean" in line)


@pytest.mark.parametrize(
    ("origin", "sentence"),
    [
        ("measured on the recording", "Signature measured on the recording"),
        ("the parameters by regression", "Signature taken from the parameters by regression"),
        (
            "measured on the recording; the parameters by maximum likelihood",
            "Signature measured on the recording and taken from the parameters by maximum likelihood",
        ),
    ],
)
def test_where_the_signature_comes_from_is_a_sentence(origin: str, sentence: str) -> None:
    signature = measure_signature(triangle_test(0.002, noise_m=5.0e-6), PLATE).to_json() | {"from": origin}
    console = Console(width=200, record=True, file=StringIO())
    print_signature(console, signature)
    assert sentence in console.export_text()


def test_a_valve_that_never_moved_has_one_reason_and_no_table() -> None:
    out = printed(at_rest())
    assert "Signature (" not in out
    assert out.count("Signature: The stem never moved") == 1
