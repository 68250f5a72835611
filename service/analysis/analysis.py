"""The analysis object: what one recording says of its valve, as the contract has it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from discrepancy.notes.change_note import change_note
from discrepancy.notes.scale_note import scale_note
from discrepancy.notes.tone_note import tone_note
from discrepancy.notes.zero_note import zero_doubt
from estimators.base import Estimate, Outcome
from estimators.data_faults.fault import DataFault
from estimators.data_faults.found import recording_number, without_data_faults
from estimators.data_faults.held_values import widened
from estimators.data_faults.vacuum import without_preload, without_preload_cause
from estimators.motion.recorded_motion import RecordedMotion, read_motion
from estimators.motion.stroke import stroke_m
from estimators.registry import estimate_all
from estimators.samples import position_noise
from estimators.signature.measure import measure_signature
from estimators.steps.response import step_figures
from service.analysis.diagnosis import NOT_YET, assess, not_assessed
from service.analysis.driven_force import with_driven_forces
from service.analysis.like_periods import of_like_periods, periods_note
from valve.errors import MotionError, ParameterError, RecordingError
from valve.messages import message_of, say
from valve.motion import simulate_recording
from valve.nameplate import Nameplate
from valve.recording import CHANNELS, FloatArray, Recording

Progress = Callable[[float, str], None]

SCHEMA: Final = "breakaway/analysis/1"
_NO_HEALTH: Final = say(
    "health_not_assessed", "not assessed: it takes the valve's limits and its earlier tests, which the service has"
)
_NO_SIMULATION: Final = say(
    "parameters_missing_for_simulation", "the method does not give the parameters that a simulation needs"
)
# Between two recordings that are analysed together, in periods of the second: the estimators see a gap there.
_PERIODS_BETWEEN: Final = 10.0
# Shares of the progress at which the estimates, and the diagnosis, are done.
_ESTIMATED: Final = 0.3
_DIAGNOSED: Final = 0.95
_LOOP_POINTS: Final = 200


def analyze_recordings(
    recordings: Sequence[Recording],
    nameplate: Nameplate,
    *,
    held_out: Sequence[tuple[str, Recording]] = (),
    accepted: Mapping[str, Any] | None = None,
    room: Mapping[str, float] | None = None,
    progress: Progress | None = None,
    keep: Callable[[dict[str, Any]], None] | None = None,
) -> dict[str, Any]:
    """Analysis object (``breakaway/analysis/1``) of one recording, or of several of one valve.

    The estimators and the diagnosis read several as one with gaps between them, of different sampling periods those
    alike; on the others the diagnosis is tried. ``held_out`` are named recordings that the estimates and the diagnosis
    are tried on; ``accepted`` is the extended model that was accepted for the valve, ``room`` what a further test of it
    may use (``service.model.sequences.Room``). ``progress`` is told the share done, 0 to 1, and what is going on;
    ``keep`` is given the object before it is diagnosed, for the case that this never ends.
    Raises RecordingError where there is no recording, or where they have different channels.
    """
    tell = progress or (lambda _share, _phase: None)
    tell(0.0, say("looking_at_recording", "looking at the recording"))
    joined(recordings)  # they fit together
    read = of_like_periods(recordings)
    as_recorded = joined([recordings[number] for number in read])
    recordings, faults = without_data_faults(recordings, nameplate)
    from_vacuum = any(one.reason == "from_vacuum" for one in faults)
    reported = next((one for one in faults if one.reason == "exception_report"), None)
    held_out, faults_there = _without_data_faults(held_out, nameplate)
    faults += faults_there
    as_cleaned = joined(recordings)
    recordings, driven = with_driven_forces(recordings, nameplate)
    recording = joined([recordings[number] for number in read])
    names = [name for name, _ in held_out]
    held_out = list(zip(names, with_driven_forces([one for _, one in held_out], nameplate)[0], strict=True))
    tell(0.1, say("estimating", "estimating"))
    motion = read_motion(recording, nameplate)  # what the estimators and the signature begin with
    estimates = estimate_all(recording, nameplate, motion)
    analysis: dict[str, Any] = {
        "schema": SCHEMA,
        "recording": {
            **recording_summary(as_cleaned),
            "sampling": sampling(as_recorded),  # what was left out was not missed
            "left_out": [one.left_out_json() for one in faults if one.samples],
            "remarks": [one.to_json() for one in faults],
        },
        "estimates": [estimate.to_json() for estimate in estimates],
        "discrepancy": not_assessed(NOT_YET),
        "signature": signature(recording, estimates, nameplate, motion),
        "health": {"ne107": None, "reasons": [_NO_HEALTH]},
    }
    if from_vacuum:
        analysis = without_preload(analysis)
    if reported is not None:
        analysis = widened(analysis, reported, nameplate)
    if held_out:
        tell(_ESTIMATED, say("trying_on_held_out", "trying the estimates on held-out recordings"))
        analysis["held_out"] = [_tried(name, recording, estimates, nameplate) for name, recording in held_out]
    if keep is not None:
        keep(analysis)
    tell(_ESTIMATED, say("looking_for_causes", "looking for what the simulation gets wrong"))
    analysis["discrepancy"] = assess(
        recordings,
        nameplate,
        estimates,
        held_out=[*held_out, *_beside(recordings, read)],
        accepted=accepted,
        room=room,
        progress=lambda share, phase: tell(_ESTIMATED + (_DIAGNOSED - _ESTIMATED) * share, phase),
        estimated=recording,
    )
    if from_vacuum:
        analysis["discrepancy"] = without_preload_cause(analysis["discrepancy"])
    tell(1.0, say("analysis_done", "done"))
    seen = [
        *(one.sentence for one in faults),
        *driven,
        *(note for note in [periods_note(recordings, read)] if note),
        *_tones(analysis, recordings),
        *_changes(analysis, recordings, nameplate),
    ]
    return {**analysis, **_doubted(analysis, nameplate, seen)}


def _without_data_faults(
    held_out: Sequence[tuple[str, Recording]], nameplate: Nameplate
) -> tuple[list[tuple[str, Recording]], list[DataFault]]:
    names = [name for name, _ in held_out]
    cleaned, told = without_data_faults([one for _, one in held_out], nameplate, names)
    return list(zip(names, cleaned, strict=True)), told


def _beside(recordings: Sequence[Recording], read: Sequence[int]) -> list[tuple[str, Recording]]:
    """Return the recordings that are not read as one with the others, by name: the diagnosis is tried on them."""
    return [(recording_number(number + 1), one) for number, one in enumerate(recordings) if number not in read]


def _tones(analysis: Mapping[str, Any], recordings: Sequence[Recording]) -> list[str]:
    """Return what the position's sensor picks up, where something is left that it may explain."""
    found = analysis["discrepancy"]
    if found["verdict"] == "none" or any(one["cause"] == "vibration" for one in found["causes"]):
        return []
    note = tone_note(recordings)
    return [note] if note else []


