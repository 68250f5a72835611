"""Whether what a cause explains of a drive's force is there all the time: what comes and goes is no such cause."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from discrepancy.force_causes.base import ForceStart, Shape
from discrepancy.force_fit import ForceModelFit, fit_forces, promises
from discrepancy.force_record import ForceRecord
from estimators.samples import FloatArray

_STRETCHES: Final = 6  # of time, each with a strength of the cause of its own
_COMES_AND_GOES: Final = 0.5  # of what the cause takes, that is taken beside it where its strength may change


def comes_and_goes(records: Sequence[ForceRecord], fit: ForceModelFit, start: ForceStart) -> bool:
    """Return whether a cause of the fit explains as much again where it may have another strength at other times.

    A burst of friction lies at some place and has some speed, and is explained by them as long as it is seen once.
    """
    without = fit_forces(records, [one for one in fit.starts if one is not start])
    taken = without.cost - fit.cost
    longest_s = max(float(record.time_s[-1]) for record in records)

    def in_stretches(record: ForceRecord, shape: Shape) -> FloatArray:
        stretch = np.minimum((record.time_s * (_STRETCHES / longest_s)).astype(np.int64), _STRETCHES - 1)
        whole = start.cause.columns(record, shape)
        return np.concatenate([whole * (stretch == number)[:, None] for number in range(_STRETCHES)], axis=1)

    if start.columns(records[0]).shape[1] == 0:
        return False
    split = ForceStart(replace(start.cause, columns=in_stretches), start.shape)
    return promises(fit, [split])[0] * fit.cost > _COMES_AND_GOES * taken
