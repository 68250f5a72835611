"""The stem's motion in each section, from breakaway on, and how it answers a change of anything in the model.

After its breakaway the stem obeys m x'' + F_v x' + k x = U - F_0 - s (F_c + w_s(x) + d(t)) and the sensor shows
z' = (x - z) / T. With the force straight between nodes a step is exact: a matrix for each length of a step. Where the
stem comes to rest again, position and its changes stay as they are and only the sensor still settles.
"""

# mypy: allow-untyped-defs
# ruff: noqa: PLR0917 - kernels take flat numbers in order
from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

FloatArray = npt.NDArray[np.float64]

_FADED: Final = 1.0e-12  # of the largest answer: what is left of a change of the force


@dataclass(frozen=True, slots=True)
class Dynamics:
    """Mass (kg), damping (N s/m), spring rate (N/m) and the time of the sensor's filter (s)."""

    mass_kg: float
    damping_n_s_per_m: float
    spring_n_per_m: float
    filter_s: float

    @property
    def lag_s(self) -> float:
        """How late a damped stem follows, F_v / k, s."""
        return self.damping_n_s_per_m / self.spring_n_per_m


class Steps(NamedTuple):
    """Exact steps of (x, v, z), shape (n, 3, 3), and their answers to the force at both ends, shape (n, 3)."""

    state: FloatArray
    from_start: FloatArray
    from_end: FloatArray
    sensor: FloatArray  # how much of the sensor's distance is left after a step at rest


@njit(cache=True, error_model="numpy")
def _product(left, right, out):
    """The product of two square matrices, into ``out``: too small for a library's call."""
    size = left.shape[0]
    for row in range(size):
        for column in range(size):
            total = 0.0
            for at in range(size):
                total += left[row, at] * right[at, column]
            out[row, column] = total


@njit(cache=True, error_model="numpy")
def exponentials(matrices):
    """Exponentials of square matrices, shape (n, c, c): a Taylor series of what is halved often enough, squared."""
    out = np.empty_like(matrices)
    size = matrices.shape[1]
    matrix, term, other = np.empty((size, size)), np.empty((size, size)), np.empty((size, size))
    for number in range(matrices.shape[0]):
        norm = 0.0
        for row in range(size):
            norm = max(norm, np.abs(matrices[number, row]).sum())
        share = 1.0
        halvings = 0
        while norm * share > 0.25:
            share *= 0.5
            halvings += 1
        # without the unit matrix, so that short steps keep their digits
        total = out[number]
        for row in range(size):
            for column in range(size):
                matrix[row, column] = share * matrices[number, row, column]
                total[row, column] = term[row, column] = matrix[row, column]
        for order in range(2, 11):
            _product(term, matrix, other)
            for row in range(size):
                for column in range(size):
                    term[row, column] = other[row, column] / order
                    total[row, column] += term[row, column]
        for _ in range(halvings):
            _product(total, total, other)
            for row in range(size):
                for column in range(size):
                    total[row, column] = 2.0 * total[row, column] + other[row, column]
        for row in range(size):
            total[row, row] += 1.0
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
def instants(time_s, first, began_s):
    """Where sections' instants of breakaway lie among their nodes: the first node after each, and how to read there.

    ``first`` are the first nodes of the sections, and the number of nodes. A value at an instant lies on the straight
    line to the node ``after`` from the one before it, at ``share`` of the way; before the first node the line goes on.
    """
    count = began_s.size
    begins, after, share = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count)
    for number in range(count):
        low, high = first[number], first[number + 1]
        begins[number] = low + np.searchsorted(time_s[low:high], began_s[number], side="right")
        after[number] = min(max(begins[number], low + 1), high - 1)
        before_s = time_s[after[number] - 1]
        share[number] = (began_s[number] - before_s) / (time_s[after[number]] - before_s)
    return begins, after, share


