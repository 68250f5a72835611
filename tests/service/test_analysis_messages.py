"""What an analysis says stays data on its way through JSON: each sentence in it has its code and its values."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any, Final

import pytest

from service.analysis.analysis import analyze_recordings
from service.words.messages import in_units
from service.words.units import UnitSystem
from tests.support.rough_valves import case
from valve.effects import Effect
from valve.effects.local_friction import LocalFriction
from valve.messages import TABLE, Message, messages_in, restored, with_table

#: Names along the axis of a picture.
LABELS: Final = frozenset({"time at rest"})
_TIGHT_SPOT: Final = LocalFriction(rise_n=0.35 * 1120.0, centre_m=0.4 * 0.06, width_m=0.025 * 0.06)


@pytest.fixture(scope="module", params=[(), (_TIGHT_SPOT,)], ids=["healthy", "tight_spot"])
def analysis(request: pytest.FixtureRequest) -> dict[str, Any]:
    effects: tuple[Effect, ...] = request.param
    made = case("large", "triangle", "usual", seed=32, effects=list(effects))
    return analyze_recordings([made.recording], made.nameplate)


def _texts(document: Any) -> Iterator[str]:
    if isinstance(document, str):
        yield document
    elif isinstance(document, Mapping):
        for member in document.values():
            yield from _texts(member)
    elif isinstance(document, list | tuple):
        for member in document:
            yield from _texts(member)


def test_each_sentence_of_an_analysis_is_in_its_table(analysis: dict[str, Any]) -> None:
    told = json.loads(json.dumps(with_table(analysis), allow_nan=False))
    table = told.pop(TABLE)
    plain = {text for text in _texts(told) if " " in text} - set(table) - LABELS
    assert plain == set()
    assert analysis["discrepancy"]["message"] in table or analysis["discrepancy"]["causes"]


def test_an_analysis_from_json_says_the_same_in_each_unit(analysis: dict[str, Any]) -> None:
    again = restored(json.loads(json.dumps(with_table(analysis))))
    said = [text for text in _texts(analysis) if isinstance(text, Message) and text]
    found = [text for text in _texts({**again, TABLE: None}) if isinstance(text, Message)]
    assert [one.code for one in found] == [one.code for one in said]
    for one, other in zip(said, found, strict=True):
        assert in_units(other, UnitSystem.PSI) == in_units(one, UnitSystem.PSI)


def test_a_finding_follows_the_units_of_its_reader(analysis: dict[str, Any]) -> None:
    codes = [one.code for text in _texts(analysis) for one in messages_in(text)]
    where = analysis["discrepancy"]["misfit"]["where"]
    assert where.code == "mean_law_misses"
    assert " in opening" in in_units(where, UnitSystem.PSI) or " in closing" in in_units(where, UnitSystem.PSI)
    if analysis["discrepancy"]["causes"]:
        (spot,) = analysis["discrepancy"]["causes"]
        assert spot["sentence"].code == "tight_spot"
        rise = spot["sentence"].values["rise"]
        assert rise.values["value"] == pytest.approx(spot["parameters"]["rise_n"]["value"])
        assert " lbf (" in in_units(spot["sentence"], UnitSystem.PSI)
    else:
        assert "no_fault" in codes
