"""Romano & Garcia (2007) again: their Tables 2 to 4 and Figures 1 to 5, ours beside the printed values."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.console import Console
from rich.text import Text

from estimators.base import Estimate, Form
from estimators.classic.garcia import GarciaEstimator
from estimators.classic.regression import RegressionEstimator
from service.paper.figures import Validation, draw_figures, paper_sweep
from service.paper.tables import PaperRow, PaperTable, rendered, rendered_validation
from valve.motion import simulate_waveform
from valve.nameplate import Nameplate
from valve.parameter_sets import parameter_set
from valve.parameters import PARAMETER_SYMBOLS, ValveParameters, parameters_from_symbols
from valve.recording import Acquisition, Provenance, Recording
from valve.waveform import Waveform, sine, triangle

VALVES: Final = ("vendor", "nominal", "rough")
SAMPLE_PERIOD_S: Final = 1.0e-3  # section 4
TEST: Final = triangle(20.0, 3, 0.0, 82737.0)  # Figure 1; |v|max of the printed DV fits a period of 20 s
# The printed k of method 1 is 1.144 % low in each table: its force was 0.98856 of S_a P, as with 0.06378 m2.
METHOD_1_FORCE_SCALE: Final = 0.98856
METHOD_1_THRESHOLD: Final = 1200  # S itself: the threshold at which ours meets the printed values
# Section 4: sine of 8 s from 0 Pa; the rough valve needs the larger one to move at all.
VALIDATION_PA: Final = {"vendor": 70050.0, "nominal": 70050.0, "rough": 82665.0}
VALIDATION_PERIOD_S: Final = 8.0
VALIDATION_CYCLES: Final = 2.0

# Tables 2, 3 and 4 as printed: values by method 1 and method 2.
PRINTED: Final[dict[str, dict[str, dict[str, float]]]] = {
    "vendor": {
        "regression": {"m": 1.3972, "k": 51937.0, "DV": 1.016e-4, "F_v": 589.0, "F_c": 44.39, "F_s": 44.39},
        "garcia": {"m": 1.5038, "k": 52544.0, "F_v": 623.0, "F_c": 44.04, "F_s": 44.04},
    },
    "nominal": {
        "regression": {"m": 1.068, "k": 51937.0, "DV": 2.54e-2, "F_v": 555.9, "F_c": 1408.4, "F_s": 1684.7},
        "garcia": {"m": 1.0575, "k": 52542.0, "F_v": 565.5, "F_c": 1424.5, "F_s": 1708.2},
    },
    "rough": {
        "regression": {"m": 0.832, "k": 51937.0, "DV": 9.58e-3, "F_v": 1163.7, "F_c": 2199.9, "F_s": 2636.9},
        "garcia": {"m": 0.9528, "k": 52538.0, "F_v": 1176.1, "F_c": 2225.2, "F_s": 2668.5},
    },
}

NOTES: Final = (
    (
        f"Method 1 is computed as the paper must have: force times {METHOD_1_FORCE_SCALE} (its k is 1.144 % low in "
        f"every table, as if S_a were 0.06378 m2) and threshold s = {METHOD_1_THRESHOLD}. With these m, F_v and k of "
        "the nominal and the rough valve meet the printed values within 0.1 percentage points."
    ),
    (
        "Not reproduced: the vendor valve's m and F_v by method 1. It does not slip, so that they hang on the few "
        "samples at the corners of the pressure, where backward differences do not fit the model at all."
    ),
    (
        "Not reproduced: DV. Eq. (8) finds where backward differences begin to hold, not where the stem comes to "
        "rest: the printed values are s |v|max / 1500 with s = 15, 106 and 46. F_s and F_c by method 1 differ by the "
        "instant that is taken for the breakaway."
    ),
    (
        "Not reproduced: m and F_v by method 2 to the digit; which three points of a slip were taken is not said. "
        "Ours are biased by backward differences and by nothing else, whichever three are taken."
    ),
    (
        "Printed errors that do not fit the printed values: DV in Table 3 1656.7 % (16567 %) and in Table 4 61.86 % "
        "(6186 %); in Table 4 also method 1's F_s 1.83 % (1.20 %), method 2's F_c 0.0495 % (0.71 %) and F_s 0.65 % "
        "(0.015 %). Here errors are computed from the printed values."
    ),
    (
        "The last column is the error of the corrected form, which takes the differences' bias out: the same data, "
        "no noise, the true diaphragm area; a dash where it says that the data do not give the parameter."
    ),
)


@dataclass(frozen=True, slots=True)
class PaperReproduction:
    """The paper's tables and figures, ours beside the printed values.

    ``largest_errors_m`` is, by valve and source, the largest position error in the validation of Figures 3 to 5.
    """

    tables: tuple[PaperTable, ...]
    figures: tuple[Path, ...]
    largest_errors_m: dict[str, dict[str, float]]

    def to_json(self) -> dict[str, Any]:
        """Return tables and figures as in the contract, with the notes and the validation's largest errors."""
        return {
            "tables": [table.to_json() for table in self.tables],
            "figures": [str(path) for path in self.figures],
            "validation_largest_error_m": self.largest_errors_m,
            "notes": list(NOTES),
        }

    def render(self, console: Console) -> None:
        """Print the tables, the validation and what does not reproduce."""
        for table in self.tables:
            console.print(rendered(table))
        console.print(rendered_validation(self.largest_errors_m))
        for note in NOTES:
            console.print(Text(note))
        for path in self.figures:
            console.print(Text(f"written: {path}"))


