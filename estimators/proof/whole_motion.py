"""The whole recorded motion as the exact motion of some valve follows it: sections without a break, from rests on."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.identifiability.sensitivities import position_sensitivities
from estimators.samples import FloatArray
from valve.errors import ValveError
from valve.motion import simulate_motion
from valve.parameters import PARAMETER_SYMBOLS, TravelStops, parameters_from_symbols
from valve.stem import StemState

SYMBOLS: Final = tuple(PARAMETER_SYMBOLS)
_WITH_START: Final = (*SYMBOLS, "x_0")
SOON_S: Final = 1.0e-6  # a difference of delays
_MOST_EVENTS: Final = 20_000

Corners = tuple[FloatArray, FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """Blocks of rows without a break, from a rest on: the force's corners (s, N), the same 1 us later, what was seen.

    The position is followed at two times a block, ``time_s`` (2 b,), a standard deviation of its rows' times about
    their mean: the mean of both is that of the block to the third order. ``position_m`` (b,) is the measured mean of
    ``rows`` (b,) rows, and 1 / ``weight`` (b,) its error in one row's noise: the inverse of their root, or more where
    their instants are in doubt.
    """

    corners: Corners
    late: Corners
    time_s: FloatArray
    position_m: FloatArray
    rows: FloatArray
    weight: FloatArray
    start_m: float

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return int(self.position_m.size)

    def means(self, position_m: FloatArray) -> FloatArray:
        """Mean of each block, of positions followed at its two times: shape (b,) or (b, n)."""
        return np.asarray(0.5 * (position_m[::2] + position_m[1::2]))


@dataclass(frozen=True, slots=True, eq=False)
class WholeMotion:
    """All sections of a recording, with the noise of its position and what is known of its channels' delay.

    ``delay_sd_s`` is one standard deviation; ``delay_doubt_s`` the same if nothing that the recording says of it holds,
    0 where it is sure. ``force_is_sure``: the force's own noise does nothing to the position that its noise shows.
    ``breakaway_rate_n_per_s`` is the force's usual rate at a breakaway. ``is_stepped``: the force is a polled command's
    staircase, which is taken for lines.
    """

    sections: tuple[Section, ...]
    noise_m: float
    delay_sd_s: float
    delay_doubt_s: float
    stops: TravelStops | None
    force_is_sure: bool
    breakaway_rate_n_per_s: float
    is_stepped: bool = False

    @property
    def blocks(self) -> int:
        """Number of blocks that are compared."""
        return sum(section.blocks for section in self.sections)

    @property
    def rows(self) -> float:
        """Number of rows in them."""
        return float(sum(section.rows.sum() for section in self.sections))

    def ratio(self, cost: float) -> float:
        """What a row leaves, in the noise's standard deviations: a cost of the blocks, and the noise within them."""
        return math.sqrt(max(0.0, self.rows - self.blocks + cost) / self.rows)

    def residual(self, values: FloatArray, starts_m: FloatArray) -> FloatArray | None:
        """Measured minus followed position in the noise's standard deviations, shape (blocks,); None for no motion.

        ``values`` (7,) are of SYMBOLS, SI; ``starts_m`` (sections,) where the stem rests at each section's start.
        """
        parts = []
        for section, start_m in zip(self.sections, starts_m.tolist(), strict=True):
            try:
                valve = parameters_from_symbols(dict(zip(SYMBOLS, values.tolist(), strict=True)))
                motion = simulate_motion(
                    valve,
                    *section.corners,
                    section.time_s,
                    stops=self.stops,
                    initial=self._start(start_m),
                    most_events=_MOST_EVENTS,
                )
            except ValveError:
                return None
            parts.append((section.position_m - section.means(motion.position_m)) * section.weight / self.noise_m)
        residual = np.concatenate(parts)
        return residual if bool(np.isfinite(residual).all()) else None

    def slopes(self, values: FloatArray, starts_m: FloatArray) -> FloatArray | None:
        """Derivatives of the followed position, in the noise's standard deviations, shape (8 + sections, blocks).

        To the 7 values, to the delay of the force (s), and to each section's start (m).
        """
        valve = parameters_from_symbols(dict(zip(SYMBOLS, values.tolist(), strict=True)))
        slopes = np.zeros((len(SYMBOLS) + 1 + len(self.sections), self.blocks))
        first = 0
        for number, (section, start_m) in enumerate(zip(self.sections, starts_m.tolist(), strict=True)):
            rows = slice(first, first + section.blocks)
            first = rows.stop
            start = self._start(start_m)
            try:
                position_m, own = position_sensitivities(
                    valve, *section.corners, section.time_s, _WITH_START, stops=self.stops, initial=start
                )
                late = simulate_motion(valve, *section.late, section.time_s, stops=self.stops, initial=start)
            except ValveError:
                return None
            weight = section.weight / self.noise_m
            each = section.means(own).T * weight
            slopes[: len(SYMBOLS), rows] = each[:-1]
            slopes[len(SYMBOLS), rows] = section.means(late.position_m - position_m) * weight / SOON_S
            slopes[len(SYMBOLS) + 1 + number, rows] = each[-1]
        return slopes if bool(np.isfinite(slopes).all()) else None

    def _start(self, start_m: float) -> StemState:
        if self.stops is None:
            return StemState(start_m)
        return StemState(min(max(start_m, self.stops.low_m), self.stops.high_m))
