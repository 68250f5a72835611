"""The report of a stored test, with its baseline, its trend and its repair."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import tzinfo
from typing import Any, Final

from service.config.settings import Plant, PlantValve
from service.health.comparison import compare
from service.health.judge import facts_of
from service.model.acknowledgement import alarm_words
from service.model.requester import person_of
from service.model.run import Label, Run, RunState
from service.model.stands_words import where_it_stands
from service.model.until import early_words
from service.recordings.place import recording_of
from service.report.before_after import BeforeAfter, before_after
from service.report.ended import EndedSource
from service.report.source import ReportSource
from service.report.valve_facts import class_facts, frame_of, identity_facts, nameplate_facts, wiring_facts
from service.runs.again import words_of_repetition
from service.shown.ending import ending_of
from service.shown.history import past_of
from service.shown.overlays import before_of, layers_of, words_of
from service.shown.words import STATES
from service.store.store import Store
from service.words.plant_clock import instant_words
from service.words.sentences import as_sentence, in_units
from service.words.units import UnitSystem
from valve.errors import ValveError

_IN_JOURNAL: Final = (
    "What was sampled is safe in the journal of this test; it becomes its recording at the next start of the service."
)


def source_of(plant: Plant, store: Store, run: Run, system: UnitSystem) -> ReportSource:
    """Return what the report of a completed test is made of; reads the database and blocks."""
    assert run.analysis is not None
    valve, zone = plant.valves.get(run.valve), plant.zone
    past = past_of(store, run.valve, valve, run)
    chosen = before_of(store, run, past)
    then = None if chosen is None else store.runs.get(chosen)
    rows: list[BeforeAfter] = []
    if valve is not None and then is not None and then.analysis is not None:
        rows = before_after(then.analysis, run.analysis, valve.health, facts_of(valve), system)
    held = past.held_against
    baseline = None if past.baseline is None or past.baseline.id == run.id else past.baseline.analysis
    return ReportSource(
        run.valve,
        _subject(run, zone),
        run.analysis,
        tuple(_facts(run, None if past.baseline is None else past.baseline.id, system, zone)),
        None if baseline is None else baseline.get("signature"),
        past.trends if len(past.same_motion) > 1 else (),
        tuple((run.permissives or {}).get("permissives") or ()),
        tuple(repair_sentences(store, run, valve)),
        system,
        _of_valve(valve, system),
        run.sequence,
        where_it_stands(run),
        alarm_words(run),
        frame_of(valve, None if held is None else held.test),
        tuple(layers_of(store, run, [] if then is None else [then.id], zone)[1:]),
        tuple(_head(run, valve, plant.service.plant)),
        "" if then is None else words_of(then, zone, "" if then.label else "test"),
        tuple(rows),
        run.note or "",
        zone,
    )


def _head(run: Run, valve: PlantValve | None, plant: str) -> Iterator[tuple[str, str]]:
    """Yield what a technician files the report by; "" where it is to be filled in by hand."""
    identity = {} if valve is None else dict(identity_facts(valve.identity))
    yield "Plant", plant
    yield "Area", identity.pop("Area", "")
    yield "Tag", run.valve
    yield "Serial number", identity.pop("Serial number", "")
    yield from identity.items()
    yield "Technician", person_of(run.requested_by)
    yield "Work order", run.work_order or (run.permissives or {}).get("permit") or ""


def ended_source_of(plant: Plant, store: Store, run: Run, system: UnitSystem) -> EndedSource:
    """Return what the report of a finished test without a result is made of; reads the database and blocks."""
    valve = plant.valves.get(run.valve)
    newest = store.runs.newest(1, valve=run.valve)
    file, no_file = None, ""
    if run.recording_file is not None:
        try:
            file = str(recording_of(run, plant, store))
        except ValveError as error:  # another gateway has it, or nobody has it any more
            no_file = as_sentence(str(error))
    elif store.journal_path(run.id).is_file():  # the disk was full
        no_file = _IN_JOURNAL
    return EndedSource(
        run.valve,
        _subject(run, plant.zone),
        STATES[run.state],
        ending_of(run, later=newest[0] if newest and newest[0].id != run.id else None, zone=plant.zone),
        file,
        no_file,
        run.quality or {},
        tuple(_facts(run, None, system, plant.zone)),
        tuple((run.permissives or {}).get("permissives") or ()),
        system,
        _of_valve(valve, system),
        tuple(_head(run, valve, plant.service.plant)),
        run.note or "",
    )


def _of_valve(valve: PlantValve | None, system: UnitSystem) -> tuple[tuple[str, str], ...]:
    if valve is None:
        return ()
    return (
        *identity_facts(valve.identity),
        *nameplate_facts(valve.nameplate, system),
        *wiring_facts(valve.wiring, valve.health, system),
        *class_facts(valve),
    )


def _subject(run: Run, zone: tzinfo | None) -> str:
    label = "" if run.label is None else f", {run.label.value.replace('_', ' ')}"
    return f"test of {instant_words(run.created_at, zone)}, {run.sequence.replace('_', ' ')}{label}"


def _facts(run: Run, baseline: str | None, system: UnitSystem, zone: tzinfo | None) -> list[tuple[str, str]]:
    quality: Mapping[str, Any] = run.quality or {}
    accepted = (run.analysis or {}).get("accepted_model")
    facts = [
        ("Test", run.id),
        ("Label", None if run.label is None else run.label.value.replace("_", " ")),
        ("Note", run.note and f"{run.note} ({run.described_by}, {instant_words(run.described_at, zone)})"),
        ("Work permit", (run.permissives or {}).get("permit")),
        ("Asked for by", person_of(run.requested_by)),
        ("Schedule", run.schedule),
        ("Began, ended", ", ".join(instant_words(at, zone) for at in (run.started_at, run.motion_ended_at))),
        ("Motion", run.sequence + "".join(f", {key} {value}" for key, value in sorted(run.overrides.items()))),
        ("Until", early_words(run.until, run.ended_early) if run.state is RunState.COMPLETED else None),
        ("After the motion", in_units(where_it_stands(run), system) or None),
        ("Notes of the driver", "; ".join(str(note) for note in quality.get("notes") or ()) or None),
        ("Recording, SHA-256", run.recording_sha256),
        ("Software", run.software),
        (
            "Analysis",
            ", ".join(one for one in ((run.analysis or {}).get("schema"), words_of_repetition(run, zone)) if one),
        ),
        ("Gateway", run.gateway or None),
        ("Baseline", baseline),
        ("Accepted model of", None if accepted is None else str(accepted.get("test"))),
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
