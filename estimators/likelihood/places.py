"""Where the numbers of a simulation stand among the unknowns, and its outputs and parts among the rows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.samples import BoolArray, FloatArray, IntArray

_ONE_INSTANT_S: Final = 1.0e-9  # a block of no more is one row


@dataclass(frozen=True, slots=True, eq=False)
class Restarts:
    """Where the simulated stem begins anew for a first fit: part j at ``row[j]``, at rest at ``position_m[j]``."""

    row: IntArray
    position_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """Where a simulation's numbers stand among the unknowns, -1 for none, as ``shoot_each`` takes them.

    Part j begins at output ``first_out[j]``, ``first_s[j]``, at the unknown ``start[j]`` or, begun anew at a measured
    rest, at ``rest_m[j]``. Outputs are at ``out_s``: a block's at both ``sides``, (2, n), a single row's once.
    """

    valve: IntArray  # of m, k, F_v, F_c, F_s/F_c - 1, DV, F_0 and both stops
    inputs: IntArray
    is_input: BoolArray
    start: IntArray
    speed: IntArray
    rest_m: FloatArray
    out_s: FloatArray
    sides: IntArray
    first_out: IntArray
    first_s: FloatArray


def placed(
    names: tuple[str, ...],
    inputs: tuple[str, ...],
    section_row: IntArray,
    restarts: Restarts | None,
    *,
    time_s: FloatArray,
    block_s: FloatArray | None,
) -> Places:
    """Return the places of unknowns, of which ``inputs`` are the force's; arrays as in ``StemModel``."""
    place = {name: number for number, name in enumerate(names)}
    rows, sections = section_row, range(section_row.size)
    start = [place.get(f"x_{number}", -1) for number in sections]
    speed = [place.get(f"v_{number}", -1) for number in sections]
    rest_m = np.zeros(len(sections))
    if restarts is not None:
        others = restarts.row.size
        rows, rest_m = np.append(rows, restarts.row), np.append(rest_m, restarts.position_m)
        start, speed = start + [-1] * others, speed + [-1] * others
    order = np.argsort(rows, kind="stable")
    out_s, sides = time_s, np.empty((2, 0), dtype=np.int64)
    if block_s is not None:
        has_two = block_s > _ONE_INSTANT_S
        last = np.cumsum(1 + has_two) - 1
        sides = np.stack([last - has_two, last])
        out_s = np.empty(int(last[-1]) + 1)
        out_s[sides[0]], out_s[sides[1]] = time_s - block_s, time_s + block_s
    taken = np.array([place[name] for name in inputs], dtype=np.int64)
    first = rows[order]
    return Places(
        valve=np.array([place.get(name, -1) for name in ("m", "k", "F_v", "F_c", "d", "DV", "F_0", "low", "high")]),
        inputs=taken,
        is_input=np.isin(np.arange(len(names)), taken),
        start=np.array(start)[order],
        speed=np.array(speed)[order],
        rest_m=rest_m[order],
        out_s=out_s,
        sides=sides,
        first_out=first if block_s is None else sides[0][np.minimum(first, time_s.size - 1)],
        first_s=time_s[first],
    )
