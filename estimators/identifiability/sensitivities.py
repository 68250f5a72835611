"""How the stem's position answers to each parameter: differences of the exact motion, none of them across a jump."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from valve.errors import ParameterError
from valve.kernel.follow import follow
from valve.kernel.modes import FOLLOWED
from valve.kernel.sampling import even_period
from valve.messages import say
from valve.motion_inputs import (
    MOST_EVENTS,
    checked_corners,
    checked_outputs,
    kernel_arguments,
    motion_error,
    require_within_stops,
)
from valve.parameters import TravelStops, ValveParameters
from valve.stem import FloatArray, ModeArray, StemState

SENSITIVITY_SYMBOLS: Final = ("m", "k", "F_v", "F_c", "F_s", "DV", "F_0", "x_0")
# Relative steps: the phase of a slip (some 200 rad/s) moves by some 600 steps, so its cube is 1e-7 of the slope;
# DV moves the stem so little that rounding asks for more.
_RELATIVE_STEP: Final = 1.0e-6
_DV_RELATIVE_STEP: Final = 1.0e-4
_SHRINK: Final = 0.1  # of a step that meets a jump
_SHRINKS: Final = 3
# A second difference beyond this share of the first is a jump, or a corner as sharp as one.
_LARGEST_BEND: Final = 0.1

_NO_VALUES: Final[FloatArray] = np.empty(0)
_NO_MODES: Final[ModeArray] = np.empty(0, np.int8)


def position_sensitivities(
    parameters: ValveParameters,
    force_time_s: npt.ArrayLike,
    force_n: npt.ArrayLike,
    output_time_s: npt.ArrayLike,
    symbols: Sequence[str],
    *,
    stops: TravelStops | None = None,
    initial: StemState | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Position, shape (n,), m, and its derivative to each symbol, shape (n, p), m per the symbol's SI unit.

    ``symbols`` are of SENSITIVITY_SYMBOLS; x_0 is the position at the start. Central differences of the exact
    motion; where the motion on one side has a slip more or less (a jump), the step is made smaller, then the other
    side is taken alone. At a bound (F_s = F_c, F_v = 0, k = 0) the derivative is that to the allowed side.
    Raises ParameterError for an unknown symbol, and as ``simulate_motion``.
    """
    unknown = sorted(set(symbols) - set(SENSITIVITY_SYMBOLS))
    if unknown:
        raise ParameterError(
            say(
                "sensitivity_unknown",
                "{symbol}: no such sensitivity; there are {all:, }",
                symbol=unknown[0],
                all=tuple(SENSITIVITY_SYMBOLS),
            )
        )
    state = StemState() if initial is None else initial
    require_within_stops(state, stops)
    corners = checked_corners(force_time_s, force_n)
    time_s = checked_outputs(output_time_s, float(corners[0][0]))
    follower = _Follower(kernel_arguments(parameters, stops), state, corners, time_s, float(even_period(time_s)))
    centre = follower.path(None, 0.0)
    # one row a symbol, so that each is written in one piece
    derivatives = np.empty((len(symbols), time_s.size))
    for row, symbol in zip(derivatives, symbols, strict=True):
        _differentiate(follower, symbol, centre, row)
    return centre.position_m, derivatives.T


@dataclass(frozen=True, slots=True, eq=False)
class _Path:
    """One motion: positions at the output times, and the modes that it went through."""

    position_m: FloatArray
    modes: ModeArray

    def like(self, other: _Path) -> bool:
        return np.array_equal(self.modes, other.modes)


