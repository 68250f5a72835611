"""The compiled fit of slips: positions after each breakaway and their derivatives, summed to normal equations.

From breakaway on the stem creeps below the limit velocity DV, m v' = F - F_s, for t_c = sqrt(2 m DV / rate). Then it
slides at DV as long as the force is below F_c + F_v DV, if it is. From there on it obeys
m x'' + F_v x' + k x = F - F_0 - s F_c on a straight force, so that with the lag d = x_s - x behind steady motion x_s
the position is x_s - d, and d is made of the impulse response S of m d'' + F_v d' + k d = 0 and of H = 1 - (k/m) S1:
d = d(0) H + d'(0) S. After a corner of the force the stem coasts on from where it is, down to DV, and rests.

Unknowns of all slips: m, F_v, k, A = F_c + F_v v_ref, F_0, F_s, DV; of each one: its own F_s less the common one, and
where it rested. Lengths are in m, forces in N, times in s.
"""

# mypy: allow-untyped-defs
# numba types each kernel from its arguments; an annotation would be a second, unchecked one.
# ruff: noqa: PLR0917 - kernels take flat numbers in order
from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numba import njit

from valve.motion_kernel import impulse_response

M: Final = 0
F_V: Final = 1
K: Final = 2
A: Final = 3
F_0: Final = 4
F_S: Final = 5
D_V: Final = 6
OWN_F_S: Final = 7
REST: Final = 8
COMMON: Final = 7  # unknowns that all slips share
UNKNOWNS: Final = 9
_STEP: Final = 1.0e-6
_BISECTIONS: Final = 50

kernel: Any = njit(cache=True, error_model="numpy")


@kernel
def responses(tau, c, w2, out):
    """Put S', S, H and the derivatives of each to c and w2 into ``out``, shape (3, 3)."""
    rate, value, once, _ = impulse_response(tau, c, w2)
    out[0, 0], out[0, 1], out[0, 2] = rate, value, 1.0 - w2 * once
    by_c, by_w2 = c * _STEP + 1.0e-12, w2 * _STEP + 1.0e-12
    r, v, o, _ = impulse_response(tau, c + by_c, w2)
    out[1, 0], out[1, 1], out[1, 2] = (r - rate) / by_c, (v - value) / by_c, -w2 * (o - once) / by_c
    r, v, o, _ = impulse_response(tau, c, w2 + by_w2)
    out[2, 0], out[2, 1] = (r - rate) / by_w2, (v - value) / by_w2
    out[2, 2] = ((1.0 - (w2 + by_w2) * o) - out[0, 2]) / by_w2


@kernel
def propagate(tau, d_tau, m, c, w2, line, d_line, speed, d_speed, lag, d_lag, lag_rate, d_lag_rate, table, grad):
    """Return position and velocity after tau from lag and lag rate; the position's gradient goes into ``grad[0]``.

    ``grad[1]`` gets the velocity's. ``line`` is the steady position at tau = 0 and ``speed`` its velocity.
    """
    responses(tau, c, w2, table)
    rate, value, height = table[0, 0], table[0, 1], table[0, 2]
    for i in range(UNKNOWNS):
        by_c, by_w2 = 0.0, 0.0
        if i == M:
            by_c, by_w2 = -c / m, -w2 / m
        elif i == F_V:
            by_c = 1.0 / m
        elif i == K:
            by_w2 = 1.0 / m
        d_rate = table[1, 0] * by_c + table[2, 0] * by_w2 + (-c * rate - w2 * value) * d_tau[i]
        d_value = table[1, 1] * by_c + table[2, 1] * by_w2 + rate * d_tau[i]
        d_height = table[1, 2] * by_c + table[2, 2] * by_w2 - w2 * value * d_tau[i]
        grad[0, i] = (
            d_line[i] + d_speed[i] * tau + speed * d_tau[i]
            - d_lag[i] * height - lag * d_height - d_lag_rate[i] * value - lag_rate * d_value
        )  # fmt: skip
        grad[1, i] = (
            d_speed[i] + d_lag[i] * w2 * value + lag * (by_w2 * value + w2 * d_value)
            - d_lag_rate[i] * rate - lag_rate * d_rate
        )  # fmt: skip
    return (
        line + speed * tau - lag * height - lag_rate * value,
        speed + lag * w2 * value - lag_rate * rate,
    )


@kernel
def time_to_rest(s, limit, c, w2, speed, lag, lag_rate, longest):
    """Time in which the velocity s v falls to the limit velocity, or ``longest`` where it does not."""
    low, high = 0.0, -1.0
    for part in range(1, 65):
        tau = longest * (part / 64.0) ** 2
        rate, value, _, _ = impulse_response(tau, c, w2)
        if s * (speed + lag * w2 * value - lag_rate * rate) <= limit:
            high = tau
            break
        low = tau
    if high < 0.0:
        return longest
    for _ in range(_BISECTIONS):
        tau = 0.5 * (low + high)
        rate, value, _, _ = impulse_response(tau, c, w2)
        if s * (speed + lag * w2 * value - lag_rate * rate) <= limit:
            high = tau
        else:
            low = tau
    return 0.5 * (low + high)


