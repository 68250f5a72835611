"""Numbers are shown with as many digits as are known of them."""

from __future__ import annotations

import pytest

from service.cli.analysis_tables import scatters
from service.words.plain_numbers import scatter_words, with_span


@pytest.mark.parametrize(
    ("value", "low", "high", "shown"),
    [
        (250.0213, 249.9713, 250.0713, ("250", "within 0.1 %")),
        (1.6007, 1.003, 2.5546, ("1.60", "1.00 to 2.55")),
        (105124.3, 105122.1, 105126.4, ("105100", "within 0.1 %")),
        (12345.0, 2345.0, 22345.0, ("12000", "2000 to 22000")),
        (0.00011217, 9.7e-5, 1.29e-4, ("0.000112", "0.000097 to 0.000129")),
        (-0.001, -0.02, 0.018, ("-0.001", "-0.020 to 0.018")),
        (5.0e8, 4.0e8, 6.0e8, ("5e+08", "4e+08 to 6e+08")),
        (0.7, 0.7, 0.7, ("0.700", "within 0.1 %")),
    ],
)
def test_a_value_and_its_interval_have_two_digits_of_half_of_it(
    value: float, low: float, high: float, shown: tuple[str, str]
) -> None:
    assert with_span(value, low, high) == shown


def test_what_a_parameter_itself_varies_by_is_said_in_percent() -> None:
    assert scatter_words("F_s", 1708.0, 41.0) == "from breakaway to breakaway ± 2.4 %"
    assert scatter_words("F_c", 1000.0, 5.0) == "along the travel and in time ± 0.5 %"
    assert not scatter_words("F_c", 1000.0, 0.012), "no instrument knows it"
    assert not scatter_words("F_s", 1708.0, None)
    assert not scatter_words("F_s", None, None)


def test_a_terminal_shows_value_interval_and_scatter_of_a_parameter() -> None:
    entry = {"value": 1708.0, "unit": "N", "ci95": [1695.0, 1721.0], "scatter": 41.0}
    silent = {"value": 2.0, "unit": "N", "ci95": None, "scatter": None}
    lines = scatters([{"method": "garcia", "parameters": {"F_c": silent, "F_s": entry}}])
    assert lines == ["garcia: F_s 1708 N (1695 to 1721), from breakaway to breakaway ± 2.4 %."]
