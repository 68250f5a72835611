from __future__ import annotations

import pytest

from valve.column_names import remedy


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("position_mm", "multiply it by 0.001 and call it position_m"),
        ("Pressure [bar]", "multiply it by 100000 and call it pressure_pa"),
        ("time_ms", "multiply it by 0.001 and call it time_s"),
        ("force_kN", "multiply it by 1000 and call it force_n"),
        ("command_percent", "command_ma, 4 + 0.16 times percent"),
        ("travel (%)", "percent / 100 times the travel"),
        ("position_deg", "the angle in rad times the lever"),
        ("valve", "rename it or leave it out"),
        ("temperature_c", "rename it or leave it out"),
        ("", "rename it or leave it out"),
    ],
)
def test_a_column_that_is_not_read_is_sent_to_the_one_that_is(name: str, said: str) -> None:
    assert said in remedy(name)
