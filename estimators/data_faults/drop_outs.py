"""Drop-outs: a channel jumps to zero or to an end of its scale, stays there, and jumps back.

No stem and no actuator does that within one sample both ways. A valve that snaps shut and open again does something
alike: it is told from a drop-out by the pressure, which then went beyond what it was at the two jumps.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np

from estimators.data_faults.fault import SHOWN, DataFault, runs
from estimators.samples import FloatArray, position_noise
from valve.messages import Message, say
from valve.recording import CHANNELS, Recording

_MEASURED: Final = ("position_m", "pressure_pa", "force_n")
# Own choices; tests/estimators/data_faults/test_drop_outs.py has what must not be taken for one.
_NOISES: Final = 5.0  # about a level, of the channel's noise
_JUMP_OF_SPAN: Final = 0.03
_JUMP_OF_STEPS: Final = 5.0  # times the largest steps elsewhere
_LARGEST_STEPS: Final = 4  # the fourth largest: a few spikes are no measure of the others
_COMES_BACK: Final = 0.25  # of the jump: after a short drop-out a channel is where it was
_SHORT_S: Final = 0.15  # no actuator is vented and filled again in it
_ANSWERS_S: Final = 0.1  # a stem that jumps does so at once
_BEYOND: Final = 0.05  # of the input's span: so far the pressure goes on while a valve is shut
_MOST: Final = 0.3  # of the samples
_SLOWEST_PERIOD_S: Final = 0.051  # slower, a valve may shut and open between two rows


def without_drop_outs(
    recording: Recording, place: str, *, by_pressure: bool = False
) -> tuple[Recording, list[DataFault]]:
    """Return the recording with its drop-outs made gaps, and what was left out of which channel.

    ``by_pressure``: those of the position that the pressure or force denies alone, and at any rate of rows, as a valve
    in service is recorded.
    """
    is_slow = recording.sample_period_s > _SLOWEST_PERIOD_S if recording.samples > 1 else True
    witnessed = recording.pressure_pa is not None or recording.force_n is not None
    if recording.samples < 50 or (not witnessed if by_pressure else is_slow):
        return recording, []
    candidates = {
        name: found
        for name in (_MEASURED[:1] if by_pressure else _MEASURED)
        if (channel := getattr(recording, name)) is not None and (found := _jumps(recording.time_s, channel))
    }
    told: list[DataFault] = []
    changed: dict[str, Any] = {}
    for name, stretches in candidates.items():
        others = [(other, *one) for other, found in candidates.items() if other != name for one in found]
        channel = np.array(getattr(recording, name))
        out = np.zeros(channel.shape, dtype=np.bool_)
        kept = [
            one
            for one in stretches
            if (_is_left_out(recording, *one) if by_pressure else _is_drop_out(recording, name, one, others))
        ]
        for first, last in kept:
            out[first:last] = True
        if not kept or np.count_nonzero(out) > _MOST * out.size:
            continue
        told.append(_told(name, place, channel, recording.time_s, kept))
        channel[out] = np.nan
        changed[name] = channel
    return (replace(recording, **changed), told) if changed else (recording, [])


def _jumps(time_s: FloatArray, channel: FloatArray) -> list[tuple[int, int]]:
    """Return first and one past the last row of each stretch at zero or an end of the scale between two jumps."""
    rows = np.flatnonzero(np.isfinite(channel))
    if rows.size < 50:
        return []
    own = channel[rows]
    span = float(np.ptp(own))
    if span == 0.0:
        return []
    noise = position_noise(time_s[rows], own, np.zeros(rows.size, dtype=np.intp))
    margin = max(_NOISES * noise, 1.0e-9 * span)
    found: list[tuple[int, int]] = []
    for level in dict.fromkeys((0.0, float(own.min()), float(own.max()))):
        at = np.abs(own - level) <= margin
        if not at.any() or np.count_nonzero(at) > 0.5 * at.size:
            continue
        away = ~at
        steps = np.abs(np.diff(own))[away[1:] & away[:-1]]
        if steps.size < 2 * _LARGEST_STEPS:
            continue
        usual = float(np.partition(steps, -_LARGEST_STEPS)[-_LARGEST_STEPS])
        rest = float(np.ptp(own[away]))
        least = max(_JUMP_OF_STEPS * usual, _JUMP_OF_SPAN * rest, 2.0 * margin)
        for first, last in runs(at):
            sides = [abs(float(own[first - 1]) - level)] if first > 0 else []
            sides += [abs(float(own[last]) - level)] if last < own.size else []
            if len(sides) == 2 and min(sides) > least:
                found.append((int(rows[first]), int(rows[last - 1]) + 1))
    return sorted(set(found))


def _is_drop_out(recording: Recording, name: str, stretch: tuple[int, int], others: list[tuple[str, int, int]]) -> bool:
    first, last = stretch
    channel = getattr(recording, name)
    before, after = _near(channel, first - 1, -1), _near(channel, last, 1)
    if before is None or after is None:  # begun or ended so, as a valve at rest does
        return False
    jump = min(abs(before - channel[first]), abs(after - channel[last - 1]))
    lasted_s = float(recording.time_s[last - 1] - recording.time_s[first])
    comes_back = lasted_s <= _SHORT_S and abs(after - before) <= _COMES_BACK * jump
    exact = _is_exact(channel, first, last)
    denied = _is_denied(recording, name, first, last, low=channel[first] < min(before, after))
    if name == "position_m" and denied and recording.pressure_pa is not None:
        return True  # a pressure may jump and leave the stem where it is, a stem does not jump without it
    # two channels at once: the device was away
    beside = [(other, begin, end) for other, begin, end in others if begin < last and first < end]
    if comes_back:
        return denied or bool(beside)
    return exact and (denied or any(_is_exact(getattr(recording, other), begin, end) for other, begin, end in beside))


def _is_left_out(recording: Recording, first: int, last: int) -> bool:
    """Whether a position in service drops out: it is exact, or back where it was with the pressure where that was.

    A stem that slips there and back needs the pressure to turn by the stick band in between.
    """
    witness = recording.force_n if recording.pressure_pa is None else recording.pressure_pa
    position = recording.position_m
    before, after = _near(position, first - 1, -1), _near(position, last, 1)
    was, is_now = _near(witness, first - 1, -1), _near(witness, last, 1)
    if witness is None or before is None or after is None or was is None or is_now is None:
        return False
    if not _is_denied(recording, "position_m", first, last, low=position[first] < min(before, after)):
        return False
    jump = min(abs(before - position[first]), abs(after - position[last - 1]))
    returns = abs(after - before) <= _COMES_BACK * jump
    stays = abs(is_now - was) <= _BEYOND * float(np.nanmax(witness) - np.nanmin(witness))
    return _is_exact(position, first, last) or (returns and stays)


def _is_exact(channel: FloatArray, first: int, last: int) -> bool:
    """Whether a stretch is one value to the last digit, longer than the channel repeats one anywhere else."""
    inside = channel[first:last]
    if float(np.nanmax(inside)) != float(np.nanmin(inside)) or (last - first < 3 and inside[0] != 0.0):
        return False
    elsewhere = channel[channel != inside[0]]
    repeats = runs(np.diff(elsewhere[np.isfinite(elsewhere)]) == 0.0)
    return 2 * max((end - begin + 1 for begin, end in repeats), default=1) <= last - first + 1


def _is_denied(recording: Recording, name: str, first: int, last: int, *, low: bool) -> bool:
    """Whether the other channels show that the value cannot have gone there: none went beyond both jumps.

    Of a recording without another channel nothing denies it.
    """
    for other in ("position_m",) if name != "position_m" else CHANNELS[:3]:
        witness = getattr(recording, other)
        if other == name or witness is None:
            continue
        known = witness[np.isfinite(witness)]
        inside = witness[first:last]
        beside = max(2, round(_ANSWERS_S / recording.sample_period_s))
        before, after = witness[max(0, first - beside) : first], witness[last : last + beside]
        if any(not np.isfinite(part).any() for part in (inside, before, after)):
            continue
        margin = _BEYOND * float(np.ptp(known))
        if low:
            went = min(float(np.nanmax(before)), float(np.nanmax(after))) - float(np.nanmin(inside))
        else:
            went = float(np.nanmax(inside)) - max(float(np.nanmin(before)), float(np.nanmin(after)))
        if went > margin:
            return False
    return True


def _near(channel: FloatArray | None, row: int, way: int) -> float | None:
    if channel is None:
        return None
    while 0 <= row < channel.size:
        if np.isfinite(channel[row]):
            return float(channel[row])
        row += way
    return None


def _told(name: str, place: str, channel: FloatArray, time_s: FloatArray, kept: list[tuple[int, int]]) -> DataFault:
    called, unit = SHOWN[name]
    period_s = float(np.median(np.diff(time_s)))
    lasted_s = [float(time_s[last - 1] - time_s[first] + period_s) for first, last in kept]
    count = sum(last - first for first, last in kept)
    sentence = say(
        "drops_out",
        "The {channel}{place} drops out {times}, to {level:.4g {unit}} for {lasted}, the first time at {first:.6g} s: "
        "{count} samples left out. Look at the cable, the supply and the link of this channel.",
        channel=called,
        place=place,
        times=_times(len(kept)),
        level=float(channel[kept[0][0]]) + 0.0,  # + 0.0: no minus before a zero
        unit=unit,
        lasted=_lasted(min(lasted_s), max(lasted_s)),
        first=float(time_s[kept[0][0]]),
        count=count,
    )
    figures = {"drop_outs": (float(len(kept)), "1"), "longest_s": (max(lasted_s), "s")}
    return DataFault(name, "drop_outs", count, sentence, figures)


def _lasted(least_s: float, most_s: float) -> Message:
    if most_s >= 1.0:
        if least_s == most_s:
            return say("lasted_seconds", "{time:.3g s}", time=most_s)
        return say("lasted_seconds_from_to", "{least:.3g in s} to {most:.3g s}", least=least_s, most=most_s)
    if least_s == most_s:
        return say("lasted", "{time:.3g ms}", time=most_s)
    return say("lasted_from_to", "{least:.3g in ms} to {most:.3g ms}", least=least_s, most=most_s)


def _times(count: int) -> Message:
    if count == 1:
        return say("once", "once")
    return say("twice", "twice") if count == 2 else say("so_many_times", "{count} times", count=count)
