"""Where the stem is where a sensor was read: what the sensor makes of a position is taken back."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from discrepancy.observed import Segment
from estimators.samples import FloatArray
from valve.extended_state import ExtendedState, Rests
from valve.extended_valve import ExtendedValve, SensorPath
from valve.kernel.loads import extra_static, load, static_level
from valve.stem import StemState

_AT_A_STOP: Final = 5.0  # standard errors of the first place, within which a stop may be where the stem rests


def start_state(
    segment: Segment, shown_m: float, velocity: float, valve: ExtendedValve, force_n: float
) -> ExtendedState:
    """Return the state in which this valve begins a segment whose first reading, without noise, is ``shown_m``.

    ``velocity``: that of the stem there, m/s; ``force_n``: what the actuator pushes with.

    After a gap the stem has moved before: its first breakaway is over, and a play's lever trails where it came from.
    A stem that rests beside a rigid stop, and is pushed there by more than friction holds, rests at the stop: begun a
    noise away it would fall the rest of the way, and have its first breakaway behind it.
    """
    sensor = valve.sensor
    settled_m = shown_m + velocity * sensor.lag_s
    played_m = float(_followed(np.array([settled_m]), sensor)[0])
    stem_m = played_m + 0.5 * sensor.play_m * segment.start_sense
    stops = valve.stops
    low_m = stops.low_m if math.isinf(stops.low_rate_n_per_m) else -math.inf
    high_m = stops.high_m if math.isinf(stops.high_rate_n_per_m) else math.inf
    has_moved = segment.start_sense != 0.0
    stem_m = min(max(stem_m, low_m), high_m)
    if not has_moved and velocity == 0.0:
        near_m = _AT_A_STOP * segment.start_error_m
        if low_m < stem_m <= low_m + near_m and _pushed(valve, stem_m, segment.elapsed_s, force_n) < 0.0:
            stem_m = low_m
        elif high_m - near_m <= stem_m < high_m and _pushed(valve, stem_m, segment.elapsed_s, force_n) > 0.0:
            stem_m = high_m
    return ExtendedState(
        StemState(stem_m, velocity),
        elapsed_s=segment.elapsed_s,
        rest_since_s=segment.rest_since_s,
        never_moved=not has_moved,
        sensor_m=(played_m, settled_m, shown_m) if has_moved else None,
    )


def _pushed(valve: ExtendedValve, stem_m: float, elapsed_s: float, force_n: float) -> float:
    """Return the direction in which the forces move a stem that rests there, 0 where friction holds it."""
    q = valve.vector()
    net_n, more_n, _ = load(q, valve.curves(), stem_m, elapsed_s, force_n)
    side = math.copysign(1.0, net_n)
    return side if abs(net_n) > static_level(q, side, more_n, extra_static(q, 0.0, True)) else 0.0


def rests_of(segment: Segment, sensor: SensorPath) -> Rests | None:
    """Return the places of the stem at the measured rests of a segment; None where it has none."""
    if segment.rest_time_s.size == 0:
        return None
    # the play's lever follows behind the stem
    followed_m = _followed(segment.rest_m, sensor)
    return Rests(segment.rest_time_s, followed_m + 0.5 * sensor.play_m * segment.rest_sense)


def _followed(shown_m: FloatArray, sensor: SensorPath) -> FloatArray:
    """Positions of the lever that the sensor shows as ``shown_m``, m, shape (n,), once it has settled."""
    straight = shown_m
    if sensor.gain != 1.0:
        straight = sensor.gain_reference_m + (shown_m - sensor.gain_reference_m) / sensor.gain
    if sensor.bow_m == 0.0:
        return straight
    place = straight
    for _ in range(3):
        u = (place - sensor.bow_low_m) / sensor.bow_span_m
        way = 2.0 * u - 1.0
        place = straight - 4.0 * sensor.bow_m * u * (1.0 - u) * (1.0 + way * (sensor.bow_skew + sensor.bow_ends * way))
    return place
