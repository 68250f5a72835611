"""``--held-out`` with one file or several, before or after the recordings."""

from __future__ import annotations

import pytest

from service.cli.held_out import repeat_flag


@pytest.mark.parametrize(
    ("given", "fitted", "held_out"),
    [
        ("a.csv --nameplate n.toml --held-out b.csv c.csv", ["a.csv"], ["b.csv", "c.csv"]),
        ("a.csv b.csv --held-out c.csv d.csv --json out.json", ["a.csv", "b.csv"], ["c.csv", "d.csv"]),
        ("--nameplate n.toml --held-out c.csv a.csv b.csv", ["a.csv", "b.csv"], ["c.csv"]),
        ("a.csv --held-out b.csv --nameplate n.toml --held-out c.csv", ["a.csv"], ["b.csv", "c.csv"]),
        ("a.csv --nameplate=n.toml --held-out=b.csv", ["a.csv"], ["b.csv"]),
    ],
)
def test_a_held_out_recording_is_never_taken_for_one_to_fit(given: str, fitted: list[str], held_out: list[str]) -> None:
    arguments = repeat_flag(given.split())
    flags = [i for i, argument in enumerate(arguments) if argument.startswith("--held-out")]
    found = [a.partition("=")[2] or arguments[i + 1] for i, a in enumerate(arguments) if i in flags]
    assert found == held_out
    options = {i for i, a in enumerate(arguments) if a.startswith("--")}
    values = {i + 1 for i in options if "=" not in arguments[i]}
    assert [a for i, a in enumerate(arguments) if i not in options | values] == fitted
