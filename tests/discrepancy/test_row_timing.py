"""What the instants of polled rows leave unknown of their positions: what is said of them, where the stem is steady."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from discrepancy.observed import Observed, observe
from tests.estimators.recordings import recorded
from valve.recording import Acquisition, Provenance

_NOISE_M = 5.0e-6
_SAID_S = 1.0e-3


def _observed(said_s: float | None) -> Observed:
    made = recorded("nominal", period_s=20.0e-3, noise_m=_NOISE_M)
    provenance = Provenance(Acquisition.POLLED, requested_period_s=20.0e-3, timing_uncertainty_s=said_s)
    observed = observe([replace(made.recording, provenance=provenance)], made.nameplate)
    assert isinstance(observed, Observed)
    return observed


def test_a_steady_stem_is_known_as_well_as_its_rows_instants_are_said_to_be() -> None:
    said, unsaid = _observed(_SAID_S), _observed(None)
    motion = said.motions[0]
    speed = np.interp(said.time_s, motion.samples.time_s, np.abs(motion.phases.velocity))
    usual = float(np.quantile(speed, 0.75))
    in_motion = speed > 0.5 * usual
    assert 1.0 / np.median(said.weight[in_motion]) < 1.5 * np.hypot(_NOISE_M, usual * _SAID_S)
    # the rows of a breakaway are known no better by anybody's word
    assert float(said.weight.min()) < 1.5 * float(unsaid.weight.min())
