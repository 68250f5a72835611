"""The extended valve by fixed steps, written from its equations: nothing here knows of modes, events or anchors.

valve/extended_valve.py has the equations. Semi-implicit Euler: the velocity first, with the viscous friction
implicitly, then the position; its error shrinks in proportion to the step (1 us: below a micrometre). The bristles
are dynamic here: Dahl's force on the stem's inertia, with a little damping of their own.
"""

# mypy: allow-untyped-defs
# numba types the loop from its arguments.
# ruff: noqa: PLR0917 - a compiled loop over flat numbers
from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from valve.extended_valve import Curve, ExtendedValve

FloatArray = npt.NDArray[np.float64]
compiled: Any = njit(cache=True, error_model="numpy")
BRISTLE_DAMPING_RATIO = 0.7
BREAK_SHARE = 0.98  # of Dahl's asymptote, at which the bristles give way: F_s


class Reference(NamedTuple):
    """Every number of an extended valve under the name that its equation gives it."""

    m: float
    k: float
    F_v: float
    F_c: float
    F_s: float
    DV: float
    F_0: float
    hardening: float
    hardening_bend: float
    hardening_middle: float
    knee: float
    knee_rate: float
    flow_force: float
    flow_decay: float
    area_slope: float
    area_reference: float
    gradient: float
    gradient_reference: float
    gradient_bend: float
    spot: float
    centre: float
    width: float
    drift: float
    drift_time: float
    pressure_share: float
    static_share: float
    a_c: float
    a_s: float
    a_v: float
    v_s: float
    dwell_rise: float
    dwell_time: float
    first_rise: float
    presliding: float
    low: float
    high: float
    low_rate: float
    high_rate: float
    vibration: float
    frequency: float
    phase: float
    gain_in: float
    leak: float
    limit: float
    lag_in: float
    dead_time: float
    gain: float
    gain_reference: float
    bow: float
    bow_low: float
    bow_span: float
    bow_skew: float
    bow_ends: float
    lag: float
    play: float


def numbers(valve: ExtendedValve) -> Reference:
    """Return the numbers of a valve without curves."""
    p, spring, area, friction = valve.parameters, valve.spring, valve.area, valve.friction
    stops, vibration, path, sensor = valve.stops, valve.vibration, valve.input, valve.sensor
    assert spring.curve_n is None
    assert area.curve is None
    assert friction.curve_n is None
    return Reference(
        p.mass_kg, p.spring_rate_n_per_m, p.viscous_friction_n_s_per_m, p.coulomb_friction_n, p.static_friction_n,
        p.limit_velocity_m_per_s, p.preload_n,
        spring.hardening_n_per_m2, spring.hardening_bend_n_per_m3, spring.hardening_middle_m,
        spring.knee_m, spring.knee_rate_n_per_m, spring.flow_force_n, spring.flow_decay_m,
        area.slope_per_m, area.reference_m,
        friction.gradient_n_per_m, friction.gradient_reference_m, friction.gradient_bend_n_per_m2,
        friction.spot_n, friction.spot_centre_m, friction.spot_width_m,
        friction.drift_n, friction.drift_time_s, friction.pressure_share, friction.static_share,
        friction.coulomb_asymmetry, friction.static_asymmetry, friction.viscous_asymmetry,
        friction.stribeck_velocity_m_per_s, friction.dwell_rise_n, friction.dwell_time_s, friction.first_rise_n,
        friction.presliding_m,
        stops.low_m, stops.high_m, stops.low_rate_n_per_m, stops.high_rate_n_per_m,
        vibration.force_n, vibration.frequency_hz, vibration.phase_rad,
        path.gain, path.leak, path.limit_n, path.lag_s, path.dead_time_s,
        sensor.gain, sensor.gain_reference_m, sensor.bow_m, sensor.bow_low_m, sensor.bow_span_m,
        sensor.bow_skew, sensor.bow_ends, sensor.lag_s,
        sensor.play_m,
    )  # fmt: skip


@compiled
def reading(q, played):
    """Return what the sensor shows, bow and gain in it, of a position that has its play in it, m."""
    share = (played - q.bow_low) / q.bow_span
    z = 2.0 * share - 1.0
    y = played + 4.0 * q.bow * share * (1.0 - share) * (1.0 + q.bow_skew * z + q.bow_ends * z * z)
    return q.gain_reference + q.gain * (y - q.gain_reference)


