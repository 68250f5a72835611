"""The diagnosis in the analysis object: called so that no fault of it takes the estimates away."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np
import structlog

from discrepancy.diagnose import diagnose
from discrepancy.diagnosis import Diagnosis, Verdict
from discrepancy.doubts import doubt
from discrepancy.force_diagnosis import diagnose_forces
from discrepancy.pictures import pictures
from discrepancy.rough.diagnose import diagnose as diagnose_rough
from discrepancy.saved_model import SavedModel, saved_model
from discrepancy.separating import SeparatingTest
from estimators.base import Estimate, Status
from estimators.exact_motion import ExactMotionEstimator
from estimators.registry import estimator
from service.friction_scatter import latent_friction, repeats_itself
from service.separating import (
    NOTHING_SEPARATES,
    find_rough_separating_test,
    find_separating_test,
    room_of_recordings,
)
from valve.nameplate import Action, Nameplate
from valve.recording import Recording

Progress = Callable[[float, str], None]

NOT_YET: Final = "The estimates are done; the diagnosis has not been."
_LIKELIHOOD: Final = "maximum_likelihood"
_OWN_FIT: Final = (
    "The diagnosis fits the valve for itself, and its fit leaves nothing beyond the noise; "
    "maximum likelihood did not get there, its message says why."
)
_NOT_PROVEN: Final = "A second test would prove it."
_DIAGNOSED: Final = 0.85  # share of the progress
_LOG = structlog.get_logger(__name__)


def not_assessed(message: str) -> dict[str, Any]:
    """Return the ``discrepancy`` of a recording that was not diagnosed, with the reason."""
    return {
        "verdict": "not_assessed",
        "message": message,
        "causes": [],
        "not_told_apart_from": [],
        "separating_test": None,
        "gain": None,
        "gains": [],
        "misfit": None,
        "extended_model": None,
        "pictures": None,
        "latent_friction": [],
        "remarks": [],
    }


def assess(
    recordings: Sequence[Recording],
    nameplate: Nameplate,
    estimates: Sequence[Estimate],
    *,
    held_out: Sequence[tuple[str, Recording]] = (),
    accepted: Mapping[str, Any] | None = None,
    room: Mapping[str, float] | None = None,
    progress: Progress | None = None,
    estimated: Recording | None = None,
) -> dict[str, Any]:
    """Return the ``discrepancy`` of recordings of one valve, with its pictures, model and separating test.

    ``estimated`` is the recording that the estimates are of, by default the first; ``accepted`` is the extended model
    that was accepted for the valve, ``room`` what a further test of it may use. A valve that repeats itself has its
    causes found by the exact motion, another one beside the variation of its friction.
    Whatever goes wrong inside gives ``not_assessed`` with the reason, and is logged.
    """
    tell = progress or (lambda _share, _phase: None)
    likelihood = next((one for one in estimates if one.method == _LIKELIHOOD), None)
    try:
        if nameplate.actuator.action is Action.DOUBLE:
            return _of_a_drive(recordings, nameplate, held_out, tell)
        whole = recordings[0] if estimated is None else estimated
        if likelihood is not None and not _repeats_itself(likelihood, whole, recordings, nameplate):
            # the search below knows valves that repeat themselves alone
            tell(0.0, "looking for what friction's variation hides")
            return _of_a_packing(recordings, whole, nameplate, likelihood, held_out=held_out, room=room)
        latent = [] if likelihood is None else latent_friction(likelihood)
        known = None if accepted is None else SavedModel.from_json(accepted)
        found = diagnose(
            recordings,
            nameplate,
            held_out=held_out,
            estimate=_exact_fit(recordings, nameplate, likelihood),
            accepted=known,
            progress=lambda share, phase: tell(_DIAGNOSED * share, phase),
        )
        tell(_DIAGNOSED, "looking for a test that tells causes apart")
        separating = find_separating_test(found, room_of_recordings(recordings) if room is None else room)
        told = shown(found, separating, known)
        if found.verdict is Verdict.NONE and likelihood is not None and likelihood.status is Status.FAILED:
            told["message"] = f"{told['message']} {_OWN_FIT}".strip()
        return {**told, "latent_friction": latent}
    except Exception as error:  # noqa: BLE001  - the estimates must not be lost with the diagnosis
        _LOG.error("diagnosis failed", valve=nameplate.tag, exc_info=error)
        reason = f"The diagnosis failed by a fault of its own ({type(error).__name__}: {error})"
        return not_assessed(f"{reason}: the estimates stand; report it with the recording.")


def _of_a_drive(
    recordings: Sequence[Recording],
    nameplate: Nameplate,
    held_out: Sequence[tuple[str, Recording]],
    tell: Progress,
) -> dict[str, Any]:
    """Return the ``discrepancy`` of a drive without a spring, by its balance of forces."""
    doubted = doubt(recordings, nameplate)
    if doubted:
        return not_assessed(doubted)
    with np.errstate(all="ignore"):
        return {**not_assessed(""), **diagnose_forces(recordings, nameplate, held_out, tell).to_json()}


def _repeats_itself(
    likelihood: Estimate, estimated: Recording, recordings: Sequence[Recording], nameplate: Nameplate
) -> bool:
    """Whether the valve repeats itself in one of its recordings: a scatter of one alone is not the packing's."""
    if repeats_itself(likelihood, estimated, nameplate):
        return True
    others = [one for one in recordings if one is not estimated]
    return any(repeats_itself(estimator(_LIKELIHOOD).estimate(one, nameplate), one, nameplate) for one in others)


