"""Nameplate files: what is read, and that each fault is one sentence with file, key, value and reason."""

from __future__ import annotations

from pathlib import Path

import pytest

from service.config.nameplates import nameplate_from_mapping, nameplate_from_toml, read_nameplate
from valve.errors import ConfigurationError
from valve.nameplate import Action, Actuator, Nameplate, Signal

GOOD = """\
tag = "FV-101"
[actuator]
diaphragm_area_m2 = 0.06452
travel_m = 0.1016
action = "spring"
moving_mass_kg = 1
bench_set_pa = [0.0, 82737]
[signal]
range_ma = [4.0, 20.0]
range_pa = [0.0, 82737.0]
"""
PLATE = Nameplate(
    "FV-101", Actuator(0.1016, 0.06452, Action.SPRING, 1.0, (0.0, 82737.0)), Signal((4.0, 20.0), (0.0, 82737.0))
)


def test_a_nameplate_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "fv-101.toml"
    path.write_text("\ufeff" + GOOD, encoding="utf-8")
    assert read_nameplate(path) == PLATE


def test_what_is_optional_may_be_absent() -> None:
    plate = nameplate_from_toml(b'tag = "A"\n[actuator]\ntravel_m = 0.02\naction = "double"\n', "a.toml")
    assert plate == Nameplate("A", Actuator(0.02, action=Action.DOUBLE))
    assert nameplate_from_mapping({"tag": "A", "actuator": {"travel_m": 0.02}, "signal": None}, "a").signal is None


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("travel_m", "travel_mm", "unknown key actuator.travel_mm"),
        ("[actuator]", "[actuatr]", "unknown key actuatr"),
        ("travel_m = 0.1016", "", "key actuator.travel_m is missing"),
        ('tag = "FV-101"', "", "key tag is missing"),
        ('tag = "FV-101"', "tag = 101", "tag is 101: input should be a valid string"),
        ('tag = "FV-101"', 'tag = ""', "1 to 64 printable characters"),
        ("0.1016", '"0.1016"', "actuator.travel_m is '0.1016': input should be a valid number"),
        ("0.1016", "true", "actuator.travel_m is True"),
        ("0.1016", "nan", "actuator.travel_m is nan m, it must be above 0"),
        ("0.1016", "-1.0", "actuator.travel_m is -1 m, it must be above 0"),
        ("0.1016", "101.6", "actuator.travel_m is 101.6 m, .* looks like mm"),
        ("0.06452", "645.2", "diaphragm_area_m2 is 645.2 m2, .* looks like cm2"),
        ("82737]", "0.83]", r"bench_set_pa is 0 to 0.83 Pa, .* looks like bar, psi or kPa"),
        ("82737.0]", "12.0]", r"range_pa is 0 to 12 Pa, .* looks like bar, psi or kPa"),
        ("[4.0, 20.0]", "[20.0, 4.0]", "signal.range_ma is 20 to 4 mA, it must rise"),
        ("[4.0, 20.0]", "[4.0]", "signal.range_ma"),
        ("[4.0, 20.0]", "[4.0, 12.0, 20.0]", "signal.range_ma"),
        ('"spring"', '"sprung"', "actuator.action is 'sprung': input should be 'spring' or 'double'"),
        ("tag =", "tag", "it is no TOML: .*line 1"),
    ],
)
def test_a_wrong_nameplate_is_one_sentence(old: str, new: str, says: str) -> None:
    assert old in GOOD
    with pytest.raises(ConfigurationError, match=says) as caught:
        nameplate_from_toml(GOOD.replace(old, new, 1).encode(), "fv-101.toml")
    assert str(caught.value).startswith("fv-101.toml: ")
    assert "\n" not in str(caught.value)


def test_a_file_that_is_no_nameplate_is_one_sentence(tmp_path: Path) -> None:
    binary, large = tmp_path / "binary.toml", tmp_path / "large.toml"
    binary.write_bytes(b"\xff\xfe")
    large.write_bytes(b"#" * 100_000)
    for path, says in (
        (tmp_path / "none.toml", "no such nameplate file"),
        (tmp_path, "it is a folder"),
        (binary, "no text in UTF-8"),
        (large, "has 100000 bytes"),
    ):
        with pytest.raises(ConfigurationError, match=says):
            read_nameplate(path)


def test_an_empty_file_says_what_is_missing() -> None:
    with pytest.raises(ConfigurationError, match="key tag is missing"):
        nameplate_from_toml(b"", "empty.toml")
