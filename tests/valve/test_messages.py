from __future__ import annotations

import copy
import json
import math
import pickle
from datetime import UTC, datetime, timedelta, timezone
from typing import Literal

import numpy as np
import pytest

from valve import messages
from valve.errors import MeasurementError, RequestError, refuse
from valve.messages import (
    Message,
    changed,
    from_json,
    joined,
    message_of,
    messages_in,
    parts_of,
    restored,
    say,
    with_table,
)

YIELDS = say(
    "yields",
    "The stem yields by {way:.3g mm} ({low:.3g in mm} to {high:.3g in mm}).",
    way=1.2e-4,
    low=1e-4,
    high=1.4e-4,
)


def test_a_message_is_the_english_sentence_in_the_units_of_its_template() -> None:
    assert YIELDS == "The stem yields by 0.12 mm (0.1 to 0.14)."
    assert YIELDS.code == "yields"
    assert YIELDS.values["way"] == 1.2e-4


@pytest.mark.parametrize(
    ("template", "value", "text"),
    [
        ("{x:g Pa}", 2.0e5, "200000 Pa"),
        ("{x:.1f %}", 0.125, "12.5 %"),
        ("{x:.3g} times", 2.0, "2 times"),
        ("{x} of 5", 3, "3 of 5"),
        ("{x:>4}|", "ab", "  ab|"),
        ("at {x}", datetime(2026, 11, 1, 13, 30, tzinfo=timezone(timedelta(hours=1))), "at 2026-11-01 12:30 UTC"),
        ("at {x:%H:%M:%S}", datetime(2026, 11, 1, 13, 30, 5, tzinfo=timezone(timedelta(hours=1))), "at 12:30:05 UTC"),
        ("{x:, }", ("a", say("b", "b {n}", n=1)), "a, b 1"),
        ("{x}", ("a", "b"), "a; b"),
    ],
)
def test_each_kind_of_value_has_its_words(template: str, value: object, text: str) -> None:
    assert say("x", template, x=value) == text  # type: ignore[arg-type]


def test_digits_may_be_a_value_themselves() -> None:
    assert say("x", "{x:.{digits}g N}", x=12.3456, digits=4) == "12.35 N"


class _Breaks(float):
    def __format__(self, spec: str, /) -> str:
        raise RuntimeError(spec)


