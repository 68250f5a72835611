"""The stem's motion in one section, from breakaway on, and how it answers a change of anything in the model.

After its breakaway the stem obeys m x'' + F_v x' + k x = U - F_0 - s (F_c + w_s(x) + d(t)) and the sensor shows
z' = (x - z) / T. With the force straight between nodes a step is exact: a matrix for each length of a step. Where the
stem comes to rest again, position and its changes stay as they are and only the sensor still settles.
"""

# mypy: allow-untyped-defs
# ruff: noqa: PLR0917 - kernels take flat numbers in order
from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from estimators.samples import FloatArray


@dataclass(frozen=True, slots=True)
class Dynamics:
    """Mass (kg), damping (N s/m), spring rate (N/m) and the time of the sensor's filter (s)."""

    mass_kg: float
    damping_n_s_per_m: float
    spring_n_per_m: float
    filter_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """Exact steps of (x, v, z), shape (n, 3, 3), and their answers to the force at both ends, shape (n, 3)."""

    state: FloatArray
    from_start: FloatArray
    from_end: FloatArray
    sensor: FloatArray  # how much of the sensor's distance is left after a step at rest


@njit(cache=True, error_model="numpy")
def exponentials(matrices):
    """Exponentials of square matrices, shape (n, c, c): a Taylor series of what is halved often enough, squared."""
    out = np.empty_like(matrices)
    size = matrices.shape[1]
    for number in range(matrices.shape[0]):
        matrix = matrices[number].copy()
        norm = 0.0
        for row in range(size):
            norm = max(norm, np.abs(matrix[row]).sum())
        halvings = 0
        while norm > 0.25:
            norm *= 0.5
            halvings += 1
        matrix /= 2.0**halvings
        # without the unit matrix, so that short steps keep their digits
        total = matrix.copy()
        term = matrix.copy()
        for order in range(2, 11):
            term = term @ matrix / order
            total += term
        for _ in range(halvings):
            total = 2.0 * total + total @ total
        for row in range(size):
            total[row, row] += 1.0
        out[number] = total
    return out


def steps_of(dynamics: Dynamics, step_s: FloatArray) -> Steps:
    """Return the steps of these lengths, shape (n,)."""
    m, c, k = dynamics.mass_kg, dynamics.damping_n_s_per_m, dynamics.spring_n_per_m
    rate = 1.0 / dynamics.filter_s
    # (x, v, z, force, its change over the step)
    generator = np.zeros((step_s.size, 5, 5))
    generator[:, 0, 1] = step_s
    generator[:, 1, 0], generator[:, 1, 1], generator[:, 1, 3] = -k / m * step_s, -c / m * step_s, step_s / m
    generator[:, 2, 0], generator[:, 2, 2] = rate * step_s, -rate * step_s
    generator[:, 3, 4] = 1.0
    whole = exponentials(generator)
    ramp = np.ascontiguousarray(whole[:, :3, 4])
    return Steps(
        np.ascontiguousarray(whole[:, :3, :3]),
        np.ascontiguousarray(whole[:, :3, 3] - ramp),
        ramp,
        np.exp(-rate * step_s),
    )


@njit(cache=True, error_model="numpy")
def follow(
    time_s, step, first_step, free, direction, limit, end, began_s, first, force, state, from_start, from_end, sensor
):
    """Base motion: position, speed and the sensor's position at the nodes, and where it stopped.

    It begins with the limit velocity, and stops where it falls to it, or at the travel's ``end``, m from its rest:
    then the share of its last step that is returned is below 0.
    """
    n = time_s.size
    x, v, z = np.zeros(n), np.zeros(n), np.zeros(n)
    stopped, share = n, 0.0
    x0 = z0 = 0.0
    v0 = direction * limit
    last = -1.0
    rest = 0.0
    for node in range(n):
        if time_s[node] <= began_s:
            continue
        if stopped < n:
            x[node], v[node] = rest, 0.0
            z0 = rest + (z0 - rest) * sensor[step[node]]
            z[node] = z0
            continue
        if last < 0.0:
            index = first_step
            begin = first
        else:
            index = step[node]
            begin = force[node - 1]
        last = 1.0
        a, b, c = state[index], from_start[index], from_end[index]
        x1 = a[0, 0] * x0 + a[0, 1] * v0 + b[0] * begin + c[0] * force[node]
        v1 = a[1, 0] * x0 + a[1, 1] * v0 + b[1] * begin + c[1] * force[node]
        z1 = a[2, 0] * x0 + a[2, 1] * v0 + a[2, 2] * z0 + b[2] * begin + c[2] * force[node]
        if node >= free and direction * v1 <= limit:
            stopped = node
            share = (v0 - direction * limit) / (v0 - v1) if v0 != v1 else 0.0
            share = min(max(share, 0.0), 1.0)
            length = time_s[node] - time_s[node - 1]
            rest = x0 + 0.5 * (v0 + direction * limit) * share * length
            # the sensor follows up to the stop, and settles from there on
            z1 = z0 + share * (z1 - z0)
            z1 = rest + (z1 - rest) * sensor[step[node]] ** (1.0 - share)
            x1, v1 = rest, 0.0
        if stopped == n and direction * (x1 - end) > 0.0:
            stopped, share, rest = node, -1.0, end
            x1, v1 = rest, 0.0
        x[node], v[node], z[node] = x1, v1, z1
        x0, v0, z0 = x1, v1, z1
    return x, v, z, stopped, share


