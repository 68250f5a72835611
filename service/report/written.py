"""The document as HTML (Jinja2) and as PDF (typst). Neither loads anything from elsewhere."""

from __future__ import annotations

import json
import re
import tempfile
from functools import cache
from pathlib import Path
from typing import Any, Final

from jinja2 import Environment
from markupsafe import Markup

from service.report.document import document_of
from service.report.ended import EndedSource, ended_document
from service.report.source import ReportSource
from service.words.languages import Language, catalogue
from service.words.templates import templates_in

_TEMPLATES: Final = Path(__file__).parent / "templates"
_ID: Final = re.compile(r'(id="|href="#|url\(#|aria-labelledby=")([^")]+)')


#: Where a template of the PDF says something, in quotes: ``#t("Why")``.
_SAID: Final = re.compile(r"""\bt\(("(?:[^"\\]|\\.)*")""")


@cache
def report_templates(language: Language) -> Environment:
    """Return what makes the reports as HTML in a language."""
    return templates_in(_TEMPLATES, language)


def sentences() -> list[str]:
    """Return what the templates of the PDF say, in English."""
    texts = (path.read_text(encoding="utf-8") for path in sorted(_TEMPLATES.glob("*.typ")))
    return list(dict.fromkeys(json.loads(one) for text in texts for one in _SAID.findall(text)))


@cache
def _words(language: Language) -> dict[str, str]:
    said = catalogue(language)
    return {english: said.text(english) for english in sentences()}


def _form(source: ReportSource | EndedSource) -> tuple[str, dict[str, Any]]:
    """Return the name of the templates, and what they are filled with."""
    if isinstance(source, EndedSource):
        return "ended", ended_document(source)
    return "report", document_of(source)


def report_html(source: ReportSource | EndedSource, pdf_address: str = "") -> bytes:
    """Return the report as one HTML file with its pictures inside, and a link to the PDF where there is one."""
    form, document = _form(source)
    document |= {"pdf_address": pdf_address}
    document["pictures"] = {
        name: {**picture, "svg": Markup(_own_ids(picture["svg"], name))}
        for name, picture in document["pictures"].items()
    }
    return report_templates(source.reader.language).get_template(f"{form}.html").render(document).encode()


def report_pdf(source: ReportSource | EndedSource) -> bytes:
    """Return the report as PDF."""
    import matplotlib
    import typst

    fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"  # DejaVu Sans, which the pictures use too
    form, document = _form(source)
    language = source.reader.language
    document |= {"words": _words(language), "language": language.value}
    with tempfile.TemporaryDirectory(prefix="breakaway-report-") as folder:
        place = Path(folder)
        for name, picture in document["pictures"].items():
            (place / f"{name}.svg").write_text(picture.pop("svg"), encoding="utf-8")
        (place / "document.json").write_text(json.dumps(document, allow_nan=False), encoding="utf-8")
        for name in ("sheet.typ", f"{form}.typ"):
            (place / name).write_bytes((_TEMPLATES / name).read_bytes())
        compiled: Any = typst.compile(
            place / f"{form}.typ", root=place, font_paths=[fonts], ignore_system_fonts=True, format="pdf"
        )
    return bytes(compiled)


def _own_ids(svg: str, name: str) -> str:
    """Give the ids inside a picture its name: several pictures stand in one page."""

    def renamed(found: re.Match[str]) -> str:
        return found.group(1) + " ".join(f"{name}-{one}" for one in found.group(2).split())

    return _ID.sub(renamed, svg)