def _changes(analysis: Mapping[str, Any], recordings: Sequence[Recording], nameplate: Nameplate) -> list[str]:
    """Return what changed while the valve was recorded, where no cause of the catalogue explains the recording."""
    note = change_note(recordings, nameplate) if analysis["discrepancy"]["verdict"] == "unexplained" else ""
    return [note] if note else []


def _doubted(analysis: Mapping[str, Any], nameplate: Nameplate, seen: Sequence[str]) -> dict[str, Any]:
    """Return ``discrepancy`` and ``notes``: what was seen of the samples, and the numbers say of plate and zero."""
    found, note = analysis["discrepancy"], scale_note(analysis, nameplate)
    notes, doubt = [*seen, *([note] if note else [])], zero_doubt(analysis, nameplate)
    if doubt and found["verdict"] == "none":
        return {"discrepancy": {**found, "verdict": "not_assessed", "message": doubt}, "notes": notes}
    return {"discrepancy": found, "notes": [*notes, doubt] if doubt else notes}


def joined(recordings: Sequence[Recording]) -> Recording:
    """Return the recordings one after the other, with a gap in time between; their provenance is the first one's.

    Raises RecordingError where there is none, or where they have different channels.
    """
    if not recordings:
        raise RecordingError(say("no_recording", "analysis: no recording is given, give at least 1"))
    first = recordings[0]
    if len(recordings) == 1:
        return first
    channels = [name for name in CHANNELS if getattr(first, name) is not None]
    columns: dict[str, list[FloatArray]] = {name: [] for name in ("time_s", *channels)}
    start_s = float(first.time_s[0])
    for number, recording in enumerate(recordings, 1):
        own = [name for name in CHANNELS if getattr(recording, name) is not None]
        if own != channels:
            raise RecordingError(
                say(
                    "channels_differ",
                    "analysis: recording {number} has the channels {own:, } and the first {first:, }: analyse "
                    "recordings with different channels one by one",
                    number=number,
                    own=tuple(own),
                    first=tuple(channels),
                )
            )
        columns["time_s"].append(recording.time_s - recording.time_s[0] + start_s)
        period_s = recording.sample_period_s if recording.samples > 1 else 1.0
        start_s = float(columns["time_s"][-1][-1]) + _PERIODS_BETWEEN * period_s
        for name in channels:
            columns[name].append(getattr(recording, name))
    whole = {name: np.concatenate(parts) for name, parts in columns.items()}
    return Recording(**whole, provenance=first.provenance)


