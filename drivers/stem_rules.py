"""When what the sensors show is no stem in good order: it stands, it jumps to and fro, it is where none can be."""

from __future__ import annotations

import math
from collections import deque
from typing import Final

from drivers.addresses import ValveWiring
from drivers.faults import FrozenSensorError, NoBreakawayError
from drivers.outcome import Sample
from drivers.recent import WINDOW_S, Recent
from valve.errors import DeviceError
from valve.messages import say

_BREAKAWAY_SHARE: Final = 0.95  # of the limits' span; a stem with 90 % of dead band still moves in a whole stroke
# Where the pressure is not measured: no I/P should be slower (the slowest published one has 0.93 s), and what
# the output's change is worth behind such a lag. A triangle of 20 s over the whole span is still worth 0.86 of it.
_SLOWEST_IP_S: Final = 1.0
_BEHIND_SHARE: Final = 0.85 / _BREAKAWAY_SHARE
_FOLLOWING_SHARE: Final = 0.75  # the output's change without any of the pressure; a low supply caps 60 % at most
_MOVED_SHARE: Final = 1.0e-3  # of the travel
_MOVED_M: Final = 1.0e-5  # where the travel is not known
_UNRESTS: Final = 3.0  # a position that is this many times the unrest at entry away has moved
_PRESSURE_MOVED: Final = 0.01  # of the limits' span
_SAME_BITS: Final = 20  # looks in a row with the very same value: a sensor whose noise was seen shows others
_SPIKE_SHARE: Final = 0.05  # of the travel, there and back between three looks
_SPIKE_WAYS: Final = 2.0  # and so many times the way that the stem went meanwhile
_STANDS_S: Final = 1.0  # after so much pressure: a step is there before damping and I/P let the stem follow
_SPIKES: Final = 3
_SPIKES_WITHIN_S: Final = 2.0
_STRUCK_SHARE: Final = 0.05  # of the limits' span between two looks and off the ramp so far: a step of the pressure
_RINGS_S: Final = 4.0  # after a step a stem with next to no friction swings for so long; F_v of 3 N*s/m on 1.4 kg does
_OUTSIDE: Final = 3  # looks within a window
_OFF_BAND: Final = 2  # the same


