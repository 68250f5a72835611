"""The recordings that a newcomer tries first say what the documentation says of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from service.analysis.analysis import analyze_recordings
from service.config.nameplates import read_nameplate
from service.own_files.reader import read_own
from service.shown.analysis_summary import verdict_lines

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "examples" / "recordings"
SAID = {
    "healthy": ("none", [], "Friction varies by 1.6 % along the travel"),
    "tight-spot": ("named", ["local_friction"], "Friction is 495 N (470 to 519) higher between 49.8 and 67.4 %"),
    "play": ("named", ["position_backlash"], "The position reading has 1.40 mm (1.25 to 1.56) of lost motion."),
    "not-told-apart": ("ambiguous", ["spring_hardening"], "22.1 % (20.4 to 23.8) over the travel"),
}


def test_every_recording_is_spoken_of() -> None:
    assert {file.stem for file in FOLDER.glob("*.csv")} == set(SAID)


@pytest.mark.parametrize(
    "name",
    [
        "healthy",
        "tight-spot",
        pytest.param("play", marks=pytest.mark.long),
        pytest.param("not-told-apart", marks=pytest.mark.long),
    ],
)
def test_a_recording_of_the_examples_says_what_the_documentation_says(name: str) -> None:
    verdict, causes, words = SAID[name]
    nameplate = read_nameplate(FOLDER / "valve.toml")
    analysis = analyze_recordings([read_own(FOLDER / f"{name}.csv", nameplate).recording], nameplate)
    found = analysis["discrepancy"]
    assert (found["verdict"], [one["cause"] for one in found["causes"]]) == (verdict, causes)
    assert words in " ".join(verdict_lines(analysis))
    told = " ".join((ROOT / "docs" / "diagnosing.md").read_text(encoding="utf-8").split())
    assert words in told
