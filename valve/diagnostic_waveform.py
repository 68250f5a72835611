"""Waveforms that tell faults apart: small loops, and the diagnostic sequence of several parts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from valve.errors import WaveformError
from valve.messages import say
from valve.waveform import LEAST_RATIO, Waveform, joined, multi_rate_triangle, require_positive

# The diagnostic sequence: one ramp up and down with rests, one small loop, and the way to the loops' middle, s.
_RESTING_PERIOD_S: Final = 13.0
# Where its ramps rest, as shares of their way: behind any usual dead band, and far enough apart to break away between.
_REST_AT: Final = (0.6, 0.68, 0.76, 0.84)
_OWN_REST: Final = 1  # which of them lasts as long as its dwell; the others last as long as the shortest
_LOOP_S: Final = 12.0
_LEAD_S: Final = 6.0
_HALVINGS: Final = 12


def small_loops(
    low_pa: float, high_pa: float, swings: Sequence[float], loop_s: float, *, lead_s: float, name: str = "small_loops"
) -> Waveform:
    """Loops about the middle, each as far to either side as its share of the range says, there and back in ``loop_s``.

    ``lead_s`` is the way from ``low_pa`` to the middle, and from there back at the end. A stem that turns within the
    range shows lost motion and what comes before it breaks away, on both sides.
    """
    require_positive(name, say("loop_time_in_s", "the time of a loop in s"), loop_s)
    require_positive(name, say("way_to_middle_in_s", "the way to the middle in s"), lead_s)
    if not low_pa < high_pa:
        raise WaveformError(
            say(
                "waveform_falls",
                "waveform {name}: it goes from {low:g in Pa} to {high:g Pa}, the second must be higher",
                name=name,
                low=low_pa,
                high=high_pa,
            )
        )
    if not swings or not all(0.0 < share <= 0.5 for share in swings):
        raise WaveformError(
            say(
                "swings_outside",
                "waveform {name}: its swings are [{swings:, }], give shares of the range up to 0.5",
                name=name,
                swings=tuple(swings),
            )
        )
    middle_pa, range_pa = (low_pa + high_pa) / 2.0, high_pa - low_pa
    legs = [(0.0, low_pa), (lead_s, middle_pa)]
    for share in swings:
        legs += [
            (loop_s / 4.0, middle_pa + share * range_pa),
            (loop_s / 2.0, middle_pa - share * range_pa),
            (loop_s / 4.0, middle_pa),
        ]
    return joined(name, [*legs, (lead_s, low_pa)])


def _resting(period_s: float, low_pa: float, high_pa: float, dwells_s: Sequence[float]) -> Waveform:
    """A triangle for each dwell: it rests four times on each ramp, for the shortest dwell and once for its own.

    A stem that rests and goes on as it came does not cross a play, one that turns does: by the many breakaways of both
    kinds a play is told from friction.
    """
    legs, short_s = [(0.0, low_pa)], min(dwells_s)
    for dwell_s in dwells_s:
        for begin_pa, end_pa in ((low_pa, high_pa), (high_pa, low_pa)):
            before = 0.0
            for place, share in enumerate(_REST_AT):
                at_pa = begin_pa + share * (end_pa - begin_pa)
                rest_s = dwell_s if place == _OWN_REST else short_s
                legs += [((share - before) * period_s / 2.0, at_pa), (rest_s, at_pa)]
                before = share
            legs.append(((1.0 - before) * period_s / 2.0, end_pa))
    return joined("resting", legs)


def one_after_the_other(name: str, waves: Sequence[Waveform]) -> Waveform:
    """Return the waveforms as one; each begins where the last ended. Raises WaveformError where one does not."""
    time_s, pressure_pa = [waves[0].time_s], [waves[0].pressure_pa]
    for wave in waves[1:]:
        if wave.pressure_pa[0] != pressure_pa[-1][-1]:
            raise WaveformError(
                say(
                    "waveforms_do_not_meet",
                    "waveform {name}: {wave} begins at {begin:g Pa} and what comes before ends at {end:g Pa}: let them "
                    "meet",
                    name=name,
                    wave=wave.name,
                    begin=float(wave.pressure_pa[0]),
                    end=float(pressure_pa[-1][-1]),
                )
            )
        time_s.append(time_s[-1][-1] + wave.time_s[1:])
        pressure_pa.append(wave.pressure_pa[1:])
    return Waveform(name, np.concatenate(time_s), np.concatenate(pressure_pa))


def diagnostic(
    low_pa: float,
    high_pa: float,
    *,
    rate_pa_per_s: float,
    longest_s: float,
    slow_s: float = 20.0,
    fast_s: Sequence[float] = (8.0, 5.0, 3.1, 2.3, 2.7),
    dwells_s: Sequence[float] = (0.5, 8.0),
    swings: Sequence[float] = (0.35, 0.23, 0.16),
) -> Waveform:
    """Triangles at a slow and at fast rates, then ramps with short rests and a long one, then small loops: 138 s.

    Each part shows what equal triangles hide: rates tell friction that falls with speed and what lags, rests a
    breakaway that grows with them, and beside turns and small loops lost motion (docs/diagnosis.md). Ramps are no
    faster than ``rate_pa_per_s``, and all is made shorter where ``longest_s`` asks for it.
    """
    name = "diagnostic"
    require_positive(name, say("pressure_rate_in_pa_per_s", "the pressure's rate in Pa/s"), rate_pa_per_s)
    require_positive(name, say("longest_time_in_s", "the longest time in s"), longest_s)
    # 1e-6 longer, so that rounding does not make it too fast
    allowed_s = 2.0 * (high_pa - low_pa) / rate_pa_per_s * (1.0 + 1.0e-6)

    def parts(share: float) -> list[Waveform]:
        def there_and_back(period_s: float, swing: float = 1.0) -> float:
            return max(share * period_s, swing * allowed_s)

        slow = there_and_back(slow_s)
        fast = [period_s for period_s in map(there_and_back, fast_s) if period_s * LEAST_RATIO <= slow]
        ramp_s = there_and_back(_RESTING_PERIOD_S)
        loop_s = there_and_back(_LOOP_S, 2.0 * max(swings))
        return [
            multi_rate_triangle([slow, *fast], low_pa, high_pa),
            _resting(ramp_s, low_pa, high_pa, [share * dwell_s for dwell_s in dwells_s]),
            small_loops(low_pa, high_pa, swings, loop_s, lead_s=there_and_back(_LEAD_S, 0.25)),
        ]

    whole = one_after_the_other(name, parts(1.0))
    if whole.duration_s <= longest_s:
        return whole
    shortest: Waveform | None = None
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):  # what a limit of the rate holds does not shrink with the rest
        share = 0.5 * (low + high)
        tried = one_after_the_other(name, parts(share))
        if tried.duration_s <= longest_s:
            low, shortest = share, tried
        else:
            high = share
    if shortest is None:
        raise WaveformError(
            say(
                "waveform_takes_longer",
                "waveform {name}: it takes more than {longest:g} s at {rate:g Pa/s}: allow more time",
                name=name,
                longest=longest_s,
                rate=rate_pa_per_s,
            )
        )
    return shortest
