"""Odd recordings end in an outcome: no exception, and no status ok without the valve in its numbers."""

from __future__ import annotations

import pytest

from estimators.base import Outcome, Status
from estimators.engine.engine import RoughFrictionEstimator
from tests.estimators.engine.odd_recordings import KINDS, odd_recording

# cheap ones: of these a fit is seldom begun
_QUICK = ("short", "constant", "noise", "drive", "other_action", "shuffled")


@pytest.mark.parametrize("kind", sorted(set(KINDS) - set(_QUICK)))
def test_what_may_still_hold_a_valve_is_answered(kind: str) -> None:
    recording, nameplate = odd_recording(kind, 1)
    estimate = RoughFrictionEstimator().estimate(recording, nameplate)

    assert estimate.message or estimate.status is Status.OK


@pytest.mark.parametrize("kind", [kind for kind in _QUICK if kind != "shuffled"])
def test_what_holds_no_valve_is_never_ok(kind: str) -> None:
    for seed in range(2):
        recording, nameplate = odd_recording(kind, seed)
        estimate = RoughFrictionEstimator().estimate(recording, nameplate)
        assert estimate.status is not Status.OK or nameplate.actuator.action == "double", (kind, seed)
        assert estimate.message or estimate.status is Status.OK


def test_a_stem_that_rests_and_a_force_that_does_not_change_are_told_apart() -> None:
    outcomes = set()
    for seed in range(6):
        recording, nameplate = odd_recording("constant", seed)
        outcomes.add(RoughFrictionEstimator().estimate(recording, nameplate).message)

    assert outcomes == {str(Outcome.NEVER_MOVED), str(Outcome.NO_FORCE_CHANGE)}
