"""The diagnosis in the analysis object: called so that no fault of it takes the estimates away."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import structlog

from discrepancy.diagnose import diagnose
from discrepancy.diagnosis import Diagnosis, Verdict
from discrepancy.pictures import pictures
from discrepancy.saved_model import SavedModel, saved_model
from discrepancy.separating import SeparatingTest
from estimators.base import Estimate, Status
from service.separating import NOTHING_SEPARATES, find_separating_test, room_of_recordings
from valve.nameplate import Nameplate
from valve.recording import Recording

Progress = Callable[[float, str], None]

NOT_YET: Final = "The estimates are done; the diagnosis has not been."
_LIKELIHOOD: Final = "maximum_likelihood"
_OWN_FIT: Final = (
    "The diagnosis fits the valve for itself, and its fit leaves nothing beyond the noise; "
    "maximum likelihood did not get there, its message says why."
)
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
) -> dict[str, Any]:
    """Return the ``discrepancy`` of recordings of one valve, with its pictures, model and separating test.

    ``accepted`` is the extended model that was accepted for the valve, ``room`` what a further test of it may use.
    Whatever goes wrong inside gives ``not_assessed`` with the reason, and is logged.
    """
    tell = progress or (lambda _share, _phase: None)
    likelihood = next((one for one in estimates if one.method == _LIKELIHOOD), None)
    try:
        known = None if accepted is None else SavedModel.from_json(accepted)
        found = diagnose(
            recordings,
            nameplate,
            held_out=held_out,
            estimate=likelihood,
            accepted=known,
            progress=lambda share, phase: tell(_DIAGNOSED * share, phase),
        )
        tell(_DIAGNOSED, "looking for a test that tells causes apart")
        separating = find_separating_test(found, room_of_recordings(recordings) if room is None else room)
        told = shown(found, separating, known)
        if found.verdict is Verdict.NONE and likelihood is not None and likelihood.status is Status.FAILED:
            told["message"] = f"{told['message']} {_OWN_FIT}".strip()
        return told
    except Exception as error:  # noqa: BLE001  - the estimates must not be lost with the diagnosis
        _LOG.error("diagnosis failed", valve=nameplate.tag, exc_info=error)
        reason = f"The diagnosis failed by a fault of its own ({type(error).__name__}: {error})"
        return not_assessed(f"{reason}: the estimates stand; report it with the recording.")


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