@pytest.mark.parametrize(
    ("template", "value", "text"),
    [
        ("{x:.3g mm} away", "unknown", "{x:.3g mm} away (x = unknown)"),
        ("{x:.3g}", ("a", "b"), "a.3gb"),
        ("{x:.3g}", None, "{x:.3g} ()"),
        ("{x:d}", 1.5, "{x:d} (x = 1.5)"),
        ("{y}", 1.5, "{y} (x = 1.5)"),
        ("{x", 1.5, "{x (x = 1.5)"),
        ("{x:.3g}", _Breaks(1.5), "{x:.3g} (x = 1.5)"),
    ],
)
def test_a_template_that_does_not_fit_is_told_and_logged_and_never_raises(
    template: str, value: object, text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    logged: list[object] = []
    monkeypatch.setattr(messages._LOG, "error", lambda *about: logged.append(about))
    made = say("unfit", template, x=value)  # type: ignore[arg-type]
    assert made == text
    assert made.code == "unfit"
    assert from_json(made.to_json()) == text
    assert bool(logged) is (text != "a.3gb")


def test_a_template_that_does_not_fit_makes_a_test_fail() -> None:
    with pytest.raises(AssertionError, match="unfit"):
        say("unfit", "{x:d}", x=1.5)


def test_a_message_outlives_a_copy_and_another_process() -> None:
    held = say("held", "{tag}: {why}", tag="FV-101", why=YIELDS)
    for same in (copy.deepcopy(held), pickle.loads(pickle.dumps(held))):
        assert same == held
        assert isinstance(same.values["why"], Message)
        assert same.values["why"].code == "yields"


def test_a_sentence_and_a_clause_stay_messages() -> None:
    assert say("late", "the valve is late").formed("sentence") == "The valve is late."
    clause = YIELDS.formed("clause")
    assert clause == "the stem yields by 0.12 mm (0.1 to 0.14)"
    assert clause.code == "yields"


def test_a_document_gives_its_messages_back_after_json() -> None:
    at = datetime(2026, 11, 1, tzinfo=UTC)
    held = say("held", "{tag}: {why}, {all:, }", tag="FV-101", why=YIELDS, all=(say("since", "since {at}", at=at), "x"))
    document = {"note": held, "plain": "The stem.", "rows": [[1.0, 2.0], [held.formed("sentence")]], "none": None}
    told = json.loads(json.dumps(with_table(document)))
    assert {name: told[name] for name in document} == json.loads(json.dumps(document))
    again = restored(told)
    assert again["note"].code == "held"
    assert again["note"].values["all"][0].values["at"] == at
    assert again["rows"][1][0].form == "sentence"
    assert not isinstance(again["plain"], Message)
    assert json.loads(json.dumps(with_table(again))) == told


def test_a_document_without_a_table_is_left_as_it_is() -> None:
    assert restored({"note": "as it was", "values": [1.0]}) == {"note": "as it was", "values": [1.0]}


def test_an_error_gives_the_message_that_it_was_raised_with() -> None:
    assert message_of(MeasurementError(YIELDS)) is YIELDS
    assert message_of(OSError(2, "no such file")) == "[Errno 2] no such file"
    with pytest.raises(RequestError) as caught:
        refuse(RequestError, ["", YIELDS, "too fast"])
    said = message_of(caught.value)
    assert isinstance(said, Message)
    assert said == f"{YIELDS}\ntoo fast"
    assert said.values["parts"] == (YIELDS, "too fast")


def test_parts_with_nothing_between_them_stand_side_by_side() -> None:
    said = joined("", [YIELDS, " (", "at once", ")"])
    assert said == f"{YIELDS} (at once)"
    assert parts_of(said) == (YIELDS, " (", "at once", ")")


@pytest.mark.parametrize(
    "value", [math.nan, -math.inf, 1.5, 3, True, np.float64(2.5), np.float32(0.5), np.int64(7), np.float64(math.nan)]
)
def test_a_number_of_any_kind_survives_strict_json(value: float) -> None:
    held = say("number", "{x} of it", x=value)
    text = json.dumps(with_table({"why": held}), allow_nan=False)
    again = restored(json.loads(text))["why"]
    assert again == held
    assert isinstance(again, Message)
    told = again.values["x"]
    assert isinstance(told, float | int)
    assert told == pytest.approx(float(value), nan_ok=True)


def test_what_a_table_of_another_version_has_stays_a_text() -> None:
    document = {"why": "as it was", "messages": {"as it was": {"code": "odd"}, "other": [1]}}
    assert restored(document)["why"] == "as it was"


def test_the_parts_that_were_joined_come_apart_again() -> None:
    several = joined(" ", [joined("; ", ["too slow", YIELDS]), "Repeat it."])
    assert parts_of(several) == ("too slow", YIELDS, "Repeat it.")
    assert parts_of(YIELDS) == (YIELDS,)
    assert parts_of("") == ()


def test_a_text_in_a_message_is_changed_and_one_in_a_list_left_out() -> None:
    held = say("held", "{tag}: {all:; }", tag="FV-101", all=("too fast", say("late", "it is late")))
    said = changed(held, lambda text: {"too fast": None, "FV-101": "FV-102", "it is late": "late"}.get(text, text))
    assert said == "FV-102: late"
    assert isinstance(said, Message)
    assert said.code == "held"


@pytest.mark.parametrize(
    ("form", "text"),
    [("sentence", "It is late."), ("clause", "it is late"), ("heading", "It is late."), ("entry", "it is late")],
)
def test_a_form_changes_the_first_letter_and_the_stop(form: Literal["sentence", "clause"], text: str) -> None:
    late = say("late", "it is late.")
    assert late.formed(form) == text
    assert late.formed(form).code == "late"


def test_one_message_alone_stays_itself_where_parts_are_joined() -> None:
    assert joined(" ", [YIELDS]) is YIELDS
    assert joined(" ", ["plain"]) == "plain"
    assert joined(" ", []) == ""


def test_the_messages_in_a_message_are_found() -> None:
    held = say("held", "{tag}: {why}, {all:, }", tag="FV-101", why=YIELDS, all=(say("since", "since {n}", n=1), "x"))
    assert [one.code for one in messages_in(held)] == ["held", "yields", "since"]
    assert list(messages_in("plain")) == []


def test_a_message_that_says_nothing_is_in_no_table() -> None:
    assert with_table({"note": joined(" ", []), "other": ""}) == {"note": "", "other": ""}
