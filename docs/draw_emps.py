"""Draw the picture of docs/diagnosis.md from the EMPS records: ``python -m docs.draw_emps FOLDER``.

FOLDER holds DATA_EMPS.mat and DATA_EMPS_PULSES.mat of the benchmark (www.nonlinearbenchmark.org); none of it is kept.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from scipy.io import loadmat

from discrepancy.force_diagnosis import diagnose_forces
from discrepancy.force_result import ForceDiagnosis
from valve.nameplate import Action, Actuator, Nameplate
from valve.recording import Recording

PICTURE = Path(__file__).parent / "pictures" / "emps.svg"
_COLOURS = {"opening": "#1f5fa8", "closing": "#b3402a"}


def recording_of(file: Path) -> Recording:
    """Return the benchmark's record as a force recording; the force is gtau times the controller's output, in V."""
    data = {
        name: np.asarray(values, dtype=np.float64).ravel() for name, values in loadmat(file).items() if name[0] != "_"
    }
    return Recording(time_s=data["t"], position_m=data["qm"], force_n=data["gtau"][0] * data["vir"])


def diagnosed(folder: Path) -> ForceDiagnosis:
    """Return the diagnosis of the estimation record, its gain measured on the record with pulses."""
    drive = Nameplate("EMPS", Actuator(travel_m=0.25, action=Action.DOUBLE))
    pulses = recording_of(folder / "DATA_EMPS_PULSES.mat")
    return diagnose_forces([recording_of(folder / "DATA_EMPS.mat")], drive, held_out=[("pulses", pulses)])


def draw(found: ForceDiagnosis, file: Path) -> None:
    """Draw the misfit along speed for both directions, the cause's part in it, and the misfit along travel."""
    assert found.pictures is not None
    with mpl.rc_context({"svg.fonttype": "path", "svg.hashsalt": "emps", "font.size": 9}):
        figure = Figure(figsize=(7.2, 2.9), layout="constrained")
        speed, travel = figure.subplots(1, 2, sharey=True)
        for place, name, factor in ((speed, "speed", 1.0e3), (travel, "travel", 1.0e3)):
            for curve in found.pictures["coordinates"]:
                if curve["coordinate"] == name:
                    _curve(place, curve, factor)
            place.axhline(0.0, color="#888888", linewidth=0.6)
            place.set_xlabel("speed, mm/s" if name == "speed" else "position, mm")
            place.spines[["top", "right"]].set_visible(False)
        speed.set_ylabel("measured minus simulated force, N")
        speed.legend(frameon=False, fontsize=8)
        figure.savefig(file, metadata={"Date": None})


def _curve(place: Any, curve: dict[str, Any], factor: float) -> None:
    colour, at = _COLOURS[curve["direction"]], factor * np.array(curve["x"])
    place.plot(at, curve["misfit_n"], "o", color=colour, markersize=2.5, label=f"{curve['direction']}, missed")
    place.plot(at, curve["part_n"], "-", color=colour, linewidth=1.2, label=f"{curve['direction']}, friction_asymmetry")


if __name__ == "__main__":
    answer = diagnosed(Path(sys.argv[1]))
    draw(answer, PICTURE)
    for finding in answer.causes:
        sys.stdout.write(f"{finding.cause}: {finding.sentence}\n")
    for gain in answer.gains:
        sys.stdout.write(f"{gain.to_json()}\n")
