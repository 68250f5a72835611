"""When a test must end by itself: the wire is lost, a limit is passed, the output does not follow."""

from __future__ import annotations

import math
import time
from collections import deque
from typing import Final

from drivers.addresses import MotionLimits
from drivers.device import ValveDevice
from drivers.outcome import Sample
from drivers.permissive_watch import PermissiveWatch
from drivers.recent import Recent, RecentLooks, window_s
from drivers.stem_rules import StemRules
from valve.errors import DeviceError, EquipmentError, MeasurementError, WireError
from valve.messages import message_of, say

_FAILURES: Final = 5  # at least, and half of the looks; fewer would end a test for one disturbance on the line
_FAILURES_WITHIN: Final = 2.0  # windows
_SILENCE_S: Final = 1.0  # without any answer, after more than one failure
_FRESH_S: Final = 0.5  # nothing is driven by a look that is older
_BLIND_S: Final = 1.0  # without a valid position or pressure, or within twice as long half of the looks without
_UNSEEN: Final = 3  # looks without one, at least: more than a slow test takes in that time would never count
_BEYOND: Final = 2  # samples beyond a limit within a window; a single one may be a spike
_FOLLOWING_S: Final = 0.5  # a PLC's scan and its output card
_PROMPT: Final = 5  # changed commands in a row that were there at the next look: this output has no lag
_FOREIGN: Final = 3  # looks at an output that nobody here asked for; one may be a write that the wire changed
_FOREIGN_WITHIN_S: Final = 2.0
_PRESSURE_SLACK: Final = 0.05  # of the limits' span: an I/P overshoots and a sensor is not exact
_DURATION_SLACK_S: Final = 5.0


