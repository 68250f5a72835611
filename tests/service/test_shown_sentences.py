from __future__ import annotations

from datetime import UTC, datetime
from zoneinfo import ZoneInfo

import pytest

from discrepancy.rough.causes.base import Fitted
from service.shown.diagnosis_words import beside_no_fault
from service.words.messages import in_units
from service.words.plain_numbers import as_read
from service.words.reader import Reader
from service.words.sentences import as_sentence, sentences_of, together, without, without_end
from service.words.units import UnitSystem, measured_said, quantity_said
from valve.messages import Message, joined, lines_of, say


@pytest.mark.parametrize(
    ("system", "text"),
    [
        (UnitSystem.SI, "82.44 kPa, broke away from 48.54 mm, within 78.60 kPa"),
        (UnitSystem.BAR, "0.8244 bar, broke away from 48.54 mm, within 0.7860 bar"),
        (UnitSystem.PSI, "11.96 psi, broke away from 1.911 in, within 11.40 psi"),
    ],
)
def test_quantities_are_read_in_the_chosen_units(system: UnitSystem, text: str) -> None:
    template = "{high:.4g Pa}, broke away from {at:.6g m}, within {healthy:.4g Pa}"
    assert in_units(say("stuck", template, high=8.244e4, at=0.0485445, healthy=7.86e4), system) == text


@pytest.mark.parametrize(
    ("template", "value", "text"),
    [
        ("noise of {x:.3g um}", 5.0e-6, "noise of 0.00020 in"),
        ("{x:g N}", 0.0, "0 lbf"),
        ("{x:.4g N*s/m}", 612.9, "3.500 lbf·s/in"),
        ("at {x:.2g mm/s}", 3.0e-3, "at 0.118 in/s"),
        ("{x:.2g mm}", -1.5e-3, "-0.0591 in"),
        ("{x:.3g s}, {x:.1f %}", 0.25, "0.25 s, 25.0 %"),
    ],
)
def test_each_unit_has_its_own(template: str, value: float, text: str) -> None:
    assert in_units(say("x", template, x=value), UnitSystem.PSI) == text


@pytest.mark.parametrize(
    ("value", "low", "high", "text"),
    [
        (250.0, 249.96, 250.04, "56.20 lbf (56.19 to 56.21)"),
        (250.0, 249.9996, 250.0004, "56.2022 lbf (56.2021 to 56.2023)"),
    ],
)
def test_the_ends_of_a_narrow_interval_differ_in_any_unit(value: float, low: float, high: float, text: str) -> None:
    said = say("f", "{x:.7g N} ({low:.7g in N} to {high:.7g in N})", x=value, low=low, high=high)
    assert in_units(said, UnitSystem.PSI) == text


@pytest.mark.parametrize(
    ("template", "value_m", "text"),
    [
        ("from {x:g m}", 2.01544e-6, "from 2.015 µm"),
        ("noise of {x:.3g um}", 5.0e-6, "noise of 5 µm"),
        ("it moved {x:g m}", 2.0e-4, "it moved 0.200 mm"),
        ("it stood at {x:g m}", 0.0, "it stood at 0 mm"),
        ("{x:g um}", -4.291e-3, "-4.291 mm"),
    ],
)
def test_a_small_length_is_read_in_micrometres(template: str, value_m: float, text: str) -> None:
    assert in_units(say("x", template, x=value_m), UnitSystem.SI) == text


def test_a_measured_value_within_a_message_is_read_in_every_unit() -> None:
    said = say(
        "rose",
        "Friction rose by {moved} to {now}.",
        moved=measured_said(50.7, (49.5, 51.9), "N"),
        now=quantity_said(612.0, "N"),
    )
    assert said == "Friction rose by 50.7 ± 1.2 N to 612.0 N."
    assert in_units(said, UnitSystem.PSI) == "Friction rose by 11.40 ± 0.27 lbf to 137.6 lbf."
    assert measured_said(None, None, "N") == "–"


