"""The page that lists the routes. It loads nothing from anywhere: a plant's network has no internet."""

from __future__ import annotations

import html
import re
from collections.abc import Iterator, Mapping
from typing import Any, Final

from service.routes.openapi import RIGHT_KEY, SAMPLES_KEY

_STYLE: Final = """\
body { font-family: system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; line-height: 1.5;
  overflow-wrap: anywhere; color-scheme: light dark; }
h2 { margin: 2.5rem 0 0.25rem; border-bottom: 1px solid; } h2::first-letter { text-transform: uppercase; }
summary { cursor: pointer; padding: 0.5rem 0; } summary code { font-size: 1.05rem; }
.method { display: inline-block; min-width: 4.2rem; font-weight: bold; }
pre { white-space: pre-wrap; border: 1px solid; padding: 0.5rem; } details > :not(summary) { margin-left: 1rem; }
table { border-collapse: collapse; } td { padding: 0.1rem 1rem 0.1rem 0; vertical-align: top; }
@media (prefers-color-scheme: dark) { body { background: #111; color: #eee; } a { color: #8cf; } }
@media print { details::details-content { content-visibility: visible; height: auto; } }"""


def docs_page(document: Mapping[str, Any]) -> str:
    """Return an OpenAPI document as one HTML page: its groups, and in each route by route what it takes and answers."""
    about = document["info"]
    intro = "".join(f"<p>{_text(part)}</p>" for part in about["description"].split("\n\n"))
    groups = document["tags"]
    links = "".join(f'<li><a href="#{_text(one["name"])}">{_text(one["name"])}</a></li>' for one in groups)
    parts = "".join(_group(document, one) for one in groups)
    return f"""\
<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{_text(about["title"])}: routes</title>
<style>
{_STYLE}
</style>
</head>
<body>
<header><h1>{_text(about["title"])} {_text(about["version"])}</h1>
{intro}
<p>For programs: <a href="openapi.json">openapi.json</a>, with every schema. In the commands,
<code>BREAKAWAY_URL</code> is this service's address; where it asks for sign-in, add
<code>-H "Authorization: Bearer TOKEN"</code>.</p>
<nav aria-label="Groups"><ul>{links}</ul></nav></header>
<main>
{parts}</main>
</body>
</html>
"""


def _group(document: Mapping[str, Any], group: Mapping[str, str]) -> str:
    name = _text(group["name"])
    routes = "".join(
        _route(method, path, operation)
        for path, operations in document["paths"].items()
        for method, operation in operations.items()
        if group["name"] in operation["tags"]
    )
    return f'<section><h2 id="{name}">{name}</h2>\n<p>{_text(group["description"])}</p>\n{routes}</section>\n'


def _route(method: str, path: str, operation: Mapping[str, Any]) -> str:
    cells = "".join("<tr>" + "".join(f"<td>{_text(cell)}</td>" for cell in row) + "</tr>\n" for row in _rows(operation))
    samples = "".join(f"<pre><code>{html.escape(one['source'])}</code></pre>" for one in operation.get(SAMPLES_KEY, ()))
    right = operation.get(RIGHT_KEY)
    needed = f"<p>Needs the right to {_text(right)}.</p>" if right else "<p>Answers everybody.</p>"
    about = "".join(f"<p>{_text(part)}</p>" for part in operation.get("description", "").split("\n\n"))
    return (
        f'<details><summary><span class="method">{_text(method.upper())}</span> <code>{_text(path)}</code> '
        f"{_text(operation['summary'])}</summary>\n{about}{needed}{samples}\n<table>\n{cells}</table>\n</details>\n"
    )


def _rows(operation: Mapping[str, Any]) -> Iterator[tuple[str, str, str]]:
    for parameter in operation.get("parameters", []):
        yield parameter["name"], parameter["in"], parameter.get("description", "")
    for kind, content in operation.get("requestBody", {}).get("content", {}).items():
        yield "body", kind, _fields(content.get("schema", {}))
    for status, answer in operation["responses"].items():
        yield status, "answer", answer["description"]


def _fields(schema: Mapping[str, Any]) -> str:
    reference = str(schema.get("$ref", "")).rpartition("/")[2]
    return reference or ", ".join(schema.get("properties", {}))


def _text(text: object) -> str:
    return re.sub(r"`+([^`]+)`+", r"<code>\1</code>", html.escape(str(text)))
