"""A stick-slip is searched from measured rest to measured rest, and judged with a stem that runs on through its own."""

from __future__ import annotations

from functools import cache

import pytest

from discrepancy.baseline import fit_baseline
from discrepancy.causes.base import Cause
from discrepancy.causes.channels import READING_LAG
from discrepancy.diagnose import explains
from discrepancy.finishing import finished
from discrepancy.least_squares import Fit
from discrepancy.observed import Observed, observe
from discrepancy.registry import CAUSES
from discrepancy.running_on import running_on
from discrepancy.screening import refit, screen
from discrepancy.selection import choose
from discrepancy.setting import setting_of
from discrepancy.significance import misfit, noise_factor
from estimators.exact_motion import ExactMotionEstimator
from tests.blind.cases import blind_case

pytestmark = pytest.mark.long

made = cache(blind_case)


@cache
def plain(seed: int) -> Fit:
    case = made(seed, "triangle")
    observed = observe(case.recordings, case.nameplate)
    assert isinstance(observed, Observed)
    found = fit_baseline(observed)
    assert found is not None
    return found


@cache
def refitted(seed: int, cause: Cause) -> Fit:
    setting = setting_of(plain(seed))
    (candidate,) = screen(plain(seed), [cause], setting)
    return refit(plain(seed), candidate, setting)


def test_a_slow_reading_is_found_by_the_shape_of_single_slips_where_means_over_many_lead_nowhere() -> None:
    fit = refitted(8965, READING_LAG)
    assert misfit(fit) < 1.3
    true_s = made(8965, "triangle").hidden[0].parameters["lag_s"]
    assert fit.values["position_lag.lag_s"] == pytest.approx(true_s, rel=0.05)


def test_a_stem_that_runs_on_leaves_noise_where_rests_that_a_slow_reading_moved_do_not() -> None:
    fit = refitted(8965, READING_LAG)
    assert noise_factor(fit) > 5.0
    found = finished(fit)
    assert noise_factor(found) < 1.1
    assert found.cost < fit.cost - 1000.0
    assert not any(one.rest_m.size for one in found.model.observed.segments)


def test_a_stem_that_is_out_of_phase_keeps_its_measured_rests() -> None:
    fit = plain(9008)
    assert running_on(fit) is fit


def test_a_plain_valve_that_explains_all_but_how_its_rests_were_measured_is_the_answer() -> None:
    """Its rests hang together, and what falls with speed there is worth 17, which nobody tells from nothing."""
    case = made(9451, "triangle")
    likelihood = ExactMotionEstimator().estimate(case.recordings[0], case.nameplate)
    observed = observe(case.recordings, case.nameplate)
    assert isinstance(observed, Observed)
    fit = fit_baseline(observed, likelihood)
    assert fit is not None
    assert noise_factor(fit) > 2.0
    assert not explains(fit)
    choice = choose(fit, CAUSES.values(), lambda _share, _phase: None)
    assert not choice.causes
    assert explains(choice.baseline)
    assert not any(one.rest_m.size for one in choice.baseline.model.observed.segments)


def test_a_fall_with_speed_that_a_wide_limit_stands_for_is_left_out_again_however_poor_the_first_fit() -> None:
    """Without the likelihood's values the plain valve is found only by way of the cause that it can do without."""
    fit = plain(9451)
    assert misfit(fit) > 5.0
    choice = choose(fit, CAUSES.values(), lambda _share, _phase: None)
    assert not choice.causes
    assert explains(choice.best)