@compiled
def integrate_numbers(q, table_x, table_n, time, force, step, count, stride):
    """Return position and sensed position every ``stride`` of ``count`` steps, m, from rest at 0 or the low stop.

    ``table_x``, ``table_n``: straight lines of more friction over travel, at least two points. What is not in the valve
    is left out, not added as 0: of some ten million steps each exponential takes a quarter of the time.
    """
    positions, sensed = np.zeros(count // stride + 1), np.zeros(count // stride + 1)
    x, v, leg, acting, bound, bristle = 0.0, 0.0, 0, 0.0, q.presliding > 0.0, math.nan
    extra, rest_since, first = 0.0, 0.0, True
    if q.low_rate == math.inf:
        x = max(x, q.low)
    played, shown = x, x
    stiffness = q.F_s / q.presliding if q.presliding > 0.0 else 0.0
    damping = 2.0 * BRISTLE_DAMPING_RATIO * math.sqrt(stiffness * q.m)
    answered = 1.0 - math.exp(-step / q.lag_in) if q.lag_in > 0.0 else 1.0
    followed = 1.0 - math.exp(-step / q.lag) if q.lag > 0.0 else 1.0
    is_uneven, to_output = np.any(table_n != 0.0), 0
    for i in range(count + 1):
        t = i * step
        # input path: dead time, gain, limit, leak, lag
        asked_at = max(t - q.dead_time, time[0])
        while leg + 2 < time.size and time[leg + 1] <= asked_at:
            leg += 1
        share = min((asked_at - time[leg]) / (time[leg + 1] - time[leg]), 1.0)
        asked = force[leg] + share * (force[leg + 1] - force[leg])
        target = (1.0 - q.leak) * min(q.gain_in * asked, q.limit)
        if q.lag_in > 0.0 and i > 0:
            acting += (target - acting) * answered
        else:
            acting = target
        # all but friction
        net = acting * (1.0 + q.area_slope * (x - q.area_reference)) - q.k * x - q.F_0
        net -= q.hardening_bend * (x**3 / 6.0 - q.hardening_middle * x * x / 2.0)
        net -= 0.5 * q.hardening * x * x + q.knee_rate * max(x - q.knee, 0.0)
        if q.flow_force != 0.0:
            net += q.flow_force * math.exp(-max(x, 0.0) / q.flow_decay)
        if q.vibration != 0.0:
            net += q.vibration * math.sin(2.0 * math.pi * q.frequency * t + q.phase)
        if q.low_rate < math.inf:
            net += q.low_rate * max(q.low - x, 0.0)
        if q.high_rate < math.inf:
            net -= q.high_rate * max(x - q.high, 0.0)
        # levels of friction
        more = q.gradient * (x - q.gradient_reference) + q.gradient_bend * (x - q.gradient_reference) ** 2
        if q.spot != 0.0:
            more += q.spot * math.exp(-0.5 * ((x - q.centre) / q.width) ** 2)
        risen = q.drift * (1.0 - math.exp(-t / q.drift_time)) if q.drift != 0.0 else 0.0
        more += risen + q.pressure_share * abs(acting)
        if is_uneven:
            more += np.interp(x, table_x, table_n)
        s = 1.0 if v > 0.0 or (v == 0.0 and net > 0.0) else -1.0
        C = max((q.F_c + more) * (1.0 + s * q.a_c), 0.0)
        if v == 0.0 or bound:
            rested = t - rest_since
            extra = q.dwell_rise * rested / (rested + q.dwell_time) if q.dwell_rise != 0.0 else 0.0
            if first:
                extra += q.first_rise
        push = 1.0 if net > 0.0 else -1.0
        S = max(
            (q.F_s + q.static_share * more + extra) * (1.0 + push * q.a_s), (q.F_c + more) * (1.0 + push * q.a_c), 0.0
        )
        held = abs(net) <= S
        if bound:
            if math.isnan(bristle):
                bristle = net
            asymptote = S / BREAK_SHARE
            side = 1.0 if v > 0.0 else -1.0
            bend = 1.0 - side * bristle / asymptote
            bristle += step * stiffness * v * bend
            if side * bristle >= S:
                bound = False
            else:
                viscous = q.F_v * (1.0 + side * q.a_v) + damping * bend
                v = (v + step / q.m * (net - bristle)) / (1.0 + step * viscous / q.m)
        if not bound:
            if abs(v) < q.DV:
                after = 0.0 if held else v + step / q.m * (net - push * S)
                if after == 0.0 and q.presliding > 0.0:
                    bound, bristle, rest_since = True, net, t
                elif after == 0.0 and v != 0.0:
                    rest_since = t
                v = after
            else:
                extra, first = 0.0, False
                base = max((q.F_s + q.static_share * more) * (1.0 + s * q.a_s), C)
                drag = C
                if q.v_s > 0.0:
                    drag += (base - C) * math.exp(-((v / q.v_s) ** 2))
                viscous = q.F_v * (1.0 + s * q.a_v)
                after = (v + step / q.m * (net - s * drag)) / (1.0 + step * viscous / q.m)
                if held and (after * v < 0.0 or abs(after) < q.DV):
                    after, rest_since = 0.0, t
                    if q.presliding > 0.0:
                        bound, bristle = True, s * C
                v = after
        if to_output == 0:
            positions[i // stride] = x
            sensed[i // stride] = shown if q.lag > 0.0 else reading(q, played)
            to_output = stride
        to_output -= 1
        x += step * v
        if q.high_rate == math.inf and x >= q.high:
            x, v = q.high, min(v, 0.0)
        if q.low_rate == math.inf and x <= q.low:
            x, v = q.low, max(v, 0.0)
        # sensor path
        played = min(max(played, x - 0.5 * q.play), x + 0.5 * q.play)
        if q.lag > 0.0:
            y = reading(q, played)
            if i == 0:
                shown = y
            shown += (y - shown) * followed
    return positions, sensed


def integrate(
    valve: ExtendedValve,
    force_time_s: FloatArray,
    force_n: FloatArray,
    duration_s: float,
    output_step_s: float,
    step_s: float,
    friction_lines: Curve | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Position and sensed position every ``output_step_s``, from rest at 0."""
    lines = Curve(0.0, 1.0, (0.0, 0.0)) if friction_lines is None else friction_lines
    table_x = np.linspace(lines.start_m, lines.end_m, len(lines.values))
    count, stride = round(duration_s / step_s), round(output_step_s / step_s)
    table_n = np.array(lines.values)
    found: tuple[FloatArray, FloatArray] = integrate_numbers(
        numbers(valve), table_x, table_n, force_time_s, force_n, step_s, count, stride
    )
    return found
