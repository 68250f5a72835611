"""A stem with a packing, followed piece by piece, and the truth about it that an estimate is judged by."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from simulator.kernel.follow_packed import follow_packed
from simulator.kernel.packed_friction import next_knot
from simulator.kernel.packed_state import (
    AGE,
    DOWN_LOW,
    DRAW,
    FILTERED,
    RECORD_TIME,
    STATE_SIZE,
    STILL_SINCE,
    UP_LOW,
    WANDER_FROM,
    WANDER_INTEGRAL,
    WANDER_SQUARES,
    WANDER_TO,
)
from simulator.kernel.random_numbers import normal_of
from valve.extended_state import ExtendedState
from valve.extended_valve import ExtendedValve
from valve.kernel.slots import AT_V, AT_X, BRISTLE, ELAPSED, IN_MODE, REST_SINCE, STATES
from valve.packing import Packing, RoughnessTable
from valve.parameters import ValveParameters
from valve.stem import Mode, ModeArray, StemState

FloatArray = npt.NDArray[np.float64]

STEP_S: Final = 4.0e-5  # tests/simulator/test_packed_stem.py states the error that it leaves
_NO_VALUES: Final[FloatArray] = np.empty(0)
_MOST_BREAKAWAYS: Final = 4096  # that are noted of one piece
_MOST_KEPT: Final = 100_000  # of a record; older ones are dropped


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What an estimate of one record is judged by.

    ``parameters``: m, k, F_v and DV as made; F_c the mean of both directions' friction over the travel that each swept
    and over the time recorded, F_0 with half of their difference, F_s the mean force of a breakaway at a place of that
    travel and a time of the record, without what a long rest before the first one adds. Scatters are standard
    deviations in N: of F_s about its mean where it breaks away (``static_scatter_n``) and with what place adds
    (``static_spread_n``), of F_c as it was drawn for this travel and time (``coulomb_spread_n``). An effect that
    changes a parameter itself (a preload, the excess of a Stribeck friction) is in it, what any other adds is not.
    ``swept_m``: from where to where the stem moved opening, and closing; NaN where it did not.

    Each breakaway: when (s, from the start of the record), where and at which net force it began, above 0 opening;
    shape (n_breakaways,). ``rests_s``: when the stem came to rest again, shape (n_rests,).
    """

    parameters: ValveParameters
    static_scatter_n: float
    static_spread_n: float
    coulomb_spread_n: float
    swept_m: tuple[tuple[float, float], tuple[float, float]]
    wander_n: float  # mean over the record
    breakaways_s: FloatArray
    breakaways_m: FloatArray
    breakaways_n: FloatArray
    rests_s: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PackedMotion:
    """A motion, arrays of shape (n,) at the times asked for.

    ``friction_n``: what F_c, effects and packing come to at each place and time, signed by the last direction.
    """

    position_m: FloatArray
    sensed_m: FloatArray
    velocity_m_per_s: FloatArray
    mode: ModeArray
    friction_n: FloatArray


