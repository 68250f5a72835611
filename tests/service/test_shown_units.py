from __future__ import annotations

import pytest

from service.words.units import UnitSystem, measured, quantity


@pytest.mark.parametrize(
    ("value", "unit", "system", "text"),
    [
        (82_737.0, "Pa", UnitSystem.SI, "82.74 kPa"),
        (82_737.0, "Pa", UnitSystem.BAR, "0.8274 bar"),
        (82_737.0, "Pa", UnitSystem.PSI, "12.00 psi"),
        (0.1016, "m", UnitSystem.BAR, "101.6 mm"),
        (0.1016, "m", UnitSystem.PSI, "4.000 in"),
        (1000.0, "N", UnitSystem.PSI, "224.8 lbf"),
        (52_538.0, "N/m", UnitSystem.SI, "52.54 N/mm"),
        (52_538.0, "N/m", UnitSystem.PSI, "300.0 lbf/in"),
        (22.4, "percent", UnitSystem.PSI, "22.40 %"),
        (None, "N", UnitSystem.SI, "–"),
        (0.02, "1", UnitSystem.PSI, "0.02000"),
    ],
)
def test_an_si_value_is_read_in_the_chosen_units(value: float | None, unit: str, system: UnitSystem, text: str) -> None:
    assert quantity(value, unit, system) == text


def test_an_interval_is_shown_as_half_of_its_width_in_the_same_unit() -> None:
    assert measured(1000.0, (990.0, 1010.0), "N", UnitSystem.SI) == "1000 ± 10 N"
    assert measured(1000.0, (990.0, 1010.0), "N", UnitSystem.PSI) == "224.8 ± 2.2 lbf"
    assert measured(1000.0, None, "N", UnitSystem.SI) == "1000 N"


def test_an_unknown_system_is_si() -> None:
    assert UnitSystem.of("furlong") is UnitSystem.of(None) is UnitSystem.SI
