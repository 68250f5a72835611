"""A stem that shakes to and fro between hundreds of rests, told from any phase by the first of them."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, Final

import numpy as np
import pytest

from discrepancy import rounds
from discrepancy.baseline import baseline_unknowns
from discrepancy.causes.forces import VIBRATION
from discrepancy.causes.friction import GRADIENT, LOCAL, STRIBECK
from discrepancy.least_squares import Fit, start_fit
from discrepancy.model import Model
from discrepancy.observed import Observed, observe
from discrepancy.screening import Candidate
from discrepancy.setting import setting_of
from discrepancy.significance import is_noise
from discrepancy.to_and_fro import from_any_phase
from tests.blind.cases import blind_case

pytestmark = pytest.mark.long

# The plain valve rings from rest to rest with a tenth of the true damping, and leaves 1.6 of the noise's variance.
RINGING: Final = {
    "m": 1.4697, "k": 50477.0, "F_v": 47.351, "F_c": 46.122, "d": 0.091399, "F_0": 203.69, "DV": 0.0043467,
    "first_rise": -4.2171, "x_0": -3.8046e-05,
}  # fmt: skip
# What the forces at the breakaways tell: the frequency, and neither phase nor size.
TOLD: Final = {"force_n": 20.45, "frequency_hz": 23.202288, "phase_rad": -1.7786}


@pytest.fixture(scope="module")
def ringing() -> tuple[dict[str, float], Fit]:
    """What is hidden, and the plain fit."""
    case = blind_case(10058, "triangle")
    observed = observe(case.recordings, case.nameplate)
    assert isinstance(observed, Observed)
    model = Model(observed, baseline_unknowns(observed, 9.0e-3, 47.0))
    return dict(case.hidden[0].parameters), start_fit(model, model.unknowns.point(RINGING))


@pytest.mark.parametrize("off", [0.0, 1.0e-13])
def test_the_first_rests_lead_to_the_force_from_any_phase(ringing: tuple[dict[str, float], Fit], off: float) -> None:
    hidden, fit = ringing
    fit = start_fit(fit.model, fit.point * (1.0 + off))
    other = {**TOLD, "frequency_hz": 1.5 * TOLD["frequency_hz"]}
    found = from_any_phase(fit, Candidate(VIBRATION, (other, TOLD), 0.0), setting_of(fit))
    assert found is not None
    assert is_noise(found)
    assert found.values["vibration.force_n"] == pytest.approx(hidden["force_n"], rel=0.05)
    assert found.values["vibration.frequency_hz"] == pytest.approx(hidden["frequency_hz"], rel=1.0e-5)


def test_a_wrong_frequency_leads_nowhere(ringing: tuple[dict[str, float], Fit]) -> None:
    _, fit = ringing
    other = {**TOLD, "frequency_hz": 1.5 * TOLD["frequency_hz"]}
    assert from_any_phase(fit, Candidate(VIBRATION, (other,), 0.0), setting_of(fit)) is None


def test_a_stem_with_few_rests_is_not_looked_at(ringing: tuple[dict[str, float], Fit]) -> None:
    _, fit = ringing
    (segment,) = fit.model.observed.segments
    few = replace(
        segment, rest_time_s=segment.rest_time_s[:90], rest_m=segment.rest_m[:90], rest_sense=segment.rest_sense[:90]
    )
    model = replace(fit.model, observed=fit.model.observed.of([few]))
    assert from_any_phase(start_fit(model, fit.point), Candidate(VIBRATION, (TOLD,), 0.0), setting_of(fit)) is None


@pytest.mark.parametrize("is_told", [True, False])
def test_what_the_first_rests_tell_needs_no_hard_and_no_slow_cause(
    is_told: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    names: list[str] = []
    samples = SimpleNamespace(period_s=1.0e-3, time_s=np.array([0.0, 60.0]))
    observed = SimpleNamespace(motions=(SimpleNamespace(samples=samples),), count=1)
    model: Any = SimpleNamespace(tally=SimpleNamespace(work=1.0), observed=observed)
    best = Fit(model, np.zeros(1), np.array([10.0]), None, 100.0)
    told = replace(best, residual=np.array([1.0]), cost=1.0)

    def refit(fit: Fit, candidate: Candidate, *_rest: Any) -> Fit:
        names.append(candidate.cause.name)
        return fit

    monkeypatch.setattr(rounds, "may_ring", lambda _fit, _setting: True)
    monkeypatch.setattr(rounds, "refit", refit)
    monkeypatch.setattr(rounds, "is_settled", lambda _best, fit: fit is told)
    monkeypatch.setattr(rounds, "from_any_phase", lambda *_: told if is_told else None)
    promises = ((LOCAL, 0.85), (GRADIENT, 0.2), (VIBRATION, 0.1), (STRIBECK, 0.0))
    candidates = [Candidate(cause, ({},), promise) for cause, promise in promises]
    fits = rounds.refits(best, candidates, setting=SimpleNamespace(), most=9, last=9.0)  # type: ignore[arg-type]
    if is_told:
        assert fits[0] == (VIBRATION, told)
        assert names == ["local_friction"]
    else:
        assert set(names) == {cause.name for cause, _ in promises}
