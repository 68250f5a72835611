"""A seat or a stop inside the travel swept."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar, Final

import numpy as np
import numpy.typing as npt

from discrepancy.rough.causes.base import Fitted
from discrepancy.rough.causes.seen import Seen, View
from discrepancy.rough.setting import Setting
from estimators.engine.segmentation import moving_mean
from valve.effects.base import Effect
from valve.effects.travel_stop_high import TravelStopHigh as HighEffect
from valve.effects.travel_stop_low import TravelStopLow as LowEffect
from valve.messages import say

_LEAST_S: Final = 0.12  # between the arrival and the turn of the force; where that was more than any friction
_AT_LEAST_S: Final = 0.03  # and
_LATER: Final = 3.0  # times how late the stem is
_DRIVEN_BANDS: Final = 6.0  # of the band of a rest that the force would have driven the stem on
_LEAST_RISE: Final = 0.006  # of the full force: a hunting I/P does half of it by itself
_UNTOLD: Final = 4.0  # times that where no command tells what an I/P does by itself, and
_REPEATS: Final = 0.01  # of that way the turns differ by more, as they do at no stop
_HUNTS: Final = 8.0  # standard deviations of what an I/P does by itself: the highest swing while a command is held
_SMOOTHED_S: Final = 0.2
_SAME_PLACE: Final = 0.1  # of that way: how far arrivals at one stop may differ
_FEWEST_VISITS: Final = 2
_PRESSED_BANDS: Final = 2.0  # the same way of a stem that is pressed against a stop for a moment, by
_PRESSED: Final = 0.5  # of F_s more than that
_FEWEST_PRESSED: Final = 3
_BEYOND: Final = 0.004  # of the travel that a reading may show beyond the stop
_SLIDING: Final = 0.3  # of the speed by the force's rate, at least, with which a sliding stem arrives
_NEAR_S: Final = 0.1
_EVEN: Final = 0.7  # least of the force's rates over the largest, before and in a rest to which no command led
_HELD: Final = 5.0  # standard deviations of the breakaway by which a stop holds more than friction


@dataclass(frozen=True, slots=True)
class _Arrival:
    """A stem that came to rest while the force went on: where, and how far the force would have driven it.

    ``is_sliding``: it came from steady motion, in which friction holds no stem. ``is_held``: the net force that it
    withstood is surely more than F_s. ``is_pressed``: far more, if only for a moment.
    """

    place_m: float
    way_m: float
    is_sliding: bool
    is_held: bool
    is_pressed: bool


def _rise(force_n: npt.NDArray[np.float64]) -> float:
    """By how much the force rises, N: twice from the mean of its first half to that of its second.

    A starved I/P hunts about its limit, and its highest swing is no force that goes on.
    """
    half = force_n.size // 2
    return 2.0 * float(force_n[half:].mean() - force_n[:half].mean()) if half else 0.0


def _may_hunt(view: View, visits_m: npt.NDArray[np.float64], way_m: float) -> bool:
    """Whether an I/P may have driven the force on by itself: by so little, where the turns do not repeat."""
    small_m = _UNTOLD * _LEAST_RISE * view.setting.full_force_n / view.null.known("k").value
    differ_m = 1.4826 * float(np.median(np.abs(visits_m - np.median(visits_m))))  # as a standard deviation
    return way_m < small_m and differ_m > _REPEATS * way_m


class _TravelStop(ABC):
    name: ClassVar[str]
    action: ClassVar[str]
    direction: ClassVar[int]
    is_last: ClassVar[bool] = False
    by_slips: ClassVar[bool] = True

    @abstractmethod
    def _effect(self, place_m: float) -> Effect:
        """Return the effect that a simulated valve takes."""

    def seen(self, view: View) -> Seen | None:
        """Return the stop if the stem arrived there twice, once at least with a force that went on, and never went on.

        It slid in without a reason to stop, or the force at rest was more than any friction; in the last percent of a
        sweep far more, three times for a moment. A stem that sticks and slips stops without a reason, so that only the
        force counts.
        """
        places_m, arrivals = self._arrivals(view)
        slides = not self._sticks(view)
        shown = [one for one in arrivals if (slides and one.is_sliding) or one.is_held]
        if not shown:
            shown = [one for one in arrivals if one.is_pressed]
            if len(shown) < _FEWEST_PRESSED:
                return None
        band_m = view.reading.segmentation.band_m
        place_m = float(np.median([one.place_m for one in shown]))
        same_m = band_m + _SAME_PLACE * min(one.way_m for one in shown)
        visits_m = places_m[np.abs(places_m - place_m) < same_m]
        if int(np.sum(self.direction * (places_m - place_m) > same_m)) > visits_m.size:
            return None  # it went on more often than it stopped there
        if view.recording.command_pa is None and _may_hunt(view, visits_m, max(one.way_m for one in shown)):
            return None
        extreme_m = view.setting.high_m if self.direction > 0 else view.setting.low_m
        if visits_m.size < _FEWEST_VISITS or abs(extreme_m - place_m) > band_m + _BEYOND * view.setting.travel_m:
            return None
        error_m = max(float(np.std(visits_m)), view.reading.noise_m) / np.sqrt(visits_m.size)
        return Seen({"position_m": Fitted(place_m, float(error_m), "m")}, self._effect(place_m))

    def _sticks(self, view: View) -> bool:
        """Whether the stem came to rest between two moves of this direction, while the force drove on evenly."""
        reading = view.reading
        time_s, force_n = reading.time_s, self.direction * reading.path.force_n
        moves, rests = reading.segmentation.moves, reading.segmentation.rests
        for move, after in pairwise(moves):
            goes_on = move.direction == after.direction == self.direction and move.next_rest >= 0
            if not goes_on or after.rest != move.next_rest:
                continue
            rest = rests[move.next_rest]
            near_s = min(_NEAR_S, 0.5 * float(time_s[rest.last] - time_s[rest.first]))
            first_s, last_s = float(time_s[rest.first]), float(time_s[rest.last])
            at_n = np.interp([first_s - near_s, first_s, first_s + near_s, last_s - near_s, last_s], time_s, force_n)
            steps_n = np.array([at_n[1] - at_n[0], at_n[2] - at_n[1], at_n[4] - at_n[3]])
            if float(steps_n.min()) > _EVEN * float(steps_n.max()) > 0.0:
                return True
        return False

    def _arrivals(self, view: View) -> tuple[npt.NDArray[np.float64], list[_Arrival]]:
        """Where the stem turned, m, and of these its arrivals while the force still went on."""
        reading, null = view.reading, view.null
        time_s, force_n = reading.time_s, self.direction * reading.path.force_n
        moves, rests = reading.segmentation.moves, reading.segmentation.rests
        spring = null.known("k").value
        static_n = null.known("F_s").value
        scatter_n = float(np.hypot(null.hyperparameter("scatter"), null.known("F_s").std_error))
        short_s = max(_AT_LEAST_S, _LATER * view.setting.late_s)
        width = 2 * (max(1, round(_SMOOTHED_S / reading.samples.period_s)) // 2) + 1
        hunts_n = float(np.std(moving_mean(reading.path.left_n, width)))
        least_n = max(_LEAST_RISE * view.setting.full_force_n, _HUNTS * hunts_n)
        found, places_m = [], []
        for move, after in zip(moves, [*moves[1:], None], strict=True):
            leaves_back = after is None or after.direction == -self.direction
            if move.direction != self.direction or move.next_rest < 0 or not leaves_back:
                continue
            rest = rests[move.next_rest]
            places_m.append(rest.level_m)
            most = rest.first + int(np.argmax(force_n[rest.first : rest.last + 1]))
            went_on_n = _rise(force_n[rest.first : most + 1])
            way_m = went_on_n / spring
            after_s = float(time_s[most] - time_s[rest.first])
            net_n = self.direction * (
                self.direction * float(force_n[most]) - spring * rest.level_m - null.known("F_0").value
            )
            over_n = net_n - static_n
            beyond = over_n / max(scatter_n, 1.0e-9)
            bands = way_m / reading.segmentation.band_m
            goes_on = went_on_n > least_n and bands > _DRIVEN_BANDS
            goes_on = goes_on and after_s > (min(short_s, _LEAST_S) if beyond > _HELD else _LEAST_S)
            pressed = bands > _PRESSED_BANDS and after_s > short_s and over_n > max(least_n, _PRESSED * static_n)
            if not (goes_on or pressed):
                continue
            before = max(move.first, int(np.searchsorted(time_s, time_s[rest.first] - _NEAR_S)))
            passed_s = max(float(time_s[rest.first] - time_s[before]), 1.0e-6)
            speed = abs(float(reading.position_m[rest.first] - reading.position_m[before])) / passed_s
            driven = abs(float(force_n[rest.first] - force_n[before])) / passed_s / spring
            is_sliding = goes_on and _SLIDING * driven < speed < driven / _SLIDING
            found.append(_Arrival(rest.level_m, way_m, is_sliding, goes_on and beyond > _HELD, pressed))
        return np.array(places_m), found

    def sentence(self, fitted: Mapping[str, Fitted], setting: Setting) -> str:
        """Return what a fitter is told."""
        entry = fitted["position_m"]
        return say(
            "runs_into_stop",
            "The stem runs into a stop at {place}, {percent:.1f} % travel.",
            place=entry.in_words("mm"),
            percent=setting.percent(entry.value),
        )


class TravelStopLow(_TravelStop):
    """A stop where the stem closes."""

    name: ClassVar[str] = "travel_stop_low"
    action: ClassVar[str] = say(
        "travel_stop_low_action", "Look at the seat and at what may lie on it, and at the stroke's adjustment."
    )
    direction: ClassVar[int] = -1

    def _effect(self, place_m: float) -> Effect:
        return LowEffect(place_m, 0.0)


class TravelStopHigh(_TravelStop):
    """A stop where the stem opens."""

    name: ClassVar[str] = "travel_stop_high"
    action: ClassVar[str] = say(
        "travel_stop_high_action", "Look at the limit screw or handwheel and at what may lie in the body."
    )
    direction: ClassVar[int] = 1

    def _effect(self, place_m: float) -> Effect:
        return HighEffect(place_m, 0.0)
