"""What the signature of a test is laid over: as found, as left, the baseline, or any other test of its valve."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, tzinfo
from typing import Any, Final

from service.config.nameplates import nameplate_from_mapping
from service.figures.signature import MOST_LAYERS, Layer, has_signature
from service.model.past_test import PastTest
from service.model.run import Label, Run
from service.shown.history import ValvePast
from service.store.store import Store
from service.words.names import named
from service.words.plant_clock import short_instant
from service.words.sentences import together
from valve.errors import NotFoundError
from valve.messages import say
from valve.recording_files import read_recording

THIS_TEST: Final = say("this_test", "this test")


@dataclass(frozen=True, slots=True)
class Overlay:
    """A test that can be laid over another one: what its chip says, and whether it is shown from the start."""

    test_id: str
    words: str
    at: datetime
    is_shown: bool = False


def words_of(run: Run, zone: tzinfo | None, role: str = "") -> str:
    """Return what a test is called in a figure: its role or label, and when it was by the plant's clock."""
    label = role or ("" if run.label is None else named(run.label.value))
    return together([label, short_instant(run.created_at, zone)])


def overlays_of(store: Store, run: Run, past: ValvePast) -> tuple[list[Overlay], list[Overlay]]:
    """Return the chips of a test, and all other tests of its valve for the choice; reads the database and blocks.

    As found and as left are the newest with these labels that are not later than the test. The first chip is shown
    from the start: as found for a test as left, else the baseline. A test without a loop has nothing to lay over.
    """
    chips: dict[str, Overlay] = {}
    for label in (Label.AS_FOUND, Label.AS_LEFT):
        test = next((one for one in _labelled(store, run, label) if one.test_id != run.id), None)
        if test is not None:
            chips[test.test_id] = Overlay(test.test_id, named(label.value), test.at)
    base = past.baseline
    if base is not None and base.id != run.id and base.id not in chips:
        chips[base.id] = Overlay(base.id, named("baseline"), base.created_at)
    first = before_of(store, run, past)
    shown = [Overlay(one.test_id, one.words, one.at, one.test_id == first) for one in chips.values()]
    others = [one for one in past.figures if one.test_id != run.id and one.test_id not in chips]
    listed = [Overlay(one.test_id, named(one.label or "test"), one.at) for one in others]
    drawn = store.figures.with_loops([one.test_id for one in (*shown, *listed)])
    return [one for one in shown if one.test_id in drawn], [one for one in listed if one.test_id in drawn]


def before_of(store: Store, run: Run, past: ValvePast) -> str | None:
    """Return the test that a result is held against: as found for a test as left, else the baseline; None without."""
    if run.label is Label.AS_LEFT:
        found = next(iter(_labelled(store, run, Label.AS_FOUND)), None)
        if found is not None:
            return found.test_id
    return None if past.baseline is None or past.baseline.id == run.id else past.baseline.id


def _labelled(store: Store, run: Run, label: Label) -> Iterator[PastTest]:
    return (one for one in store.figures.newest(run.valve, 100, label=label) if one.at <= run.created_at)


def layers_of(
    store: Store, run: Run, others: Sequence[str], zone: tzinfo | None, own: Mapping[str, Any] | None = None
) -> list[Layer]:
    """Return the layers of a figure: a test, then others of its valve; reads the database and blocks.

    ``own`` is the test's signature where it is not analysed yet. Raises NotFoundError for a test of another valve.
    """
    layers = [_layer(run, zone, THIS_TEST if others else "", own)]
    for test_id in list(dict.fromkeys(others))[: MOST_LAYERS - 1]:
        other = store.runs.get(test_id)
        if other.valve != run.valve:
            raise NotFoundError(
                say(
                    "test_of_no_such_valve",
                    "test {test} is none of {valve}: choose one of the same valve",
                    test=other.id,
                    valve=run.valve,
                )
            )
        layer = _layer(other, zone, "" if other.label else named("test"))
        if other.id != run.id and has_signature(layer.signature):
            layers.append(layer)
    return layers


def _layer(run: Run, zone: tzinfo | None, role: str, own: Mapping[str, Any] | None = None) -> Layer:
    analysis = run.analysis or {}
    latent = (analysis.get("discrepancy") or {}).get("latent_friction") or ()
    shown = own if own is not None else analysis.get("signature") or {}
    return Layer(words_of(run, zone, role), shown, () if own is not None else latent)


def measured_signature(file: str, nameplate: str) -> str:
    """Return the signature of a recording as JSON, measured on the loop alone: a second after the motion has ended.

    ``nameplate`` is JSON. Estimates and the diagnosis follow. Raises what reading a recording raises.
    """
    # The process that serves pages needs none of these.
    from estimators.data_faults.found import without_data_faults  # noqa: PLC0415
    from service.analysis.analysis import signature  # noqa: PLC0415
    from service.analysis.driven_force import with_driven_forces  # noqa: PLC0415

    plate = nameplate_from_mapping(json.loads(nameplate), "nameplate")
    (recording,), _ = without_data_faults([read_recording(file, plate)], plate)
    (driven,), _ = with_driven_forces([recording], plate)
    return json.dumps(signature(driven, (), plate))
