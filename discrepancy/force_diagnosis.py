"""The diagnosis of a force recording: what a drive's balance of forces misses, along direction, travel and speed."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from discrepancy.force_causes.base import ForceStart, fitted_value
from discrepancy.force_causes.friction import SIDE_LOAD
from discrepancy.force_causes.registry import FORCE_CAUSES
from discrepancy.force_fit import ForceModelFit, fit_forces, promises
from discrepancy.force_gain import ForceGain, force_gain, left_out_force_gain
from discrepancy.force_pictures import force_pictures, share_along
from discrepancy.force_record import ForceRecord, read_force_record
from discrepancy.force_result import ForceDiagnosis, ForceFinding
from discrepancy.force_shapes import refined, with_shape_errors, with_shape_intervals
from discrepancy.force_steadiness import comes_and_goes
from discrepancy.rough.result import Verdict
from estimators.base import Outcome
from valve.messages import Message, say
from valve.nameplate import Nameplate
from valve.recording import Recording

# Own choices: what a cause must take, and within which a rival is not told apart, in units of what noise takes.
_SURE: Final = 45.0
_NEAR: Final = 16.0
_MOST_CAUSES: Final = 3
_LEAST_SHARE: Final = 0.08  # of what was left, that a cause must take
_EXPLAINED: Final = 0.3  # of the misfit, from which on what was named is worth a name
_CURVED: Final = 0.25  # of what is left goes with a coordinate: something is there
_SURE_FORCE: Final = 4.0  # standard errors of a constant force
_SURE_SIZE: Final = 3.0  # standard errors of a cause's size
_LEAST_FORCE: Final = 0.02  # of F_c
_LOAD: Final = "spring_preload"  # what a constant force is called on a valve
_NO_FORCE: Final = say(
    "drive_needs_force",
    "A drive without a spring is assessed by its balance of forces, and a recording has no force_n: record the force, "
    "or pressure_pa as the difference of both chambers' pressures.",
)
_TURNED_ROUND: Final = say(
    "friction_drives_stem",
    "Friction comes out below zero, as if it drove the stem: the sign of the force or of the position is turned round. "
    "Record the force positive where it drives towards larger positions.",
)


@dataclass(frozen=True, slots=True, eq=False)
class _Tried:
    start: ForceStart
    fit: ForceModelFit
    gain: float
    share: float
    is_possible: bool


def diagnose_forces(
    recordings: Sequence[Recording],
    nameplate: Nameplate,
    held_out: Sequence[tuple[str, Recording]] = (),
    progress: Callable[[float, str], None] | None = None,
) -> ForceDiagnosis:
    """Return what the balance F = m a + F_v v + F_c sgn v + F_0 of a drive without a spring misses, and why."""
    tell = progress or (lambda _share, _phase: None)
    if any(recording.force_n is None for recording in recordings):
        return ForceDiagnosis(Verdict.NOT_ASSESSED, _NO_FORCE)
    records = []
    for recording in recordings:
        record = read_force_record(recording, nameplate)
        if isinstance(record, Outcome):
            return ForceDiagnosis(Verdict.NOT_ASSESSED, str(record))
        records.append(record)
    baseline = best = fit_forces(records)
    if _is_turned_round(baseline):
        return ForceDiagnosis(Verdict.NOT_ASSESSED, _TURNED_ROUND)
    chosen: list[_Tried] = []
    rivals: tuple[str, ...] = ()
    details: dict[str, Any] = {"force_error_before_percent": 100.0 * baseline.rms_n / baseline.force_rms_n}
    for number in range(_MOST_CAUSES):
        tell(0.1 + 0.6 * number / _MOST_CAUSES, say("trying_causes", "trying one cause after the other"))
        tried = _tried(records, best)
        if number == 0:
            details["tried"] = [{"cause": one.start.cause.name, "gain": one.gain} for one in tried]
        first = tried[0] if tried else None
        # what no physical value explains better than any that is leaves no name to trust
        if first is None or not first.is_possible or first.gain < _SURE or first.share < _LEAST_SHARE:
            break
        if number == 0:
            rivals = tuple(
                one.start.cause.name for one in tried[1:] if one.is_possible and first.gain - one.gain < _NEAR
            )
        best = first.fit
        chosen.append(first)
    details["force_error_after_percent"] = 100.0 * best.rms_n / best.force_rms_n
    tell(0.8, say("measuring_gain", "measuring the gain"))
    pictures = force_pictures(records, baseline, best if chosen else None)
    return _concluded(_Choice(baseline, best, chosen, rivals), held_out, nameplate, details, pictures)


@dataclass(frozen=True, slots=True, eq=False)
class _Choice:
    baseline: ForceModelFit
    best: ForceModelFit
    chosen: list[_Tried]
    rivals: tuple[str, ...]

    @property
    def share(self) -> float:
        """Share of the misfit that all causes take."""
        return 1.0 - self.best.cost / max(self.baseline.cost, 1.0e-300)


def _concluded(
    choice: _Choice,
    held_out: Sequence[tuple[str, Recording]],
    nameplate: Nameplate,
    details: dict[str, Any],
    pictures: dict[str, Any],
) -> ForceDiagnosis:
    best, records = choice.best, choice.best.records
    where, share = share_along(records, best)
    structure = share > _CURVED
    left = best.rms_n / best.force_rms_n
    if not choice.chosen or choice.share < _EXPLAINED:
        offset = _constant_force(best) if not structure and not choice.chosen else None
        if offset is not None:
            return ForceDiagnosis(Verdict.AMBIGUOUS, "", (offset,), (_LOAD,), details=details, pictures=pictures)
        if not structure and not choice.chosen:
            return ForceDiagnosis(Verdict.NONE, details=details, pictures=pictures)
        message = say(
            "balance_unexplained",
            "The balance of forces misses {left:.1f %} of the force, {share:.0f %} of that along {where}, and no cause "
            "of the catalogue explains it.",
            left=left,
            share=share,
            where=where,
        )
        return ForceDiagnosis(Verdict.UNEXPLAINED, message, details=details, pictures=pictures)
    gains: list[ForceGain] = []
    for name, recording in held_out:
        record = read_force_record(recording, nameplate)
        if not isinstance(record, Outcome):
            gains.append(force_gain(name, record, choice.baseline, best))
    gains.append(left_out_force_gain(records, best))
    names = tuple(one.start.cause.name for one in choice.chosen)
    if any(gain.is_worse for gain in gains):
        message = say(
            "predicts_worse",
            "{causes: and } would explain the misfit and predicts other data worse than the plain drive: none is "
            "named.",
            causes=names,
        )
        return ForceDiagnosis(Verdict.UNEXPLAINED, message, gains=tuple(gains), details=details, pictures=pictures)
    told, shape_errors = with_shape_errors(records, best)
    refuted = _refuted(records, best, told)
    if refuted is not None:
        message = say(
            "cause_refuted",
            "{why}: none is named. The balance of forces misses {left:.1f %} of the force with it.",
            why=refuted,
            left=left,
        )
        return ForceDiagnosis(Verdict.UNEXPLAINED, message, gains=tuple(gains), details=details, pictures=pictures)
    rest = say(
        "rest_goes_with",
        "What is left, {left:.1f %} of the force, goes in part with {where}.",
        left=left,
        where=where,
    )
    return ForceDiagnosis(
        Verdict.AMBIGUOUS if choice.rivals else Verdict.NAMED,
        rest if structure else "",
        tuple(_finding(one, told, shape_errors, choice) for one in choice.chosen),
        choice.rivals,
        tuple(gains),
        details=details,
        pictures=pictures,
    )


def _tried(records: Sequence[ForceRecord], best: ForceModelFit) -> list[_Tried]:
    """The best start of each cause that is not in the fit yet, the most gain first."""
    taken = {start.cause.name for start in best.starts}
    whole = records[0]
    left = np.where(whole.rows, whole.force_n - best.predicted(whole), 0.0)
    found = []
    for cause in FORCE_CAUSES.values():
        if cause.name in taken:
            continue
        starts = [ForceStart(cause, shape) for shape in cause.shapes(whole, left)]
        if not starts:
            continue
        promised = promises(best, starts)
        start, _ = refined(best, starts[int(np.argmax(promised))], max(promised))
        fit = fit_forces(records, [*best.starts, start])
        won = best.cost - fit.cost
        gain = won / max(fit.rms_n**2 * fit.inflation, 1.0e-300)
        read = cause.read(fit.values, fit.of_causes[-1], start.shape)
        found.append(_Tried(start, fit, gain, won / max(best.cost, 1.0e-300), read is not None))
    return sorted(found, key=lambda one: -one.share)


def _refuted(records: Sequence[ForceRecord], best: ForceModelFit, told: ForceModelFit) -> Message | None:
    """Return why a cause of the fit is not to be named, as a clause; None where each is steady and of a known size."""
    for start, found in zip(told.starts, told.of_causes, strict=True):
        name = start.cause.name
        if found and all(abs(value) < _SURE_SIZE * error for value, error in found):
            return say(
                "size_unknown_with_shape",
                "{cause} would explain a part of the misfit, and how much of it is not known with its shape open",
                cause=name,
            )
        if comes_and_goes(records, best, start):
            return say(
                "comes_and_goes",
                "{cause} would explain a part of the misfit at times only, so something comes and goes",
                cause=name,
            )
    return None


def _finding(
    one: _Tried, best: ForceModelFit, shape_errors: Sequence[Mapping[str, float]], choice: _Choice
) -> ForceFinding:
    cause = one.start.cause
    place = best.starts.index(one.start)
    parameters = cause.read(best.values, best.of_causes[place], one.start.shape) or {}
    if parameters:
        parameters = with_shape_intervals(parameters, one.start, shape_errors[place])
    return ForceFinding(cause.name, cause.sentence(parameters, best.values), cause.action, parameters, choice.share)


def _is_turned_round(fit: ForceModelFit) -> bool:
    """Whether friction is below zero for sure, at the speeds that the stem had."""
    usual = float(np.median(np.abs(np.concatenate([record.velocity[record.rows] for record in fit.records]))))
    (coulomb_n, coulomb_error_n), (viscous, viscous_error) = fit.values["F_c"], fit.values["F_v"]
    friction_n = coulomb_n + viscous * usual
    return friction_n < -_SURE_FORCE * math.hypot(coulomb_error_n, viscous_error * usual)


def _constant_force(best: ForceModelFit) -> ForceFinding | None:
    """A constant force, which is a friction that differs by direction or a load: nothing tells them apart."""
    (force_n, error_n), coulomb_n = best.values["F_0"], best.values["F_c"][0]
    if abs(force_n) < max(_SURE_FORCE * error_n, _LEAST_FORCE * coulomb_n):
        return None
    share = fitted_value(force_n / coulomb_n, error_n / coulomb_n, "1")
    if force_n > 0.0:
        sentence = say(
            "drive_needs_more_up",
            "The drive needs {more:.2f N} more towards larger positions than the other way, at any speed: friction "
            "that differs by direction, or a constant load of {load:.2f N}.",
            more=2.0 * force_n,
            load=force_n,
        )
    else:
        sentence = say(
            "drive_needs_more_back",
            "The drive needs {more:.2f N} more back than the other way, at any speed: friction that differs by "
            "direction, or a constant load of {load:.2f N}.",
            more=-2.0 * force_n,
            load=-force_n,
        )
    action = say(
        "compare_with_load",
        "Compare it with the load that the drive carries (a weight, the process). Else: {else_}",
        else_=SIDE_LOAD,
    )
    return ForceFinding("friction_asymmetry", sentence, action, {"asymmetry": share}, 0.0)
