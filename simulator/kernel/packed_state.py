"""The flat vectors of a stem with a packing: the packing, and what goes on beside the extended valve's state."""

from __future__ import annotations

from typing import Final

from valve.kernel.slots import STATES

STUCK, BAND, SLIP, SLIDE, STOPPED = range(5)
# What the packing is, in the order of the kernel's vector ``p``.
PACKING_SLOTS: Final = (
    "scatter", "static_share", "wander_n", "wander_time", "first_rise_n", "first_rise_time", "filter", "start", "step",
)  # fmt: skip
(P_SCATTER, P_SHARE, P_WANDER, P_WANDER_TIME, P_RISE, P_RISE_TIME, P_FILTER, P_START, P_STEP) = range(
    len(PACKING_SLOTS)
)
# What goes on beside the extended valve's own state. ``since_knot``: time since the earlier one of the two knots of the
# wander that it lies between. ``wander_integral`` and ``_squares``: over the record's time. ``up_``, ``down_``: from
# where to where the stem moved in the record, opening and closing.
MORE_STATES: Final = (
    "age", "still_since", "draw", "side", "draws", "slipped", "knot", "since_knot", "wander_from", "wander_to",
    "filtered", "record_time", "wander_integral", "wander_squares",
    "up_low", "up_high", "down_low", "down_high",
)  # fmt: skip
(
    AGE, STILL_SINCE, DRAW, SIDE, DRAWS, SLIPPED, KNOT, SINCE_KNOT, WANDER_FROM, WANDER_TO, FILTERED,
    RECORD_TIME, WANDER_INTEGRAL, WANDER_SQUARES,
    UP_LOW, UP_HIGH, DOWN_LOW, DOWN_HIGH,
) = range(len(STATES), len(STATES) + len(MORE_STATES))  # fmt: skip
STATE_SIZE: Final = len(STATES) + len(MORE_STATES)

KNOT_S: Final = 0.05  # between two knots of the wander, straight lines
