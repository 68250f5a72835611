"""The compiled fit of slips: positions after each breakaway and their derivatives, summed to normal equations.

From breakaway on the stem creeps below the limit velocity DV, m v' = F - F_s, for t_c = sqrt(2 m DV / rate). Then it
slides at DV as long as the force is below F_c + F_v DV, if it is. From there on it obeys
m x'' + F_v x' + k x = F - F_0 - s F_c on a straight force, so that with the lag d = x_s - x behind steady motion x_s
the position is x_s - d, and d is made of the impulse response S of d'' + c d' + w2 d = 0, with c = F_v/m and w2 = k/m,
and of H = S' + c S: d = d(0) H + d'(0) S. After a corner of the force the stem coasts on from where it is, down to DV,
and rests.

Unknowns of all slips: m, F_v, k, A = F_c + F_v v_ref, F_0, F_s, DV; of each one: its own F_s less the common one, and
where it rested. Lengths are in m, forces in N, times in s.
"""

# mypy: allow-untyped-defs
# numba types each kernel from its arguments; an annotation would be a second, unchecked one.
# ruff: noqa: PLR0917 - kernels take flat numbers in order
from __future__ import annotations

import math
from typing import Final

import numpy as np

from estimators.compiled import kernel_of
from estimators.slips import responses as response_file
from estimators.slips.responses import responses
from valve.kernel.response import impulse_response

M: Final = 0
F_V: Final = 1
K: Final = 2
A: Final = 3
F_0: Final = 4
F_S: Final = 5
D_V: Final = 6
REST: Final = 7
COMMON: Final = 7  # unknowns that all slips share
UNKNOWNS: Final = 8  # of one slip: a change of its own F_s does what one of the common F_s does
_BISECTIONS: Final = 50

# A path on a straight force from t = 0 on: steady position there, steady speed, lag behind it and the lag's rate. Its
# derivatives ``by`` (7, 8) are those to the unknowns of these four, of the age, and of c and w2.
_LINE: Final = 0
_SPEED: Final = 1
_LAG: Final = 2
_LAG_RATE: Final = 3
_AGE: Final = 4
_C: Final = 5
_W2: Final = 6

kernel = kernel_of(response_file.__file__, __file__)


@kernel
def position_after(tau, c, w2, path, by, table, gradient):
    """Return the position after tau on the path; its gradient goes into ``gradient`` (8,)."""
    responses(tau, c, w2, table)
    speed, lag, lag_rate = path[_SPEED], path[_LAG], path[_LAG_RATE]
    rate, value, height = table[0, 0], table[0, 1], table[0, 2]
    velocity = speed + lag * w2 * value - lag_rate * rate
    by_c = -lag * table[1, 2] - lag_rate * table[1, 1]
    by_w2 = -lag * table[2, 2] - lag_rate * table[2, 1]
    for i in range(UNKNOWNS):
        gradient[i] = (
            by[_LINE, i] + tau * by[_SPEED, i] - height * by[_LAG, i] - value * by[_LAG_RATE, i]
            + velocity * by[_AGE, i] + by_c * by[_C, i] + by_w2 * by[_W2, i]
        )  # fmt: skip
    return path[_LINE] + speed * tau - lag * height - lag_rate * value


