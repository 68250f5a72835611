"""What is believed of the mass of moving parts."""

from __future__ import annotations

import pytest

from estimators.motion.balance import heaviest_believed_kg


@pytest.mark.parametrize(
    ("nameplate_kg", "force_range_n", "mass_kg", "is_believed"),
    [
        (None, 5.4e3, 99.0, True),
        (None, 5.4e3, 134.0, False),  # what once stood in for a falling friction
        (2.0, 5.4e3, 134.0, False),
        (None, 96.0e3, 110.0, True),  # a globe valve of 12 inches and more
        (300.0, 5.4e3, 320.0, True),
    ],
)
def test_a_mass_is_believed_by_its_nameplate_and_by_the_force_that_moves_it(
    nameplate_kg: float | None, force_range_n: float, mass_kg: float, is_believed: bool
) -> None:
    assert (mass_kg < heaviest_believed_kg(nameplate_kg, force_range_n)) is is_believed
