"""Reasons are data: each has one code, one template, and the values that the template tells."""

from __future__ import annotations

import ast
import re
import string
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Final

import pytest

from valve import errors
from valve.messages import Message, Value, from_json, parted

ROOT = Path(__file__).parents[2]
ROOMS = ("valve", "drivers", "simulator", "estimators", "discrepancy", "service")
#: Where no error is raised with a plain text, and no sentence is put together: its quantities would be lost.
DATA_ALONE: tuple[str, ...] = (
    "drivers",
    "simulator",
    "service/access",
    "service/audit",
    "service/backup",
    "service/config",
    "service/health",
    "service/model",
    "service/mqtt",
    "service/recordings",
    "service/reload.py",
    "service/report",
    "service/runs",
    "service/server",
    "service/store",
    "service/workers",
)
#: Where no text that a person reads is put together: its quantities would be lost. Rooms, folders and files.
WHOLE: tuple[str, ...] = (
    "valve",
    "estimators",
    "discrepancy",
    "service/analysis",
    "service/own_files/understood.py",
    "service/watching",
    "service/planning",
)
#: Rooms of the service where nobody is told a plain text; what they put together else goes to no person, or is a table.
AT_THE_EDGE: tuple[str, ...] = tuple(
    f"service/{room}"
    for room in (
        "shown",
        "report",
        "tablet",
        "routes",
        "http",
        "access",
        "schedules",
        "recordings",
        "config",
        "mqtt",
        "audit",
        "backup",
        "server",
        "workers",
        "cli",
        "reload.py",
    )
)
#: Where each sentence that is not logged is a message: a person is told all of them.
SAID_ALONE: tuple[str, ...] = (
    "drivers/motion/watch_keeper.py",
    "service/access",
    "service/http/body_limits.py",
    "service/http/errors.py",
    "service/http/hosts.py",
    "service/workers",
)
#: Whose messages judge what stands in plant.toml and nameplates.
JUDGE_FILES: tuple[str, ...] = (
    "drivers/addresses.py",
    "drivers/observable.py",
    "drivers/permissive_rules.py",
    "drivers/representable.py",
    "drivers/stands_at.py",
    "drivers/watch_rules.py",
    "service/config",
    "service/model/health_limits.py",
    "simulator/transducer.py",
    "valve/nameplate.py",
)
#: What a call is named by that refuses a request: each of its texts is told to who asked.
REFUSES = ("Error", "Refusal", "HTTPException")
#: By these names a call takes what a person is told.
TOLD_AS = ("reason", "remedy", "problem", "note", "why", "sentence")
LOGGED = ("debug", "info", "warning", "error", "append")
FAULT = 4  # what Findings.add takes: key, value, reason, remedy
OF_PYTHON = (
    "ValueError",
    "TypeError",
    "RuntimeError",
    "AssertionError",
    "KeyError",
    "ImportError",
    "OSError",
    "PydanticCustomError",
)
_THREE_WORDS: Final = re.compile(r"[^\W\d_]{2,}[,;:]? [^\W\d_]{2,}[,;:]? [^\W\d_]{2,}")
_SI_KEY: Final = re.compile(r"\b[a-z_.]+_(?:pa_per_s|per_s|percent|days|pa|m2|kg|ma|hz|m|s|n)\b")
_TWO_WORDS: Final = re.compile(r"[^\W\d_]{2,}[,;:]? [^\W\d_]{2,}")
OWN_ERRORS = tuple(name for name, kind in vars(errors).items() if isinstance(kind, type))
WORDS = re.compile(r"[a-z]{2,} [a-z]{2,}")
#: What a register is, in a map: not told as a reason.
ABOUT_REGISTERS = ("meaning", "source")


def _modules(room: str) -> Iterator[tuple[Path, ast.Module]]:
    place = ROOT / room
    for path in [place] if place.is_file() else sorted(place.rglob("*.py")):
        yield path.relative_to(ROOT), ast.parse(path.read_text(encoding="utf-8"))


def _plain(module: ast.Module) -> Iterator[ast.AST]:
    """Parts of a module without docstrings, logs, errors of a fault of ours, and what registers are called."""
    waiting: list[ast.AST] = [module]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Call):
            whose = ast.unparse(node.func)
            if whose.startswith("_LOG.") or whose in (*OF_PYTHON, "say"):
                continue
        if isinstance(node, ast.keyword) and node.arg in ABOUT_REGISTERS:
            continue
        yield node
        waiting += ast.iter_child_nodes(node)


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))


def _told(text: ast.JoinedStr) -> str:
    return "".join(str(one.value) if isinstance(one, ast.Constant) else " " for one in text.values)


def _calls(module: ast.Module) -> Iterator[tuple[str, ast.Call]]:
    for node in ast.walk(module):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            yield node.func.id, node


def _says(module: ast.Module) -> bool:
    imports = [node for node in module.body if isinstance(node, ast.ImportFrom) and node.module == "valve.messages"]
    return any(one.name == "say" for node in imports for one in node.names)


