"""What is known of a test's parameters: the bound, the ties and their words, against plain algebra and known cases."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from estimators.base import digits_within
from estimators.identifiability.bound import Knowledge, knowledge
from estimators.identifiability.sensitivities import SENSITIVITY_SYMBOLS, position_sensitivities
from estimators.samples import FloatArray
from valve.parameter_sets import parameter_set
from valve.waveform import multi_rate_triangle

NOISE_M = 20.0e-6


def known_of(name: str, periods_s: list[float], *, sample_period_s: float = 1.0e-3, dv_prior: float = 1.5) -> Knowledge:
    """What triangles of these periods tell of a published valve; DV with a prior of this sd of its logarithm."""
    chosen = parameter_set(name)
    signal, area_m2, parameters = (
        chosen.nameplate.signal,
        chosen.nameplate.actuator.diaphragm_area_m2,
        chosen.parameters,
    )
    assert signal is not None
    assert area_m2 is not None
    wave = multi_rate_triangle(periods_s, *signal.range_pa)
    outputs_s = np.arange(0.0, wave.duration_s, sample_period_s)
    _, derivatives = position_sensitivities(
        parameters, wave.time_s, area_m2 * wave.pressure_pa, outputs_s, SENSITIVITY_SYMBOLS
    )
    information = derivatives.T @ derivatives / NOISE_M**2
    place = SENSITIVITY_SYMBOLS.index("DV")
    information[place, place] += (dv_prior * parameters.limit_velocity_m_per_s) ** -2
    rates = sorted({area_m2 * (signal.range_pa[1] - signal.range_pa[0]) / (0.5 * period_s) for period_s in periods_s})
    return knowledge(
        SENSITIVITY_SYMBOLS,
        [*parameters.by_symbol().values(), 0.0],
        information,
        sliding_speeds_m_per_s=[rate / parameters.spring_rate_n_per_m for rate in rates],
        ramp_rates_n_per_s=rates,
    )


def line_information(columns: FloatArray) -> FloatArray:
    return np.asarray(columns.T @ columns)


def test_bound_is_the_inverse_of_the_information() -> None:
    columns = np.random.default_rng(1).standard_normal((50, 3)) * np.array([1.0e3, 1.0e-4, 1.0])
    known = knowledge(["m", "k", "F_v"], [1.0, 5.0e4, 600.0], line_information(columns))
    assert known.covariance == pytest.approx(np.linalg.inv(line_information(columns)), rel=1.0e-9)
    assert known.relative("m") == pytest.approx(1.959964 * known.std_error("m"))
    assert not known.undetermined


def test_published_bounds_of_the_triangle_are_met() -> None:
    # worked out beforehand, six parameters: m / F_v of A (3 x 20 s) and B (20 s + 20 x 2 s), % at one sigma
    published = {
        ("nominal", "A"): (1.2, 0.19),
        ("nominal", "B"): (0.13, 0.018),
        ("rough", "A"): (4.0, 0.18),
        ("rough", "B"): (0.42, 0.022),
        ("vendor", "B"): (0.44, 0.017),
    }
    for (name, test), (m, viscous) in published.items():
        known = known_of(name, [20.0] * 3 if test == "A" else [20.0] + [2.0] * 20, dv_prior=1.0e6)
        assert 100.0 * known.relative("m") / 1.96 == pytest.approx(m, rel=0.15)
        assert 100.0 * known.relative("F_v") / 1.96 == pytest.approx(viscous, rel=0.15)


def test_two_parameters_that_enter_as_one_sum_are_tied_and_the_sum_is_known() -> None:
    random = np.random.default_rng(2)
    columns = np.empty((200, 3))
    columns[:, :2] = random.standard_normal((200, 1)) * np.array([1.0, 0.01])
    columns[:, 2] = random.standard_normal(200)
    known = knowledge(["F_c", "F_v", "k"], [1400.0, 600.0, 5.0e4], line_information(columns))
    assert known.undetermined == {"F_c", "F_v"}
    assert known.std_error("F_c") == np.inf
    assert known.std_error("k") == pytest.approx(np.linalg.norm(columns[:, 2]) ** -1, rel=0.01)
    for symbol, other in (("F_c", "F_v"), ("F_v", "F_c")):
        tie = known.ties(symbol)
        assert tie is not None
        assert tie.symbols == (symbol, other)
        assert tie.correlation == pytest.approx(-1.0)
        assert tie.value == pytest.approx(1406.0)
        assert tie.std_error == pytest.approx(np.linalg.norm(columns[:, 0]) ** -1, rel=0.02)
        assert "while the stem slides at 10 mm/s, F_c + v F_v = 1406 N" in known.note(symbol)
        assert "multi_rate" in tie.separated_by
    assert known.ties("k") is None
    assert known.note("k") == ""


def test_the_speed_of_a_tie_has_the_digits_that_its_sum_is_known_to() -> None:
    column = np.random.default_rng(2).standard_normal((200, 1)) * 100.0
    known = knowledge(["F_c", "F_v"], [590.0, 77000.0], line_information(column * np.array([1.0, 0.0033142])))
    tie = known.ties("F_c")
    assert tie is not None
    # a thousandth of a N: of 255 N of viscous friction the sixth digit
    assert tie.std_error < 0.001
    assert "slides at 3.3142 mm/s" in known.note("F_c")


def test_friction_at_one_speed_is_tied_and_at_two_is_not() -> None:
    one = known_of("vendor", [20.0] * 3, sample_period_s=0.02)
    tie = one.ties("F_v")
    assert tie is not None
    assert tie.symbols == ("F_v", "F_c")
    # F_c + v F_v at v = rate / k
    assert tie.value == pytest.approx(44.4822 + 612.944 * 82737.0 * 0.06452 / 10.0 / 52538.0, rel=2.0e-3)
    assert 1.96 * tie.std_error < 1.0e-3 * tie.value
    two = known_of("vendor", [20.0, 10.0], sample_period_s=0.02)
    assert two.identifiable("F_v")
    assert two.note("F_v") == ""


@pytest.mark.parametrize(("name", "sample_period_s"), list(itertools.product(["nominal", "rough"], [1.0e-3, 0.02])))
def test_limit_velocity_is_tied_to_static_friction_on_one_rate(name: str, sample_period_s: float) -> None:
    known = known_of(name, [20.0] * 3, sample_period_s=sample_period_s)
    parameters = parameter_set(name).parameters
    assert known.identifiable("F_s")
    tie = known.ties("DV")
    assert tie is not None
    assert tie.symbols == ("DV", "F_s")
    rate = 82737.0 * 0.06452 / 10.0
    more_n = (2.0 * parameters.mass_kg * parameters.limit_velocity_m_per_s * rate) ** 0.5
    assert tie.value == pytest.approx(parameters.static_friction_n + more_n, abs=0.01)
    assert tie.std_error < 0.3 * known.std_error("F_s")
    assert "breaks the stem away when it rises by 534 N/s" in known.note("DV")


def test_several_rates_give_the_limit_velocity() -> None:
    known = known_of("nominal", [20.0] + [2.0] * 20)
    assert known.ties("DV") is None
    assert 100.0 * known.relative("DV") / 1.96 == pytest.approx(4.0, rel=0.2)


def test_a_late_input_is_told_as_friction_on_ramps_of_one_rate() -> None:
    columns = np.zeros((100, 3))
    columns[:, 0], columns[:, 1] = 1.0, 534.0
    columns[:, 2] = np.random.default_rng(3).standard_normal(100)
    known = knowledge(
        ["F_c", "transducer_lag_s", "k"], [1400.0, 0.5, 5.0e4], line_information(columns), ramp_rates_n_per_s=[534.0]
    )
    tie = known.ties("F_c")
    assert tie is not None
    assert tie.value == pytest.approx(1400.0 + 534.0 * 0.5)
    assert "measure the pressure" in tie.separated_by
    assert "the transducer's lag" in known.note("F_c")


def test_three_parameters_tied_only_together_are_told_together() -> None:
    # only F_c + v F_v + r T shows: to know one of the three more would not help
    columns = np.ones((400, 1)) * np.array([[1.0, 0.01, 500.0]])
    known = knowledge(["F_c", "F_v", "transducer_lag_s"], [1400.0, 600.0, 0.5], line_information(columns))
    tie = known.ties("F_c")
    assert tie is not None
    assert set(tie.symbols) == {"F_c", "F_v", "transducer_lag_s"}
    assert tie.value == pytest.approx(1400.0 + 0.01 * 600.0 + 500.0 * 0.5, rel=1.0e-6)
    assert tie.std_error == pytest.approx(0.05, rel=0.01)
    assert "measure the pressure" in tie.separated_by


@pytest.mark.parametrize(("sense", "sign", "word"), [(1.0, "+", "and"), (-1.0, "-", "less")])
def test_friction_and_preload_of_one_direction_are_told_as_their_sum_or_difference(
    sense: float, sign: str, word: str
) -> None:
    travel_m = np.linspace(0.0, 0.1, 400)
    columns = np.stack([np.full(400, sense), travel_m, np.ones(400)], axis=1)
    columns[0, 2] += 1.0e-3  # and one row tells the two apart, badly
    known = knowledge(["F_c", "k", "F_0"], [1000.0, 5.0e4, 200.0], line_information(columns))
    tie = known.ties("F_c")
    assert tie is not None
    assert tie.combination == f"F_c {sign} F_0"
    assert f"friction {word} preload" in tie.sentence
    assert "way back" in tie.sentence
    assert tie.value == pytest.approx(1000.0 + sense * 200.0)
    assert tie.std_error < 0.01 * known.std_error("F_c")


def test_a_combination_does_not_say_once_a_symbol() -> None:
    columns = np.ones((400, 1)) * np.array([[1.0, 1.0, 500.0]])
    known = knowledge(["F_c", "F_0", "transducer_lag_s"], [1400.0, 600.0, 0.5], line_information(columns))
    tie = known.ties("F_c")
    assert tie is not None
    assert " 1 F_0" not in tie.combination
    assert "F_0" in tie.combination


def test_an_unusual_pair_is_told_by_its_best_known_combination() -> None:
    random = np.random.default_rng(5)
    columns = random.standard_normal((200, 1)) * np.array([[1.0, 0.002]])
    columns += 1.0e-5 * random.standard_normal((200, 2))
    known = knowledge(["m", "k"], [1.0, 5.0e4], line_information(columns))
    tie = known.ties("m")
    assert tie is not None
    gradient = np.array([1.0, known.covariance[0, 1] / -known.covariance[1, 1]])
    assert tie.std_error == pytest.approx(float(np.sqrt(gradient @ known.covariance @ gradient)), rel=1.0e-6)
    assert tie.combination.startswith("m + 0.002")
    assert tie.std_error < 0.15 * known.std_error("m")


def test_what_does_not_show_is_not_called_a_tie() -> None:
    known = knowledge(["m", "k", "F_v"], [1.0, 5.0e4, 600.0], np.diag([0.1, 1.0, 1.0]), ramp_rates_n_per_s=[500.0])
    assert known.ties("m") is None
    assert "too briefly" in known.note("m")
    assert "multi_rate" in known.note("m")


def test_a_symbol_without_any_information_takes_no_other_with_it() -> None:
    known = knowledge(["m", "k", "DV"], [1.0, 5.0e4, 1.0e-4], np.diag([100.0, 1.0, 0.0]))
    assert known.undetermined == {"DV"}
    assert known.std_error("k") == pytest.approx(1.0)
    assert not known.identifiable("DV")


def test_a_hidden_mass_is_called_so() -> None:
    known = known_of("graphite", [20.0] * 3)
    assert "damped so strongly" in known.note("m")
    assert known.ties("m") is None


def test_preload_is_judged_against_friction_where_it_is_small() -> None:
    known = knowledge(["F_c", "F_0"], [1000.0, 0.0], np.diag([1.0, 0.01]))
    assert known.relative("F_0") == pytest.approx(1.959964 * 10.0 / 1000.0)


def test_information_that_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="information of shape"):
        knowledge(["m"], [1.0], np.eye(2))


def test_a_lag_that_hides_friction_without_being_tied_to_it_alone_is_named() -> None:
    known = knowledge(["F_c", "transducer_lag_s"], [1.0, 0.1], np.diag([1.0, 1.0]))
    assert known.ties("F_c") is None
    assert "lag of the transducer hides it" in known.note("F_c")


def test_a_factor_has_digits_by_what_they_leave_of_its_product() -> None:
    assert digits_within(1.0, 100.0) == 3
    assert digits_within(1.0e-3, 100.0) == 6
    assert digits_within(0.0, 100.0) == 7
    assert digits_within(1.0e-12, -100.0) == 7
    # a stem without viscous friction: no digit of the speed matters
    assert digits_within(1.0, 0.0) == 3
    assert digits_within(math.inf, 100.0) == 3