class StemRules:
    """Watches the position and the pressure of one test."""

    def __init__(self, wiring: ValveWiring, within_s: float = WINDOW_S) -> None:
        self._within_s = within_s
        limits = wiring.limits
        self._tag = wiring.tag
        self._span_pa = limits.pressure_pa[1] - limits.pressure_pa[0]
        self._breakaway_pa = limits.breakaway_pa or _BREAKAWAY_SHARE * self._span_pa
        self._band_m = limits.band_m
        self._range_m = wiring.permissives.position_m
        self._moved_m = _MOVED_M if self._range_m is None else _MOVED_SHARE * (self._range_m[1] - self._range_m[0])
        self._noisy = False
        self._entry_m = math.nan
        self._standstill = True
        self._begin()

    def _begin(self) -> None:
        self._rest_m = self._last_m = math.nan
        self._rest_pa = math.nan
        self._pressures: tuple[float, float] = (math.inf, -math.inf)  # since the stem moved last
        self._asked: tuple[float, float] = (math.inf, -math.inf)  # the output, since then
        self._behind_pa, self._behind_s = math.nan, -math.inf  # the output behind the slowest I/P
        self._outputs: tuple[float, float] = (math.inf, -math.inf)  # since the pressure moved last
        self._same = 0
        self._outside, self._off_band = Recent(_OUTSIDE, self._within_s), Recent(_OFF_BAND, self._within_s)
        self._enough_s = self._unfollowed_s = math.inf  # since when the pressure, or the output, changed by enough
        self._recent: deque[tuple[float, float, float]] = deque(maxlen=3)  # time, position, pressure
        self._spikes_s: deque[float] = deque(maxlen=_SPIKES)
        self._struck_s = -math.inf

    def begin(self, entry: Sample | None, unrest_m: float) -> None:
        """Count from now. ``entry`` is how the valve stood before, ``unrest_m`` how much the position varied then."""
        self._begin()
        if entry is not None:
            self._entry_m = entry.position_m
        if unrest_m > 0.0:
            self._noisy = True
            self._moved_m = max(self._moved_m, _UNRESTS * unrest_m)

    def stand_down(self) -> None:
        """Judge no longer whether the stem moves: the pressure goes back because it did not."""
        self._standstill = False

    def fault(self, sample: Sample) -> DeviceError | None:
        """Return why the test must end by this sample, or None."""
        following = self._ip_stuck(sample)
        if not math.isfinite(sample.position_m):
            return following
        return self._impossible(sample) or following or self._standing(sample)

    def _impossible(self, sample: Sample) -> DeviceError | None:
        position_m = sample.position_m
        if self._range_m is not None:
            outside = not self._range_m[0] <= position_m <= self._range_m[1]
            if outside and self._outside.note(sample.sent_s):
                return DeviceError(
                    say(
                        "position_impossible",
                        "{tag}: position {position:g m} is outside {low:g in m} to {high:g m}, where no stem can be: "
                        "check the position sensor and its scaling",
                        tag=self._tag,
                        position=position_m,
                        low=self._range_m[0],
                        high=self._range_m[1],
                    )
                )
        if self._band_m is not None and math.isfinite(self._entry_m):
            away_m = abs(position_m - self._entry_m)
            if away_m > self._band_m and self._off_band.note(sample.sent_s):
                return DeviceError(
                    say(
                        "stem_left_band",
                        "{tag}: the stem is {away:g m} from where it stood before the test, limits.band_m allows "
                        "{allowed:g m}: choose a smaller range",
                        tag=self._tag,
                        away=away_m,
                        allowed=self._band_m,
                    )
                )
        return self._spiking(sample)

    def _spiking(self, sample: Sample) -> DeviceError | None:
        acting_pa = sample.pressure_pa if math.isfinite(sample.pressure_pa) else sample.output_pa
        self._recent.append((sample.sent_s, sample.position_m, acting_pa))
        if len(self._recent) < 3:
            return None
        (first_s, first_m, first_pa), (middle_s, middle_m, middle_pa), (last_s, last_m, last_pa) = self._recent
        before = abs(middle_pa - first_pa), middle_s - first_s
        now = abs(last_pa - middle_pa), last_s - middle_s
        if _beyond_ramp(before, now) > _STRUCK_SHARE * self._span_pa:
            self._struck_s = last_s
        if self._range_m is None or last_s - self._struck_s < _RINGS_S:
            return None
        spike_m = _SPIKE_SHARE * (self._range_m[1] - self._range_m[0])
        away_m = min(abs(middle_m - first_m), abs(middle_m - last_m))
        there_and_back = away_m > max(spike_m, _SPIKE_WAYS * abs(last_m - first_m))
        # A pressure that goes one way moves no stem there and back.
        if there_and_back and min(first_pa, last_pa) <= middle_pa <= max(first_pa, last_pa):
            self._spikes_s.append(sample.sent_s)
        if len(self._spikes_s) < _SPIKES or self._spikes_s[-1] - self._spikes_s[0] > _SPIKES_WITHIN_S:
            return None
        return DeviceError(
            say(
                "position_jumps",
                "{tag}: the position jumped to and fro {times} times within {time:g s}, as no stem can: "
                "check the position sensor and its cable",
                tag=self._tag,
                times=_SPIKES,
                time=_SPIKES_WITHIN_S,
            )
        )

    def _ip_stuck(self, sample: Sample) -> DeviceError | None:
        if not math.isfinite(sample.pressure_pa):
            return None
        if not abs(sample.pressure_pa - self._rest_pa) <= _PRESSURE_MOVED * self._span_pa:
            self._rest_pa, self._outputs = sample.pressure_pa, (sample.output_pa, sample.output_pa)
            self._unfollowed_s = math.inf
            return None
        self._outputs = min(self._outputs[0], sample.output_pa), max(self._outputs[1], sample.output_pa)
        change_pa = self._outputs[1] - self._outputs[0]
        if not self._standstill or change_pa <= _FOLLOWING_SHARE * self._span_pa:
            return None
        self._unfollowed_s = min(self._unfollowed_s, sample.sent_s)
        if sample.sent_s - self._unfollowed_s < _STANDS_S:
            return None
        return DeviceError(
            say(
                "pressure_does_not_follow",
                "{tag}: the output changed by {change:.4g Pa} and the actuator's pressure stayed at "
                "{pressure:.4g Pa}: check the I/P, its air supply and the pressure sensor",
                tag=self._tag,
                change=change_pa,
                pressure=sample.pressure_pa,
            )
        )

    def _behind_ip(self, sample: Sample) -> float:
        """Return the pressure at the actuator if its I/P were the slowest, Pa."""
        if math.isfinite(self._behind_pa):
            waited_s = max(0.0, sample.sent_s - self._behind_s)
            self._behind_pa += (sample.output_pa - self._behind_pa) * -math.expm1(-waited_s / _SLOWEST_IP_S)
        else:
            self._behind_pa = sample.output_pa
        self._behind_s = sample.sent_s
        return self._behind_pa

    def _standing(self, sample: Sample) -> DeviceError | None:
        position_m = sample.position_m
        behind_pa, blind = self._behind_ip(sample), not math.isfinite(sample.pressure_pa)
        acting_pa = behind_pa if blind else sample.pressure_pa
        self._same = self._same + 1 if position_m == self._last_m else 0
        self._last_m = position_m
        if not abs(position_m - self._rest_m) <= self._moved_m:
            self._rest_m, self._pressures, self._enough_s = position_m, (acting_pa, acting_pa), math.inf
            self._asked = sample.output_pa, sample.output_pa
            return None
        self._pressures = min(self._pressures[0], acting_pa), max(self._pressures[1], acting_pa)
        self._asked = min(self._asked[0], sample.output_pa), max(self._asked[1], sample.output_pa)
        change_pa = self._pressures[1] - self._pressures[0]
        enough = change_pa > self._breakaway_pa
        if blind:
            enough = change_pa > _BEHIND_SHARE * self._breakaway_pa
            change_pa = self._asked[1] - self._asked[0]
            enough = enough and change_pa > self._breakaway_pa
        if not (self._standstill and enough):
            return None
        self._enough_s = min(self._enough_s, sample.sent_s)
        if sample.sent_s - self._enough_s < _STANDS_S:
            return None
        swept = say("pressure_changed", "the pressure changed by {change:.4g Pa}", change=change_pa)
        if self._noisy and self._same >= _SAME_BITS:
            return FrozenSensorError(
                say(
                    "sensor_frozen",
                    "{tag}: {swept} and the position shows the very same {position:g m} for {looks} looks, "
                    "without the noise that it had before: the position sensor is frozen, check it",
                    tag=self._tag,
                    swept=swept,
                    position=position_m,
                    looks=self._same,
                )
            )
        return NoBreakawayError(
            say(
                "no_breakaway",
                "{tag}: {swept} and the stem did not break away from {position:g m}, a healthy one moves "
                "within {healthy:.4g Pa}: the stem is stuck, look at packing, seat and actuator",
                tag=self._tag,
                swept=swept,
                position=position_m,
                healthy=self._breakaway_pa,
            )
        )


def _beyond_ramp(before: tuple[float, float], now: tuple[float, float]) -> float:
    """Return by how much the faster of two changes (amount, time) exceeds a ramp as fast as the slower one.

    A step of the pressure stands out so; a ramp that is looked at late does not, nor does its turn.
    """
    (slower, slower_s), (faster, faster_s) = sorted((before, now), key=lambda change: change[0] / max(change[1], 1e-9))
    return faster - slower * faster_s / max(slower_s, 1e-9)
