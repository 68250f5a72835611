"""The slips' covariance: what the straight line through a noisy force leaves open goes into the frictions."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from estimators.base import Form
from estimators.classic.robust_form import robust_covariance
from estimators.motion.balance import Balance
from estimators.motion.recorded_motion import RecordedMotion, read_motion
from estimators.samples import FloatArray
from estimators.slips.kernel import F_0, F_S, A, K, M
from estimators.slips.search import ALL_AT_ONCE, SlipsFound, solve_slips
from estimators.slips.solution import SlipFit, SlipSolution
from tests.estimators.recordings import recorded

LINE_N = 30.0


@pytest.fixture(scope="module")
def slips() -> SlipsFound:
    one = recorded("nominal", noise_m=20.0e-6, period_s=2.0e-3)
    with np.errstate(all="ignore"):
        motion = read_motion(one.recording, one.nameplate)
        assert isinstance(motion, RecordedMotion)
        assert motion.uniform is not None
        found = solve_slips(motion, Balance.of(motion.uniform, Form.ROBUST, motion.action), ALL_AT_ONCE)
    assert found is not None
    return found


@dataclass(frozen=True, slots=True, eq=False)
class Shallow(SlipFit):
    """A fit whose cost is known: it rises by ``lighter`` below the mass found and by ``heavier`` above it."""

    found: SlipSolution | None = None
    lighter: float = 0.0
    heavier: float = 0.0

    def solve(self, start: FloatArray, rounds: int = 0, rest_m: FloatArray | None = None) -> SlipSolution:
        del rounds, rest_m
        assert self.found is not None
        rise = self.lighter if start[M] < self.found.common[M] else self.heavier
        return replace(self.found, cost=self.found.cost + rise)


def shallow(found: SlipsFound, lighter: float, heavier: float) -> SlipsFound:
    """The slips with a mass known to 10 %, nothing else changed, and the rise of the cost 1.5 such errors beside it."""
    covariance = found.solution.covariance.copy()
    factor = 0.1 * found.solution.common[M] / np.sqrt(covariance[M, M])
    covariance[M, :] *= factor
    covariance[:, M] *= factor
    solution = replace(found.solution, covariance=covariance)
    fit = found.fit
    of_known_cost = Shallow(
        fit.windows, fit.noise_m, fit.reference_speed, fit.free, fit.believed, fit.tie, fit.slaved,
        found=solution, lighter=lighter, heavier=heavier,
    )  # fmt: skip
    return replace(found, fit=of_known_cost, solution=solution)


def with_line_error(found: SlipsFound, error_n: float) -> SlipsFound:
    return replace(found, fit=replace(found.fit, windows=replace(found.windows, line_error_n=error_n)))


def test_the_lines_error_widens_friction_breakaway_and_preload_by_its_mean_over_the_slips(slips: SlipsFound) -> None:
    without = robust_covariance(with_line_error(slips, 0.0), None)
    more = robust_covariance(with_line_error(slips, LINE_N), None) - without
    expected = np.zeros_like(more)
    for place in (A, F_0, F_S):
        expected[place, place] = LINE_N**2 / slips.windows.count
    assert slips.windows.count == 6
    np.testing.assert_allclose(more, expected, atol=1.0e-9 * LINE_N**2)


def test_a_steady_balance_adds_its_own_errors_and_what_follows_from_them(slips: SlipsFound) -> None:
    steady = np.diag([4.0, 9.0, 16.0])  # of k, A and F_0
    more = robust_covariance(slips, steady) - robust_covariance(slips, None)
    assert more[A, A] == pytest.approx(9.0, rel=1.0e-6)
    assert more[F_0, F_0] == pytest.approx(16.0, rel=1.0e-6)
    # all at once nothing follows from k, A and F_0 that the fit itself has not
    assert np.count_nonzero(np.abs(more) > 1.0e-6) == 3


@pytest.mark.parametrize(("lighter", "heavier"), [(1.0, 0.5625), (0.5625, 1.0), (0.5625, 9.0)])
def test_a_cost_that_rises_slowly_on_both_sides_widens_an_error_by_the_slower_side_alone(
    slips: SlipsFound, lighter: float, heavier: float
) -> None:
    # a parabola would rise by 2.25: on one side the error is 1.5 times as large, on the other twice
    one = with_line_error(shallow(slips, lighter, heavier), 0.0)
    plain, widened = one.solution.covariance, robust_covariance(one, None)
    assert widened[M, M] == pytest.approx(4.0 * plain[M, M])
    assert widened[M, A] == pytest.approx(2.0 * plain[M, A])
    assert widened[K, K] == pytest.approx(plain[K, K])