@njit(cache=True, error_model="numpy")
def after_play(time_s, began_s, direction, gap_m, x, filter_s):
    """What a sensor with a filter shows of a stem that first takes up a play of ``gap_m``, shape (n,), from rest."""
    n = x.size
    shown = np.zeros(n)
    before = z = 0.0
    last_s = began_s
    for node in range(n):
        if time_s[node] <= began_s:
            continue
        y = direction * max(direction * x[node] - gap_m, 0.0)
        length = time_s[node] - last_s
        fades = np.exp(-length / filter_s)
        slope = (y - before) / length
        z = y - slope * filter_s + (z - before + slope * filter_s) * fades
        shown[node] = z
        before, last_s = y, time_s[node]
    return shown


@njit(cache=True, error_model="numpy")
def answers(
    time_s, step, first_step, stop, share, later, began_s, first, force, stiffer, state, from_start, from_end, sensor
):
    """How the sensor's position answers to changes of the force, shape (nodes, columns), from rest.

    ``stiffer``, shape (nodes,), is by how much friction that changes along the travel makes the spring stiffer there.
    A stem that is faster where it stops goes on for ``later``, s, times the difference.
    """
    n, columns = force.shape
    out = np.zeros((n, columns))
    now = np.zeros((3, columns))
    begun = False
    for node in range(n):
        if time_s[node] <= began_s:
            continue
        if node > stop:
            fades = sensor[step[node]]
            for column in range(columns):
                now[2, column] = now[0, column] + (now[2, column] - now[0, column]) * fades
                out[node, column] = now[2, column]
            continue
        index = step[node] if begun else first_step
        a, b, c = state[index], from_start[index], from_end[index]
        for column in range(columns):
            x0, v0, z0 = now[0, column], now[1, column], now[2, column]
            begin = force[node - 1, column] - stiffer[node - 1] * x0 if begun else first[column]
            end = force[node, column]
            # x1 = ... + c (end - stiffer x1)
            x1 = (a[0, 0] * x0 + a[0, 1] * v0 + b[0] * begin + c[0] * end) / (1.0 + c[0] * stiffer[node])
            end -= stiffer[node] * x1
            v1 = a[1, 0] * x0 + a[1, 1] * v0 + b[1] * begin + c[1] * end
            if node == stop:
                # nothing but its own place moves the travel's end
                x1 = x0 + share * (x1 - x0) + later * (v0 + share * (v1 - v0)) if share >= 0.0 else 0.0
            z1 = a[2, 0] * x0 + a[2, 1] * v0 + a[2, 2] * z0 + b[2] * begin + c[2] * end
            if node == stop and share >= 0.0:
                z1 = x1 + (z0 + share * (z1 - z0) - x1) * sensor[step[node]] ** (1.0 - share)
            now[0, column] = x1
            now[1, column] = v1
            now[2, column] = z1
            out[node, column] = now[2, column]
        begun = True
    return out


@njit(cache=True, error_model="numpy")
def whitened(time_s, matrix, white, coloured, coloured_s):
    """Innovations of each column against white noise plus an Ornstein-Uhlenbeck process, in their standard deviations.

    ``white`` is the variance of each row, ``coloured`` that of the process; also returned: the sum of their logarithms.
    """
    rows, columns = matrix.shape
    out = np.empty((rows, columns))
    level = np.zeros(columns)
    variance = coloured
    logarithms = 0.0
    for row in range(rows):
        if row > 0:
            fades = np.exp(-(time_s[row] - time_s[row - 1]) / coloured_s)
            variance = coloured + fades * fades * (variance - coloured)
            for column in range(columns):
                level[column] *= fades
        total = variance + white[row]
        gain = variance / total
        size = 1.0 / np.sqrt(total)
        logarithms += np.log(total)
        for column in range(columns):
            away = matrix[row, column] - level[column]
            out[row, column] = away * size
            level[column] += gain * away
        variance -= gain * variance
    return out, logarithms