def recording_summary(recording: Recording) -> dict[str, Any]:
    """Return size, rate, gaps, noise and how evenly the samples were taken; None where it cannot be told."""
    return {
        "samples": recording.samples,
        "duration_s": recording.duration_s,
        "sample_period_s": recording.sample_period_s if recording.samples > 1 else None,
        "gaps": recording.gaps,
        "position_noise_m": position_noise_m(recording),
        "position_range_m": _position_range(recording),
        "stroke_m": stroke_m(recording),
        "acquisition": str(recording.provenance.acquisition),
        "channels": [name for name in CHANNELS if getattr(recording, name) is not None],
        "sampling": sampling(recording),
    }


def sampling(recording: Recording) -> dict[str, Any] | None:
    """Return how evenly the samples were taken; None with fewer than two."""
    if recording.samples < 2:
        return None
    quality = recording.sampling_quality()
    return {
        "rate_hz": quality.achieved_rate_hz,
        "jitter_rms_s": quality.jitter_rms_s,
        "largest_period_s": quality.largest_period_s,
        "missed_slots": quality.missed_slots,
        "exchange_s": quality.median_exchange_s,
    }


def _position_range(recording: Recording) -> list[float] | None:
    """Lowest and highest position that was measured, m; None where none was."""
    known_m = recording.position_m[np.isfinite(recording.position_m)]
    return None if known_m.size == 0 else [float(known_m.min()), float(known_m.max())]


def position_noise_m(recording: Recording) -> float | None:
    """Noise of the position within runs without a gap, as the estimators see it, m; None with too few samples."""
    rows = np.flatnonzero(np.isfinite(recording.position_m))
    if rows.size < 12:
        return None
    firsts = np.concatenate([[True], np.diff(rows) > 1])
    run_first = np.maximum.accumulate(np.where(firsts, np.arange(rows.size), 0))
    return position_noise(recording.time_s[rows], recording.position_m[rows], run_first)