@kernel
def velocity_after(c, w2, path, by, table, gradient):
    """Return velocity and acceleration where ``table`` is of; the velocity's gradient goes into ``gradient``."""
    speed, lag, lag_rate = path[_SPEED], path[_LAG], path[_LAG_RATE]
    rate, value = table[0, 0], table[0, 1]
    acceleration = lag * w2 * rate + lag_rate * (c * rate + w2 * value)
    by_c = lag * w2 * table[1, 1] - lag_rate * table[1, 0]
    by_w2 = lag * (value + w2 * table[2, 1]) - lag_rate * table[2, 0]
    for i in range(UNKNOWNS):
        gradient[i] = (
            by[_SPEED, i] + w2 * value * by[_LAG, i] - rate * by[_LAG_RATE, i]
            + acceleration * by[_AGE, i] + by_c * by[_C, i] + by_w2 * by[_W2, i]
        )  # fmt: skip
    return speed + lag * w2 * value - lag_rate * rate, acceleration


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
def break_away(common, v_ref, own, rest, slip, path, by, begun, crept_by):
    """Put the path that the stem slips on into ``path`` and ``by``; return the times of breakaway, creep and slide.

    ``begun`` (8,) and ``crept_by`` (2, 8) get the derivatives of the instant of breakaway, of the time of creep, and of
    the way crept. Fourth comes the way crept, m.
    """
    m, viscous, k, limit = common[M], common[F_V], common[K], common[D_V]
    s, rate, force = slip[0], slip[1], slip[2]
    by[_C, M], by[_C, F_V] = -viscous / (m * m), 1.0 / m
    by[_W2, M], by[_W2, K] = -k / (m * m), 1.0 / m
    # the instant of breakaway: s (F - k rest - F_0) = F_s
    begin = (s * (common[F_S] + own) + k * rest + common[F_0] - force) / rate
    begun[F_S], begun[K], begun[F_0], begun[REST] = s / rate, rest / rate, 1.0 / rate, k / rate
    # creep: s v = |rate| t^2 / (2 m) up to DV
    creep = math.sqrt(2.0 * m * limit / abs(rate))
    crept_by[0, M], crept_by[0, D_V] = 0.5 * creep / m, 0.5 * creep / limit
    crept = limit * creep / 3.0
    crept_by[1, M], crept_by[1, D_V] = 0.5 * crept / m, 1.5 * crept / limit
    net, d_net = common[F_S] + own + abs(rate) * creep - k * crept, np.zeros(UNKNOWNS)
    d_net[F_S], d_net[K] = 1.0, -crept
    d_net[M] = abs(rate) * crept_by[0, M] - k * crept_by[1, M]
    d_net[D_V] = abs(rate) * crept_by[0, D_V] - k * crept_by[1, D_V]
    # slide at DV while the force is below the friction in motion
    sliding, climb, d_sliding = 0.0, abs(rate) - k * limit, np.zeros(UNKNOWNS)
    short = common[A] + viscous * (limit - v_ref) - net
    if short > 0.0 and climb > 0.0:
        sliding = short / climb
        d_sliding[:] = -d_net / climb
        d_sliding[A] += 1.0 / climb
        d_sliding[F_V] += (limit - v_ref) / climb
        d_sliding[D_V] += viscous / climb + sliding * k / climb
        d_sliding[K] += sliding * limit / climb
        net += short
        d_net[:] = 0.0
        d_net[A], d_net[F_V], d_net[D_V] = 1.0, limit - v_ref, viscous
    speed = rate / k
    lag = s * (net - common[A] - viscous * (s * speed - v_ref)) / k
    path[_LINE] = rest + s * crept + s * limit * sliding + lag
    path[_SPEED], path[_LAG], path[_LAG_RATE] = speed, lag, speed - s * limit
    by[_AGE] = -(begun + crept_by[0] + d_sliding)
    by[_SPEED, K] = by[_LAG_RATE, K] = -speed / k
    by[_LAG_RATE, D_V] = -s
    by[_LAG] = s * d_net / k
    by[_LAG, A] -= s / k
    by[_LAG, F_V] -= s * (s * speed - v_ref) / k
    by[_LAG, K] += -lag / k + viscous * speed / (k * k)
    by[_LINE] = s * crept_by[1] + s * limit * d_sliding + by[_LAG]
    by[_LINE, D_V] += s * sliding
    by[_LINE, REST] += 1.0
    return begin, creep, sliding, crept


@kernel
def turn(common, v_ref, slip, path, by, table, gradient, late, late_by):
    """Put the path after the corner of the force into ``late`` and ``late_by``, from that up to the corner."""
    m, viscous, k = common[M], common[F_V], common[K]
    s, rate, force, corner, rate_after = slip[0], slip[1], slip[2], slip[3], slip[4]
    speed = rate_after / k
    line = (force + rate * corner - common[F_0] - s * (common[A] + viscous * (s * speed - v_ref))) / k
    late_by[_LINE, K], late_by[_LINE, F_0] = -line / k + viscous * speed / (k * k), -1.0 / k
    late_by[_LINE, A], late_by[_LINE, F_V] = -s / k, -s * (s * speed - v_ref) / k
    late_by[_SPEED, K] = -speed / k
    late_by[_LAG] = late_by[_LINE] - gradient
    late_by[_C:] = by[_C:]
    velocity, _ = velocity_after(viscous / m, k / m, path, by, table, late_by[_LAG_RATE])
    late_by[_LAG_RATE] = late_by[_SPEED] - late_by[_LAG_RATE]
    late[_LINE], late[_SPEED], late[_LAG_RATE] = line, speed, speed - velocity


