"""Recordings that no cause should be named from: what is wrong with them, as a sentence, before anything is fitted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from estimators.base import Outcome
from estimators.samples import FloatArray
from valve.messages import Message, say
from valve.nameplate import Nameplate
from valve.recording import Recording

# Own choices.
_LEAST_TRAVEL: Final = 0.01  # of the rated travel: below, play and friction are as large as the motion
_STUCK_AT_END: Final = 0.6  # of the samples, at the very highest or lowest value
_NEAR_END: Final = 1.0e-6  # of the span
_LEAST_SAMPLES: Final = 100
_SCALES_APART: Final = 0.1  # force over pressure times area
_TURNED: Final = -0.5  # correlation of position and pressure
_MEANS: Final = 200  # of a recording, in which its ways are looked at
_COMES_BACK: Final = 0.1
_TURNED_BACK: Final = 0.5  # of what the force, pressure or command spans: so much is a way back
_CENTRAL: Final = (0.5, 99.5)  # percent: without single odd samples
# A pressure that comes before its command: by how much, and how much better that fits than at once.
_LEADS_PERIODS: Final = 3.0
_LEADS_S: Final = 0.02
_LONGEST_LEAD_S: Final = 3.0
_LEADS: Final = 61  # tried on a side
_INSTANTS: Final = 2000  # compared
_LEFT_BY_LEADING: Final = 0.3  # of what the command at once leaves of the pressure's variance


def doubt(recordings: Sequence[Recording], nameplate: Nameplate) -> str:
    """Return why recordings cannot be assessed, with the remedy; "" where nothing speaks against it."""
    for recording in recordings:
        said = _doubt(recording, nameplate)
        if said:
            return said
    least_m = _LEAST_TRAVEL * nameplate.actuator.travel_m
    if recordings and all(_goes_one_way(one.position_m, least_m) for one in recordings):
        is_held = any(_is_turned_back(one) for one in recordings)
        return (Outcome.HELD_ON_THE_WAY_BACK if is_held else Outcome.ONE_DIRECTION_ONLY).message
    return ""


def _is_turned_back(recording: Recording) -> bool:
    """Whether what drives a stem that goes one way went back as well: friction held it then, no cycle is missing."""
    channels = (recording.force_n, recording.pressure_pa, recording.command_pa)
    driven = next((one for one in channels if one is not None), None)
    if driven is None:
        return False
    known = np.isfinite(driven) & np.isfinite(recording.position_m)
    towards, position_m = driven[known], recording.position_m[known]
    tenth = max(1, position_m.size // 10)
    towards = towards if float(position_m[-tenth:].mean()) > float(position_m[:tenth].mean()) else -towards
    back = float(np.max(np.maximum.accumulate(towards) - towards))
    return back > _TURNED_BACK * float(np.ptp(towards))


def _goes_one_way(position_m: FloatArray, least_m: float) -> bool:
    """Whether the stem moved and never came back by a tenth of its way."""
    known_m = position_m[np.isfinite(position_m)]
    size = known_m.size // _MEANS
    if size == 0:
        return False
    mean_m = known_m[: size * _MEANS].reshape(_MEANS, size).mean(axis=1)
    swept_m = float(np.ptp(mean_m))
    back_m = float((np.maximum.accumulate(mean_m) - mean_m).max())
    up_m = float((mean_m - np.minimum.accumulate(mean_m)).max())
    return swept_m > least_m and min(back_m, up_m) < _COMES_BACK * swept_m


def _doubt(recording: Recording, nameplate: Nameplate) -> str:
    position_m = recording.position_m[np.isfinite(recording.position_m)]
    if position_m.size < _LEAST_SAMPLES:
        return ""
    travel_m = nameplate.actuator.travel_m
    swept_m = _span(position_m)
    pressure_pa = recording.pressure_pa
    return (
        _pegged(say("position", "position"), position_m)
        or ("" if pressure_pa is None else _pegged(say("pressure", "pressure"), pressure_pa[np.isfinite(pressure_pa)]))
        or _swapped(recording, nameplate, swept_m)
        or _leading(recording)
        or _too_little(swept_m, travel_m, position_m)
        or _area(recording, nameplate)
    )


def _span(values: FloatArray) -> float:
    low, high = np.percentile(values, _CENTRAL)
    return float(high - low)


def _pegged(name: Message, values: FloatArray) -> str:
    """Return that a channel stands at one end of what it shows for most of the time, as a saturated one does."""
    if values.size < _LEAST_SAMPLES:
        return ""
    low, high = float(values.min()), float(values.max())
    margin = _NEAR_END * (high - low)
    if not high > low:
        return ""
    for end, word in ((high, say("highest", "highest")), (low, say("lowest", "lowest"))):
        share = float(np.mean(np.abs(values - end) <= margin))
        if share > _STUCK_AT_END:
            return say(
                "channel_saturated",
                "The {channel} reads exactly its {end} value, {value:.4g}, in {share:.0f %} of the samples: its "
                "channel is saturated, or the stem stands at a stop. Correct the channel's range, or repeat with a "
                "smaller amplitude.",
                channel=name,
                end=word,
                value=end,
                share=share,
            )
    return ""


def _swapped(recording: Recording, nameplate: Nameplate, swept_m: float) -> str:
    pressure_pa, travel_m = recording.pressure_pa, nameplate.actuator.travel_m
    if pressure_pa is None or not np.isfinite(pressure_pa).any():
        return ""
    if swept_m > 10.0 * travel_m and float(np.nanmax(np.abs(pressure_pa))) < 10.0 * travel_m:
        return say(
            "channels_swapped",
            "The position spans {swept:.4g m} and the pressure reaches {pressure:.3g Pa} on a valve with {travel:g m} "
            "of travel: the two channels are swapped. Exchange them.",
            swept=swept_m,
            pressure=float(np.nanmax(np.abs(pressure_pa))),
            travel=travel_m,
        )
    both = np.isfinite(pressure_pa) & np.isfinite(recording.position_m)
    own_m, own_pa = recording.position_m[both], pressure_pa[both]
    if own_m.size >= _LEAST_SAMPLES and swept_m > _LEAST_TRAVEL * travel_m and _span(own_pa) > 0.0:
        related = float(np.corrcoef(own_m, own_pa)[0, 1])
        if related < _TURNED:
            return say(
                "position_turned_round",
                "The position falls where the pressure rises: the position's sign or zero is turned round. Record the "
                "travel so that it grows with the pressure.",
            )
    return ""


def _leading(recording: Recording) -> str:
    """Return that the pressure comes before the command that it follows."""
    command_pa, pressure_pa, time_s = recording.command_pa, recording.pressure_pa, recording.time_s
    if command_pa is None or pressure_pa is None:
        return ""
    both = np.isfinite(command_pa) & np.isfinite(pressure_pa)
    if np.count_nonzero(both) < _LEAST_SAMPLES:
        return ""
    own_s, asked_pa, acting_pa = time_s[both], command_pa[both], pressure_pa[both]
    least_s = max(_LEADS_PERIODS * float(np.median(np.diff(own_s))), _LEADS_S)
    longest_s = min(_LONGEST_LEAD_S, 0.1 * float(own_s[-1] - own_s[0]))
    if longest_s <= least_s or _span(asked_pa) <= 0.0 or _span(acting_pa) <= 0.0:
        return ""
    at_s = np.linspace(own_s[0] + longest_s, own_s[-1] - longest_s, _INSTANTS)
    followed_pa = np.interp(at_s, own_s, acting_pa)

    def left(lead_s: float) -> float:
        """Share of the pressure's variance that the command of ``lead_s`` later does not explain."""
        return 1.0 - float(np.corrcoef(np.interp(at_s + lead_s, own_s, asked_pa), followed_pa)[0, 1]) ** 2

    leads_s = np.geomspace(least_s, longest_s, _LEADS)
    early = [left(lead_s) for lead_s in leads_s]
    best = int(np.argmin(early))
    at_once_or_later = min(left(0.0), *(left(-lead_s) for lead_s in leads_s))
    if not early[best] < _LEFT_BY_LEADING * at_once_or_later:
        return ""
    return say(
        "pressure_leads",
        "The pressure comes {lead:.2g} s before the command that it follows: the columns command_pa and pressure_pa "
        "are swapped, or the command was recorded late. Exchange them, or leave the command out.",
        lead=float(leads_s[best]),
    )


