"""What is said of a valve over MQTT: JSON objects small enough for any subscriber, and their topics."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from datetime import datetime
from typing import Any, Final
from urllib.parse import quote

from service.model.acknowledgement import stem_astray
from service.model.run import Run, RunState
from service.model.stands_words import where_it_stands

_ESTIMATE: Final = ("value", "unit", "ci95", "identifiable")
_SIGNATURE: Final = (
    "friction_mean_n",
    "friction_max_n",
    "spring_rate_n_per_m",
    "bench_set_pa",
    "dead_band_percent",
)


def topic_part(text: str) -> str:
    """Return ``text`` as one level of a topic: what MQTT reserves (/ + # $) is percent-encoded, as in an address."""
    return quote(text, safe=" ")


def state_message(run: Run) -> dict[str, Any]:
    """Return how a valve stands now: its last test, and whether somebody must go and look."""
    in_doubt = (run.safe_confirmed is False or stem_astray(run)) and run.acknowledged_at is None
    stands = None if run.stands is None else {**run.stands.to_json(), "stem_percent": run.stands.stem_percent}
    return {
        "valve": run.valve,
        "under_test": not run.state.finished and run.state is not RunState.ANALYZING,
        "test": run.id,
        "state": run.state.value,
        "safe_confirmed": run.safe_confirmed,
        "stands": stands,
        "stands_sentence": where_it_stands(run),
        "alarm": in_doubt,
        "message": run.error,
    }


def result_message(run: Run) -> dict[str, Any]:
    """Return what a completed test found: estimates with intervals, the diagnosis in words, the signature's figures."""
    analysis = run.analysis or {}
    discrepancy = analysis.get("discrepancy") or {}
    signature = analysis.get("signature") or {}
    return {
        "valve": run.valve,
        "test": run.id,
        "sequence": run.sequence,
        "requested_by": run.requested_by,
        "schedule": run.schedule,
        "finished_at": _instant(run.finished_at),
        "recording_sha256": run.recording_sha256,
        "estimates": [_estimate(one) for one in analysis.get("estimates") or ()],
        "signature": {name: signature.get(name) for name in _SIGNATURE},
        "verdict": discrepancy.get("verdict"),
        "causes": [
            {name: one.get(name) for name in ("cause", "sentence", "action")} for one in discrepancy.get("causes") or ()
        ],
        "href": f"/tests/{run.id}",
    }


def health_message(completed: Run, health: Mapping[str, Any]) -> dict[str, Any]:
    """Return the NE 107 state of a valve as it stands today, with its reasons; null where it could not be judged.

    ``at`` is when the test was asked for that it rests on.
    """
    return {
        "valve": completed.valve,
        "ne107": health.get("ne107"),
        "reasons": list(health.get("reasons") or ()),
        "test": completed.id,
        "at": _instant(completed.created_at),
    }


def messages_of(last: Run, completed: Run | None, health: Mapping[str, Any]) -> Iterator[tuple[str, bytes]]:
    """Yield the last level of each topic of a valve and what it says; ``health`` is that of the completed test."""
    yield "state", _payload(state_message(last))
    if completed is not None and completed.state is RunState.COMPLETED:
        yield "result", _payload(result_message(completed))
        yield "ne107", _payload(health_message(completed, health))


def _estimate(one: Mapping[str, Any]) -> dict[str, Any]:
    parameters: Mapping[str, Mapping[str, Any]] = one.get("parameters") or {}
    return {
        "method": one.get("method"),
        "status": one.get("status"),
        "message": one.get("message"),
        "parameters": {name: {key: of.get(key) for key in _ESTIMATE} for name, of in parameters.items()},
    }


def _instant(at: datetime | None) -> str | None:
    return None if at is None else at.isoformat()


def _payload(message: Mapping[str, Any]) -> bytes:
    return json.dumps(message, allow_nan=False, separators=(",", ":"), default=str).encode()