def _of_a_packing(
    recordings: Sequence[Recording],
    estimated: Recording,
    nameplate: Nameplate,
    likelihood: Estimate,
    *,
    held_out: Sequence[tuple[str, Recording]],
    room: Mapping[str, float] | None,
) -> dict[str, Any]:
    """Return the ``discrepancy`` of a valve whose friction scatters: causes beside its packing's variation."""
    doubted = doubt(recordings, nameplate)
    if doubted:
        return {**not_assessed(doubted), "latent_friction": latent_friction(likelihood)}
    diagnosed = diagnose_rough(estimated, nameplate, likelihood, held_out=held_out)
    found = diagnosed.to_json()
    separating = find_rough_separating_test(
        diagnosed.undecided, room_of_recordings(recordings) if room is None else room
    )
    if found["causes"]:
        # the causes have their own sentences
        none = NOTHING_SEPARATES if diagnosed.undecided is not None and separating is None else ""
        by_hand = diagnosed.separating_test or ""
        more = {"likely": _NOT_PROVEN, "ambiguous": f"{none} {by_hand}".strip()}
        found["message"] = more.get(found["verdict"], "")
    return {**not_assessed(""), **found, "separating_test": None if separating is None else separating.to_json()}


def _exact_fit(recordings: Sequence[Recording], nameplate: Nameplate, likelihood: Estimate | None) -> Estimate:
    """Return the exact motion's fit of the first recording, from which the search for causes begins."""
    if likelihood is not None and "fitted" in likelihood.diagnostics:
        return likelihood  # of a kind that the engine does not take yet
    return ExactMotionEstimator().estimate(recordings[0], nameplate)


def shown(
    found: Diagnosis, separating: SeparatingTest | None = None, accepted: SavedModel | None = None
) -> dict[str, Any]:
    """Return a diagnosis as the analysis object has it."""
    before, after = found.before, found.after
    misfit = None
    if before is not None:
        misfit = {
            "rms_before_m": before.rms_m,
            "rms_after_m": None if after is None else after.rms_m,
            "noise_m": before.noise_m,
            "where": before.where,
        }
    said = found.to_json()
    if found.verdict is Verdict.AMBIGUOUS and separating is None and found.rival_fits:
        said["message"] = f"{said['message']} {NOTHING_SEPARATES}".strip()
    extended = None if found.extended is None else saved_model(found.extended, found.causes, accepted).to_json()
    return {
        **said,
        "separating_test": None if separating is None else separating.to_json(),
        "gains": [gain.to_json() for gain in found.gains],
        "misfit": misfit,
        "extended_model": extended,
        "pictures": pictures(found),
    }