class AbortRules:
    """Watches one test; ``fault`` tells the first rule that was broken.

    ``believed`` is whether the output of the last sample was asked for here: whatever moves the stem where it was not,
    it is not what would be recorded.
    """

    def __init__(self, device: ValveDevice, limits: MotionLimits, longest_s: float, period_s: float) -> None:
        self._device = device
        self._limits = limits
        self._longest_s = longest_s + _DURATION_SLACK_S
        self._last_error: EquipmentError | None = None
        self._silence_s = max(_SILENCE_S, 2.0 * period_s)
        self._blind_s = max(_BLIND_S, self._silence_s)
        self._commands: deque[tuple[float, float]] = deque()
        self._asked: deque[tuple[float, float]] = deque()  # what an output that lags may still show
        self._foreign_s: deque[float] = deque(maxlen=_FOREIGN)
        self._window_s = window_s(period_s)
        self._stem = StemRules(device.wiring, self._window_s)
        self._watch: PermissiveWatch | None = None
        self.believed = True
        self.begin()

    def begin(
        self, entry: Sample | None = None, unrest_m: float = math.nan, watch: PermissiveWatch | None = None
    ) -> None:
        """Count from now: the first motion is about to begin.

        ``entry`` is how the valve stood before, ``unrest_m`` how much its position varied then.
        """
        self._watch = watch
        if watch is not None:
            watch.begin()
        self._stem.begin(entry, unrest_m)
        self._looked_s = -math.inf
        if entry is not None:
            self.commanded(entry.output_pa)
            self._looked_s = entry.sent_s
        self._started_s = self._followed_s = self._answered_s = time.monotonic()
        # A gauge that shows nothing before the test is none: many a device has its register and no sensor behind it.
        has_gauge = entry is not None and math.isfinite(entry.pressure_pa)
        measured = ("position", "pressure") if has_gauge else ("position",)
        self._seen_s = dict.fromkeys(measured, self._started_s)
        self._seen = {name: RecentLooks(_UNSEEN, 2.0 * self._blind_s) for name in measured}
        self._failures = 0  # since the last answer
        self._looks = RecentLooks(_FAILURES, _FAILURES_WITHIN * self._window_s)
        self._beyond = Recent(_BEYOND, self._window_s)
        self._prompt, self._judged_pa = _PROMPT, math.nan  # until it shows a lag: that costs one gap

    def commanded(self, pressure_pa: float) -> None:
        """Note what was asked for, Pa."""
        now_s = time.monotonic()
        self._commands.append((now_s, pressure_pa))
        self._asked.append((now_s, pressure_pa))
        while len(self._asked) > 1 and self._asked[1][0] < now_s - _FOLLOWING_S:
            self._asked.popleft()

    def stand_down(self) -> None:
        """Judge no longer whether the stem moves: the pressure goes back because it did not."""
        self._stem.stand_down()

    @property
    def look_is_old(self) -> bool:
        """Whether the last look says too little of now to drive by it."""
        return time.monotonic() - self._looked_s > _FRESH_S

    def permissive_lost(self) -> DeviceError | None:
        """Return which permissive that no sample shows is lost; nothing is asked for it."""
        return None if self._watch is None else self._watch.lost()

    def missed(self, error: EquipmentError) -> None:
        """Note a transaction that failed."""
        self._failures += 1
        self._looks.note(time.monotonic(), failed=True)
        self._last_error = error

    def fault(self, sample: Sample | None, *, follows: bool = True) -> EquipmentError | MeasurementError | None:
        """Return why the test must end now, or None. ``follows``: whether the output is commanded by us."""
        tag, now_s = self._device.tag, time.monotonic()
        if now_s - self._started_s > self._longest_s:
            return MeasurementError(
                say(
                    "test_too_long",
                    "{tag}: the test lasts longer than {longest:.3g s}, it is ended",
                    tag=tag,
                    longest=self._longest_s,
                )
            )
        lost = self.permissive_lost()
        if lost is not None:
            return lost
        if sample is not None:
            self._failures, self._answered_s, self._looked_s = 0, now_s, sample.sent_s
            self._looks.note(now_s, failed=False)
        silent = self._failures > 1 and now_s - self._answered_s > self._silence_s
        if silent or self._looks.too_many_failed:
            return WireError(
                say(
                    "communication_lost",
                    "{tag}: communication is lost, too many looks failed: {why}",
                    tag=tag,
                    why="None" if self._last_error is None else message_of(self._last_error),
                )
            )
        if sample is None:
            return None
        if self._device.drives_safe_itself(sample):
            return DeviceError(
                say(
                    "watchdog_tripped",
                    "{tag}: the device went to its safe value by itself: its watchdog tripped",
                    tag=tag,
                )
            )
        blind = self._blind(sample, now_s)
        if blind is not None:
            return blind
        gone = None if self._watch is None else self._watch.judge(sample)
        following = self._not_following(sample, now_s) if follows else None
        return gone or self._beyond_limits(sample) or self._stem.fault(sample) or following

    def _blind(self, sample: Sample, now_s: float) -> DeviceError | None:
        """Return which measured value the limits cannot be watched by any more: half of it or all is not valid."""
        for name, seen in self._seen.items():
            is_valid = math.isfinite(sample.position_m if name == "position" else sample.pressure_pa)
            seen.note(now_s, failed=not is_valid)
            if is_valid:
                self._seen_s[name] = now_s
            unseen_s, began_s = now_s - self._seen_s[name], now_s - self._started_s
            said = ""
            if unseen_s > self._blind_s:
                said = say("unseen_for", "no valid {quantity} for {time:.2g s}", quantity=name, time=unseen_s)
            elif began_s > self._blind_s and seen.too_many_failed:
                said = say(
                    "unseen_half_of_looks",
                    "no valid {quantity} in half of the looks within {time:.2g s}",
                    quantity=name,
                    time=2.0 * self._blind_s,
                )
            if said:
                return DeviceError(
                    say(
                        "value_not_seen",
                        "{tag}: {why}: check the {quantity} sensor, its cable and its range",
                        tag=self._device.tag,
                        why=said,
                        quantity=name,
                    )
                )
        return None

    def _beyond_limits(self, sample: Sample) -> EquipmentError | None:
        low_pa, high_pa = self._limits.pressure_pa
        slack_pa = _PRESSURE_SLACK * (high_pa - low_pa)
        broken = ""
        if sample.pressure_pa < low_pa - slack_pa or sample.pressure_pa > high_pa + slack_pa:
            broken = say(
                "pressure_beyond_limits",
                "pressure {pressure:g Pa} is outside {low:g in Pa} to {high:g Pa}",
                pressure=sample.pressure_pa,
                low=low_pa,
                high=high_pa,
            )
        if self._limits.position_m is not None:
            low_m, high_m = self._limits.position_m
            if sample.position_m < low_m or sample.position_m > high_m:
                broken = say(
                    "position_beyond_limits",
                    "position {position:g m} is outside {low:g in m} to {high:g m}",
                    position=sample.position_m,
                    low=low_m,
                    high=high_m,
                )
        if not (broken and self._beyond.note(sample.sent_s)):
            return None
        return DeviceError(
            say("limit_passed", "{tag}: {what}: check the valve and its limits", tag=self._device.tag, what=broken)
        )

    def foreign(self, output_pa: float) -> DeviceError | None:
        """Return why the test must end where an output is, for the third time lately, outside of what it asked for.

        That is somebody else, whose command the next one of ours covers up again: it need not stand to be seen. At a
        turn an output that lags goes through the same values twice, so that what was shown once says nothing.
        """
        now_s, slack_pa = time.monotonic(), self._device.tolerance_pa
        lately = [pressure_pa for _, pressure_pa in self._asked]
        if not lately or min(lately) - slack_pa <= output_pa <= max(lately) + slack_pa:
            return None
        self._foreign_s.append(now_s)
        if len(self._foreign_s) < _FOREIGN or now_s - self._foreign_s[0] > _FOREIGN_WITHIN_S:
            return None
        return DeviceError(
            say(
                "command_of_another",
                "{tag}: {commanded:g Pa} are commanded and the device shows {shown:g Pa}, {times} times "
                "within {time:g s}: check that nobody else commands it, by another master",
                tag=self._device.tag,
                commanded=self._commands[-1][1],
                shown=output_pa,
                times=_FOREIGN,
                time=_FOREIGN_WITHIN_S,
            )
        )

    def _is_asked_for(self, sample: Sample) -> bool:
        """Whether an output is one that was asked for lately; from a device that follows at once, the newest."""
        slack_pa, newest_pa = self._device.tolerance_pa, self._commands[-1][1]
        lately = [pressure_pa for _, pressure_pa in self._commands]
        at_once = abs(sample.output_pa - newest_pa) <= slack_pa
        asked_for = min(lately) - slack_pa <= sample.output_pa <= max(lately) + slack_pa
        believed = at_once or (asked_for and self._prompt < _PROMPT)
        if not abs(newest_pa - self._judged_pa) <= slack_pa:  # only a command that changed shows how prompt a device is
            self._prompt = min(self._prompt + 1, 2 * _PROMPT) if at_once else max(0, self._prompt - 2)
            self._judged_pa = newest_pa
        return believed

    def _forget_what_is_over(self, sample: Sample) -> None:
        """Drop commands before the one that the output shows: it never goes back to them, but by a late write."""
        for place in range(len(self._commands) - 1, 0, -1):
            if abs(self._commands[place][1] - sample.output_pa) <= self._device.tolerance_pa:
                for _ in range(place):
                    self._commands.popleft()
                return

    def _not_following(self, sample: Sample, now_s: float) -> EquipmentError | None:
        """Compare with everything that was commanded lately: an output may lag and may not differ."""
        while len(self._commands) > 1 and self._commands[1][0] < sample.sent_s - _FOLLOWING_S:
            self._commands.popleft()
        self.believed = True
        if not self._commands:
            return None
        self.believed = self._is_asked_for(sample)
        if self.believed:
            self._followed_s = now_s
            self._forget_what_is_over(sample)
            return None
        if now_s - self._followed_s <= _FOLLOWING_S:
            return self.foreign(sample.output_pa)
        return DeviceError(
            say(
                "output_does_not_follow",
                "{tag}: {commanded:g Pa} are commanded and the device shows {shown:g Pa}: check that it is "
                "in automatic and nobody else commands it",
                tag=self._device.tag,
                commanded=self._commands[-1][1],
                shown=sample.output_pa,
            )
        )
