"""The diagnosis in the analysis object: called so that no fault of it takes the estimates away."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

import structlog

from discrepancy.diagnose import diagnose
from discrepancy.diagnosis import Diagnosis
from discrepancy.pictures import pictures
from estimators.base import Estimate
from valve.nameplate import Nameplate
from valve.recording import Recording

Progress = Callable[[float, str], None]

NOT_YET: Final = "The estimates are done; the diagnosis has not been."
_LIKELIHOOD: Final = "maximum_likelihood"
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
        "pictures": None,
    }


def assess(
    recordings: Sequence[Recording],
    nameplate: Nameplate,
    estimates: Sequence[Estimate],
    *,
    held_out: Sequence[tuple[str, Recording]] = (),
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Return the ``discrepancy`` of recordings of one valve, with its pictures.

    Whatever goes wrong inside gives ``not_assessed`` with the reason, and is logged.
    """
    likelihood = next((one for one in estimates if one.method == _LIKELIHOOD), None)
    try:
        found = diagnose(recordings, nameplate, held_out=held_out, estimate=likelihood, progress=progress)
        return shown(found)
    except Exception as error:  # noqa: BLE001  - the estimates must not be lost with the diagnosis
        _LOG.error("diagnosis failed", valve=nameplate.tag, exc_info=error)
        reason = f"The diagnosis failed by a fault of its own ({type(error).__name__}: {error})"
        return not_assessed(f"{reason}: the estimates stand; report it with the recording.")


def shown(found: Diagnosis) -> dict[str, Any]:
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
    gains = [gain.to_json() for gain in found.gains]
    return {**found.to_json(), "gains": gains, "misfit": misfit, "pictures": pictures(found)}
