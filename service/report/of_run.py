"""The report of a stored test, with its baseline, its trend and its repair."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import tzinfo
from typing import Any, Final

from service.config.plant import Plant, PlantValve
from service.health.changes import facts_of
from service.health.comparison import compare
from service.model.acknowledgement import alarm_words
from service.model.analysis import words_of_repetition
from service.model.family_rule import event_of_early
from service.model.requester import person_of
from service.model.run import Label, Run, RunState
from service.model.stands_words import where_it_stands
from service.model.until import early_words
from service.recordings.place import recording_of
from service.report.before_after import BeforeAfter, before_after
from service.report.ended import EndedSource
from service.report.source import ReportSource
from service.report.valve_facts import (
    AREA,
    SERIAL_NUMBER,
    class_facts,
    frame_of,
    identity_facts,
    nameplate_facts,
    wiring_facts,
)
from service.shown.ending import ending_of
from service.shown.history import past_of
from service.shown.overlays import before_of, layers_of, words_of
from service.shown.words import STATES
from service.store.store import Store
from service.words.names import named
from service.words.plant_clock import instant_words
from service.words.reader import Reader
from service.words.sentences import as_sentence, together
from valve.errors import ValveError
from valve.messages import message_of, say

_IN_JOURNAL: Final = say(
    "sampled_in_journal",
    "What was sampled is safe in the journal of this test; it becomes its recording at the next start of the service.",
)


def source_of(plant: Plant, store: Store, run: Run, reader: Reader) -> ReportSource:
    """Return what the report of a completed test is made of; reads the database and blocks."""
    assert run.analysis is not None
    valve, zone = plant.valves.get(run.valve), reader.zone
    past = past_of(store, run.valve, valve, run)
    chosen = before_of(store, run, past)
    then = None if chosen is None else store.runs.get(chosen)
    rows: list[BeforeAfter] = []
    if valve is not None and then is not None and then.analysis is not None:
        rows = before_after(then.analysis, run.analysis, valve.health, facts_of(valve), reader)
    held = past.held_against
    baseline = None if past.baseline is None or past.baseline.id == run.id else past.baseline.analysis
    return ReportSource(
        run.valve,
        _subject(run, zone),
        run.analysis,
        tuple(_facts(run, None if past.baseline is None else past.baseline.id, reader)),
        None if baseline is None else baseline.get("signature"),
        past.trends if len(past.same_motion) > 1 else (),
        tuple((run.permissives or {}).get("permissives") or ()),
        tuple(repair_sentences(store, run, valve)),
        reader,
        _of_valve(valve, reader),
        run.sequence,
        where_it_stands(run),
        alarm_words(run),
        frame_of(valve, None if held is None else held.test),
        tuple(layers_of(store, run, [] if then is None else [then.id], zone)[1:]),
        tuple(_head(run, valve, plant.service.plant)),
        "" if then is None else words_of(then, zone, "" if then.label else named("test")),
        tuple(rows),
        run.note or "",
    )


def _head(run: Run, valve: PlantValve | None, plant: str) -> Iterator[tuple[str, str]]:
    """Yield what a technician files the report by; "" where it is to be filled in by hand."""
    identity: dict[str, str] = {} if valve is None else dict(identity_facts(valve.identity))
    yield say("fact_plant", "Plant"), plant
    yield AREA, identity.pop(AREA, "")
    yield say("fact_tag", "Tag"), run.valve
    yield SERIAL_NUMBER, identity.pop(SERIAL_NUMBER, "")
    yield from identity.items()
    yield say("fact_technician", "Technician"), person_of(run.requested_by)
    yield say("fact_work_order", "Work order"), run.work_order or (run.permissives or {}).get("permit") or ""


def ended_source_of(plant: Plant, store: Store, run: Run, reader: Reader) -> EndedSource:
    """Return what the report of a finished test without a result is made of; reads the database and blocks."""
    valve = plant.valves.get(run.valve)
    newest = store.runs.newest(1, valve=run.valve)
    file, no_file = None, ""
    if run.recording_file is not None:
        try:
            file = str(recording_of(run, plant, store))
        except ValveError as error:  # another gateway has it, or nobody has it any more
            no_file = as_sentence(message_of(error))
    elif store.journal_path(run.id).is_file():  # the disk was full
        no_file = _IN_JOURNAL
    return EndedSource(
        run.valve,
        _subject(run, reader.zone),
        STATES[run.state],
        ending_of(run, later=newest[0] if newest and newest[0].id != run.id else None, zone=reader.zone),
        file,
        no_file,
        run.quality or {},
        tuple(_facts(run, None, reader)),
        tuple((run.permissives or {}).get("permissives") or ()),
        reader,
        _of_valve(valve, reader),
        tuple(_head(run, valve, plant.service.plant)),
        run.note or "",
    )


def _of_valve(valve: PlantValve | None, reader: Reader) -> tuple[tuple[str, str], ...]:
    if valve is None:
        return ()
    return (
        *identity_facts(valve.identity),
        *nameplate_facts(valve.nameplate, reader),
        *wiring_facts(valve.wiring, valve.health, reader),
        *class_facts(valve),
    )


def _subject(run: Run, zone: tzinfo | None) -> str:
    test = say(
        "test_of",
        "test of {at}, {sequence}",
        at=instant_words(run.created_at, zone),
        sequence=named(run.sequence),
    )
    return together([test, "" if run.label is None else named(run.label.value)], ", ")


def _facts(run: Run, baseline: str | None, reader: Reader) -> list[tuple[str, str]]:
    quality: Mapping[str, Any] = run.quality or {}
    zone = reader.zone
    accepted = (run.analysis or {}).get("accepted_model")
    facts = [
        (say("fact_test", "Test"), run.id),
        (say("fact_label", "Label"), None if run.label is None else named(run.label.value)),
        (
            say("fact_note", "Note"),
            run.note and f"{run.note} ({run.described_by}, {instant_words(run.described_at, zone)})",
        ),
        (say("fact_permit", "Work permit"), (run.permissives or {}).get("permit")),
        (say("fact_asked_by", "Asked for by"), person_of(run.requested_by)),
        (say("fact_schedule", "Schedule"), run.schedule),
        (
            say("fact_began_ended", "Began, ended"),
            ", ".join(instant_words(at, zone) for at in (run.started_at, run.motion_ended_at)),
        ),
        (
            say("fact_motion", "Motion"),
            run.sequence + "".join(f", {key} {value}" for key, value in sorted(run.overrides.items())),
        ),
        (
            say("fact_ended_early", "Ended early")
            if event_of_early(run.ended_early) is not None
            else say("fact_until", "Until"),
            early_words(run.until, run.ended_early) if run.state is RunState.COMPLETED else None,
        ),
        (say("fact_after_motion", "After the motion"), where_it_stands(run)),
        (say("fact_driver_notes", "Notes of the driver"), reader.told(together(quality.get("notes") or (), "; "))),
        (say("fact_recording_hash", "Recording, SHA-256"), run.recording_sha256),
        (say("fact_software", "Software"), run.software),
        (
            say("fact_analysis", "Analysis"),
            together([(run.analysis or {}).get("schema") or "", words_of_repetition(run, zone) or ""], ", "),
        ),
        (say("fact_gateway", "Gateway"), run.gateway or None),
        (say("fact_baseline", "Baseline"), baseline),
        (say("fact_accepted_model", "Accepted model of"), None if accepted is None else str(accepted.get("test"))),
    ]
    return [(name, value) for name, value in facts if value]


def repair_sentences(store: Store, run: Run, valve: PlantValve | None) -> list[str]:
    """Return what the repair before this test changed, where it is labelled as left; reads the database and blocks."""
    if run.label is not Label.AS_LEFT or valve is None:
        return []
    after = store.figures.get(run.id)
    if after is None:
        return []
    found = [one for one in store.figures.newest(run.valve, 100, label=Label.AS_FOUND) if one.at <= after.at]
    return compare(found[0], after, valve.health, facts_of(valve)).sentences if found else []