@cache
def _said() -> tuple[tuple[str, str, str, set[str]], ...]:
    """Where each message is said, its code, its template, and the names of its values."""
    return tuple(_sayings())


def _sayings() -> Iterator[tuple[str, str, str, set[str]]]:
    for room in ROOMS:
        for path, module in _modules(room):
            for name, call in _calls(module) if _says(module) else ():
                if name != "say" or any(one.arg is None for one in call.keywords):
                    continue
                where = f"{path}:{call.lineno}"
                code, template = (ast.literal_eval(one) for one in call.args)
                yield where, code, template, {str(one.arg) for one in call.keywords}


def test_a_code_stands_for_one_sentence() -> None:
    templates: dict[str, set[str]] = defaultdict(set)
    for _, code, template, _ in _said():
        templates[code].add(template)
    assert templates
    assert {code: said for code, said in templates.items() if len(said) > 1} == {}


def test_a_template_has_a_field_for_each_value_and_a_value_for_each_field() -> None:
    for where, _, template, values in _said():
        named: set[str] = set()
        for _, name, spec, _ in string.Formatter().parse(template):
            named |= {name} if name else set()
            named |= {inner for _, inner, _, _ in string.Formatter().parse(spec or "") if inner}
        assert named == values, where


def test_a_key_of_the_plant_file_with_a_unit_is_a_value_where_the_file_is_judged() -> None:
    """Who wrote another key and unit reads those: they are exchanged in the values, the words are not searched."""
    literal = [
        f"{where} {key}"
        for where, _, template, _ in _said()
        if where.startswith(JUDGE_FILES)
        for text, *_ in string.Formatter().parse(template)
        for key in _SI_KEY.findall(text)
    ]
    assert literal == []


def _fitting(spec: str) -> Value:
    """Return a value of the kind that a field writes."""
    number, unit, _ = parted(spec)
    if number.endswith(("d", "x")):
        return 7
    if unit or number.endswith(("e", "f", "g", "%")):
        return 1.5
    return ("one", "another") if spec else "text"


def test_each_template_can_be_told_with_values_of_the_kind_that_it_names() -> None:
    """Where one cannot it is told all the same (``valve.messages``), and tests/conftest.py makes that a failure."""
    for where, code, template, _ in _said():
        values: dict[str, Value] = {}
        for _, name, spec, _ in string.Formatter().parse(template):
            inner = [one for _, one, _, _ in string.Formatter().parse(spec or "") if one]
            values |= dict.fromkeys(inner, 3)
            if name:
                values[name] = _fitting((spec or "").format_map(dict.fromkeys(inner, 3)))
        made = Message(code, template, values)
        assert made.values == values, where
        assert from_json(made.to_json()) == made, where


@pytest.mark.parametrize("room", DATA_ALONE)
def test_no_error_is_raised_with_a_plain_text(room: str) -> None:
    put_together = [
        f"{path}:{call.lineno}"
        for path, module in _modules(room)
        for name, call in _calls(module)
        if name.endswith(REFUSES) and name not in OF_PYTHON and any(_is_text(one) for one in call.args)
    ]
    assert put_together == []


def _sentences(module: ast.Module) -> Iterator[str]:
    """Yield the sentences of a module, each with its line, that stand in no docstring, log, message or own fault."""
    waiting: list[ast.AST] = [module]
    while waiting:
        node = waiting.pop()
        called = ast.unparse(node.func) if isinstance(node, ast.Call) else ""
        if called.startswith("_LOG.") or called in ("say", *(one for one in OF_PYTHON if one != "OSError")):
            continue
        if isinstance(node, ast.Assert) or (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)):
            continue
        if isinstance(node, ast.Constant | ast.JoinedStr):
            text = _told(node) if isinstance(node, ast.JoinedStr) else str(node.value)
            if _THREE_WORDS.search(text):
                yield f"{node.lineno}: {text}"
        waiting += ast.iter_child_nodes(node)


@pytest.mark.parametrize("room", SAID_ALONE)
def test_each_sentence_is_a_message(room: str) -> None:
    plain = [f"{path}:{one}" for path, module in _modules(room) for one in _sentences(module)]
    assert plain == []


@pytest.mark.parametrize("room", DATA_ALONE)
def test_no_sentence_is_put_together(room: str) -> None:
    put_together = [
        f"{path}:{node.lineno} {_told(node)}"
        for path, module in _modules(room)
        for node in _plain(module)
        if isinstance(node, ast.JoinedStr) and WORDS.search(_told(node))
    ]
    assert put_together == []


def _is_bare(node: ast.expr) -> bool:
    """Whether an expression is a sentence that is no message: a literal, an f-string, a sum, a join, or str(error)."""
    if isinstance(node, ast.Constant):
        return isinstance(node.value, str) and " " in node.value
    if isinstance(node, ast.IfExp):
        return _is_bare(node.body) or _is_bare(node.orelse)
    if isinstance(node, ast.BoolOp):
        return any(map(_is_bare, node.values))
    if isinstance(node, ast.BinOp):
        return isinstance(node.op, ast.Add) and (_is_bare(node.left) or _is_bare(node.right))
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
        return node.func.attr == "join" and isinstance(node.func.value, ast.Constant)
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        return node.func.id == "str" and [ast.unparse(one) for one in node.args] == ["error"]
    return isinstance(node, ast.JoinedStr)