def test_messages_of_one_text_are_told_apart_by_what_they_were_made_of() -> None:
    first, second = (say("moved", "it moved {way:.2g mm}", way=way) for way in (1.21e-3, 1.24e-3))
    assert first == second
    assert [in_units(one, UnitSystem.PSI) for one in (first, second)] == ["it moved 0.0476 in", "it moved 0.0488 in"]
    within = [say("so", "{why}", why=one) for one in (first, second)]
    assert [in_units(one, UnitSystem.PSI) for one in within] == ["it moved 0.0476 in", "it moved 0.0488 in"]


def test_a_text_that_is_no_message_stays_as_it_was_said() -> None:
    assert in_units("it stood at 0.0485445 m, +-3 %", UnitSystem.PSI) == "it stood at 0.0485445 m, ±3 %"


def test_every_text_of_a_document_is_changed_and_nothing_else() -> None:
    at, by = say("at", "at {x:.3g mm}", x=1.0e-3), say("by", "{x:.3g N}", x=2.0)
    document = {"why": [at, (by,)], "value": 3.0, "none": None}
    assert Reader(UnitSystem.PSI).all_told(document) == {
        "why": ["at 0.0394 in", ["0.450 lbf"]],
        "value": 3.0,
        "none": None,
    }


def test_a_person_reads_no_powers_of_ten_where_a_plain_number_does() -> None:
    said = "known to +-302 % only, 2.58e+04 standard deviations, 1.2e+02 times the noise, F_s = 8.5e+03 N"
    shown = "known to ±302 % only, 25800 standard deviations, 120 times the noise, F_s = 8500 N"
    assert in_units(said, UnitSystem.SI) == shown
    assert in_units("test 1e+03x and 3e+12", UnitSystem.SI) == "test 1e+03x and 3e+12"


@pytest.mark.parametrize(
    ("system", "text"),
    [
        (UnitSystem.SI, "FV-101: moved 0.12 mm (0.1 to 0.14) at 82.4 kPa, ±3 %; 510 N"),
        (UnitSystem.PSI, "FV-101: moved 0.00472 in (0.00394 to 0.00551) at 12.0 psi, ±3 %; 115 lbf"),
    ],
)
def test_a_message_is_made_anew_in_the_units_of_its_reader(system: UnitSystem, text: str) -> None:
    moved = say(
        "moved",
        "moved {way:.3g mm} ({low:.3g in mm} to {high:.3g in mm}) at {at:.3g Pa}, +-{share:.0f %}",
        way=1.2e-4,
        low=1.0e-4,
        high=1.4e-4,
        at=8.24e4,
        share=0.03,
    )
    assert in_units(say("held", "{tag}: {why}; {force:.3g N}", tag="FV-101", why=moved, force=510.0), system) == text


def test_numbers_that_differ_differ_in_every_unit() -> None:
    said = say("k", "{k:.5g N/mm} ({low:.5g in N/mm} to {high:.5g in N/mm})", k=52501.0, low=52500.0, high=52502.0)
    assert in_units(said, UnitSystem.PSI) == "299.788 lbf/in (299.783 to 299.794)"


def test_an_instant_is_told_by_the_plants_clock() -> None:
    said = say("since", "since {at}", at=datetime(2026, 11, 1, 12, 30, tzinfo=UTC))
    assert in_units(said, UnitSystem.SI, ZoneInfo("Europe/Berlin")) == "since 2026-11-01 13:30 CET"
    assert in_units(said, UnitSystem.SI) == "since 2026-11-01 12:30 UTC"


def test_a_message_that_becomes_a_sentence_keeps_its_units() -> None:
    said = as_sentence(say("moved", "it moved {way:.3g mm}", way=2.54e-3))
    assert in_units(said, UnitSystem.PSI) == "It moved 0.100 in."


ASTRAY = say("astray", "{tag}: it stands at {at:.3g mm}", tag="FV-101", at=0.0508)
ALARM = "SAFE STATE NOT CONFIRMED: go and look"