@dataclass(frozen=True, slots=True, eq=False)
class _Follower:
    """The motion as a function of one changed number."""

    arguments: tuple[float, ...]  # m, k, F_v, F_c, F_s, DV, F_0, low stop, high stop
    initial: StemState
    corners: tuple[FloatArray, FloatArray]
    time_s: FloatArray
    even_step_s: float

    def path(self, symbol: str | None, change: float, room: int = 1024) -> _Path:
        """Return the motion with ``symbol`` changed. Raises MotionError where it has too many events."""
        values = [*self.arguments, self.initial.position_m]
        if symbol is not None:
            values[_PLACES[symbol]] += change
        *arguments, start_m = values
        position_m, event_time_s, event_mode = np.empty(self.time_s.size), np.empty(room), np.empty(room, np.int8)
        end_s = float(self.time_s[-1]) if self.time_s.size else float(self.corners[0][-1])
        status, events, *_ = follow(
            *arguments,
            start_m,
            float(self.initial.velocity_m_per_s),
            int(self.initial.mode),
            *self.corners,
            end_s,
            self.time_s,
            self.even_step_s,
            position_m,
            _NO_VALUES,
            _NO_MODES,
            _NO_VALUES,
            event_time_s,
            event_mode,
            MOST_EVENTS,
        )
        if status != FOLLOWED:
            raise motion_error(tuple(arguments), status, events, MOST_EVENTS)
        if events > room:
            return self.path(symbol, change, room=events)
        return _Path(position_m, event_mode[:events])

    def step(self, symbol: str) -> float:
        """Return the step of the differences, in the symbol's unit; a value of 0 is stepped by what would matter."""
        swing_n = float(np.ptp(self.corners[1])) or 1.0
        mass_kg, spring_n_per_m = self.arguments[:2]
        travel_m = swing_n / spring_n_per_m if spring_n_per_m > 0.0 else 1.0
        stiffness_n_per_m = swing_n / travel_m
        scales = {
            "k": stiffness_n_per_m,
            "F_v": math.sqrt(stiffness_n_per_m * mass_kg),
            "F_c": swing_n,
            "F_s": swing_n,
            "F_0": swing_n,
            "x_0": travel_m,
        }
        value = self.initial.position_m if symbol == "x_0" else self.arguments[_PLACES[symbol]]
        if symbol in {"F_0", "x_0"} or value == 0.0:
            return _RELATIVE_STEP * scales[symbol]
        return (_DV_RELATIVE_STEP if symbol == "DV" else _RELATIVE_STEP) * value

    def room(self, symbol: str) -> tuple[float, float]:
        """Return how far the symbol may go down and up."""
        _, k, F_v, F_c, F_s, _, _, low_m, high_m = self.arguments
        start_m = self.initial.position_m
        rooms = {
            "k": (k, math.inf),
            "F_v": (F_v, math.inf),
            "F_c": (F_c, F_s - F_c),
            "F_s": (F_s - F_c, math.inf),
            "x_0": (start_m - low_m, high_m - start_m),
        }
        return rooms.get(symbol, (math.inf, math.inf))


# x_0 comes after the kernel's nine arguments
_PLACES: Final = {"m": 0, "k": 1, "F_v": 2, "F_c": 3, "F_s": 4, "DV": 5, "F_0": 6, "x_0": 9}


def _differentiate(follower: _Follower, symbol: str, centre: _Path, out: FloatArray) -> None:
    """Write the derivative to ``symbol`` into ``out``, shape (n,)."""
    step = follower.step(symbol)
    below, above = follower.room(symbol)
    if min(below, above) < 2.0 * step:
        _one_side(follower, symbol, centre, step if above >= below else -step, out)
        return
    lower, upper = follower.path(symbol, -step), follower.path(symbol, step)
    for _ in range(_SHRINKS):
        if _central(lower, centre, upper, step, out):
            return
        step *= _SHRINK
        lower, upper = follower.path(symbol, -step), follower.path(symbol, step)
    if _central(lower, centre, upper, step, out):
        return
    jumps_up = float(np.abs(upper.position_m - centre.position_m).max(initial=0.0))
    jumps_down = float(np.abs(lower.position_m - centre.position_m).max(initial=0.0))
    _one_side(follower, symbol, centre, step if jumps_up <= jumps_down else -step, out)


def _central(lower: _Path, centre: _Path, upper: _Path, step: float, out: FloatArray) -> bool:
    """Write the central difference; False where there is a jump between the two sides."""
    np.subtract(upper.position_m, lower.position_m, out=out)
    if not (lower.like(centre) and upper.like(centre)) and not _is_smooth(lower, centre, upper, out):
        return False
    out /= 2.0 * step
    return True


def _is_smooth(lower: _Path, centre: _Path, upper: _Path, difference_m: FloatArray) -> bool:
    """Whether the positions bend little between both sides: then modes that differ moved nothing."""
    bend_m = upper.position_m + lower.position_m
    bend_m -= 2.0 * centre.position_m
    return bool(np.abs(bend_m).max(initial=0.0) <= _LARGEST_BEND * np.abs(difference_m).max(initial=0.0))


def _one_side(follower: _Follower, symbol: str, centre: _Path, step: float, out: FloatArray) -> None:
    """Write the one-sided derivative: of second order, or of first where the farther point lies behind a jump."""
    near, far = follower.path(symbol, step), follower.path(symbol, 2.0 * step)
    np.subtract(near.position_m, centre.position_m, out=out)
    if _is_smooth(centre, near, far, out):
        out *= 4.0
        out -= far.position_m - centre.position_m
        out /= 2.0 * step
    else:
        out /= step