def _told_by(call: ast.Call) -> Iterator[ast.expr]:
    """Yield what a call tells a person: the text of an error, a fault of a file, and what is called a reason."""
    name = call.func.id if isinstance(call.func, ast.Name) else getattr(call.func, "attr", "")
    if name.endswith("Error") and name not in OF_PYTHON:
        yield from call.args[:1]
    elif name not in OF_PYTHON and name.endswith(REFUSES):
        yield from call.args
    elif name == "add" and len(call.args) == FAULT:
        yield from call.args[2:]
    if name not in LOGGED:
        yield from (one.value for one in call.keywords if one.arg in TOLD_AS)


@pytest.mark.parametrize("room", AT_THE_EDGE)
def test_nobody_is_told_a_text_that_was_put_together(room: str) -> None:
    put_together = [
        f"{path}:{one.lineno}: {ast.unparse(one)[:60]}"
        for path, module in _modules(room)
        for node in ast.walk(module)
        if isinstance(node, ast.Call)
        for one in _told_by(node)
        if _is_bare(one)
    ]
    assert put_together == []


@pytest.mark.parametrize(
    "text",
    [
        'NotFoundError(f"{tag}: unknown")',
        'NotFoundError("no such test: name another")',
        '_Refusal(HTTPStatus.FORBIDDEN, "nobody is signed in")',
        "NotFoundError(str(error))",
        'NotFoundError("; ".join(reasons))',
        'findings.add(key, value, "it is too large", remedy)',
        'Plan(name, problem="too " + much)',
        'Plan(name, reason=busy or f"{tag} waits")',
    ],
)
def test_a_text_that_was_put_together_is_seen(text: str) -> None:
    call = ast.parse(text, mode="eval").body
    assert isinstance(call, ast.Call)
    assert any(map(_is_bare, _told_by(call)))


def _apart(module: ast.Module) -> set[int]:
    """What stands in a fault of the program, an assertion, a reference or a message: no sentence of its own."""
    inside: set[int] = set()
    for node in ast.walk(module):
        called = node.func if isinstance(node, ast.Call) else None
        if isinstance(node, ast.Assert) or (isinstance(called, ast.Name) and called.id in (*OF_PYTHON, "say")):
            inside |= {id(one) for one in ast.walk(node)}
        target = node.target if isinstance(node, ast.AnnAssign) else None
        if (isinstance(node, ast.keyword) and node.arg == "source") or (
            isinstance(target, ast.Name) and target.id == "source"
        ):
            inside |= {id(one) for one in ast.walk(node)}
    return inside


def _is_put_together(node: ast.AST) -> bool:
    """Whether several words stand in an f-string, or texts are added up or joined to sentences."""
    if isinstance(node, ast.JoinedStr):
        words = "".join(str(one.value) if isinstance(one, ast.Constant) else " " for one in node.values)
        return _TWO_WORDS.search(words) is not None
    if isinstance(node, ast.BinOp | ast.AugAssign) and isinstance(node.op, ast.Add):
        parts = [one.value for one in ast.iter_child_nodes(node) if isinstance(one, ast.Constant)]
        return any(isinstance(one, str) and " " in one for one in parts)
    called = node.func if isinstance(node, ast.Call) else None
    if not isinstance(node, ast.Call) or not isinstance(called, ast.Attribute) or called.attr != "join":
        return False
    are_listed = any(isinstance(one, ast.List | ast.Tuple | ast.GeneratorExp | ast.Name) for one in node.args)
    return are_listed and isinstance(called.value, ast.Constant) and called.value.value in (" ", "; ", ". ")


@pytest.mark.parametrize("room", WHOLE)
def test_no_text_is_put_together(room: str) -> None:
    put_together = []
    for path, module in _modules(room):
        apart = _apart(module)
        nodes = [node for node in ast.walk(module) if isinstance(node, ast.expr | ast.stmt) and id(node) not in apart]
        put_together += [f"{path}:{node.lineno}" for node in nodes if _is_put_together(node)]
    assert put_together == []


@pytest.mark.parametrize("room", WHOLE)
def test_what_an_error_of_ours_says_is_handed_on_as_its_message(room: str) -> None:
    """``str(error)`` loses what its message is made of, ``message_of(error)`` keeps it."""
    lost = [
        f"{path}:{call.lineno}"
        for path, module in _modules(room)
        for caught in ast.walk(module)
        if isinstance(caught, ast.ExceptHandler) and caught.name and _is_ours(caught.type)
        for name, call in _calls(ast.Module(caught.body, []))
        if name == "str" and any(isinstance(one, ast.Name) and one.id == caught.name for one in call.args)
    ]
    assert lost == []


def _is_ours(kinds: ast.expr | None) -> bool:
    names = [] if kinds is None else [one.id for one in ast.walk(kinds) if isinstance(one, ast.Name)]
    return any(name in OWN_ERRORS for name in names)
