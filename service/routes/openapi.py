"""The OpenAPI document: routes in groups that say what they are for, each with one sentence and a command to copy."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final
from urllib.parse import quote

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from service.access.principal import Right
from service.http.problems import Problem

RIGHT_KEY: Final = "x-breakaway-right"
#: Where documents have commands to copy: several readers of OpenAPI show it.
SAMPLES_KEY: Final = "x-codeSamples"
GROUPS: Final[Mapping[str, str]] = {
    "tests": "Run a test, watch it, stop it; its result, recording and report.",
    "valves": "The plant's valves: how each stands, what it may do now, and stop by tag.",
    "health": "What a valve is held against: baseline, as found beside as left, figures over time.",
    "models": "The model of a valve that a person accepted: later tests are judged against it.",
    "recordings": "Analyse a file that exists already. Nothing moves.",
    "schedules": "The nightly checks: when each runs, what the night found, one run by hand.",
    "re-analyses": "Stored tests of a time analysed anew with the installed version: asked for, watched, stopped.",
    "plant": "The plant file of a running service.",
    "access": "Who may do what: sessions of people, users, and tokens of machines.",
    "service": "Whether the service lives, and what it counts. For monitoring.",
}
_TEST: Final = "20261121T031502Z-9f3c01ab"


@dataclass(frozen=True, slots=True)
class Example:
    """One request: its path with values filled in, its query, what it asks for, and what it sends."""

    path: str
    body: Mapping[str, Any] | None = None
    query: str = ""
    options: tuple[str, ...] = ()  # further ones of curl

    def command(self, method: str) -> str:
        """Return the request as a command line."""
        words = ["curl", "-s"]
        words += [] if method == "get" else ["-X", method.upper()]
        words += self.options
        if self.body is not None:
            words += ["-H", "Content-Type: application/json", "-d", json.dumps(self.body)]
        address = f"$BREAKAWAY_URL{quote(self.path)}{'?' if self.query else ''}{self.query}"
        return f'{shlex.join(words)} "{address}"'


#: By method and route, as the document names them.
EXAMPLES: Final[Mapping[str, Example]] = {
    "post /tests/run": Example(
        "/tests/run",
        {"valve": "FV-101", "sequence": "triangle", "overrides": {"cycles": 2, "period_s": 20}},
        options=("-H", "Prefer: wait=120", "-H", "Idempotency-Key: order 4711"),
    ),
    "get /tests": Example("/tests", query="valve=FV-101&state=completed&since=2026-11-01&limit=10"),
    "get /tests/{test_id}": Example(f"/tests/{_TEST}"),
    "post /tests/{test_id}/stop": Example(f"/tests/{_TEST}/stop"),
    "post /tests/{test_id}/analyze": Example(f"/tests/{_TEST}/analyze"),
    "get /tests/{test_id}/events": Example(f"/tests/{_TEST}/events", options=("-N",)),
    "get /tests/{test_id}/recording": Example(
        f"/tests/{_TEST}/recording", options=("-H", "Accept: text/csv", "-o", "recording.csv")
    ),
    "get /tests/{test_id}/report": Example(
        f"/tests/{_TEST}/report", options=("-H", "Accept: application/pdf", "-o", "report.pdf")
    ),
    "patch /tests/{test_id}": Example(f"/tests/{_TEST}", {"label": "as_left", "work_order": "WO-4711"}),
    "post /tests/{test_id}/acknowledge": Example(
        f"/tests/{_TEST}/acknowledge", {"note": "I/P fuse replaced, valve shut"}
    ),
    "get /valves": Example("/valves", query="area=Unit%201&ne107=M&ne107=F"),
    "get /valves/{tag}": Example("/valves/FV-101"),
    "get /valves/{tag}/permissives": Example("/valves/FV-101/permissives", query="permit=WP-2231"),
    "post /valves/{tag}/stop": Example("/valves/FV-101/stop"),
    "get /valves/{tag}/baseline": Example("/valves/FV-101/baseline"),
    "post /valves/{tag}/baseline": Example("/valves/FV-101/baseline", {"test": _TEST}),
    "get /valves/{tag}/comparison": Example("/valves/FV-101/comparison"),
    "get /valves/{tag}/trend": Example("/valves/FV-101/trend", query="limit=365&format=csv"),
    "get /valves/{tag}/watched": Example("/valves/FV-101/watched", query="limit=365&format=csv"),
    "get /valves/{tag}/model": Example("/valves/FV-101/model"),
    "post /valves/{tag}/model": Example("/valves/FV-101/model", {"test": _TEST}),
    "delete /valves/{tag}/model": Example("/valves/FV-101/model"),
    "get /alarms": Example("/alarms"),
    "post /recordings/analyze": Example(
        "/recordings/analyze", options=("-F", "recording=@recording.csv", "-F", "nameplate=@nameplate.toml")
    ),
    "get /schedules": Example("/schedules"),
    "get /schedules/night": Example("/schedules/night", query="format=csv"),
    "post /schedules/{name}/run": Example("/schedules/nightly/run"),
    "post /reanalyses": Example("/reanalyses", {"since": "2026-11-01", "valve": "FV-101"}),
    "get /reanalyses": Example("/reanalyses"),
    "get /reanalyses/{number}": Example("/reanalyses/1"),
    "post /reanalyses/{number}/stop": Example("/reanalyses/1/stop"),
    "post /plant/reload": Example("/plant/reload"),
    "get /session": Example("/session"),
    "post /session": Example("/session", {"name": "anna", "password": "a long pass phrase"}, options=("-c", "cookies")),
    "delete /session": Example("/session", options=("-b", "cookies", "-H", "X-CSRF-Token: TOKEN")),
    "post /session/password": Example(
        "/session/password",
        {"old": "a long pass phrase", "new": "another long pass phrase"},
        options=("-b", "cookies", "-H", "X-CSRF-Token: TOKEN"),
    ),
    "get /users": Example("/users"),
    "post /users": Example("/users", {"name": "anna", "role": "operator", "password": "a long pass phrase"}),
    "patch /users/{name}": Example("/users/anna", {"role": "engineer"}),
    "delete /users/{name}": Example("/users/anna"),
    "get /tokens": Example("/tokens"),
    "post /tokens": Example(
        "/tokens", {"name": "maintenance system", "role": "viewer", "days": 365, "valves": ["FV-101"]}
    ),
    "delete /tokens/{token_id}": Example("/tokens/4f1c2a9b"),
    "get /metrics": Example("/metrics"),
    "get /healthz": Example("/healthz"),
}


def openapi_of(app: FastAPI, needed: Sequence[tuple[str, str, Right | None]]) -> dict[str, Any]:
    """Return the OpenAPI document of an application; ``needed`` is which right each route asks for."""
    tags = [{"name": name, "description": words} for name, words in GROUPS.items()]
    document: dict[str, Any] = get_openapi(
        title=app.title, version=app.version, description=app.description, routes=app.routes, tags=tags
    )
    document["components"]["schemas"]["Problem"] = Problem.model_json_schema()
    for path, method, right in needed:
        document["paths"][path][method][RIGHT_KEY] = right
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            operation["summary"] = _first_sentence(operation.get("description", ""))
            example = EXAMPLES.get(f"{method} {path}")
            if example is not None:
                operation[SAMPLES_KEY] = [{"lang": "Shell", "source": example.command(method)}]
    return document


def _first_sentence(text: str) -> str:
    """Return what a route does in one line: the first sentence of its description, without its stop."""
    line = " ".join(text.split("\n\n", maxsplit=1)[0].split())
    return line.partition(". ")[0].removesuffix(".")
