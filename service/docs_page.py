"""The page that lists the routes. It loads nothing from anywhere: a plant's network has no internet."""

from __future__ import annotations

import html
import re
from collections.abc import Mapping
from typing import Any, Final

_STYLE: Final = """\
body { font-family: system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; line-height: 1.5; }
h2 { font-size: 1rem; margin: 2rem 0 0.25rem; } h2 code { font-size: 1.1rem; }
.method { display: inline-block; min-width: 3.5rem; font-weight: bold; }
table { border-collapse: collapse; } td { padding: 0.1rem 1rem 0.1rem 0; vertical-align: top; }
@media (prefers-color-scheme: dark) { body { background: #111; color: #eee; } a { color: #8cf; } }"""


def docs_page(document: Mapping[str, Any]) -> str:
    """Return an OpenAPI document as one HTML page: each route with its parameters, bodies and answers."""
    about = document["info"]
    routes = [
        _route(method, path, operation)
        for path, operations in document["paths"].items()
        for method, operation in operations.items()
    ]
    intro = "".join(f"<p>{_text(part)}</p>" for part in about["description"].split("\n\n"))
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
<h1>{_text(about["title"])} {_text(about["version"])}</h1>
{intro}
<p>For programs: <a href="openapi.json">openapi.json</a>, with every schema.</p>
{"".join(routes)}</body>
</html>
"""


def _route(method: str, path: str, operation: Mapping[str, Any]) -> str:
    rows = [
        (parameter["name"], parameter["in"], parameter.get("description", ""))
        for parameter in operation.get("parameters", [])
    ]
    rows += [
        ("body", kind, _fields(content.get("schema", {})))
        for kind, content in operation.get("requestBody", {}).get("content", {}).items()
    ]
    rows += [(status, "answer", answer["description"]) for status, answer in operation["responses"].items()]
    cells = "".join("<tr>" + "".join(f"<td>{_text(cell)}</td>" for cell in row) + "</tr>\n" for row in rows)
    return (
        f'<h2><span class="method">{_text(method.upper())}</span> <code>{_text(path)}</code></h2>\n'
        f"<p>{_text(operation.get('description', ''))}</p>\n<table>\n{cells}</table>\n"
    )


def _fields(schema: Mapping[str, Any]) -> str:
    reference = str(schema.get("$ref", "")).rpartition("/")[2]
    return reference or ", ".join(schema.get("properties", {}))


def _text(text: object) -> str:
    return re.sub(r"`+([^`]+)`+", r"<code>\1</code>", html.escape(str(text)))
