"""What every problem document must be."""

from __future__ import annotations

import httpx

from valve.messages import from_json


def assert_problem(answer: httpx.Response, status: int, *parts: str) -> None:
    """Fail unless ``answer`` is a problem document of this status whose detail has these parts."""
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    body = answer.json()
    assert body["status"] == status
    assert {"type", "title", "detail", "instance"} <= body.keys()
    if "message" in body:
        assert from_json(body["message"]) == body["detail"]
    for part in parts:
        assert part in body["detail"]
