"""The diagnosis in the analysis object: called so that no fault of it takes the estimates away."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np
import structlog

from discrepancy.doubts import doubt
from discrepancy.force_diagnosis import diagnose_forces
from discrepancy.rough.diagnose import diagnose
from discrepancy.rough.result import RoughDiagnosis
from discrepancy.rough.saved_model import SavedModel
from discrepancy.rough.separating import SeparatingTest
from estimators.base import Estimate
from service.analysis.friction_scatter import latent_friction
from service.analysis.separating import NOTHING_SEPARATES, find_separating_test, room_of_recordings
from valve.errors import RequestError
from valve.messages import joined, message_of, say
from valve.nameplate import Action, Nameplate
from valve.recording import Recording

Progress = Callable[[float, str], None]

NOT_YET: Final = say("diagnosis_not_yet", "The estimates are done; the diagnosis has not been.")
_LIKELIHOOD: Final = "maximum_likelihood"
_NOT_PROVEN: Final = say("second_test_would_prove", "A second test would prove it.")
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

    ``estimated`` is the recording that the estimates are of, by default the first: it is the one that is diagnosed.
    ``held_out`` are others, by name, that the gain is measured on. ``accepted`` is the extended model that was accepted
    for the valve, ``room`` what a further test of it may use.
    Whatever goes wrong inside gives ``not_assessed`` with the reason, and is logged.
    """
    tell = progress or (lambda _share, _phase: None)
    likelihood = next((one for one in estimates if one.method == _LIKELIHOOD), None)
    latent = [] if likelihood is None else latent_friction(likelihood)
    try:
        doubted = doubt(recordings, nameplate)
        if doubted:
            return {**not_assessed(doubted), "latent_friction": latent}
        if nameplate.actuator.action is Action.DOUBLE:
            with np.errstate(all="ignore"):
                drive = diagnose_forces(recordings, nameplate, held_out, tell)
            return {**not_assessed(""), "latent_friction": latent, **drive.to_json()}
        tell(0.0, say("looking_behind_friction", "looking for what friction's variation hides"))
        known, unread = _read(accepted)
        whole = recordings[0] if estimated is None else estimated
        with np.errstate(all="ignore"):
            diagnosed = diagnose(whole, nameplate, likelihood, held_out=held_out, model=known)
            tell(_DIAGNOSED, say("looking_for_separating_test", "looking for a test that tells causes apart"))
            allowed = room_of_recordings(recordings) if room is None else room
            separating = find_separating_test(diagnosed.undecided, allowed)
        told = shown(diagnosed, separating)
        told["latent_friction"] = told["latent_friction"] or latent
        said = [one for one in (told["message"], unread) if one]
        return {**told, "message": joined(" ", said) if said else ""}
    except Exception as error:  # noqa: BLE001  - the estimates must not be lost with the diagnosis
        _LOG.error("diagnosis failed", valve=nameplate.tag, exc_info=error)
        return not_assessed(
            say(
                "diagnosis_failed",
                "The diagnosis failed by a fault of its own ({kind}: {why}): the estimates stand; report it with the "
                "recording.",
                kind=type(error).__name__,
                why=message_of(error),
            )
        )


def _read(accepted: Mapping[str, Any] | None) -> tuple[SavedModel | None, str]:
    """Return the accepted model; none and the reason where it is of another version."""
    if accepted is None:
        return None, ""
    try:
        return SavedModel.from_json(accepted), ""
    except RequestError as error:
        return None, say(
            "accepted_model_not_used",
            "The model that was accepted for this valve was not used: {why}, and accept its model.",
            why=message_of(error),
        )


def shown(diagnosed: RoughDiagnosis, separating: SeparatingTest | None = None) -> dict[str, Any]:
    """Return a diagnosis as the analysis object has it."""
    found = diagnosed.to_json()
    if found["causes"]:
        # the causes have their own sentences
        apart = [NOTHING_SEPARATES] if diagnosed.undecided is not None and separating is None else []
        by_hand = [diagnosed.separating_test] if diagnosed.separating_test else []
        of_verdict: dict[str, list[str]] = {"likely": [_NOT_PROVEN], "ambiguous": [*apart, *by_hand]}
        more = of_verdict.get(found["verdict"], [])
        found["message"] = joined(" ", more) if more else ""
    if diagnosed.not_looked_for:
        found["message"] = joined(" ", [one for one in (found["message"], diagnosed.not_looked_for) if one])
    return {**not_assessed(""), **found, "separating_test": None if separating is None else separating.to_json()}
