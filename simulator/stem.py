"""The stem of a software valve with what its position sensor makes of it, followed piece by piece."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import Final, Protocol

import numpy as np
import numpy.typing as npt

from valve.extended_motion import ExtendedStem
from valve.extended_state import ExtendedState
from valve.extended_valve import ExtendedValve
from valve.motion import StemIntegrator, StemState, simulate_motion
from valve.parameters import TravelStops, ValveParameters
from valve.stem import Mode

FloatArray = npt.NDArray[np.float64]

# A vibrating stem changes its mode tens of times a second: pieces of this length stay far below the limit of changes.
LONGEST_PIECE_S: Final = 60.0


class FollowedStem(Protocol):
    """A stem at the present time: where it is, what its sensor shows, and how it goes on.

    Forces begin now: their first time is 0. ``sample`` and ``hold`` return true and sensed positions at ``wanted_s``,
    rising times up to the end.
    """

    @property
    def state(self) -> StemState:
        """Where the stem is and how fast."""

    @property
    def sensed_m(self) -> float:
        """Position that the sensor shows, before its noise and resolution, m."""

    def advance(self, time_s: FloatArray, force_n: FloatArray) -> None:
        """Go on under this actuator force to its last corner; arrays: shape (n_corners,)."""

    def sample(self, time_s: FloatArray, force_n: FloatArray, wanted_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Go on in the same way and say where the stem was at ``wanted_s``, shape (n,); corners: shape (n_corners,)."""

    def hold(self, duration_s: float, wanted_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Stay where it is, whatever the force: the stem is jammed. ``wanted_s``: shape (n,)."""

    def begin_record(self) -> None:
        """Begin what counts from the start of a record (a drift, a vibration's phase) anew."""


class PlainStem:
    """The Karnopp valve's stem with a sensor that shows what is there."""

    def __init__(self, parameters: ValveParameters, stops: TravelStops, start_m: float) -> None:
        self._parameters, self._stops = parameters, stops
        self._integrator = StemIntegrator(parameters, stops)
        self.state = StemState(start_m, 0.0)

    @property
    def sensed_m(self) -> float:
        """Position that the sensor shows, m: the true one."""
        return self.state.position_m

    def advance(self, time_s: FloatArray, force_n: FloatArray) -> None:
        """Go on under this actuator force to its last corner; arrays: shape (n_corners,)."""
        self.state = self._integrator.advance(self.state, time_s, force_n)

    def sample(self, time_s: FloatArray, force_n: FloatArray, wanted_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Go on in the same way and say where the stem was at ``wanted_s``, shape (n,); corners: shape (n_corners,)."""
        # A motion ends with its last output: the end of the course is one more.
        motion = simulate_motion(
            self._parameters,
            time_s,
            force_n,
            np.append(wanted_s, time_s[-1]),
            stops=self._stops,
            initial=self.state,
        )
        self.state = motion.final_state
        position_m = motion.position_m[:-1]
        return position_m, position_m

    def hold(self, duration_s: float, wanted_s: FloatArray) -> tuple[FloatArray, FloatArray]:  # noqa: ARG002 - the protocol's
        """Stay where it is: the stem is jammed. ``wanted_s``: shape (n,)."""
        self.state = StemState(self.state.position_m, 0.0)
        position_m = np.full(wanted_s.shape, self.state.position_m)
        return position_m, position_m

    def begin_record(self) -> None:
        """Nothing of this valve counts from the start of a record."""


class StemWithEffects:
    """The extended valve's stem and sensor; its input path is the transducer's business."""

    def __init__(self, valve: ExtendedValve, start_m: float) -> None:
        self._stem = ExtendedStem(valve)
        self._lag_s = valve.sensor.lag_s
        self._now = ExtendedState(StemState(start_m, 0.0))
        # The sensor has been there for long: it shows the start.
        still_s, still_n = np.zeros(1), np.zeros(1)
        self._now = self._stem.advance(self._now, still_s, still_n)

    @property
    def state(self) -> StemState:
        """Where the stem is and how fast."""
        return self._now.stem

    @property
    def sensed_m(self) -> float:
        """Position that the sensor shows, before its noise and resolution, m."""
        return self._now.sensed_m

    def advance(self, time_s: FloatArray, force_n: FloatArray) -> None:
        """Go on under this actuator force to its last corner; arrays: shape (n_corners,)."""
        for piece_s, piece_n in _pieces(time_s, force_n):
            self._now = self._stem.advance(self._now, piece_s, piece_n)

    def sample(self, time_s: FloatArray, force_n: FloatArray, wanted_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Go on in the same way and say where the stem was at ``wanted_s``, shape (n,); corners: shape (n_corners,)."""
        motion = self._stem.motion(self._now, time_s, force_n, np.append(wanted_s, time_s[-1]))
        self._now = motion.final_state
        return motion.position_m[:-1], motion.sensed_m[:-1]

    def hold(self, duration_s: float, wanted_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Stay where it is: the stem is jammed, and only the sensor still settles. ``wanted_s``: shape (n,)."""
        now = self._now
        sensor_m, sensed_m = now.sensor_m, np.full(wanted_s.shape, now.sensed_m)
        if sensor_m is not None and self._lag_s > 0.0:
            played_m, shown_m, lagged_m = sensor_m
            sensed_m = shown_m + (lagged_m - shown_m) * np.exp(-wanted_s / self._lag_s)
            sensor_m = (played_m, shown_m, shown_m + (lagged_m - shown_m) * math.exp(-duration_s / self._lag_s))
        stem = StemState(now.stem.position_m, 0.0, Mode.STUCK)
        self._now = replace(
            now, stem=stem, elapsed_s=now.elapsed_s + duration_s, bristle_n=None, extra_static_n=0.0, sensor_m=sensor_m
        )
        return np.full(wanted_s.shape, stem.position_m), sensed_m

    def begin_record(self) -> None:
        """Begin what counts from the start of a record (a drift, a vibration's phase) anew."""
        now = self._now
        self._now = replace(now, elapsed_s=0.0, rest_since_s=now.rest_since_s - now.elapsed_s)


def _pieces(time_s: FloatArray, force_n: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
    """Return a course cut into pieces of at most LONGEST_PIECE_S, each from 0."""
    end_s = float(time_s[-1])
    if end_s <= LONGEST_PIECE_S:
        return [(time_s, force_n)]
    pieces = []
    count = math.ceil(end_s / LONGEST_PIECE_S)
    edges_s = np.linspace(0.0, end_s, count + 1)
    for from_s, to_s in itertools.pairwise(edges_s):
        inside = (time_s > from_s) & (time_s < to_s)
        ends_n = np.interp([from_s, to_s], time_s, force_n)
        piece_s = np.concatenate(([from_s], time_s[inside], [to_s])) - from_s
        pieces.append((piece_s, np.concatenate((ends_n[:1], force_n[inside], ends_n[1:]))))
    return pieces