def signature(
    recording: Recording,
    estimates: Sequence[Estimate],
    nameplate: Nameplate,
    motion: RecordedMotion | Outcome | None = None,
) -> dict[str, Any]:
    """Return the technician's figures: measured on the loop where it shows them, else from the estimates; and steps.

    ``input_percent`` is the range of the signal in percent of its span, ``stops_m`` the travel stops that the stem
    rested on, m, closed end first; each is None where it is not known.
    """
    found = measure_signature(recording, nameplate, estimates, motion).to_json()
    stops = motion.stops if isinstance(motion, RecordedMotion) else None
    ends = None if stops is None else (stops.low_m, stops.high_m)
    return {
        **found,
        "input_percent": _input_percent(recording, found["span"]),
        "stops_m": None if ends is None else [end if np.isfinite(end) else None for end in ends],
        "loop": loop(found.get("curve")),
        "steps": step_figures(recording, nameplate),
    }


def _input_percent(recording: Recording, span: Mapping[str, Any] | None) -> list[float] | None:
    """Lowest and highest command, or pressure without one, in percent of the span; None where either is unknown."""
    asked = recording.pressure_pa if recording.command_pa is None else recording.command_pa
    if asked is None or span is None or span["pressure_pa"] is None or not np.isfinite(asked).any():
        return None
    low_pa, high_pa = span["pressure_pa"]
    ends = (float(np.nanmin(asked)), float(np.nanmax(asked)))
    return [100.0 * (end - low_pa) / (high_pa - low_pa) for end in ends]


def loop(curve: dict[str, Any] | None) -> dict[str, Any] | None:
    """Return both branches of the loop at the same positions, for drawing; None where there are not two.

    ``position_m`` with ``pressure_opening_pa`` and ``pressure_closing_pa``, or with forces in N without an area.
    """
    if curve is None:
        return None
    up, down = curve["up"], curve["down"]
    if len(up["travel_m"]) < 2 or len(down["travel_m"]) < 2:
        return None
    low_m = max(min(up["travel_m"]), min(down["travel_m"]))
    high_m = min(max(up["travel_m"]), max(down["travel_m"]))
    if not high_m > low_m:
        return None
    position_m = np.linspace(low_m, high_m, _LOOP_POINTS)
    drawn: dict[str, Any] = {"position_m": _rounded(position_m)}
    key, unit = ("pressure_pa", "pa") if "pressure_pa" in up else ("force_n", "n")
    for way, branch in (("opening", up), ("closing", down)):
        order = np.argsort(branch["travel_m"], kind="stable")
        values = np.interp(position_m, np.array(branch["travel_m"])[order], np.array(branch[key])[order])
        drawn[f"{key.partition('_')[0]}_{way}_{unit}"] = _rounded(values)
    return drawn


def _rounded(values: FloatArray) -> list[float]:
    return [float(f"{value:.6g}") for value in values]


def _tried(name: str, recording: Recording, estimates: Sequence[Estimate], nameplate: Nameplate) -> dict[str, Any]:
    """RMS of measured minus simulated position by method, m, on a recording that was not fitted, or why none."""
    rmse_m: dict[str, float | None] = {}
    notes: dict[str, str] = {}
    for estimate in estimates:
        rmse_m[estimate.method] = None
        try:
            stand_ins = estimate.diagnostics.get("stand_ins", {})
            parameters = estimate.valve_parameters(stand_ins)
            if parameters is None:
                notes[estimate.method] = _NO_SIMULATION
                continue
            if stand_ins:
                notes[estimate.method] = say(
                    "unconfirmed_values_used",
                    "values that this test does not confirm were used for {symbols:, }",
                    symbols=tuple(stand_ins),
                )
            simulated_m = simulate_recording(parameters, recording, nameplate).position_m
        except (MotionError, ParameterError, RecordingError) as error:
            notes[estimate.method] = message_of(error)
            continue
        rmse_m[estimate.method] = float(np.sqrt(np.nanmean((recording.position_m - simulated_m) ** 2)))
    return {"file": name, "position_noise_m": position_noise_m(recording), "rmse_m": rmse_m, "notes": notes}
