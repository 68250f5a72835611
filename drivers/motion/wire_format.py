"""What goes between the service and the program that moves valves, as JSON: the same on the socket and on disk.

On the socket a message is a line::

    {"id": 1, "ask": "permissives", "tag": "FV-101", ...}                   a question, answered once
    {"id": 1, "answer": [...]}   {"id": 1, "error": "BusyError", "text": "..."}
    {"say": "stop", "run_id": "...", "reason": "..."}                       an order that is not answered
    {"run": "...", "event": "samples", "value": {...}}                      what is heard of a motion that was asked for

A value is what its dataclass holds, by name; a column of numbers is a list, a gap in it NaN. Only the types of
``drivers.motion.orders`` and what they hold can be read: an unknown name or a missing value is an error. What the
texts of a line were made of stands in it as ``messages`` (``valve.messages``); a line without it is read all the same.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
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
from valve.messages import TABLE, Message, message_of, messages_by_text, restored, say, with_table
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
        return {"error": name, "text": message_of(value)}
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
    """Return a value of a type that ``to_json`` wrote, with its messages. Raises InternalError where it is none."""
    try:
        named: Any = kind
        own: Any = _OWN.get(named)
        value: Value = _reader(named)(said) if own is None else own(said)
        if own is None:  # pydantic makes a plain text of a message
            table = messages_by_text(said)
            value = _with_messages(value, table) if table else value
    except (ValidationError, TypeError, KeyError) as error:
        raise InternalError(
            say(
                "said_unreadable",
                "{kind} cannot be read ({why}): service and motion process must be of the same version",
                kind=kind.__name__,
                why=message_of(error),
            )
        ) from error
    return value


def _with_messages(value: Any, table: Mapping[str, Message]) -> Any:
    """Return a value that was read with each of its texts that a table has as that message."""
    if type(value) is str:
        return table.get(value, value)
    if isinstance(value, tuple):
        return tuple(_with_messages(one, table) for one in value)
    if isinstance(value, Mapping):
        return {name: _with_messages(one, table) for name, one in value.items()}
    if not is_dataclass(value) or isinstance(value, type):
        return value
    return replace(value, **{one.name: _with_messages(getattr(value, one.name), table) for one in fields(value)})


def _samples(said: dict[str, Any]) -> SampleBlock:
    columns: dict[str, Any] = {key: np.array(one) if isinstance(one, list) else one for key, one in said.items()}
    return SampleBlock(**columns)


def _waveform(said: dict[str, Any]) -> Waveform:
    return Waveform(said["name"], np.array(said["time_s"]), np.array(said["pressure_pa"]))


def _order(said: dict[str, Any]) -> Order:
    return Order(**{**said, "waveform": _waveform(said["waveform"]), "together": tuple(said["together"])})


_OWN: Final[dict[type, Any]] = {SampleBlock: _samples, Waveform: _waveform, Order: _order}  # with columns of numbers


def line_of(message: dict[str, Any]) -> bytes:
    """Return a message as a line, with what its texts were made of; samples have none and are not looked into."""
    whole = message if message.get("event") == "samples" else with_table(message)
    return json.dumps(whole, separators=(",", ":")).encode() + b"\n"


def said_in(line: bytes) -> dict[str, Any]:
    """Return what a line says, its texts as what they were made of. Raises ValueError where it is no message."""
    said = restored(json.loads(line))
    said.pop(TABLE, None)
    return said
