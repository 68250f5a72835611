"""Which test would tell causes apart beside a packing's variation: the first is simulated, and all are asked for it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from discrepancy.rough.accepted import Accepted
from discrepancy.rough.causes.base import Cause, Shape
from discrepancy.rough.causes.seen import View
from discrepancy.rough.evidence import SYMBOLS, Solved, problem_of, solved
from discrepancy.rough.observations import Observations, observations
from discrepancy.rough.selection import LIKELY, Candidate, column_of
from discrepancy.rough.setting import Setting, setting_of
from estimators.base import Outcome
from estimators.engine.lateness import lag_after_corners
from estimators.engine.parameters import Known
from estimators.engine.reading import Reading, read
from valve.errors import ValveError
from valve.extended_motion import ExtendedStem
from valve.extended_state import ExtendedState
from valve.extended_valve import ExtendedValve
from valve.messages import Message, say
from valve.recording import Recording
from valve.stem import StemState
from valve.waveform import Waveform

FloatArray = npt.NDArray[np.float64]

ENOUGH: Final = LIKELY  # nats
_ROW_S: Final = 5.0e-3  # a planned test is simulated in rows as long as this at least
_SAME: Final = 0.03  # of the force's range: root mean square by which a repeated test differs
_SAME_LENGTH: Final = 0.05  # of the test
_FEWEST_BLOCKS: Final = 6
_SEED: Final = 1


@dataclass(frozen=True, slots=True)
class Planned:
    """A sequence that the valve's limits allow, with the overrides that make this waveform."""

    name: str
    overrides: Mapping[str, Any]
    waveform: Waveform


@dataclass(frozen=True, slots=True)
class SeparatingTest:
    """The test to run: ``discrimination`` is by how many nats the first cause is expected to win at least."""

    sequence: str
    overrides: Mapping[str, Any]
    duration_s: float
    separates: tuple[str, ...]
    discrimination: float

    @property
    def sentence(self) -> Message:
        """What to do, for a person."""
        one, *others = (name.replace("_", " ") for name in self.separates)
        return say(
            "run_separating_test",
            "run the sequence {sequence} ({duration:.0f} s): if it is {cause}, evidence against {others: and } of "
            "{nats:.0f} nats is expected, and {enough:.0f} tell them apart.",
            sequence=self.sequence,
            duration=self.duration_s,
            cause=one,
            others=tuple(others),
            nats=self.discrimination,
            enough=ENOUGH,
        )

    def to_json(self) -> dict[str, Any]:
        """Return the test as the analysis object's ``separating_test``."""
        return {
            "sequence": self.sequence,
            "overrides": dict(self.overrides),
            "duration_s": self.duration_s,
            "separates": list(self.separates),
            "discrimination": self.discrimination,
            "sentence": self.sentence,
        }


@dataclass(frozen=True, slots=True, eq=False)
class Undecided:
    """A first cause and the rivals that a recording does not tell it apart from.

    ``earlier`` are the causes that were taken into the model before it, ``accepted`` those of the model that was
    accepted for the valve; ``valve`` has the effects of all.
    """

    view: View
    accepted: Accepted
    earlier: tuple[Candidate, ...]
    first: Candidate
    rivals: tuple[Candidate, ...]
    valve: ExtendedValve


def separating_test(undecided: Undecided, planned: Sequence[Planned]) -> SeparatingTest | None:
    """Return the planned sequence on which the first cause is expected to win by most nats over every rival.

    None where no sequence is worth ``ENOUGH``. A sequence like the recorded one is left out.
    """
    best: tuple[float, Planned] | None = None
    for one in planned:
        if _is_recorded(undecided.view, one.waveform):
            continue
        nats = expected_nats(undecided, one.waveform)
        if nats is not None and nats > ENOUGH and (best is None or nats > best[0]):
            best = nats, one
    if best is None:
        return None
    nats, chosen = best
    names = (undecided.first.cause.name, *(one.cause.name for one in undecided.rivals))
    return SeparatingTest(chosen.name, dict(chosen.overrides), chosen.waveform.duration_s, names, nats)


def expected_nats(undecided: Undecided, waveform: Waveform) -> float | None:
    """Return by how many nats the first cause is expected to win over its strongest rival on this test alone.

    The hyperparameters are those of the fit with the first cause. None where the test could not be judged.
    """
    planned = _planned_rows(undecided, waveform)
    if planned is None:
        return None
    rows, setting, lag = planned
    first, base = undecided.first, _expected(undecided, rows, setting, lag)
    own = _best_nats(base, first.cause, [first.shape], len(first.cause.tried()), first.size.value)
    others = []
    for one in undecided.rivals:
        # in another test it may have another shape, also the one that it has now
        again = type(one.cause)(setting, one.cause.known)
        shapes = again.tried()
        tried = [
            _best_nats(base, again, shapes, len(shapes)),
            _best_nats(base, one.cause, [one.shape], len(one.cause.tried()), one.size.value),
        ]
        others.append(max(tried))
    return own - max(others)