@njit(cache=True, error_model="numpy")
def follow(
    time_s, step, first, begins, after, share, free, direction, limit, force, state, from_start, from_end, sensor
):
    """Base motion: position, speed and the sensor's position at the nodes of all sections, and where each stopped.

    A section begins with the limit velocity at its instant (``instants``); the step from there to the next node is the
    section's own, behind those of all lengths. It stops where its speed falls to the limit velocity again, at this
    share of the last step; where it does not, at the first node of the next one.
    """
    count = begins.size
    own_steps = sensor.size - count
    x, v, z = np.zeros(time_s.size), np.zeros(time_s.size), np.zeros(time_s.size)
    stopped, stop_share = first[1:].copy(), np.zeros(count)
    for number in range(count):
        sign = direction[number]
        last_node = first[number + 1]
        x0 = z0 = rest = 0.0
        v0 = sign * limit
        at = after[number]
        begin = force[at - 1] + share[number] * (force[at] - force[at - 1])
        index = own_steps + number
        for node in range(begins[number], last_node):
            if stopped[number] < last_node:
                x[node] = rest
                z0 = rest + (z0 - rest) * sensor[step[node]]
                z[node] = z0
                continue
            a, b, c = state[index], from_start[index], from_end[index]
            x1 = a[0, 0] * x0 + a[0, 1] * v0 + b[0] * begin + c[0] * force[node]
            v1 = a[1, 0] * x0 + a[1, 1] * v0 + b[1] * begin + c[1] * force[node]
            z1 = a[2, 0] * x0 + a[2, 1] * v0 + a[2, 2] * z0 + b[2] * begin + c[2] * force[node]
            if node >= free[number] and sign * v1 <= limit:
                stopped[number] = node
                part = (v0 - sign * limit) / (v0 - v1) if v0 != v1 else 0.0
                part = min(max(part, 0.0), 1.0)
                stop_share[number] = part
                rest = x0 + 0.5 * (v0 + sign * limit) * part * (time_s[node] - time_s[node - 1])
                # the sensor follows up to the stop, and settles from there on
                z1 = z0 + part * (z1 - z0)
                z1 = rest + (z1 - rest) * sensor[step[node]] ** (1.0 - part)
                x1, v1 = rest, 0.0
            x[node], v[node], z[node] = x1, v1, z1
            x0, v0, z0 = x1, v1, z1
            begin = force[node]
            if node + 1 < last_node:
                index = step[node + 1]
    return x, v, z, stopped, stop_share


@njit(cache=True, error_model="numpy")
def answers(
    step, row, first_step, begins, stop, share, later, first, force, stiffer, state, from_start, from_end, sensor, out
):
    """How the sensor's position at a section's nodes ``row`` answers to changes of the force, from rest, into ``out``.

    ``force`` has the shape (lines, nodes), ``out`` (lines, rows), zeros. ``first`` is the force at the instant of
    breakaway, before the node ``begins``. ``stiffer``, shape (nodes,), is by how much friction that changes along the
    travel makes the spring stiffer there. A stem that is faster where it stops goes on for ``later``, s, times the
    difference.
    """
    lines, n = force.shape
    inverse = np.empty(n)
    for node in range(begins, n):
        inverse[node] = 1.0 / (1.0 + from_end[first_step if node == begins else step[node], 0] * stiffer[node])
    for line in range(lines):
        begin, end = begins, n - 1
        # a force that begins later finds the stem where it was
        while first[line] == 0.0 and begin < n and force[line, begin] == 0.0:
            begin += 1
        while end > begin and force[line, end] == 0.0:
            end -= 1
        x = v = z = largest = 0.0
        at = np.searchsorted(row, begin)
        for node in range(begin, n):
            if node > stop:
                z = x + (z - x) * sensor[step[node]]
            else:
                index = first_step if node == begins else step[node]
                a, b, c = state[index], from_start[index], from_end[index]
                before = first[line] if node == begins else force[line, node - 1] - stiffer[node - 1] * x
                after = force[line, node]
                # x1 = ... + c (after - stiffer x1)
                x1 = (a[0, 0] * x + a[0, 1] * v + b[0] * before + c[0] * after) * inverse[node]
                after -= stiffer[node] * x1
                v1 = a[1, 0] * x + a[1, 1] * v + b[1] * before + c[1] * after
                if node == stop:
                    x1 = x + share * (x1 - x) + later * (v + share * (v1 - v))
                z1 = a[2, 0] * x + a[2, 1] * v + a[2, 2] * z + b[2] * before + c[2] * after
                if node == stop:
                    z1 = x1 + (z + share * (z1 - z) - x1) * sensor[step[node]] ** (1.0 - share)
                x, v, z = x1, v1, z1
            if at < row.size and row[at] == node:
                out[line, at] = z
                at += 1
            largest = max(largest, abs(z))
            if node > end and abs(x) < _FADED * largest and abs(z) < _FADED * largest:
                break
