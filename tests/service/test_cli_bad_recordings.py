"""Bad recordings through ``breakaway analyze``: each is told in a sentence, and no cause is named."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.service.command_line import Called, called
from tests.support.nominal_recordings import NAMEPLATE_TOML, at_rest, recorded, triangle_test
from valve.recording import Recording
from valve.recording_files import write_csv
from valve.waveform import Waveform


def one_way() -> Recording:
    return recorded(Waveform("up", np.array([0.0, 10.0]), np.array([0.0, 82737.0])), 0.01, 2.0e-6)


def good() -> Recording:
    return triangle_test(0.01, noise_m=2.0e-6)


NOT_ASSESSED = {
    "rest": (at_rest(), "never moved"),
    "one_way": (one_way(), "in one direction only"),
    "saturated": (replace(good(), position_m=np.minimum(good().position_m, 0.01)), "position reads exactly"),
    "wrong_area": (replace(good(), force_n=np.asarray(good().pressure_pa) * 0.03), "the misfit is a scale"),
}


def analyzed(folder: Path, recording: Recording) -> Called:
    write_csv(recording, folder / "r.csv")
    (folder / "fv.toml").write_text(NAMEPLATE_TOML)
    return called("analyze", "r.csv", "--nameplate", "fv.toml", "--json", "r.json", folder=folder)


@pytest.mark.parametrize("name", NOT_ASSESSED)
def test_what_cannot_be_assessed_is_told_with_its_reason(name: str, tmp_path: Path) -> None:
    recording, words = NOT_ASSESSED[name]
    done = analyzed(tmp_path, recording)
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "r.json").read_text())["discrepancy"]
    assert found["verdict"] == "not_assessed"
    assert words in found["message"]
    assert words in " ".join(done.stdout.split())


@pytest.mark.parametrize(
    ("recording", "words"),
    [
        (replace(good(), pressure_pa=np.asarray(good().pressure_pa) / 6894.757), "psi"),
        (replace(good(), pressure_pa=np.asarray(good().pressure_pa) / 1.0e5), "bar"),
        (replace(good(), position_m=np.asarray(good().pressure_pa), pressure_pa=good().position_m), "swapped"),
        (replace(good(), time_s=good().time_s * 1.0e3), "milliseconds"),
    ],
)
def test_a_wrong_unit_or_swapped_channels_are_refused_when_the_file_is_read(
    recording: Recording, words: str, tmp_path: Path
) -> None:
    done = analyzed(tmp_path, recording)
    assert done.returncode == 1
    assert words in done.stderr
    assert "Traceback" not in done.stderr
