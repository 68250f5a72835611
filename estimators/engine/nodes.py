"""The sections that the dynamic fit works on, and their nodes behind one another.

What is asked of every section is computed for all nodes in one go.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """One move from its breakaway to where the stem rests again or the recording ends.

    ``time_s``, ``force_n`` and ``rate_n_per_s`` are at the nodes, shape (n,); ``step`` says which of the steps' lengths
    leads to each. ``row``, ``measured_m`` and ``rows``, shape (r,), are the nodes at which the position is compared,
    the mean of the rows there and their number. From node ``free`` on the stem may stop.
    """

    direction: int
    began_s: float
    rest_m: float
    rest_error_m: float
    time_s: FloatArray
    step: IntArray
    force_n: FloatArray
    rate_n_per_s: FloatArray
    free: int
    row: IntArray
    measured_m: FloatArray
    rows: FloatArray
    path_m: FloatArray  # where the stem was at the nodes, as measured, smoothed
    rested_s: float = 0.0  # since the stem came to rest before it, or since the recording began
    rest_ends_s: float = 0.0  # as it was seen; the middle of the rest has its level
    before: int = 0  # direction of the move before it, 0 where there is none in the recording


class Nodes(NamedTuple):
    """What ``Section`` has, for n sections, N nodes and R rows.

    ``first``, shape (n + 1,), are the sections' first nodes and their number, ``first_row`` the same of the rows;
    ``free`` and ``row`` are nodes among all. ``way``, shape (3, N), is at the nodes the direction of the motion, how
    long the rest before it was, s, and the direction of the move before that; ``rest_way``, shape (3, n), is the same
    of the sections.
    """

    first: IntArray
    first_row: IntArray
    time_s: FloatArray
    step: IntArray
    force_n: FloatArray
    rate_n_per_s: FloatArray
    path_m: FloatArray
    free: IntArray
    row: IntArray
    row_time_s: FloatArray
    measured_m: FloatArray
    rows: FloatArray
    rest_m: FloatArray
    rest_error_m: FloatArray
    seen_s: FloatArray  # where the breakaway was seen
    rest_ends_s: FloatArray
    rest_force_n: FloatArray  # and its rate, there
    rest_rate_n_per_s: FloatArray
    way: FloatArray
    rest_way: FloatArray

    @property
    def direction(self) -> FloatArray:
        """Directions of the sections, shape (n,)."""
        return np.asarray(self.rest_way[0])

    @property
    def rested_s(self) -> FloatArray:
        """How long the rest before each section was, shape (n,)."""
        return np.asarray(self.rest_way[1])


def _nodes_of(sections: tuple[Section, ...]) -> Nodes:
    """Return the nodes of these sections, one at least."""
    nodes = np.array([one.time_s.size for one in sections])
    first = np.concatenate([[0], np.cumsum(nodes)]).astype(np.int64)
    first_row = np.concatenate([[0], np.cumsum([one.row.size for one in sections])]).astype(np.int64)
    time_s = np.concatenate([one.time_s for one in sections])
    row = np.concatenate([one.row + begin for one, begin in zip(sections, first[:-1], strict=True)])
    way = np.array([[one.direction, one.rested_s, one.before] for one in sections], dtype=np.float64).T
    return Nodes(
        first,
        first_row,
        time_s,
        np.concatenate([one.step for one in sections]),
        np.concatenate([one.force_n for one in sections]),
        np.concatenate([one.rate_n_per_s for one in sections]),
        np.concatenate([one.path_m for one in sections]),
        np.array([one.free for one in sections], dtype=np.int64) + first[:-1],
        row,
        time_s[row],
        np.concatenate([one.measured_m for one in sections]),
        np.concatenate([one.rows for one in sections]),
        np.array([one.rest_m for one in sections]),
        np.array([one.rest_error_m for one in sections]),
        np.array([one.began_s for one in sections]),
        np.array([one.rest_ends_s for one in sections]),
        np.array([np.interp(one.began_s, one.time_s, one.force_n) for one in sections]),
        np.array([np.interp(one.began_s, one.time_s, one.rate_n_per_s) for one in sections]),
        np.ascontiguousarray(np.repeat(way, nodes, axis=1)),
        np.ascontiguousarray(way),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Sections:
    """All sections, the lengths of the steps between their nodes, s, and how many others no fit explains."""

    sections: tuple[Section, ...]
    step_s: FloatArray
    left_out: int = 0
    nodes: Nodes = field(init=False)

    def __post_init__(self) -> None:
        """Lay the nodes of all sections behind one another."""
        if self.sections:
            object.__setattr__(self, "nodes", _nodes_of(self.sections))

    @property
    def count(self) -> int:
        """Number of sections."""
        return len(self.sections)
