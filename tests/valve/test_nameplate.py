"""The nameplate and the units that it is written in."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from valve.errors import ParameterError
from valve.nameplate import Action, Actuator, Nameplate, Signal
from valve.units import PASCAL_PER_PSI, SI_FACTORS, linear

SIGNAL = Signal((4.0, 20.0), (0.0, 82737.0))


@pytest.mark.parametrize(("field", "unit"), [("travel_m", "m"), ("diaphragm_area_m2", "m2"), ("moving_mass_kg", "kg")])
@pytest.mark.parametrize("value", [0.0, -0.1, math.nan, math.inf])
def test_a_size_that_is_not_above_zero_is_refused(field: str, unit: str, value: float) -> None:
    sizes: dict[str, Any] = {"travel_m": 0.1, field: value}
    with pytest.raises(ParameterError, match=rf"actuator\.{field} is .* {unit}, it must be above 0"):
        Actuator(**sizes)


@pytest.mark.parametrize("span", [(2.0, 1.0), (1.0, 1.0), (math.nan, 1.0), (0.0, math.inf)])
def test_a_range_that_does_not_rise_is_refused(span: tuple[float, float]) -> None:
    with pytest.raises(ParameterError, match=r"actuator\.bench_set_pa .* must rise"):
        Actuator(0.1, bench_set_pa=span)
    with pytest.raises(ParameterError, match=r"signal\.range_ma .* must rise"):
        Signal(span, (0.0, 1.0))
    with pytest.raises(ParameterError, match=r"signal\.range_pa .* must rise"):
        Signal((4.0, 20.0), span)


@pytest.mark.parametrize("span", [[], [4.0], [4.0, 12.0, 20.0]])
def test_a_range_has_two_ends(span: list[float]) -> None:
    with pytest.raises(ParameterError, match=f"has {len(span)} values, it needs 2"):
        Signal(span, (0.0, 1.0))  # type: ignore[arg-type]  # as a file may give it


def test_a_range_from_a_file_becomes_a_tuple() -> None:
    actuator = Actuator(0.1, 0.05, bench_set_pa=[0.0, 1.0e5])  # type: ignore[arg-type]  # as a file gives it
    assert actuator.bench_set_pa == (0.0, 1.0e5)
    assert hash(actuator) == hash(Actuator(0.1, 0.05, bench_set_pa=(0.0, 1.0e5)))


def test_the_action_is_one_of_two() -> None:
    assert Actuator(0.1, action="double").action is Action.DOUBLE  # type: ignore[arg-type]  # as a file gives it
    with pytest.raises(ParameterError, match=r"actuator\.action is 'triple', there are spring, double"):
        Actuator(0.1, action="triple")  # type: ignore[arg-type]  # the refusal is what is tested


def test_a_double_acting_actuator_has_no_bench_set() -> None:
    with pytest.raises(ParameterError, match="no spring"):
        Actuator(0.1, 0.05, Action.DOUBLE, bench_set_pa=(0.0, 1.0e5))


@pytest.mark.parametrize("tag", ["", "x" * 65, "FV\n101", "FV\x00"])
def test_a_tag_must_be_short_and_printable(tag: str) -> None:
    with pytest.raises(ParameterError, match="1 to 64 printable"):
        Nameplate(tag, Actuator(0.1))


def test_the_bench_set_implies_spring_and_preload() -> None:
    plate = Nameplate("FV-1", Actuator(0.05, 0.04, bench_set_pa=(20_000.0, 100_000.0)))
    assert plate.nominal_preload_n == pytest.approx(800.0)
    assert plate.nominal_spring_rate_n_per_m == pytest.approx(0.04 * 80_000.0 / 0.05)


@pytest.mark.parametrize("actuator", [Actuator(0.05, 0.04), Actuator(0.05, bench_set_pa=(0.0, 1.0e5))])
def test_without_area_or_bench_set_nothing_is_implied(actuator: Actuator) -> None:
    plate = Nameplate("FV-1", actuator)
    assert plate.nominal_preload_n is None
    assert plate.nominal_spring_rate_n_per_m is None


@pytest.mark.parametrize(
    ("current_ma", "pressure_pa"), [(4.0, 0.0), (12.0, 41368.5), (20.0, 82737.0), (3.8, -1034.2125)]
)
def test_the_signal_maps_current_to_pressure_without_clamping(current_ma: float, pressure_pa: float) -> None:
    assert SIGNAL.pressure_pa(current_ma) == pytest.approx(pressure_pa)
    assert SIGNAL.current_ma(pressure_pa) == pytest.approx(current_ma)


@given(st.floats(-1.0e6, 1.0e6), st.floats(-100.0, 100.0), st.floats(0.1, 100.0), st.floats(-1.0e5, 1.0e5))
def test_a_linear_map_meets_both_ends_and_inverts(value: float, low: float, width: float, to_low: float) -> None:
    source, target = (low, low + width), (to_low, to_low + 1000.0)
    assert linear(source[0], source, target) == pytest.approx(target[0])
    assert linear(source[1], source, target) == pytest.approx(target[1])
    there = linear(value, source, target)
    assert linear(there, target, source) == pytest.approx(value, abs=1.0e-6 * (1.0 + abs(value)))


def test_units_convert_by_their_definitions() -> None:
    assert SI_FACTORS["psi"] == ("Pa", PASCAL_PER_PSI)
    assert pytest.approx(82737.0, abs=1.0) == 12.0 * PASCAL_PER_PSI
    assert pytest.approx(0.1016) == 4.0 * SI_FACTORS["inch"][1]
    assert SI_FACTORS["percent"] == ("1", 0.01)
    assert all(factor > 0.0 for _unit, factor in SI_FACTORS.values())
    assert all(SI_FACTORS[unit] == (unit, 1.0) for unit, _factor in SI_FACTORS.values())
