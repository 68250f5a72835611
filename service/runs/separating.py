"""The sequence ``separating``: what the last test's diagnosis asks for, analysed together with that test."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from service.model.analysis import TOGETHER
from service.model.run import Run, RunState
from service.model.sequences import SEQUENCES
from service.model.until import SEPARATING
from service.store.store import Store
from service.words.names import named
from valve.errors import RequestError
from valve.messages import say

_LOOKED_THROUGH: Final = 50  # tests of the valve before it
_MOST_TOGETHER: Final = 3  # earlier tests: a fit of more takes too long


@dataclass(frozen=True, slots=True)
class Separating:
    """The sequence to play, and the tests whose recordings are analysed with it, the newest first."""

    sequence: str
    overrides: Mapping[str, Any]
    tests: tuple[str, ...]


def check_name(sequence: str) -> None:
    """Raise RequestError where a test that somebody asks for cannot run a sequence of this name."""
    if sequence != SEPARATING and sequence not in SEQUENCES:
        raise RequestError(
            say(
                "sequence_unknown_or_separating",
                "sequence {sequence} is unknown: choose one of {known:, }, or {separating}, which the "
                "last test asks for",
                sequence=repr(sequence[:64]),
                known=tuple(SEQUENCES),
                separating=SEPARATING,
            )
        )


def separating_of(store: Store, tag: str, asking: Run | None = None) -> Separating:
    """Return what a completed test of a valve, by default the last, asks for; blocks.

    Raises RequestError where that is nothing.
    """
    last = asking or store.runs.last_completed(tag)
    if last is None or last.analysis is None:
        raise RequestError(
            say(
                "nothing_completed_to_separate",
                "{tag}: there is nothing to separate, as no test of it is completed: run another sequence",
                tag=tag,
            )
        )
    wanted = (last.analysis.get("discrepancy") or {}).get("separating_test")
    if wanted is None:
        verdict = named(str((last.analysis.get("discrepancy") or {}).get("verdict", "not_assessed")))
        raise RequestError(
            say(
                "nothing_to_separate",
                "{tag}: test {test} leaves nothing to separate (diagnosis: {verdict}): run another sequence",
                tag=tag,
                test=last.id,
                verdict=verdict,
            )
        )
    if not store.recording_path(last.id).exists():
        raise RequestError(
            say(
                "recording_no_longer_kept",
                "{tag}: the recording of test {test} is no longer kept: repeat that test first",
                tag=tag,
                test=last.id,
            )
        )
    earlier = [run_id for run_id in _analysed_with(last) if store.recording_path(run_id).exists()]
    tests = (last.id, *earlier)[:_MOST_TOGETHER]
    return Separating(str(wanted["sequence"]), dict(wanted["overrides"]), tests)


def played_by(store: Store, run: Run) -> tuple[str, tuple[str, ...]]:
    """Return the sequence that a test played, and the tests whose recordings are analysed with its own; blocks.

    Raises RequestError where it is a separating one and what it was to separate is no longer kept.
    """
    if run.sequence != SEPARATING:
        return run.sequence, ()
    if run.analysis is not None:
        together = run.analysis.get(TOGETHER) or {}
        kept = tuple(one for one in _analysed_with(run) if store.recording_path(one).exists())
        return str(together.get("sequence", SEPARATING)), kept
    earlier = store.runs.newest(_LOOKED_THROUGH, before=run.number, valve=run.valve)
    last = next((one for one in earlier if one.state is RunState.COMPLETED), None)
    wish = separating_of(store, run.valve, None if last is None else store.runs.get(last.id))
    return wish.sequence, wish.tests


def _analysed_with(run: Run) -> list[str]:
    together = (run.analysis or {}).get(TOGETHER) or {}
    return [str(run_id) for run_id in together.get("tests", [])]
