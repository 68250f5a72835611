"""What naming a cause gains in a force recording: the error of the predicted force, before and after."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from discrepancy.force_fit import ForceModelFit, fit_forces
from discrepancy.force_record import ForceRecord
from valve.messages import say

LEFT_OUT: Final = say("part_left_out", "the part of the recording that was left out of the fit")
_FITTED_SHARE: Final = 0.65  # of the rows, where nothing was held out
_WORSE: Final = 1.02


@dataclass(frozen=True, slots=True)
class ForceGain:
    """Root mean square errors of the predicted force, N, both sides filtered alike, and that of the force itself."""

    held_out: str
    rmse_before_n: float
    rmse_after_n: float
    force_rms_n: float

    @property
    def is_worse(self) -> bool:
        """Whether the extended model predicts worse than the baseline."""
        return self.rmse_after_n > _WORSE * self.rmse_before_n

    def to_json(self) -> dict[str, Any]:
        """Return the gain as in the analysis object: a force's errors are in N, and in percent of the force."""
        return {
            "held_out": self.held_out,
            "rmse_before_m": None,
            "rmse_after_m": None,
            "noise_floor_m": None,
            "rmse_before_n": self.rmse_before_n,
            "rmse_after_n": self.rmse_after_n,
            "error_before_percent": 100.0 * self.rmse_before_n / self.force_rms_n,
            "error_after_percent": 100.0 * self.rmse_after_n / self.force_rms_n,
        }


def force_gain(name: str, record: ForceRecord, before: ForceModelFit, after: ForceModelFit) -> ForceGain:
    """Return the gain on a record that had no part in the fits."""
    first, second = (float(np.sqrt(np.mean(fit.left(record) ** 2))) for fit in (before, after))
    return ForceGain(name, first, second, float(np.sqrt(np.mean(record.force_n[record.rows] ** 2))))


def left_out_force_gain(records: Sequence[ForceRecord], after: ForceModelFit) -> ForceGain:
    """Return the gain on the last third of the first record, with both models fitted to the rest."""
    whole = records[0]
    rows = np.flatnonzero(whole.rows)
    split = int(rows[int(_FITTED_SHARE * rows.size)])
    early, late = whole.rows.copy(), whole.rows.copy()
    early[split:] = False
    late[:split] = False
    kept = [replace(whole, rows=early), *records[1:]]
    fits = fit_forces(kept), fit_forces(kept, after.starts)
    return force_gain(LEFT_OUT, replace(whole, rows=late), *fits)