@pytest.mark.parametrize("error", [joined("; ", [ALARM, ASTRAY]), f"{ALARM}; {ASTRAY}"])
def test_what_stands_beside_a_reason_is_left_out_of_it(error: str) -> None:
    assert without(error, "FV-101", ALARM) == "it stands at 50.8 mm"
    assert without(error, "FV-102") == error


def test_an_alarm_with_its_reason_leaves_the_reason() -> None:
    unsafe = say("unsafe", "{alarm}: {why}", alarm=say("alarm", ALARM), why="the supply is gone")
    assert without(joined("; ", [ASTRAY, unsafe]), "FV-101", ALARM) == "it stands at 50.8 mm; the supply is gone"
    assert without(unsafe, "FV-101", ALARM) == "the supply is gone"
    assert without(say("alarm", ALARM), "FV-101", ALARM) == ""


def test_a_reason_without_its_subject_keeps_its_units() -> None:
    said = without(joined("; ", [ALARM, ASTRAY]), "FV-101", ALARM)
    assert isinstance(said, Message)
    assert in_units(said, UnitSystem.PSI) == "it stands at 2.00 in"


def test_a_reason_that_was_told_is_left_out_of_a_note() -> None:
    slow = say("slow", "The rate is too low.")
    note = say("known_to", "known to +-{share:.0f %} only: {why}", share=0.55, why=slow)
    assert without_end(note, [slow]) == "known to +-55 % only"
    assert without_end(note, []) == note
    assert without_end(str(note), [str(slow)]) == "known to +-55 % only"


@pytest.mark.parametrize("is_message", [True, False])
def test_sentences_are_parts_and_not_cut_out_of_a_message(is_message: bool) -> None:
    two = say("two", "See No. 4. It is B. Repeat it.")
    said = joined(" ", [two, say("late", "It is late.")])
    assert sentences_of(said if is_message else str(said)) == (
        [str(two), "It is late."] if is_message else ["See No. 4.", "It is B.", "Repeat it.", "It is late."]
    )


def test_lines_and_sentences_are_put_together_as_they_were() -> None:
    assert lines_of(joined("\n", [ASTRAY, "it is late\nand far"])) == [ASTRAY, "it is late", "and far"]
    assert together(["", ASTRAY]) is ASTRAY
    assert together([ASTRAY, "", "Look."], "; ") == f"{ASTRAY}; Look."
    assert together([]) == ""


def test_beside_no_fault_stands_how_friction_varies() -> None:
    varies = say("varies", "It varies by {share:.1f %}.", share=0.03)
    assert beside_no_fault(say("no_fault", "No fault found. {how}", how=varies)) == [varies]
    assert beside_no_fault("No fault found. It varies by 3.0 %.") == ["It varies by 3.0 %."]
    assert beside_no_fault(varies) == [varies]


def test_a_message_is_read_in_its_own_units_without_powers_of_ten() -> None:
    said = say("off", "off by {n:.2g} to +-{share:.2g %}: {why}", n=123.0, share=1.2, why="1.2e+02 N")
    assert as_read(said) == "off by 120 to ±120 %: 120 N"


def test_an_instant_to_the_second_is_told_by_the_plants_clock_too() -> None:
    said = say("at", "at {at:%H:%M:%S}", at=datetime(2026, 11, 1, 12, 30, 5, tzinfo=UTC))
    assert in_units(said, UnitSystem.SI) == "at 12:30:05 UTC"
    assert in_units(said, UnitSystem.SI, ZoneInfo("Europe/Berlin")) == "at 13:30:05 CET"


def test_a_length_with_fixed_places_stays_in_millimetres() -> None:
    stands = say("stands_in_test", "{at:.3f mm}, moved by {moved:.3g mm}", at=6.4e-7, moved=6.4e-7)
    assert in_units(stands, UnitSystem.SI) == "0.001 mm, moved by 0.640 µm"


def test_a_fitted_value_without_an_interval_is_told_in_every_unit() -> None:
    fitted = Fitted(66182.0, 3.0, "Pa").in_words("kPa")
    assert [in_units(fitted, one) for one in UnitSystem] == ["66.2 kPa", "0.662 bar", "9.60 psi"]