class PackedStem:
    """The stem of a valve with a packing and a sensor with a filter; the same seed gives always the same motion.

    Its roughness is the valve's own, drawn before; what differs from time to time (breakaways, wander) is drawn by
    ``seed``. It has rested for very long when it begins. ``step_s`` is the longest time step.
    """

    def __init__(
        self,
        valve: ExtendedValve,
        packing: Packing,
        roughness: RoughnessTable,
        start_m: float,
        *,
        seed: int = 0,
        filter_s: float = 0.0,
        step_s: float = STEP_S,
    ) -> None:
        self._valve, self._packing, self._seed, self._step_s = valve, packing, seed, step_s
        made = valve.parameters
        coulomb_n = made.coulomb_friction_n
        self._share = made.static_friction_n / coulomb_n if coulomb_n > 0.0 else 1.0
        self._roughness = roughness
        self._table = np.vstack((roughness.opening_n, roughness.closing_n))
        self._slots, self._curves = valve.vector(), valve.curves()
        self._p = np.array(
            (
                packing.breakaway_scatter,
                self._share,
                packing.wander * coulomb_n,
                packing.wander_time_s,
                packing.first_rise * made.static_friction_n,
                packing.first_rise_time_s,
                filter_s,
                self._roughness.start_m,
                self._roughness.step_m,
            )
        )
        self._state = np.zeros(STATE_SIZE)
        self._state[: len(STATES)] = ExtendedState(StemState(start_m, 0.0)).vector()
        self._state[STILL_SINCE] = -math.inf
        self._state[DRAW] = normal_of(seed, 1, 0)
        if self._p[2] > 0.0:
            self._state[WANDER_TO] = self._p[2] * normal_of(seed, 2, 0)
            next_knot(self._p, self._state, seed)
        self.begin_record()
        # The sensor has been there for long: it shows the start.
        self._run(np.zeros(1), np.zeros(1), _NO_VALUES)

    @property
    def state(self) -> StemState:
        """Where the stem is and how fast."""
        return StemState(float(self._state[AT_X]), float(self._state[AT_V]), Mode(int(self._state[IN_MODE])))

    @property
    def sensed_m(self) -> float:
        """Position that the sensor shows, before its noise and resolution, m."""
        return float(self._state[FILTERED])

    def advance(self, time_s: FloatArray, force_n: FloatArray) -> None:
        """Go on under this actuator force to its last corner; arrays: shape (n_corners,)."""
        self._run(time_s, force_n, _NO_VALUES)

    def sample(self, time_s: FloatArray, force_n: FloatArray, wanted_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Go on in the same way and say where the stem was at ``wanted_s``, shape (n,); corners: shape (n_corners,)."""
        motion = self._run(time_s, force_n, wanted_s)
        return motion.position_m, motion.sensed_m

    def motion(self, time_s: FloatArray, force_n: FloatArray, wanted_s: FloatArray) -> PackedMotion:
        """Go on in the same way and return all that can be said.

        Force of shape (n_corners,); ``wanted_s``, shape (n,), rises up to the last corner.
        """
        return self._run(time_s, force_n, wanted_s)

    def hold(self, duration_s: float, wanted_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Stay where it is, whatever the force: the stem is jammed, and only the sensor still settles.

        ``wanted_s``: shape (n,).
        """
        state = self._state
        state[AT_V], state[IN_MODE], state[BRISTLE] = 0.0, Mode.STUCK, math.nan
        held_at = self._slots.copy()
        held = replace(self._valve, parameters=replace(self._valve.parameters, static_friction_n=1.0e15))
        self._slots = held.vector()
        try:
            return self.sample(np.array((0.0, duration_s)), np.zeros(2), wanted_s)
        finally:
            self._slots = held_at

    def begin_record(self) -> None:
        """Begin what counts from the start of a record anew: a drift, a vibration's phase, the truth's averages."""
        state = self._state
        state[REST_SINCE] -= state[ELAPSED]
        if math.isfinite(state[STILL_SINCE]):
            state[STILL_SINCE] -= state[AGE]
        state[ELAPSED] = state[AGE] = 0.0
        state[RECORD_TIME] = state[WANDER_INTEGRAL] = state[WANDER_SQUARES] = 0.0
        self._breakaways: deque[tuple[float, float, float]] = deque(maxlen=_MOST_KEPT)
        self._rests_s: deque[float] = deque(maxlen=_MOST_KEPT)
        for first in (UP_LOW, DOWN_LOW):
            state[first : first + 2] = (math.inf, -math.inf)

    def truth(self) -> Truth:
        """Return the truth about the record so far; without motion the fields' values where the stem rests."""
        state, made, packing = self._state, self._valve.parameters, self._packing
        wander_n, wandered_n2 = float(state[WANDER_FROM]), 0.0
        if state[RECORD_TIME] > 0.0:
            wander_n = float(state[WANDER_INTEGRAL] / state[RECORD_TIME])
            wandered_n2 = max(float(state[WANDER_SQUARES] / state[RECORD_TIME]) - wander_n**2, 0.0)
        means_n, places_n, swept_m = [], [], []
        for first, opening in ((UP_LOW, True), (DOWN_LOW, False)):
            low_m, high_m = float(state[first]), float(state[first + 1])
            moved = low_m < high_m
            swept_m.append((low_m, high_m) if moved else (math.nan, math.nan))
            if not moved:
                low_m = high_m = float(state[AT_X])
            means_n.append(self._roughness.mean_n(low_m, high_m, opening=opening))
            values = self._roughness.opening_n if opening else self._roughness.closing_n
            fine_m = np.linspace(low_m, high_m, 2001)
            places_n.append(np.interp(fine_m, self._roughness.places_m, values))
        added_n = np.concatenate(places_n) + wander_n
        level_n = made.static_friction_n + self._share * added_n
        least_n = made.coulomb_friction_n + added_n
        mean_n, deviation_n = _at_least(level_n, packing.breakaway_scatter * np.abs(level_n), least_n)
        coulomb_n = made.coulomb_friction_n + 0.5 * (means_n[0] + means_n[1]) + wander_n
        # about F_0 with half of the directions' difference, as an estimate sees them
        half_n = 0.5 * (means_n[0] - means_n[1])
        sides_n = np.repeat((-half_n, half_n), mean_n.size // 2)
        static_n = made.static_friction_n if packing.is_ideal else float(mean_n.mean())
        events = np.array(self._breakaways).reshape(-1, 3).T
        parameters = replace(
            made,
            coulomb_friction_n=coulomb_n,
            static_friction_n=max(static_n, coulomb_n),
            preload_n=made.preload_n + half_n,
        )
        return Truth(
            parameters,
            static_scatter_n=float(np.sqrt(np.mean(deviation_n**2))),
            static_spread_n=float(np.sqrt(np.mean(deviation_n**2) + np.var(mean_n + sides_n))),
            coulomb_spread_n=math.sqrt(float(np.var(added_n + sides_n)) + wandered_n2),
            swept_m=(swept_m[0], swept_m[1]),
            wander_n=wander_n,
            breakaways_s=events[0],
            breakaways_m=events[1],
            breakaways_n=events[2],
            rests_s=np.array(self._rests_s),
        )

    def _run(self, time_s: FloatArray, force_n: FloatArray, wanted_s: FloatArray) -> PackedMotion:
        outputs = position_m, sensed_m, velocity_m_per_s, friction_n = np.empty((4, wanted_s.size))
        mode = np.empty(wanted_s.size, np.int8)
        events = np.empty((4, _MOST_BREAKAWAYS))
        before_s = float(self._state[RECORD_TIME]) - float(time_s[0])
        breakaways, rests = follow_packed(
            self._slots,
            self._curves,
            self._p,
            self._table,
            self._seed,
            self._state,
            time_s,
            force_n,
            float(time_s[-1]),
            wanted_s,
            self._step_s,
            *outputs[:3],
            mode,
            friction_n,
            *events,
        )
        if breakaways < 0 and self._breakaways:
            self._breakaways.pop()
        self._breakaways += [
            (before_s + at_s, at_m, level_n) for at_s, at_m, level_n in events[:3, : max(breakaways, 0)].T.tolist()
        ]
        self._rests_s += [before_s + at_s for at_s in events[3, :rests].tolist()]
        return PackedMotion(position_m, sensed_m, velocity_m_per_s, mode, friction_n)


def plain_truth(parameters: ValveParameters) -> Truth:
    """Return the truth about a valve whose friction is the same everywhere and always."""
    nowhere = (math.nan, math.nan)
    return Truth(parameters, 0.0, 0.0, 0.0, (nowhere, nowhere), 0.0, _NO_VALUES, _NO_VALUES, _NO_VALUES, _NO_VALUES)


def _at_least(mean: FloatArray, deviation: FloatArray, least: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean and standard deviation of max(X, least) for normal X of this mean and deviation, shape as given."""
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.where(deviation > 0.0, (mean - least) / deviation, np.where(mean >= least, np.inf, -np.inf))
    above = 0.5 * (1.0 + np.vectorize(math.erf, otypes=[np.float64])(u / math.sqrt(2.0)))
    density = np.exp(-0.5 * np.minimum(u * u, 1.0e3)) / math.sqrt(2.0 * math.pi)
    first = mean * above + least * (1.0 - above) + deviation * density
    second = (mean**2 + deviation**2) * above + (mean + least) * deviation * density + least**2 * (1.0 - above)
    return np.asarray(first), np.asarray(np.sqrt(np.maximum(second - first**2, 0.0)))
