from __future__ import annotations

import pytest

from service.words.sentences import all_in_units, in_units
from service.words.units import UnitSystem

STUCK = "{} and the stem did not break away from {}, a healthy one moves within {}"


@pytest.mark.parametrize(
    ("system", "quantities"),
    [
        (UnitSystem.SI, ("82.44 kPa", "48.55 mm", "78.6 kPa")),
        (UnitSystem.BAR, ("0.8244 bar", "48.55 mm", "0.786 bar")),
        (UnitSystem.PSI, ("11.96 psi", "1.911 in", "11.4 psi")),
    ],
)
def test_a_sentence_of_the_drivers_is_read_in_the_chosen_units(
    system: UnitSystem, quantities: tuple[str, str, str]
) -> None:
    said = STUCK.format("8.244e+04 Pa", "0.0485455 m", "7.86e+04 Pa")
    assert in_units(said, system) == STUCK.format(*quantities)


@pytest.mark.parametrize(
    ("said", "text"),
    [
        ("between 10 and 20 mm of travel", "between 0.394 and 0.787 in of travel"),
        ("20 to 80 kPa, at 3 mm/s", "2.90 to 11.6 psi, at 0.118 in/s"),
        ("509.58 ± 0.72 N", "114.6 ± 0.162 lbf"),
        ("52.5 N/mm, 612.9 N*s/m", "300 lbf/in, 3.500 lbf·s/in"),
        ("-1.5 mm", "-0.0591 in"),
        ("noise of 5 um", "noise of 0.00020 in"),
        ("0 N", "0 lbf"),
        ("by 667 N/s, sqrt(2 m DV r) = 1708.6 N (+-0.03)", "by 150 lbf/s, sqrt(2 m DV r) = 384.11 lbf (±0.00674)"),
        ("640.5 N (638.2 to 642.8) higher", "143.99 lbf (143.47 to 144.51) higher"),
    ],
)
def test_ranges_intervals_and_signs_are_taken_along(said: str, text: str) -> None:
    assert in_units(said, UnitSystem.PSI) == text


@pytest.mark.parametrize(
    ("said", "text"),
    [
        ("250.00 N (249.96 to 250.04) higher", "56.202 lbf (56.193 to 56.211) higher"),
        ("250.0000 N (249.9996 to 250.0004) higher", "56.2022 lbf (56.2021 to 56.2023) higher"),
        ("by 5.0000 um (4.9996 to 5.0004)", "by 0.0001969 in (0.0001968 to 0.0001969)"),
        ("250.0 N (250.0 to 250.0) higher", "56.202 lbf (56.202 to 56.202) higher"),
    ],
)
def test_the_ends_of_a_narrow_interval_differ_in_any_unit_where_they_did(said: str, text: str) -> None:
    assert in_units(said, UnitSystem.PSI) == text


@pytest.mark.parametrize(
    ("said", "text"),
    [
        ("did not break away from 2.01544e-06 m", "did not break away from 2.02 µm"),
        ("noise of 5 um", "noise of 5 µm"),
        ("5e-06 m (4e-06 to 6e-06)", "5 µm (4 to 6)"),
        ("it moved 0.0002 m", "it moved 0.200 mm"),
        ("it stood at 0 m", "it stood at 0 mm"),
    ],
)
def test_a_small_length_is_read_in_micrometres(said: str, text: str) -> None:
    assert in_units(said, UnitSystem.SI) == text


@pytest.mark.parametrize(
    "said",
    [
        "FV-101: at 12.4 s, 3 of 5 tests",
        "1 min 5 s",
        "4 mA",
        "v1.5 N",
        "12.00 psi",
        "0.61 N·s/mm",
        "1e3 Nm",
        "F_s + sqrt(2 m DV r)",
        "2 m DV",
        "5 %, M",
    ],
)
def test_what_is_no_quantity_of_ours_is_left_alone(said: str) -> None:
    assert in_units(said, UnitSystem.PSI) == said


def test_what_is_metric_already_stays_digit_by_digit() -> None:
    said = "0.00 kPa, 5.12345 mm, 640.5 N (638.2 to 642.8), 12345.678 N"
    assert in_units(said, UnitSystem.SI) == said


@pytest.mark.parametrize(
    ("said", "text"),
    [("7 um", "7 µm"), ("-4291 um", "-4.291 mm"), ("250 um (240 to 260) off", "0.2500 mm (0.2400 to 0.2600) off")],
)
def test_a_length_in_micrometres_is_read_in_millimetres_where_it_is_large(said: str, text: str) -> None:
    assert in_units(said, UnitSystem.BAR) == text


def test_every_text_of_a_document_is_changed_and_nothing_else() -> None:
    document = {"why": ["at 1 mm", ("2 N",)], "value": 3.0, "none": None}
    assert all_in_units(document, UnitSystem.PSI) == {
        "why": ["at 0.0394 in", ["0.450 lbf"]],
        "value": 3.0,
        "none": None,
    }


def test_a_person_reads_no_powers_of_ten_where_a_plain_number_does() -> None:
    said = "known to +-302 % only, 2.58e+04 standard deviations, 1.2e+02 times the noise, F_s = 8.5e+03 N"
    shown = "known to ±302 % only, 25800 standard deviations, 120 times the noise, F_s = 8500 N"
    assert in_units(said, UnitSystem.SI) == shown
    assert in_units("test 1e+03x and 3e+12", UnitSystem.SI) == "test 1e+03x and 3e+12"