def _too_little(swept_m: float, travel_m: float, position_m: FloatArray) -> str:
    noise_m = float(np.median(np.abs(np.diff(position_m)))) * 1.05  # of white noise, one standard deviation
    if swept_m >= _LEAST_TRAVEL * travel_m or swept_m <= 8.0 * noise_m:
        return ""  # what never moved is told as such
    return say(
        "travel_too_small",
        "The travel spans {share:.2g %}, the diagnosis needs {needed:g %}: repeat with a larger amplitude.",
        share=swept_m / travel_m,
        needed=_LEAST_TRAVEL,
    )


def _area(recording: Recording, nameplate: Nameplate) -> str:
    """Return that force and pressure, both recorded, do not fit the nameplate's area."""
    force_n, pressure_pa, area_m2 = recording.force_n, recording.pressure_pa, nameplate.actuator.diaphragm_area_m2
    if force_n is None or pressure_pa is None or area_m2 is None:
        return ""
    both = np.isfinite(force_n) & np.isfinite(pressure_pa)
    if np.count_nonzero(both) < _LEAST_SAMPLES or _span(pressure_pa[both]) <= 0.0:
        return ""
    slope_m2 = float(np.polyfit(pressure_pa[both], force_n[both], 1)[0])
    if abs(slope_m2 / area_m2 - 1.0) < _SCALES_APART:
        return ""
    return say(
        "force_off_area",
        "The recorded force is {times:.3g} times the pressure on the nameplate's area: the misfit is a scale. Correct "
        "actuator.diaphragm_area_m2 ({area:g}, the recording says {recorded:.4g}).",
        times=slope_m2 / area_m2,
        area=area_m2,
        recorded=slope_m2,
    )
