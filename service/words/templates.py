"""Templates of pages and reports, in a language."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from service.words.languages import Language, catalogue


def templates_in(folder: Path, language: Language, finalize: Callable[..., Any] | None = None) -> Environment:
    """Return what fills the templates of a folder: what they say in ``_()`` and ``trans`` is in a language.

    ``finalize`` makes of each value what is shown. ``language`` is known to every template.
    """
    said = catalogue(language)
    made = Environment(
        loader=FileSystemLoader(folder),
        autoescape=True,
        undefined=StrictUndefined,
        auto_reload=False,  # else each template's file is looked at with every page
        trim_blocks=True,
        lstrip_blocks=True,
        extensions=["jinja2.ext.i18n"],
        finalize=finalize,
    )
    made.install_gettext_callables(  # type: ignore[attr-defined]
        said.text, lambda one, more, count: said.text(one if count == 1 else more), newstyle=True
    )
    made.globals["language"] = language
    return made
