"""Each language says everything that the product says, with the same values in it."""

from __future__ import annotations

import polib
import pytest

from service.model.acknowledgement import last_end
from service.model.run import Run, RunState, new_run_id
from service.words.languages import Catalogue, Language, catalogue, path_of
from service.words.messages import in_units
from service.words.units import UnitSystem
from tests.bench.translations import everything_said, fields_of
from valve.messages import say

OTHERS = [language for language in Language if language is not Language.ENGLISH]


@pytest.mark.parametrize("language", OTHERS)
def test_a_catalogue_is_complete(language: Language) -> None:
    path = path_of(language)
    assert path is not None
    done = {(one.msgctxt or "", one.msgid) for one in polib.pofile(str(path)) if one.translated()}
    missing = [one for one in everything_said() if (one.code, one.english) not in done]
    assert missing == [], "python -m tests.bench.translations lists what is missing"


@pytest.mark.parametrize("language", OTHERS)
def test_a_translation_tells_the_same_values(language: Language) -> None:
    path = path_of(language)
    assert path is not None
    other = [
        one.msgid
        for one in polib.pofile(str(path))
        if fields_of(one.msgctxt or "", one.msgid) != fields_of(one.msgctxt or "", one.msgstr)
    ]
    assert other == []


def test_a_message_is_told_in_the_language_of_its_reader() -> None:
    why = say("elsewhere", "{reason}: repeat the request at {url}", reason="it moved", url="x")
    assert in_units(why, UnitSystem.SI, language=Language.GERMAN).startswith("it moved: wiederholen Sie")


def test_how_the_last_test_ended_is_told_in_the_language_of_its_reader() -> None:
    ended = last_end(Run(new_run_id(), "FV-101", "triangle", state=RunState.COMPLETED))
    assert ended.value == "completed"
    assert in_units(ended.value, UnitSystem.SI, language=Language.GERMAN) == "abgeschlossen"


def test_a_message_of_another_time_than_the_catalogue_is_told_in_english() -> None:
    said = Catalogue({"late": ("It is {by} late.", "Es ist {by} zu spät.")})
    assert said.template(say("late", "It is {by} late.", by=3)) == "Es ist {by} zu spät."
    assert said.template(say("late", "It comes {by} late.", by=3)) == "It comes {by} late."


@pytest.mark.parametrize(
    ("header", "language"),
    [
        (None, Language.ENGLISH),
        ("de-AT,de;q=0.9,en;q=0.5", Language.GERMAN),
        ("fr, en;q=0.3, de;q=0.8", Language.GERMAN),
        ("en-GB,de;q=0.9", Language.ENGLISH),
        ("fr;q=high, *", Language.ENGLISH),
    ],
)
def test_a_browser_gets_the_language_that_it_likes_best(header: str | None, language: Language) -> None:
    assert Language.wished(header) is language


def test_a_page_says_what_its_catalogue_has() -> None:
    assert catalogue(Language.GERMAN).text("Valves") == "Ventile"
    assert catalogue(Language.GERMAN).text("no text of a page") == "no text of a page"
    assert catalogue(Language.ENGLISH).text("Valves") == "Valves"
