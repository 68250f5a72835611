"""``python -m tests.bench.judge KIND COUNT``: make cases, have them diagnosed, and grade the answers."""

from __future__ import annotations

import argparse
import csv
import json
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from service.analysis.analysis import analyze_recordings
from service.config.nameplates import read_nameplate
from tests.bench.judge import judging
from tests.bench.judge.cases import KINDS, Case, case
from valve.errors import ValveError
from valve.recording import Recording

# Weaker ones are made and not judged; a play is judged by its size.
_WEAK: Final = {"hidden": 3.0, "perfect": 3.0, "odd": 3.0, "pairs": 10.0}


def diagnosed(made: Case) -> tuple[dict[str, Any], float]:
    """Return the analysis of a case, and its seconds of processor time."""
    with tempfile.TemporaryDirectory() as folder:
        plate = Path(folder) / "valve.toml"
        plate.write_text(made.nameplate, encoding="utf-8")
        nameplate = read_nameplate(plate)
    held_out = [] if made.held_out is None else [("held-out.csv", made.held_out)]
    begin_s = time.process_time()  # of one core, whatever else runs
    analysis = analyze_recordings([made.recording], nameplate, held_out=held_out)
    return analysis, time.process_time() - begin_s


def line_of(made: Case, analysis: Mapping[str, Any], seconds: float) -> dict[str, Any]:
    """Return what is kept of a case: one line of the results."""
    found = analysis["discrepancy"]
    causes = [one["cause"] for one in found["causes"]]
    line: dict[str, Any] = {
        **made.facts,
        "verdict": found["verdict"],
        "names": causes,
        "rivals": list(found["not_told_apart_from"]),
        "grade": judging.grade(
            found["verdict"], causes, found["not_told_apart_from"], made.facts["truth"], made.facts["beside"]
        ),
        "effect": [one.get("effect_percent_of_span") for one in found["causes"]],
        "values": [
            {name: (entry["value"], entry["ci95"]) for name, entry in one["parameters"].items()}
            for one in found["causes"]
        ],
        "message": found.get("message", ""),
        "remarks": [one["cause"] for one in found.get("remarks", [])],
        "seconds": round(seconds, 2),
    }
    gain = found.get("gain")
    if gain and made.true_rmse_m is not None:
        with_map = gain.get("with_map") or {}
        told = bool(causes) and found["verdict"] in {"named", "likely"}
        share = judging.share_of_gain(gain["rmse_before_m"], gain["rmse_after_m"], made.true_rmse_m) if told else None
        line["gain"] = {
            "before_m": gain["rmse_before_m"],
            "after_m": gain["rmse_after_m"],
            "true_m": made.true_rmse_m,
            "share": share,
            "inside": with_map.get("inside_band_after"),
        }
    likely = next(one for one in analysis["estimates"] if one["method"] == "maximum_likelihood")
    line["status"] = likely["status"]
    if made.truth is not None:
        line["estimates"] = judging.judged_estimate(likely["parameters"], made.truth, likely["status"])
    return line


def write_case(made: Case, folder: Path) -> None:
    """Write a case as files that ``breakaway analyze`` reads."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "valve.toml").write_text(made.nameplate, encoding="utf-8")
    _write_csv(made.recording, folder / "test.csv")
    if made.held_out is not None:
        _write_csv(made.held_out, folder / "held-out.csv")


def _write_csv(recording: Recording, path: Path) -> None:
    columns = {
        name: getattr(recording, name)
        for name in ("time_s", "command_pa", "pressure_pa", "position_m")
        if getattr(recording, name) is not None
    }
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows([f"{value:.9g}" for value in row] for row in np.stack(list(columns.values()), axis=1))


def main() -> None:
    """Run the cases that are asked for, print each, and the table of all results at the end."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.judge", description=__doc__)
    parser.add_argument("kind", choices=[*KINDS, "table"])
    parser.add_argument("count", type=int, nargs="?", default=0)
    parser.add_argument("--first", type=int, default=1, metavar="SEED")
    parser.add_argument("--results", type=Path, default=Path("build/judge.jsonl"), metavar="FILE")
    parser.add_argument("--only", default="", metavar="CAUSE", help="hide this one in every case")
    parser.add_argument("--write", type=Path, metavar="FOLDER", help="write each case's files there, do not diagnose")
    parser.add_argument("--until", type=float, default=np.inf, metavar="SECONDS", help="begin no case after that")
    chosen = parser.parse_args()
    chosen.results.parent.mkdir(parents=True, exist_ok=True)
    begin_s = time.perf_counter()
    for seed in range(chosen.first, chosen.first + chosen.count):
        if time.perf_counter() - begin_s > chosen.until:
            break
        made = case(chosen.kind, seed, chosen.only)
        facts = made.facts
        if chosen.write is not None:
            write_case(made, chosen.write / f"{chosen.kind}-{seed}")
            print(json.dumps(facts), flush=True)
            continue
        if min(facts["strength"], default=np.inf) < _WEAK.get(chosen.kind, 0.0):
            line = {**facts, "grade": "weak", "verdict": "", "names": [], "seconds": 0.0}
        else:
            try:
                line = line_of(made, *diagnosed(made))
            except ValveError as error:
                line = {
                    **facts,
                    "grade": "failed",
                    "verdict": "failed",
                    "names": [],
                    "message": str(error),
                    "seconds": 0,
                }
        with chosen.results.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
        strengths = "/".join(f"{one:.1f}" for one in facts["strength"])
        truth = "+".join(facts["truth"]) or "healthy"
        print(
            f"{chosen.kind} {seed} {facts['valve']} {facts['packing']} {facts['sequence']} {facts['period_s']:g} "
            f"{truth} x{strengths}: {line['grade']} ({line['verdict']} {line['names']}) {line['seconds']} s",
            flush=True,
        )
    if chosen.write is None:
        kept = [json.loads(text) for text in chosen.results.read_text(encoding="utf-8").splitlines()]
        print(judging.table([one for one in kept if one["grade"] != "weak"]))


if __name__ == "__main__":
    main()
