"""Every docstring of a public function that takes arrays gives their shapes and units."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

import pytest

_ROOT: Final = Path(__file__).parents[2]
_ROOMS: Final = ("valve", "estimators", "discrepancy", "drivers", "simulator", "service")
_ARRAY: Final = re.compile(r"\b(\w+Array|NDArray|ndarray|ArrayLike|Matrix)\b")
#: Their values are true or false, or numbers of rows.
_WITHOUT_UNIT: Final = re.compile(r"\b(BoolArray|IntArray|SenseArray|WordArray|bool_|int64)\b")
#: "Any shape" and "shape as given" are said of what works value by value.
_SHAPE: Final = re.compile(r"\bshapes? \(|\bany shape\b|\bshape as given\b", re.IGNORECASE)
_SUFFIX: Final = re.compile(r"(^|_)(m|s|n|pa|kg|hz|ma|days|n2|per_[a-z0-9_]+)$")
_UNIT: Final = re.compile(
    r"(?:, |; |: |\bin |\band |\bor |\()(?:SI|Pa|N|N/m|N/s|m|m/s|s|kg|Hz|mA|days)(?=[\s,.;:)]|$)"
    r"|\b(?:units?|dimensionless|logarithms?|index|indices|booleans?)\b"
)

_Function = ast.FunctionDef | ast.AsyncFunctionDef


class _Taking(NamedTuple):
    """A public function or method that takes arrays, with the annotations of these."""

    file: str
    owner: str  # its class, or empty
    node: _Function
    arrays: dict[str, str]

    @property
    def is_complete(self) -> bool:
        said = ast.get_docstring(self.node) or ""
        without_shapes = re.sub(r"\([\w, +*/]*,[\w, +*/]*\)", "", said)
        named = all(_SUFFIX.search(name) or _WITHOUT_UNIT.search(kind) for name, kind in self.arrays.items())
        return _SHAPE.search(said) is not None and (named or _UNIT.search(without_shapes) is not None)


def _arrays(node: _Function) -> dict[str, str]:
    given = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
    written = {one.arg: ast.unparse(one.annotation) for one in given if one.annotation is not None}
    return {name: kind for name, kind in written.items() if _ARRAY.search(kind)}


def _taking(tree: ast.Module, file: str) -> Iterator[_Taking]:
    classes = [node for node in tree.body if isinstance(node, ast.ClassDef) and not node.name.startswith("_")]
    for owner, body in [("", tree.body), *((node.name, node.body) for node in classes)]:
        for node in body:
            if isinstance(node, _Function) and not node.name.startswith("_") and (arrays := _arrays(node)):
                yield _Taking(file, owner, node, arrays)


def _incomplete(sources: dict[str, str]) -> list[str]:
    """Return what takes arrays and does not say shapes or units; what overrides a method has them from there."""
    found, bases = list[_Taking](), defaultdict[str, set[str]](set)
    for file, source in sources.items():
        tree = ast.parse(source)
        found += _taking(tree, file)
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                bases[node.name] |= {ast.unparse(base).partition("[")[0] for base in node.bases}
    methods = {(one.owner, one.node.name) for one in found if one.owner}

    def overrides(owner: str, name: str) -> bool:
        return any((base, name) in methods or overrides(base, name) for base in bases.get(owner, ()))

    return [
        f"{one.file}:{one.node.lineno} {one.node.name}({', '.join(one.arrays)})"
        for one in found
        if not (one.is_complete or (one.owner and overrides(one.owner, one.node.name)))
    ]


def _sources() -> dict[str, str]:
    files = [file for room in _ROOMS for file in sorted((_ROOT / room).rglob("*.py"))]
    public = [file for file in files if not any(part.startswith("_") for part in file.relative_to(_ROOT).parts)]
    return {file.relative_to(_ROOT).as_posix(): file.read_text("utf-8") for file in public}


def test_a_public_function_that_takes_arrays_gives_their_shapes_and_units() -> None:
    sources = _sources()
    assert len(sources) > 100
    assert _incomplete(sources) == []


@pytest.mark.parametrize(
    ("parameter", "said", "is_complete"),
    [
        ("force_n: FloatArray", "Largest force.", False),
        ("force_n: FloatArray", "Largest force; ``force_n``, shape (n,).", True),
        ("force: FloatArray", "Largest force; ``force``, shape (n,).", False),
        ("force: FloatArray", "Largest force; ``force``, N, shape (n,).", True),
        ("kept: npt.NDArray[np.bool_]", "Number of rows kept, shape (n,).", True),
        ("count: int", "Twice as many.", True),
    ],
)
def test_a_docstring_without_shape_or_unit_is_found(parameter: str, said: str, is_complete: bool) -> None:
    source = f'def public({parameter}):\n    """{said}"""\n'
    assert (_incomplete({"a.py": source}) == []) is is_complete
    assert _incomplete({"a.py": source.replace("def public", "def _private")}) == []


def test_a_method_has_its_shapes_and_units_from_the_one_that_it_overrides() -> None:
    method = '    def force_n(self, values: FloatArray):\n        """{}"""\n'
    base = "class Law:\n" + method.format("Return what it adds; ``values``, SI, shape (p,).")
    law = "class Spring(Law):\n" + method.format("Return k x.")
    assert _incomplete({"a.py": base, "b.py": law}) == []
    assert _incomplete({"b.py": law}) == ["b.py:2 force_n(values)"]
