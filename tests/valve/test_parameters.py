"""Parameters and travel stops: what physics allows, and each refusal."""

from __future__ import annotations

import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from valve.errors import NotFoundError, ParameterError
from valve.parameter_sets import PARAMETER_SETS, parameter_set
from valve.parameters import PARAMETER_SYMBOLS, TravelStops, ValveParameters, parameters_from_symbols

GOOD = ValveParameters(1.36, 52538.0, 612.9, 1423.4, 1708.1, 1.524e-4, 100.0)
positive = st.floats(1.0e-9, 1.0e9)
not_negative = st.floats(0.0, 1.0e9)


@given(st.tuples(positive, not_negative, not_negative, not_negative, not_negative, positive), st.floats(-1.0e6, 1.0e6))
def test_every_physical_set_is_accepted_and_survives_its_symbols(values: tuple[float, ...], F_0: float) -> None:
    m, k, F_v, F_c, excess, DV = values
    parameters = ValveParameters(m, k, F_v, F_c, F_c + excess, DV, F_0)
    assert parameters_from_symbols(parameters.by_symbol()) == parameters
    assert list(parameters.by_symbol()) == ["m", "k", "F_v", "F_c", "F_s", "DV", "F_0"]


@pytest.mark.parametrize("entry", PARAMETER_SYMBOLS.values(), ids=lambda entry: entry.symbol)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_value_that_is_not_finite_is_refused_by_its_name(entry: object, value: float) -> None:
    field = entry.field  # type: ignore[attr-defined]  # a ParameterSymbol, which pytest hands on as an object
    with pytest.raises(ParameterError, match=f"{field} is .*finite"):
        dataclasses.replace(GOOD, **{field: value})


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("mass_kg", 0.0, "must be above 0"),
        ("mass_kg", -1.0, "must be above 0"),
        ("limit_velocity_m_per_s", 0.0, "must be above 0"),
        ("spring_rate_n_per_m", -1.0, "must not be negative"),
        ("viscous_friction_n_s_per_m", -0.1, "must not be negative"),
        ("coulomb_friction_n", -5.0, "must not be negative"),
        ("static_friction_n", 1423.3, "below the Coulomb friction of 1423.4 N"),
    ],
)
def test_an_unphysical_value_is_refused_with_its_limit(field: str, value: float, words: str) -> None:
    with pytest.raises(ParameterError, match=f"{field} is .*{words}"):
        dataclasses.replace(GOOD, **{field: value})


@pytest.mark.parametrize("field", ["spring_rate_n_per_m", "viscous_friction_n_s_per_m", "preload_n"])
def test_a_valve_may_do_without_spring_damping_or_preload(field: str) -> None:
    assert getattr(dataclasses.replace(GOOD, **{field: 0.0}), field) == 0.0


def test_no_stiction_and_no_friction_are_valves_too() -> None:
    assert dataclasses.replace(GOOD, static_friction_n=1423.4).static_friction_n == 1423.4
    assert dataclasses.replace(GOOD, static_friction_n=0.0, coulomb_friction_n=0.0).static_friction_n == 0.0


def test_parameters_cannot_be_changed() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        GOOD.mass_kg = 2.0  # type: ignore[misc]  # the refusal is what is tested


def test_the_preload_alone_may_be_left_out() -> None:
    values = GOOD.by_symbol()
    del values["F_0"]
    assert parameters_from_symbols(values).preload_n == 0.0
    del values["F_v"], values["DV"]
    with pytest.raises(ParameterError, match="F_v, DV: missing"):
        parameters_from_symbols(values)


def test_an_unknown_symbol_is_refused_with_the_known_ones() -> None:
    with pytest.raises(ParameterError, match="F_x: no such parameter; there are m, k, F_v"):
        parameters_from_symbols({**GOOD.by_symbol(), "F_x": 1.0})


@pytest.mark.parametrize(("low_m", "high_m"), [(0.1, 0.1), (0.1, 0.0), (math.nan, 0.1), (0.0, math.nan)])
def test_travel_stops_must_leave_room_between_them(low_m: float, high_m: float) -> None:
    with pytest.raises(ParameterError, match="low one must lie below"):
        TravelStops(low_m, high_m)


def test_either_travel_stop_may_be_absent() -> None:
    assert TravelStops() == TravelStops(-math.inf, math.inf)
    assert TravelStops(low_m=0.0).high_m == math.inf


@pytest.mark.parametrize("name", sorted(PARAMETER_SETS))
def test_each_published_set_has_its_source_and_fits_its_nameplate(name: str) -> None:
    chosen = parameter_set(name)
    assert chosen.name == name
    assert len(chosen.source) > 30
    spring_n_per_m = chosen.nameplate.nominal_spring_rate_n_per_m
    assert spring_n_per_m == pytest.approx(chosen.parameters.spring_rate_n_per_m, rel=0.02)
    assert chosen.nameplate.nominal_preload_n == pytest.approx(chosen.parameters.preload_n, rel=0.02, abs=1.0e-9)


def test_the_papers_three_valves_differ_in_friction_alone() -> None:
    vendor, nominal, rough = (parameter_set(name).parameters for name in ("vendor", "nominal", "rough"))
    assert vendor.coulomb_friction_n == vendor.static_friction_n == 44.4822
    assert (nominal.static_friction_n, rough.static_friction_n) == (1708.1, 2668.9)
    for other in (nominal, rough):
        assert other.mass_kg == vendor.mass_kg
        assert other.spring_rate_n_per_m == vendor.spring_rate_n_per_m
        assert other.limit_velocity_m_per_s == vendor.limit_velocity_m_per_s


def test_an_unknown_set_is_refused_with_the_known_ones() -> None:
    with pytest.raises(NotFoundError, match="'rusty' is unknown: choose one of vendor, nominal, rough, graphite"):
        parameter_set("rusty")
