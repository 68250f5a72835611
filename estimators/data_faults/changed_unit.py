"""A channel that goes on in another unit within a recording, as exports that were pasted together do."""

from __future__ import annotations

from typing import Final

import numpy as np

from valve.errors import RecordingError
from valve.messages import Message, say
from valve.recording import FloatArray

#: Between units of length and of pressure.
UNIT_RATIOS: Final = (1000.0, 100.0, 25.4, 14.50377, 6.894757, 39.37008, 68.94757)  # m to mm, % to share, bar to psi
LIKE_RATIO: Final = 0.1  # how near the levels' ratio is to one of these


def require_one_unit(channel: Message, values: FloatArray, other: FloatArray, time_s: FloatArray, subject: str) -> None:
    """Raise RecordingError where a channel goes on at once in another unit while the other channel stays.

    Channels: shape (n,), each in its unit.
    """
    least = 1.0e-6 * float(np.abs(values).max())
    before, after = np.abs(values[:-1]), np.abs(values[1:])
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where((before > least) & (after > least), np.maximum(before / after, after / before), 1.0)
    rows = np.flatnonzero(ratio > 5.0)
    span = float(np.ptp(other))
    for row in rows[:200].tolist():
        near = [known for known in UNIT_RATIOS if abs(ratio[row] / known - 1.0) <= LIKE_RATIO]
        side = min(row + 1, values.size - row - 1, 200)
        if not near or side < 10:
            continue
        first, last = np.abs(values[row + 1 - side : row + 1]), np.abs(values[row + 1 : row + 1 + side])
        levels = np.sort([float(np.median(first)), float(np.median(last))])
        stays = abs(float(other[row + 1] - other[row])) <= 0.05 * span
        if stays and levels[0] > 0.0 and abs(levels[1] / levels[0] / near[0] - 1.0) <= 0.3:
            raise RecordingError(
                say(
                    "unit_changes",
                    "{subject}: the unit of the {channel} changes after row {row} ({time:.7g} s): its values change at "
                    "once by a factor of {factor:.4g} and stay so, while the other channel stays: cut the file there, "
                    "or write one unit",
                    subject=subject,
                    channel=channel,
                    row=int(row) + 1,
                    time=float(time_s[row]),
                    factor=float(near[0]),
                )
            )
