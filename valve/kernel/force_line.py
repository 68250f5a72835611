"""The force between two of its corners."""

# mypy: allow-untyped-defs
# numba types each kernel from its arguments; an annotation would be a second, unchecked one.
from __future__ import annotations

from valve.kernel.compiled import kernel


@kernel
def force_line(corner_time, corner_force, i, end_time):
    """Return (whether it counts, its end, its slope) of the force's line from corner ``i`` on.

    The last corner's force is held to ``end_time``. Of a step only the far side counts, and a line of no length
    only where it is one.
    """
    start, last = corner_time[i], i == corner_time.size - 1
    stop = end_time if last else min(corner_time[i + 1], end_time)
    if stop == start:
        far_side = last or corner_time[i + 1] > start
        return far_side and i > 0 and corner_time[i - 1] == start, stop, 0.0
    return True, stop, (0.0 if last else (corner_force[i + 1] - corner_force[i]) / (corner_time[i + 1] - start))
