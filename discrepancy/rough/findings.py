"""The causes that were found, as a reader has them: sentence, parameters, what each explains and does to the stem."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from discrepancy.rough.accepted import Accepted
from discrepancy.rough.causes.base import Fitted
from discrepancy.rough.causes.seen import Seen, SeenCause, View
from discrepancy.rough.causes.spring_preload import SpringPreload
from discrepancy.rough.evidence import Solved
from discrepancy.rough.prediction import effect_percent
from discrepancy.rough.result import Finding
from discrepancy.rough.saved_model import SavedModel
from discrepancy.rough.selection import Candidate, Selection
from discrepancy.rough.simulation import parameters_of

_UNITS: Final = {"k": "N/m", "F_0": "N", "F_c": "N", "F_s": "N"}


def findings(
    view: View, selection: Selection, seen: Sequence[tuple[SeenCause, Seen]], accepted: Accepted
) -> list[Finding]:
    """Return the causes that were taken, the one that moves the stem most first."""
    found = [_seen_finding(view, selection, *one, accepted) for one in seen]
    found += [_finding(view, selection, number, accepted) for number in range(len(selection.causes))]
    return sorted(found, key=lambda one: -(one.effect_percent_of_span or 0.0))


def extended_model(model: Solved, found: Sequence[Finding], accepted: SavedModel | None) -> SavedModel:
    """Return the valve with its causes; what was accepted stays, and the preload's offset adds to the accepted one."""
    parameters = {
        symbol: Fitted(model.known(symbol).value, model.known(symbol).std_error, unit)
        for symbol, unit in _UNITS.items()
    }
    causes = {} if accepted is None else {name: dict(entries) for name, entries in accepted.causes.items()}
    before = None if accepted is None else accepted.preload
    for one in found:
        entries = dict(one.parameters)
        if one.cause == SpringPreload.name and before is not None:
            entries = {
                name: Fitted(entry.value + before.value, entry.std_error, entry.unit) for name, entry in entries.items()
            }
        causes[one.cause] = entries
    return SavedModel(parameters, causes)


def _seen_finding(view: View, selection: Selection, cause: SeenCause, one: Seen, accepted: Accepted) -> Finding:
    percent = None
    if one.effect is not None:
        plain = parameters_of(selection.null, view.estimate, view.nameplate)
        percent = effect_percent(plain, one.effect, view.reading, view.setting.travel_m)
    sentence = cause.sentence(one.fitted, view.setting)
    key, first = next(iter(one.fitted.items()))
    return Finding(
        cause.name, accepted.words(cause.name, key, first, sentence), cause.action, one.fitted, None, percent
    )


def _finding(view: View, selection: Selection, number: int, accepted: Accepted) -> Finding:
    found, model = selection.causes[number], selection.model
    name = found.cause.name
    of_law = [len(accepted.laws) + number]
    if name in accepted.names:
        of_law.append(accepted.names.index(name))
    size, first = model.total(of_law), found.cause.parameters[0]
    entry = {**found.fitted, first.name: Fitted(size.value, size.std_error, first.unit)}
    percent = None
    if model.problem.rows.has_spring:
        mended = parameters_of(model, view.estimate, view.nameplate)
        short_n = max(mended.static_friction_n - model.known("F_s").value, 0.0)
        effect = found.cause.effect(found.cause.values(size.value, found.shape), short_n)
        percent = effect_percent(mended, effect, view.reading, view.setting.travel_m)
    sentence = accepted.words(name, first.name, entry[first.name], found.cause.sentence(entry))
    return Finding(name, sentence, found.cause.action, entry, _share(selection, found), percent, found.evidence)


def _share(selection: Selection, found: Candidate) -> float | None:
    """Share of what the null leaves that the model with this cause takes."""
    before = float(np.mean(selection.null.left_n**2))
    return max(0.0, 1.0 - float(np.mean(found.model.left_n**2)) / before) if before > 0.0 else None
