"""Causes between command and pressure, which the measured pressure itself shows, beside those of the stem."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from discrepancy.causes.base import Fitted, Setting
from discrepancy.diagnosis import Diagnosis, Finding, Verdict
from discrepancy.gain import Gain, prediction_error
from discrepancy.least_squares import Fit
from discrepancy.pressure_path import PressurePath, read_pressure_path, without_pressure
from discrepancy.registry import CAUSES
from discrepancy.setting import setting_of
from valve.nameplate import Nameplate
from valve.recording import Recording

COMMANDED = "the recording itself, simulated from its command"


def with_pressure_findings(
    found: Diagnosis,
    best: Fit,
    recordings: Sequence[Recording],
    nameplate: Nameplate,
    held_out: Sequence[tuple[str, Recording]],
) -> Diagnosis:
    """Return the diagnosis with what stands between command and pressure, where both were measured.

    The stem is fitted to the pressure that acted, so these causes are no part of its misfit; their gain is that of a
    prediction from the command.
    """
    path = read_pressure_path(recordings)
    if path is None or not path.causes or found.verdict in {Verdict.UNEXPLAINED, Verdict.NOT_ASSESSED}:
        return found
    setting = setting_of(best)
    findings = tuple(_finding(cause, value, setting, path) for cause, value in path.causes)
    named = {finding.cause for finding in found.causes}
    findings = tuple(finding for finding in findings if finding.cause not in named)
    gains = found.gains
    if found.verdict is Verdict.NONE:
        tried = [*held_out, (COMMANDED, recordings[0])]
        measured = [_gain(name, one, nameplate, best, path) for name, one in tried]
        gains = tuple(gain for gain in measured if gain is not None)
    verdict = Verdict.NAMED if found.verdict is Verdict.NONE else found.verdict
    return replace(found, verdict=verdict, message="", causes=(*found.causes, *findings), gains=gains)


def _finding(name: str, value: Fitted, setting: Setting, path: PressurePath) -> Finding:
    cause = CAUSES[name]
    parameters = {cause.strength: value}
    if name == "supply_saturation":
        area_m2 = setting.observed.nameplate.actuator.diaphragm_area_m2 or 1.0
        parameters = {cause.strength: Fitted(area_m2 * value.value, area_m2 * value.low, area_m2 * value.high, "N")}
    return Finding(name, cause.sentence(parameters, setting), cause.action, parameters, max(path.share, 0.0))


def _gain(name: str, recording: Recording, nameplate: Nameplate, fit: Fit, path: PressurePath) -> Gain | None:
    if recording.command_pa is None:
        return None
    before = prediction_error(without_pressure(recording, None), nameplate, fit)
    after = prediction_error(without_pressure(recording, path), nameplate, fit)
    if before is None or after is None or not math.isfinite(before[0]):
        return None
    return Gain(name, before[0], after[0], before[1])