@kernel
def slip_rows(common, v_ref, own, rest, slip, time, position, jacobian):
    """Put the positions of one slip at ``time`` (n,) into ``position`` (n,), the gradients into ``jacobian`` (n, 9).

    ``slip``: direction, force rate, force at time 0, time of the corner (inf: none), force rate after it.
    """
    m, viscous, k, limit = common[M], common[F_V], common[K], common[D_V]
    s, rate, force, corner, rate_after = slip[0], slip[1], slip[2], slip[3], slip[4]
    c, w2 = viscous / m, k / m
    table, grad = np.zeros((3, 3)), np.zeros((2, UNKNOWNS))
    d_begin, d_creep, d_crept = np.zeros(UNKNOWNS), np.zeros(UNKNOWNS), np.zeros(UNKNOWNS)
    d_net, d_sliding, d_tau = np.zeros(UNKNOWNS), np.zeros(UNKNOWNS), np.zeros(UNKNOWNS)
    # the instant of breakaway: s (F - k rest - F_0) = F_s
    begin = (s * (common[F_S] + own) + k * rest + common[F_0] - force) / rate
    d_begin[F_S] = d_begin[OWN_F_S] = s / rate
    d_begin[K], d_begin[F_0], d_begin[REST] = rest / rate, 1.0 / rate, k / rate
    # creep: s v = |rate| t^2 / (2 m) up to DV
    creep = math.sqrt(2.0 * m * limit / abs(rate))
    d_creep[M], d_creep[D_V] = 0.5 * creep / m, 0.5 * creep / limit
    crept = limit * creep / 3.0
    d_crept[M], d_crept[D_V] = 0.5 * crept / m, 1.5 * crept / limit
    net = common[F_S] + own + abs(rate) * creep - k * crept
    d_net[F_S] = d_net[OWN_F_S] = 1.0
    d_net[K] = -crept
    d_net[M] = abs(rate) * d_creep[M] - k * d_crept[M]
    d_net[D_V] = abs(rate) * d_creep[D_V] - k * d_crept[D_V]
    # slide at DV while the force is below the friction in motion
    sliding, climb = 0.0, abs(rate) - k * limit
    short = common[A] + viscous * (limit - v_ref) - net
    if short > 0.0 and climb > 0.0:
        sliding = short / climb
        for i in range(UNKNOWNS):
            d_sliding[i] = -d_net[i] / climb
        d_sliding[A] += 1.0 / climb
        d_sliding[F_V] += (limit - v_ref) / climb
        d_sliding[D_V] += viscous / climb + sliding * k / climb
        d_sliding[K] += sliding * limit / climb
        net += short
        d_net[:] = 0.0
        d_net[A], d_net[F_V], d_net[D_V] = 1.0, limit - v_ref, viscous
    start = begin + creep + sliding
    d_tau = -(d_begin + d_creep + d_sliding)
    speed = rate / k
    d_speed = np.zeros(UNKNOWNS)
    d_speed[K] = -speed / k
    lag = s * (net - common[A] - viscous * (s * speed - v_ref)) / k
    d_lag = s * d_net / k
    d_lag[A] -= s / k
    d_lag[F_V] -= s * (s * speed - v_ref) / k
    d_lag[K] += -lag / k + viscous * speed / (k * k)
    lag_rate = speed - s * limit
    d_lag_rate = d_speed.copy()
    d_lag_rate[D_V] -= s
    line = rest + s * crept + s * limit * sliding + lag
    d_line = s * d_crept + s * limit * d_sliding + d_lag
    d_line[D_V] += s * sliding
    d_line[REST] += 1.0
    turned, still_after, stopped = False, math.inf, False
    late_tau, late = np.zeros(UNKNOWNS), np.zeros((4, UNKNOWNS))
    late_line = late_speed = late_lag = late_rate = 0.0
    stop_position, stop_gradient = 0.0, np.zeros(UNKNOWNS)
    for row in range(time.size):
        age = time[row] - begin
        if age <= 0.0:
            position[row] = rest
            jacobian[row] = 0.0
            jacobian[row, REST] = 1.0
            continue
        if age <= creep:
            part = age / creep
            position[row] = rest + s * crept * part**3
            jacobian[row] = -s * limit * part * part * d_begin
            jacobian[row, REST] += 1.0
            continue
        if time[row] <= start:
            position[row] = rest + s * crept + s * limit * (age - creep)
            jacobian[row] = s * d_crept - s * limit * (d_begin + d_creep)
            jacobian[row, D_V] += s * (age - creep)
            jacobian[row, REST] += 1.0
            continue
        if time[row] <= corner:
            position[row], _ = propagate(
                time[row] - start, d_tau, m, c, w2, line, d_line, speed, d_speed, lag, d_lag, lag_rate, d_lag_rate,
                table, grad,
            )  # fmt: skip
            jacobian[row] = grad[0]
            continue
        if not turned:
            turned = True
            at, pace = propagate(
                max(corner - start, 0.0), d_tau, m, c, w2, line, d_line, speed, d_speed, lag, d_lag, lag_rate,
                d_lag_rate, table, grad,
            )  # fmt: skip
            late_speed = rate_after / k
            friction = common[A] + viscous * (s * late_speed - v_ref)
            late_line = (force + rate * corner - common[F_0] - s * friction) / k
            late[0, K] = -late_line / k + viscous * late_speed / (k * k)
            late[0, F_0], late[0, A] = -1.0 / k, -s / k
            late[0, F_V] = -s * (s * late_speed - v_ref) / k
            late[1, K] = -late_speed / k
            late_lag, late_rate = late_line - at, late_speed - pace
            late[2], late[3] = late[0] - grad[0], late[1] - grad[1]
            still_after = time_to_rest(s, limit, c, w2, late_speed, late_lag, late_rate, time[-1] - corner)
        tau = min(time[row] - corner, still_after)
        if stopped:
            position[row] = stop_position
            jacobian[row] = stop_gradient
            continue
        position[row], pace = propagate(
            tau, late_tau, m, c, w2, late_line, late[0], late_speed, late[1], late_lag, late[2], late_rate, late[3],
            table, grad,
        )  # fmt: skip
        jacobian[row] = grad[0]
        if tau == still_after:
            # the instant of rest moves too: s v = DV there
            slowing = late_lag * w2 * table[0, 0] + late_rate * (c * table[0, 0] + w2 * table[0, 1])
            if s * slowing < 0.0:
                jacobian[row] -= pace * grad[1] / slowing
                jacobian[row, D_V] += pace * s / slowing
            stopped = True
            stop_position = position[row]
            stop_gradient[:] = jacobian[row]