@kernel
def slip_rows(common, v_ref, own, rest, slip, time, position, jacobian):
    """Put the positions of one slip at ``time`` (n,) into ``position`` (n,), the gradients into ``jacobian`` (n, 8).

    ``slip``: direction, force rate, force at time 0, time of the corner (inf: none), force rate after it.
    """
    s, corner, limit = slip[0], slip[3], common[D_V]
    c, w2 = common[F_V] / common[M], common[K] / common[M]
    path, by, late, late_by = np.zeros(4), np.zeros((7, UNKNOWNS)), np.zeros(4), np.zeros((7, UNKNOWNS))
    table, begun, crept_by, d_pace = np.zeros((3, 3)), np.zeros(UNKNOWNS), np.zeros((2, UNKNOWNS)), np.zeros(UNKNOWNS)
    begin, creep, sliding, crept = break_away(common, v_ref, own, rest, slip, path, by, begun, crept_by)
    start, still_after, stopped = begin + creep + sliding, -1.0, -1
    for row in range(time.size):
        age, gradient = time[row] - begin, jacobian[row]
        if age <= creep:
            part = max(age, 0.0) / creep
            position[row] = rest + s * crept * part**3
            gradient[:] = -s * limit * part * part * begun
            gradient[REST] += 1.0
        elif time[row] <= start:
            position[row] = rest + s * crept + s * limit * (age - creep)
            gradient[:] = s * crept_by[1] - s * limit * (begun + crept_by[0])
            gradient[D_V] += s * (age - creep)
            gradient[REST] += 1.0
        elif time[row] <= corner:
            position[row] = position_after(time[row] - start, c, w2, path, by, table, gradient)
        elif stopped >= 0:
            position[row] = position[stopped]
            gradient[:] = jacobian[stopped]
        else:
            if still_after < 0.0:
                at = position_after(max(corner - start, 0.0), c, w2, path, by, table, gradient)
                turn(common, v_ref, slip, path, by, table, gradient, late, late_by)
                late[_LAG] = late[_LINE] - at
                still_after = time_to_rest(
                    s, limit, c, w2, late[_SPEED], late[_LAG], late[_LAG_RATE], time[-1] - corner
                )
            tau = min(time[row] - corner, still_after)
            position[row] = position_after(tau, c, w2, late, late_by, table, gradient)
            if tau == still_after:
                # the instant of rest moves too: s v = DV there
                stopped = row
                pace, slowing = velocity_after(c, w2, late, late_by, table, d_pace)
                if s * slowing < 0.0:
                    gradient -= pace * d_pace / slowing
                    gradient[D_V] += pace * s / slowing


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
    longest = np.diff(first).max()
    positions, gradients, inverse = np.empty(longest), np.empty((longest, UNKNOWNS)), np.zeros((2, 2))
    for slip in range(slips.shape[0]):
        begin, end = first[slip], first[slip + 1]
        position, jacobian = positions[: end - begin], gradients[: end - begin]
        slip_rows(common, v_ref, own[slip], rest[slip], slips[slip], time[begin:end], position, jacobian)
        full, side = np.zeros((UNKNOWNS, UNKNOWNS)), np.zeros(UNKNOWNS)
        before = cost
        for row in range(end - begin):
            left = seen[begin + row] - position[row]
            if not math.isfinite(left):
                return math.inf
            cost += weight[begin + row] * left * left
            for i in range(UNKNOWNS):
                pushed = weight[begin + row] * jacobian[row, i]
                side[i] += pushed * left
                for j in range(UNKNOWNS):
                    full[i, j] += pushed * jacobian[row, j]
        costs[slip] = cost - before
        own_side = side[F_S]
        if math.isinf(tie):
            inverse[1, 1] = 1.0 / full[REST, REST]
        else:
            own_side -= tie * own[slip]
            cost += tie * own[slip] * own[slip]
            p, q, r = full[F_S, F_S] + tie, full[F_S, REST], full[REST, REST]
            determinant = p * r - q * q
            inverse[0, 0], inverse[1, 1] = r / determinant, p / determinant
            inverse[0, 1] = inverse[1, 0] = -q / determinant
        for one in range(2):
            local[slip, one, :COMMON] = inverse[one, 0] * full[F_S, :COMMON] + inverse[one, 1] * full[REST, :COMMON]
            local[slip, one, COMMON] = inverse[one, 0] * own_side + inverse[one, 1] * side[REST]
            local[slip, one, COMMON + 1 :] = inverse[one]
        for i in range(COMMON):
            for j in range(COMMON):
                normal[i, j] += full[i, j] - full[i, F_S] * local[slip, 0, j] - full[i, REST] * local[slip, 1, j]
            normal[i, COMMON] += (
                side[i] - full[i, F_S] * local[slip, 0, COMMON] - full[i, REST] * local[slip, 1, COMMON]
            )
    return cost
