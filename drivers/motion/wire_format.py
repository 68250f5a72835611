"""What goes between the service and the program that moves valves, as JSON: the same on the socket and on disk.

On the socket a message is a line::

    {"id": 1, "ask": "permissives", "tag": "FV-101", ...}                   a question, answered once
    {"id": 1, "answer": [...]}   {"id": 1, "error": "BusyError", "text": "..."}
    {"say": "stop", "run_id": "...", "reason": "..."}                       an order that is not answered
    {"run": "...", "event": "samples", "value": {...}}                      what is heard of a motion that was asked for

A value is what its dataclass holds, by name; a column of numbers is a list, a gap in it NaN. Only the types of
``drivers.motion.orders`` and what they hold can be read: an unknown name or a missing value is an error.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from datetime import datetime
from enum import Enum
from functools import cache
from typing import Any, Final, TypeVar

import numpy as np
from pydantic import TypeAdapter, ValidationError

import valve.errors
from drivers import faults
from drivers.motion.orders import Order
from drivers.outcome import SampleBlock
from valve.errors import ElsewhereError, InternalError, ValveError
from valve.waveform import Waveform

Value = TypeVar("Value")

#: Of what both ends say; service and motion process of different numbers do not understand each other.
PROTOCOL: Final = 2

_ERRORS: Final[dict[str, type[ValveError]]] = {
    name: kind
    for module in (valve.errors, faults)
    for name, kind in vars(module).items()
    if isinstance(kind, type) and issubclass(kind, ValveError) and kind is not ElsewhereError
}


def to_json(value: Any) -> Any:
    """Return a value as JSON has it."""
    if isinstance(value, ValveError):
        name = next(kind.__name__ for kind in type(value).__mro__ if kind.__name__ in _ERRORS)
        return {"error": name, "text": str(value)}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: to_json(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, datetime):
        return value.isoformat()
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, tuple | list | frozenset | set):
        return [to_json(one) for one in value]
    return value


def error_of(said: dict[str, str]) -> ValveError:
    """Return the error that ``to_json`` wrote."""
    return _ERRORS.get(said["error"], InternalError)(said["text"])


@cache
def _reader(kind: Any) -> Any:
    return TypeAdapter(kind).validate_python


def of_json(kind: type[Value], said: Any) -> Value:
    """Return a value of a type that ``to_json`` wrote. Raises InternalError where it is none."""
    try:
        named: Any = kind
        read: Any = _OWN.get(named) or _reader(named)
        value: Value = read(said)
    except (ValidationError, TypeError, KeyError) as error:
        raise InternalError(
            f"{kind.__name__} cannot be read ({error}): service and motion process must be of the same version"
        ) from error
    return value


def _samples(said: dict[str, Any]) -> SampleBlock:
    columns: dict[str, Any] = {key: np.array(one) if isinstance(one, list) else one for key, one in said.items()}
    return SampleBlock(**columns)


def _waveform(said: dict[str, Any]) -> Waveform:
    return Waveform(said["name"], np.array(said["time_s"]), np.array(said["pressure_pa"]))


def _order(said: dict[str, Any]) -> Order:
    return Order(**{**said, "waveform": _waveform(said["waveform"]), "together": tuple(said["together"])})


_OWN: Final[dict[type, Any]] = {SampleBlock: _samples, Waveform: _waveform, Order: _order}  # with columns of numbers


def line_of(message: dict[str, Any]) -> bytes:
    """Return a message as a line."""
    return json.dumps(message, separators=(",", ":")).encode() + b"\n"