@kernel
def normal_equations(common, v_ref, own, rest, slips, first, time, seen, weight, tie, normal, local, costs):
    """Sum the normal equations of all slips; return the weighted sum of squares, ties included.

    ``normal`` (7, 8) gets those of the common unknowns with the slips' own eliminated, right-hand side last.
    ``local`` (slips, 2, 10) gets what gives the own ones back: their equations' inverse (2, 2) times the coupling
    to the common ones (7) and to the right-hand side (1), and the inverse itself (2).
    ``costs`` (slips,) gets each one's share of the sum.
    ``tie`` is the weight that keeps a slip's F_s with the common one; infinite: it is the common one.
    """
    normal[:] = 0.0
    cost = 0.0
    for slip in range(slips.shape[0]):
        begin, end = first[slip], first[slip + 1]
        position, jacobian = np.empty(end - begin), np.empty((end - begin, UNKNOWNS))
        slip_rows(common, v_ref, own[slip], rest[slip], slips[slip], time[begin:end], position, jacobian)
        full = np.zeros((UNKNOWNS, UNKNOWNS + 1))
        before = cost
        for row in range(end - begin):
            left = seen[begin + row] - position[row]
            if not math.isfinite(left):
                return math.inf
            cost += weight[begin + row] * left * left
            for i in range(UNKNOWNS):
                pushed = weight[begin + row] * jacobian[row, i]
                for j in range(i, UNKNOWNS):
                    full[i, j] += pushed * jacobian[row, j]
                full[i, UNKNOWNS] += pushed * left
        for i in range(UNKNOWNS):
            for j in range(i):
                full[i, j] = full[j, i]
        costs[slip] = cost - before
        inverse = np.zeros((2, 2))
        if math.isinf(tie):
            inverse[1, 1] = 1.0 / full[REST, REST]
        else:
            full[OWN_F_S, OWN_F_S] += tie
            full[OWN_F_S, UNKNOWNS] -= tie * own[slip]
            cost += tie * own[slip] * own[slip]
            p, q, r = full[OWN_F_S, OWN_F_S], full[OWN_F_S, REST], full[REST, REST]
            determinant = p * r - q * q
            inverse[0, 0], inverse[1, 1] = r / determinant, p / determinant
            inverse[0, 1] = inverse[1, 0] = -q / determinant
        for one in range(2):
            for i in range(COMMON):
                local[slip, one, i] = inverse[one, 0] * full[OWN_F_S, i] + inverse[one, 1] * full[REST, i]
            local[slip, one, COMMON] = (
                inverse[one, 0] * full[OWN_F_S, UNKNOWNS] + inverse[one, 1] * full[REST, UNKNOWNS]
            )
            local[slip, one, COMMON + 1], local[slip, one, COMMON + 2] = inverse[one, 0], inverse[one, 1]
        for i in range(COMMON):
            for j in range(COMMON):
                normal[i, j] += full[i, j] - full[i, OWN_F_S] * local[slip, 0, j] - full[i, REST] * local[slip, 1, j]
            normal[i, COMMON] += (
                full[i, UNKNOWNS] - full[i, OWN_F_S] * local[slip, 0, COMMON] - full[i, REST] * local[slip, 1, COMMON]
            )
    return cost
