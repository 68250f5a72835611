"""pymodbus is used by what it documents alone: then any version of its range may come."""

from __future__ import annotations

import ast
import tomllib
from pathlib import Path
from typing import Final

_ROOT: Final = Path(__file__).parents[2]
_MODULES: Final = {"pymodbus.client", "pymodbus.exceptions"}
_CLIENT: Final = {
    *("connect", "close", "connected"),
    *("read_holding_registers", "read_input_registers", "write_register", "write_registers", "readwrite_registers"),
}


def _is_client(value: ast.expr) -> bool:
    return (isinstance(value, ast.Name) and value.id == "client") or (
        isinstance(value, ast.Attribute) and value.attr == "_client"
    )


def test_the_drivers_ask_of_pymodbus_what_it_documents_and_nothing_else() -> None:
    tree = ast.parse((_ROOT / "drivers" / "connection.py").read_text("utf-8"))
    imported = {
        node.module
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("pymodbus")
    }
    assert imported == _MODULES
    asked = {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute) and _is_client(node.value)}
    assert asked == _CLIENT


def test_no_other_file_of_the_product_imports_pymodbus() -> None:
    rooms = ("valve", "estimators", "discrepancy", "drivers", "simulator", "service")
    files = [file for room in rooms for file in (_ROOT / room).rglob("*.py")]
    assert len(files) > 100
    importing = [
        file.name for file in files if "import pymodbus" in (text := file.read_text("utf-8")) or "from pymodbus" in text
    ]
    assert importing == ["connection.py"]


def test_the_project_names_a_range_of_pymodbus_and_the_lock_one_version() -> None:
    project = tomllib.loads((_ROOT / "pyproject.toml").read_text("utf-8"))
    (named,) = [one for one in project["project"]["dependencies"] if one.startswith("pymodbus")]
    assert ">=" in named
    assert "<4" in named
    assert "\npymodbus==3." in (_ROOT / "requirements.lock").read_text("utf-8")
