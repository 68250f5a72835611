"""The closed forms and the search for the first root, each against an independent computation."""

from __future__ import annotations

import math
from decimal import Decimal, localcontext

import numpy as np
import pytest

from valve.kernel.first_roots import slip_end
from valve.kernel.response import impulse_response, settling_time
from valve.kernel.sampling import even_period, first_at_or_after, first_fall, sample_motion


def decimal_response(tau: float, c: float, w2: float) -> tuple[float, float, float, float]:
    """S', S, S1 and S2 by the power series in 120 digits."""
    with localcontext() as context:
        context.prec = 120
        T, C, W = Decimal(tau), Decimal(c), Decimal(w2)
        before, now = Decimal(0), Decimal(1)  # s_0 and s_1 of S = sum of s_n T^n / n!
        sums = [Decimal(0)] * 4
        weight = Decimal(1)  # T^(n-1) / (n-1)!
        for n in range(1, 5000):
            terms = [now * weight]
            for order in range(3):
                terms.append(terms[-1] * T / (n + order))
            sums = [a + b for a, b in zip(sums, terms, strict=True)]
            if n > 20 and max(abs(terms[0]), abs(before * weight)) < Decimal(10) ** -60:
                break
            before, now = now, -C * now - W * before
            weight *= T / n
        return float(sums[0]), float(sums[1]), float(sums[2]), float(sums[3])


@pytest.mark.parametrize("w", [0.0, 1.0e-3, 1.0, 196.0])
@pytest.mark.parametrize("ratio", [0.0, 0.3, 1.0 - 1.0e-6, 1.0 - 1.0e-12, 1.0, 1.0 + 1.0e-12, 1.0 + 1.0e-6, 1.5, 60.0])
@pytest.mark.parametrize("reach", [1.0e-4, 0.24, 0.26, 0.49, 0.51, 1.0, 3.0, 20.0])
def test_the_response_is_right_to_rounding_at_every_damping(w: float, ratio: float, reach: float) -> None:
    # without a spring the time scale comes from the damping
    c = 2.0 * ratio * w if w > 0.0 else 10.0 * ratio
    tau = reach / max(w, c, 1.0)
    exact = decimal_response(tau, c, w * w)
    # each against the size that it would have without damping and spring
    sizes = (1.0, tau, tau**2 / 2.0, tau**3 / 6.0)
    for found, wanted, size in zip(impulse_response(tau, c, w * w), exact, sizes, strict=True):
        assert abs(found - wanted) <= 3.0e-14 * max(abs(wanted), 1.0e-2 * size)


@pytest.mark.parametrize("ratio", [0.0, 0.1, 1.0, 1.0 + 1.0e-12, 2.0, 60.0])
def test_uneven_samples_are_the_closed_form_before_and_after_its_transient_has_faded(ratio: float) -> None:
    w, c = 30.0, 60.0 * ratio
    x, v, a, push, offset = 0.01, 0.004, 0.3, 0.5, 2.0
    r = push - w * w * v
    settled = settling_time(c, w * w)
    assert math.isinf(settled) if ratio == 0.0 else math.exp(-settled * w * max(2.0 * ratio, 1.0)) < 1.0e-20
    rng = np.random.default_rng(3)
    time_s = np.sort(offset + rng.uniform(0.0, 3.0 * min(settled, 100.0), 400))
    found_x, found_v = np.full(400, math.nan), np.full(400, math.nan)
    sample_motion(c, w * w, x, v, a, r, push, offset, 0, 400, time_s, 0.0, np.zeros((4, 128)), found_x, found_v)
    exact = np.array([impulse_response(one, c, w * w) for one in time_s - offset])
    assert found_x == pytest.approx(x + v * (time_s - offset) + a * exact[:, 2] + r * exact[:, 3], rel=1.0e-14)
    assert found_v == pytest.approx(v + a * exact[:, 1] + r * exact[:, 2], rel=1.0e-13)


@pytest.mark.parametrize("seed", range(40))
def test_the_end_of_a_slip_is_the_first_root_and_none_is_leapt_over(seed: int) -> None:
    rng = np.random.default_rng(seed)
    w = 10.0 ** rng.uniform(0.5, 2.5)
    c = 2.0 * w * rng.choice([0.0, 0.02, 0.3, 1.0, 1.0 + 1.0e-9, 3.0, 50.0])
    DV = 10.0 ** rng.uniform(-4.0, -2.0)
    v, a, push = DV * rng.uniform(1.0, 50.0), rng.normal() * w * DV * 50.0, rng.normal() * w * w * DV * 5.0
    horizon = rng.uniform(1.0, 40.0) / w
    if abs(v - DV) < 1.0e-3 * DV:
        a = abs(a)

    def velocity(tau: float) -> float:
        _rate, S, S1, _twice = impulse_response(tau, c, w * w)
        return float(v + a * S + (push - w * w * v) * S1)

    found = slip_end(c, w * w, DV, 1.0, v, a, push, horizon)
    dense = np.linspace(0.0, horizon, 20001)[1:]
    below = np.array([velocity(tau) for tau in dense]) < DV
    if found < horizon:
        assert velocity(found) == pytest.approx(DV, rel=1.0e-9)
        assert not below[dense < found * (1.0 - 1.0e-9)].any()
    else:
        assert math.isinf(found)
        assert not below.any()


@pytest.mark.parametrize("ratio", [0.02, 1.0, 30.0])
def test_a_slip_that_starts_on_the_edge_without_slope_goes_on(ratio: float) -> None:
    # v = DV and a = 0, but the force rises faster than the spring takes up (push > w2 DV)
    w, DV = 10.0, 1.0e-3
    assert math.isinf(slip_end(2.0 * ratio * w, w * w, DV, 1.0, DV, 0.0, 1.5 * w * w * DV, 100.0))


def test_a_slip_that_stays_above_the_edge_ends_never() -> None:
    # v tends to 0.01 m/s from above, 66 times DV
    assert math.isinf(slip_end(450.0, 38608.0, 1.5e-4, 1.0, 0.3, -10.0, 386.08, 1.0e9))


def test_the_first_value_at_or_after_a_limit_is_found_from_any_start() -> None:
    values = np.array([0.0, 1.0, 1.0, 2.0, 5.0, 5.0, 9.0])
    for begin in range(values.size + 1):
        for limit in (-1.0, 0.0, 0.5, 1.0, 2.0, 4.9, 5.0, 9.0, 9.1):
            expected = max(begin, int(np.searchsorted(values, limit)))
            assert first_at_or_after(values, begin, limit) == expected


def test_even_times_are_told_from_uneven_ones() -> None:
    even = np.arange(60001) * 1.0e-3
    assert even_period(even) == pytest.approx(1.0e-3)
    assert even_period(even + 3.25) == pytest.approx(1.0e-3)
    uneven = even.copy()
    uneven[777] += 1.0e-12
    assert even_period(uneven) == 0.0
    assert even_period(np.arange(10) * 0.5) == 0.0  # too coarse to share an anchor
    assert even_period(np.zeros(3)) == 0.0


@pytest.mark.parametrize(
    ("values", "index"),
    [
        ([], -1),
        ([1.0], -1),
        ([0.0, 0.0, 1.0], -1),
        ([0.0, 1.0, 0.5], 2),
        ([math.nan], 0),
        ([0.0, math.nan, 1.0], 1),
        ([0.0, math.inf], 1),
        ([-math.inf, 0.0], 0),
    ],
)
def test_the_first_time_that_falls_or_is_not_finite_is_found(values: list[float], index: int) -> None:
    assert first_fall(np.array(values, dtype=np.float64)) == index