def reproduce_paper(out_dir: Path | None = None) -> PaperReproduction:
    """Compute Tables 2 to 4 and, where ``out_dir`` is given, draw Figures 1 to 5 there as PNG and SVG."""
    tables, validations, largest = [], [], {}
    for number, valve in enumerate(VALVES, 2):
        published, corrected = _estimates(valve)
        tables.append(_table(number, valve, published, corrected))
        validations.append(_validation(valve, published))
        largest[valve] = validations[-1].largest_errors_m()
    figures: tuple[Path, ...] = ()
    if out_dir is not None:
        vendor = paper_recording("vendor")
        sweep = paper_sweep(vendor, _method_1_nameplate("vendor"), _method_1())
        figures = draw_figures(out_dir, TEST, sweep, tuple(validations))
    return PaperReproduction(tuple(tables), figures, largest)


def paper_recording(valve: str) -> Recording:
    """The recording that the paper estimates from: its triangular wave on the exact motion, sampled at 1 ms."""
    chosen = parameter_set(valve)
    area_m2 = chosen.nameplate.actuator.diaphragm_area_m2
    assert area_m2 is not None
    motion = simulate_waveform(chosen.parameters, TEST, area_m2, SAMPLE_PERIOD_S)
    return Recording(
        time_s=motion.time_s,
        position_m=motion.position_m,
        pressure_pa=TEST.at(motion.time_s),
        provenance=Provenance(Acquisition.SIMULATED, tag=chosen.nameplate.tag, sequence=TEST.name),
    )


def _method_1() -> RegressionEstimator:
    return RegressionEstimator(form=Form.PUBLISHED, threshold=METHOD_1_THRESHOLD)


def _method_1_nameplate(valve: str) -> Nameplate:
    """The nameplate with the diaphragm area that the printed k of method 1 belongs to."""
    nameplate = parameter_set(valve).nameplate
    area_m2 = nameplate.actuator.diaphragm_area_m2
    assert area_m2 is not None
    return replace(nameplate, actuator=replace(nameplate.actuator, diaphragm_area_m2=METHOD_1_FORCE_SCALE * area_m2))


def _estimates(valve: str) -> tuple[dict[str, Estimate], dict[str, Estimate]]:
    """Both methods as published (method 1 with the paper's scale) and corrected."""
    recording, nameplate = paper_recording(valve), parameter_set(valve).nameplate
    published = {
        "regression": _method_1().estimate(recording, _method_1_nameplate(valve)),
        "garcia": GarciaEstimator(form=Form.PUBLISHED).estimate(recording, nameplate),
    }
    corrected = {
        "regression": RegressionEstimator().estimate(recording, nameplate),
        "garcia": GarciaEstimator().estimate(recording, nameplate),
    }
    return published, corrected


def _published_values(estimate: Estimate) -> dict[str, float]:
    """Values as the method computes them, before any judgement; DV by Eq. (8)."""
    values: dict[str, float] = dict(estimate.diagnostics["raw"])
    found = estimate.diagnostics.get("eq8_limit_velocity_m_per_s")
    if found is not None:
        values["DV"] = found
    return values


def _table(number: int, valve: str, published: dict[str, Estimate], corrected: dict[str, Estimate]) -> PaperTable:
    truth = parameter_set(valve).parameters.by_symbol()
    rows = []
    for method, estimate in published.items():
        ours, printed = _published_values(estimate), PRINTED[valve][method]
        rows += [
            PaperRow(
                parameter=symbol,
                method=method,
                truth=truth[symbol],
                printed=printed.get(symbol),
                ours=ours.get(symbol),
                corrected=corrected[method].value(symbol),
            )
            for symbol in ("m", "k", "DV", "F_v", "F_c", "F_s")
            if symbol in printed
        ]
    return PaperTable(number, valve, tuple(rows))


def _validation(valve: str, published: dict[str, Estimate]) -> Validation:
    """Figures 3 to 5: the true valve and those of the methods under a sine that the estimates have not seen."""
    chosen = parameter_set(valve)
    area_m2 = chosen.nameplate.actuator.diaphragm_area_m2
    assert area_m2 is not None
    wave = sine(VALIDATION_PERIOD_S, VALIDATION_CYCLES, 0.0, VALIDATION_PA[valve])
    time_s, truth_m = _followed(chosen.parameters, wave, area_m2)
    positions = {}
    for method, estimate in published.items():
        sources = {"ours": _published_values(estimate), "printed": PRINTED[valve][method]}
        for source, values in sources.items():
            model = _completed(values, chosen.parameters)
            positions[f"{method}, {source}"] = _followed(model, wave, area_m2)[1]
    return Validation(valve, time_s, wave.at(time_s), truth_m, positions)


def _completed(values: dict[str, float], truth: ValveParameters) -> ValveParameters:
    """A valve of these values, with the true DV where a method has none; F_s is raised to F_c where they cross."""
    complete = {symbol: values.get(symbol, truth.by_symbol()[symbol]) for symbol in PARAMETER_SYMBOLS}
    complete["F_s"] = max(complete["F_s"], complete["F_c"])
    return parameters_from_symbols(complete)


def _followed(parameters: ValveParameters, wave: Waveform, area_m2: float) -> tuple[np.ndarray, np.ndarray]:
    motion = simulate_waveform(parameters, wave, area_m2, SAMPLE_PERIOD_S)
    return motion.time_s, motion.position_m