def _best_nats(base: Solved, cause: Cause, shapes: Sequence[Shape], count: int, size: float | None = None) -> float:
    """Nats of the best of these shapes, each of which is one of ``count``; minus infinite without any.

    The law is taken at ``size``, where that is known.
    """
    if not shapes:
        return -math.inf
    columns = np.column_stack([column_of(cause, shape, base.problem, size) for shape in shapes])
    gains = base.gains(columns, np.full(len(shapes), cause.parameters[0].spread))[0]
    return float(gains.max()) - math.log(max(count, 1))


def _expected(undecided: Undecided, rows: Observations, setting: Setting, lag: Known) -> Solved:
    """The balance of a test without the first cause, its forces those of the fit with it and free of chance."""
    fit = undecided.first.model
    problem = problem_of(rows, setting, lag)
    columns = undecided.accepted.columns(problem)
    for one in undecided.earlier:
        column = column_of(one.cause, one.shape, problem, one.size.value)
        columns = columns.with_column(column, one.cause.parameters[0].spread)
    first = undecided.first
    own = column_of(first.cause, first.shape, problem, first.size.value)
    values = fit.values.copy()
    values[SYMBOLS.index("lag")] = lag.value
    # sizes after the cause's own belong to none of these columns
    design = np.column_stack([problem.design, columns.values, own])
    force_n = design @ values[: design.shape[1]]
    return solved(replace(problem, rows=replace(rows, force_n=force_n)), columns, fit.logarithms)


def _planned_rows(undecided: Undecided, waveform: Waveform) -> tuple[Observations, Setting, Known] | None:
    """Rows of the simulated test, read like a recorded one; None where nothing could be read."""
    view = undecided.view
    reading = _played(view, undecided.valve, waveform)
    if reading is None or len(reading.segmentation.directions) < 2:
        return None
    lag = lag_after_corners(reading)
    rows = observations(reading, lag)
    if int(rows.is_slide.sum()) < _FEWEST_BLOCKS or np.unique(rows.direction[rows.is_slide]).size < 2:
        return None
    # what the gauge and the I/P add is not simulated: as much as they added in the recording
    recorded = view.null.problem.rows
    least_n2 = np.zeros(rows.count)
    for chosen, kind in ((rows.is_slide, recorded.is_slide), (~rows.is_slide, ~recorded.is_slide)):
        least_n2[chosen] = float(np.median(recorded.variance_n2[kind])) if bool(kind.any()) else 0.0
    rows = replace(rows, variance_n2=np.maximum(rows.variance_n2, least_n2))
    return rows, replace(setting_of(rows, reading, view.nameplate), late_s=view.setting.late_s), lag


def _played(view: View, valve: ExtendedValve, waveform: Waveform) -> Reading | None:
    """The waveform as this valve would be recorded on it, with the position's noise."""
    area_m2 = view.nameplate.actuator.diaphragm_area_m2
    if area_m2 is None:
        return None
    time_s = np.arange(0.0, waveform.duration_s, max(_ROW_S, view.reading.samples.period_s))
    pressure_pa = np.interp(time_s, waveform.time_s, waveform.pressure_pa)
    parameters = valve.parameters
    rest_m = (area_m2 * float(pressure_pa[0]) - parameters.preload_n) / max(parameters.spring_rate_n_per_m, 1.0e-9)
    start_m = min(max(rest_m, view.setting.low_m), view.setting.high_m)
    try:
        start = ExtendedState(StemState(start_m, 0.0))
        shown_m = ExtendedStem(valve).motion(start, time_s, area_m2 * pressure_pa, time_s).sensed_m
        noise_m = np.random.default_rng(_SEED).normal(0.0, view.reading.noise_m, time_s.size)
        found = read(Recording(time_s, shown_m + noise_m, pressure_pa=pressure_pa), view.nameplate)
    except ValveError:
        return None
    return None if isinstance(found, Outcome) else found


def _is_recorded(view: View, waveform: Waveform) -> bool:
    """Whether the recording is of this waveform."""
    area_m2, time_s = view.nameplate.actuator.diaphragm_area_m2, view.reading.time_s
    length_s = float(time_s[-1] - time_s[0])
    if area_m2 is None or abs(length_s - waveform.duration_s) > _SAME_LENGTH * waveform.duration_s:
        return False
    asked_n = area_m2 * np.interp(time_s - time_s[0], waveform.time_s, waveform.pressure_pa)
    off_n = float(np.sqrt(np.mean((view.reading.path.force_n - asked_n) ** 2)))
    return off_n < _SAME * float(np.ptp(asked_n))
