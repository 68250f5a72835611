"""Bring the catalogues of other languages up to what the product says now: ``python -m tests.bench.translations``.

What is new stands there without a translation, what changed as fuzzy with the old one, and what is gone is taken out.
``--missing FILE`` writes what a translator has left to do as a catalogue of its own, ``--merge FILE`` takes that back.
"""

from __future__ import annotations

import argparse
import ast
import re
import string
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import polib

from service.report.written import report_templates
from service.report.written import sentences as typst_sentences
from service.tablet import rendering
from service.tablet.script import sentences
from service.words.languages import Language, path_of
from service.words.names import NAMES

ROOT = Path(__file__).parents[2]
ROOMS = ("valve", "drivers", "simulator", "estimators", "discrepancy", "service")


@dataclass(frozen=True, slots=True)
class Said:
    """One thing that the product says: the code of a message or "" for a text of a page, its English, and where."""

    code: str
    english: str
    where: str


def everything_said() -> list[Said]:
    """Return all messages and texts once, in order of their places."""
    found: dict[tuple[str, str], Said] = {}
    for one in (*_messages(), *_texts()):
        if not one.english:
            continue
        found.setdefault((one.code, one.english), one)
    return list(found.values())


def _messages() -> Iterator[Said]:
    for room in ROOMS:
        for path in sorted((ROOT / room).rglob("*.py")):
            module = ast.parse(path.read_text(encoding="utf-8"))
            if not _says(module):
                continue
            for node in ast.walk(module):
                if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "say":
                    code, template = (ast.literal_eval(one) for one in node.args)
                    yield Said(code, template, str(path.relative_to(ROOT)))


def _says(module: ast.Module) -> bool:
    imports = [node for node in module.body if isinstance(node, ast.ImportFrom) and node.module == "valve.messages"]
    return any(one.name == "say" for node in imports for one in node.names)


def _texts() -> Iterator[Said]:
    for environment in (rendering.environment(Language.ENGLISH), report_templates(Language.ENGLISH)):
        for name in sorted(environment.list_templates(extensions=["html"])):
            assert environment.loader is not None
            source, path, _ = environment.loader.get_source(environment, name)
            for _, _, words in environment.extract_translations(source):  # type: ignore[attr-defined]
                for one in (words,) if isinstance(words, str) else words:
                    if one:
                        yield Said("", one, str(Path(str(path)).relative_to(ROOT)))
    for sentence in typst_sentences():
        yield Said("", sentence, "service/report/templates")
    for sentence in sentences():
        yield Said("", sentence, "service/tablet/script_parts")
    for name in NAMES:
        yield Said("", name, "service/words/names.py")


def fields_of(code: str, words: str) -> list[str]:
    """Return the fields of a template, or of a text of a page, sorted."""
    if code:
        parts = list(string.Formatter().parse(words))
        return sorted({f"{name}:{spec}" for _, name, spec, _ in parts if name})
    return sorted(set(re.findall(r"%\(\w+\)s|\{\w+\}", words)))


def renewed(path: Path) -> polib.POFile:
    """Return the catalogue of a file with what is said now, in that order."""
    old = polib.pofile(str(path)) if path.exists() else polib.POFile()
    by_key = {(one.msgctxt or "", one.msgid): one for one in old}
    by_code = {one.msgctxt: one for one in old if one.msgctxt}
    new = polib.POFile(wrapwidth=120)
    new.metadata = {"Language": path.stem, "Content-Type": "text/plain; charset=utf-8"}
    for one in everything_said():
        same, former = by_key.get((one.code, one.english)), by_code.get(one.code)
        entry = polib.POEntry(
            msgctxt=one.code or None,
            msgid=one.english,
            occurrences=[(one.where, "")],
            msgstr=same.msgstr if same else "",
        )
        if same is None and former is not None and former.msgstr:
            entry.msgstr, entry.flags = former.msgstr, ["fuzzy"]
        elif same is not None and same.fuzzy:
            entry.flags = ["fuzzy"]
        new.append(entry)
    return new


def main() -> None:
    """Renew each catalogue and say what is missing."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--missing", type=Path, help="write what has no translation yet")
    options.add_argument("--merge", type=Path, nargs="*", default=[], help="take translations from these catalogues")
    asked = options.parse_args()
    for language in Language:
        path = path_of(language)
        if path is None:
            continue
        catalogue = renewed(path)
        given = {(one.msgctxt, one.msgid): one for file in asked.merge for one in polib.pofile(str(file)) if one.msgstr}
        for entry in catalogue:
            own = given.get((entry.msgctxt, entry.msgid))
            if own is not None:
                entry.msgstr, entry.flags = own.msgstr, []
        catalogue.save(str(path))
        missing = [one for one in catalogue if not one.translated()]
        print(f"{path.relative_to(ROOT)}: {len(catalogue) - len(missing)} of {len(catalogue)} translated")
        if asked.missing is not None:
            left = polib.POFile(wrapwidth=120)
            left.metadata = catalogue.metadata
            left.extend(missing)
            left.save(str(asked.missing))


if __name__ == "__main__":
    main()
