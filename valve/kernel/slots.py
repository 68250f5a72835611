"""The flat vectors that the extended valve's kernels share: its slots ``q``, curves over travel, what goes on.

Slots stand in one flat vector ``q`` (SLOTS names its places), curves over travel in the rows of ``curves``, what the
future depends on in ``state`` (STATES). Times in s, lengths in m, forces in N.
"""

from __future__ import annotations

import math
from typing import Final

# The places in q and their neutral values; the parameters themselves have none.
SLOTS: Final = {
    "m": 1.0, "k": 0.0, "F_v": 0.0, "F_c": 0.0, "F_s": 0.0, "DV": 1.0, "F_0": 0.0,
    "low": -math.inf, "high": math.inf, "low_rate": math.inf, "high_rate": math.inf,
    "hardening": 0.0, "hardening_bend": 0.0, "hardening_middle": 0.0,
    "knee": 0.0, "knee_rate": 0.0, "flow": 0.0, "flow_decay": 1.0,
    "area_slope": 0.0, "area_reference": 0.0,
    "gradient": 0.0, "gradient_reference": 0.0, "gradient_bend": 0.0,
    "spot": 0.0, "spot_centre": 0.0, "spot_width": 1.0,
    "drift": 0.0, "drift_time": 1.0, "pressure_share": 0.0, "static_share": 1.0,
    "coulomb_asymmetry": 0.0, "static_asymmetry": 0.0, "viscous_asymmetry": 0.0,
    "stribeck_velocity": 0.0, "dwell_rise": 0.0, "dwell_time": 1.0, "first_rise": 0.0, "presliding": 0.0,
    "vibration": 0.0, "vibration_rate": 1.0, "vibration_phase": 0.0,
    "position_gain": 1.0, "gain_reference": 0.0, "bow": 0.0, "bow_low": 0.0, "bow_span": 1.0,
    "bow_skew": 0.0, "bow_ends": 0.0,
    "position_lag": 0.0, "play": 0.0,
    "spring_points": 0.0, "spring_from": 0.0, "spring_to": 1.0,
    "area_points": 0.0, "area_from": 0.0, "area_to": 1.0,
    "friction_points": 0.0, "friction_from": 0.0, "friction_to": 1.0,
}  # fmt: skip
(
    M, K, F_V, F_C, F_S, D_V, F_0,
    LOW, HIGH, LOW_RATE, HIGH_RATE,
    HARDENING, HARDENING_BEND, HARDENING_MIDDLE, KNEE, KNEE_RATE, FLOW, FLOW_DECAY,
    AREA_SLOPE, AREA_REFERENCE,
    GRADIENT, GRADIENT_REFERENCE, GRADIENT_BEND, SPOT, SPOT_CENTRE, SPOT_WIDTH,
    DRIFT, DRIFT_TIME, PRESSURE_SHARE, STATIC_SHARE,
    COULOMB_ASYMMETRY, STATIC_ASYMMETRY, VISCOUS_ASYMMETRY,
    STRIBECK, DWELL_RISE, DWELL_TIME, FIRST_RISE, PRESLIDING,
    VIBRATION, VIBRATION_RATE, VIBRATION_PHASE,
    GAIN, GAIN_REFERENCE, BOW, BOW_LOW, BOW_SPAN, BOW_SKEW, BOW_ENDS,
    POSITION_LAG, PLAY,
    SPRING_POINTS, SPRING_FROM, SPRING_TO,
    AREA_POINTS, AREA_FROM, AREA_TO,
    FRICTION_POINTS, FRICTION_FROM, FRICTION_TO,
) = range(len(SLOTS))  # fmt: skip
SPRING_CURVE, AREA_CURVE, FRICTION_CURVE = range(3)
# What the future depends on. REST_SINCE and ELAPSED are times of the slots' own clock; BRISTLE, PLAYED and LAGGED
# may be NaN: not loaded yet, nothing shown yet.
STATES: Final = (
    "x", "v", "mode", "elapsed", "rest_since", "never_moved", "bristle", "extra_static", "played", "shown", "lagged",
)  # fmt: skip
(
    AT_X, AT_V, IN_MODE, ELAPSED, REST_SINCE, NEVER_MOVED, BRISTLE, EXTRA, PLAYED, SHOWN, LAGGED,
) = range(len(STATES))  # fmt: skip
