"""Make examples/recordings and the pictures of docs/diagnosing.md: ``python -m docs.draw_verdicts``.

Four recordings of one valve with a usual packing, simulated, polled every 20 ms: one healthy, one with a tight spot,
one with a play in the linkage of its sensor, one whose spring hardens, which nobody can tell from a bowed reading.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from service.analysis.analysis import analyze_recordings
from service.config.nameplates import read_nameplate
from service.figures.canvas import svg_text
from service.figures.friction import friction_picture
from service.figures.misfit import coordinate_picture
from service.own_files.reader import read_own
from service.shown.analysis_summary import verdict_lines
from service.words.reader import Reader
from tests.support.rough_valves import VALVES, case
from valve.effects.base import Effect
from valve.effects.local_friction import LocalFriction
from valve.effects.position_backlash import PositionBacklash
from valve.effects.spring_hardening import SpringHardening

RECORDINGS: Final = Path(__file__).parents[1] / "examples" / "recordings"
PICTURES: Final = Path(__file__).parent / "pictures"
_VALVE: Final = "large"
_PERIOD_S: Final = 0.02
_PSI: Final = 6894.757
_TRAVEL_M: Final = VALVES[_VALVE][1].actuator.travel_m
_HARDENING: Final = 0.25 * VALVES[_VALVE][0].spring_rate_n_per_m / _TRAVEL_M
# By the file's name: the sequence, what is hidden, and the draw of the packing.
HIDDEN: Final[Mapping[str, tuple[str, tuple[Effect, ...], int]]] = {
    "healthy": ("triangle", (), 5),
    "tight-spot": ("triangle", (LocalFriction(500.0, 0.035, 0.004),), 6),
    "play": ("diagnostic", (PositionBacklash(0.023 * _TRAVEL_M),), 7),
    "not-told-apart": ("triangle", (SpringHardening(_HARDENING),), 8),
}


def make(name: str) -> None:
    """Write one recording as a plant has it: percent of travel and psi, as many digits as the instruments carry."""
    sequence, effects, seed = HIDDEN[name]
    recording = case(_VALVE, sequence, "usual", _PERIOD_S, seed, effects=effects).recording
    assert recording.pressure_pa is not None
    columns = np.column_stack(
        [recording.time_s, 100.0 * recording.position_m / _TRAVEL_M, recording.pressure_pa / _PSI]
    )
    with (RECORDINGS / f"{name}.csv").open("w", encoding="utf-8", newline="") as file:
        written = csv.writer(file, lineterminator="\n")
        written.writerow(["Time [s]", "Travel [%]", "Pressure [psi]"])
        written.writerows([f"{time:.2f}", f"{travel:.3f}", f"{psi:.4f}"] for time, travel, psi in columns)


def analysis_of(name: str) -> dict[str, Any]:
    """Return the analysis of one recording as anybody would make it, from its file."""
    nameplate = read_nameplate(RECORDINGS / "valve.toml")
    return analyze_recordings([read_own(RECORDINGS / f"{name}.csv", nameplate).recording], nameplate)


def draw(name: str, analysis: Mapping[str, Any]) -> None:
    """Draw friction along the travel where nothing was found, else the misfit and what the cause makes of it."""
    found = analysis["discrepancy"]
    if found["causes"]:
        picture = coordinate_picture(found["pictures"], Reader())
    else:
        picture = friction_picture(found["latent_friction"], Reader())
    assert picture is not None
    (PICTURES / f"{name}.svg").write_text(svg_text(picture, text_as_paths=True), encoding="utf-8")


if __name__ == "__main__":
    for recorded in HIDDEN:
        make(recorded)
        result = analysis_of(recorded)
        draw(recorded, result)
        sys.stdout.write("\n".join([f"{recorded}:", *verdict_lines(result), ""]))
