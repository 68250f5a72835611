"""Messages as data: a code with its quantities, and the English sentence in SI that they make.

A message is text, so that it can stand wherever a sentence stands; who shows it to a person makes the sentence anew, in
the units, by the clock and in the language of that person.

Making one never raises: what ends a test and sends a valve to its safe value must not fail at its own words. A template
that does not fit its values is told as it stands with the values behind it, as one text, and logged as a fault of ours.
"""

from __future__ import annotations

import contextlib
import logging
import math
import numbers
import string
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from datetime import UTC, datetime
from functools import lru_cache
from typing import Any, Final, Literal, TypeAlias

Form: TypeAlias = Literal["", "sentence", "clause", "heading", "entry"]
#: What a message may tell: a number in SI, a text, an instant, a message, or several that are listed.
Value: TypeAlias = "float | str | datetime | Message | tuple[Value, ...]"

#: Each unit that a template may name: its SI unit, and how many of that it is.
UNITS: Final[dict[str, tuple[str, float]]] = {
    "N": ("N", 1.0),
    "N/s": ("N/s", 1.0),
    "N/m": ("N/m", 1.0),
    "N/mm": ("N/m", 1.0e3),
    "N*s/m": ("N*s/m", 1.0),
    "Pa": ("Pa", 1.0),
    "kPa": ("Pa", 1.0e3),
    "Pa/s": ("Pa/s", 1.0),
    "kPa/s": ("Pa/s", 1.0e3),
    "m": ("m", 1.0),
    "mm": ("m", 1.0e-3),
    "um": ("m", 1.0e-6),
    "m/s": ("m/s", 1.0),
    "mm/s": ("m/s", 1.0e-3),
    "kg": ("kg", 1.0),
    "s": ("s", 1.0),
    "ms": ("s", 1.0e-3),
    "%": ("1", 1.0e-2),
}
#: Where a document keeps what its messages were made of.
TABLE: Final = "messages"
#: Before a unit: the number alone is told.
ALONE: Final = " in"
#: An instant whose field does not say how it is written.
MINUTES: Final = "%Y-%m-%d %H:%M"
_LISTED: Final = "; "
_COLON: Final = ": "
_TEMPLATES: Final = 4096  # so many are kept taken apart
_LOG: Final = logging.getLogger(__name__)


class Message(str):
    """A sentence, or a part of one, with what it was made of; as text it is English and SI.

    ``code`` names it for programs; "" is a text that holds other messages. ``template`` has a field for each of
    ``values``, as ``str.format`` has them: ``{way:.3g mm}`` is a number in SI that is told in mm, ``{way:.3g in mm}``
    the same without its unit, ``{reasons:, }`` a tuple with what stands between its members, ``{at}`` an instant to
    the minute, ``{at:%H:%M:%S}`` one as the field says.
    """

    __slots__ = ("code", "form", "template", "values")

    code: str
    template: str
    values: Mapping[str, Value]
    form: Form

    def __new__(cls, code: str, template: str, values: Mapping[str, Value], form: Form = "") -> Message:
        """Make the English text; where the template does not fit the values, they stand behind it."""
        try:
            text = formed(filled(template, values, as_told), form)
        except Exception as error:  # noqa: BLE001  - what ends a test must not fail at its own words
            _LOG.error("message %r does not fit its values: %r", code, error)
            text = _unfilled(template, values)
            template, values = text.replace("{", "{{").replace("}", "}}"), {}
        made = super().__new__(cls, text)
        made.code, made.template, made.values, made.form = code, template, values, form
        return made

    def __reduce__(self) -> tuple[type[Message], tuple[Any, ...]]:
        """Keep the parts in a copy and between processes."""
        return Message, (self.code, self.template, self.values, self.form)

    def formed(self, form: Form) -> Message:
        """Return this as a sentence (capital, stop), a clause (neither), a heading (capital) or an entry (no stop)."""
        return Message(self.code, self.template, self.values, form)

    def to_json(self) -> dict[str, Any]:
        """Return the code, the template, and the values, from which ``from_json`` makes the message."""
        values = {name: _to_json(value) for name, value in self.values.items()}
        return {"code": self.code, "template": self.template, "values": values, "form": self.form}


def say(code: str, template: str, **values: Value) -> Message:
    """Return a message: its code, the English sentence with a field for each value, and the values in SI.

    >>> say("yields", "The stem yields by {way:.3g mm} before it breaks away.", way=1.2e-4)
    'The stem yields by 0.12 mm before it breaks away.'

    It never raises: a template that does not fit its values is told with the values behind it, and is logged.
    """
    return Message(code, template, values)


def joined(between: str, parts: Iterable[str]) -> Message:
    """Return the parts, messages or plain texts, one after the other with ``between`` between them.

    A message alone stays what it is.
    """
    those = tuple(parts)
    if len(those) == 1 and isinstance(those[0], Message):
        return those[0]
    if not between:
        return Message(
            "",
            "".join(f"{{part{place}}}" for place in range(len(those))),
            {f"part{place}": one for place, one in enumerate(those)},
        )
    return Message("", f"{{parts:{between}}}", {"parts": those})


def messages_in(text: str) -> Iterator[Message]:
    """Yield a message and each that it holds, outermost first; a text that is none has none."""
    if not isinstance(text, Message):
        return
    yield text
    for value in text.values.values():
        for one in value if isinstance(value, tuple) else (value,):
            if isinstance(one, str):
                yield from messages_in(one)


def parts_of(text: str) -> tuple[str, ...]:
    """Return the parts that ``joined`` put together, those of parts too; any other text is one part, "" none."""
    if isinstance(text, Message) and not text.code:
        return tuple(part for value in text.values.values() for one in _texts(value) for part in parts_of(one))
    return (text,) if text else ()


def lines_of(text: str) -> list[str]:
    """Return the lines of a text, messages where each of them was one."""
    if isinstance(text, Message) and not text.code:
        return [line for part in parts_of(text) for line in lines_of(part)]
    return [text] if isinstance(text, Message) else text.splitlines()


def changed(text: str, by: Callable[[str], str | None]) -> str:
    """Return a text as ``by`` makes it, in which each text that it holds was changed so before.

    None leaves a text out of a list; elsewhere it is "".
    """
    if isinstance(text, Message):
        values = {name: _changed(value, by) for name, value in text.values.items()}
        text = Message(text.code, text.template, values, text.form)
    return by(text) or ""


def message_of(error: BaseException) -> str:
    """Return what an error says, as the message that it was raised with where there is one."""
    return error.args[0] if error.args and isinstance(error.args[0], Message) else str(error)


def _unfilled(template: str, values: Mapping[str, Value]) -> str:
    """Return a template as it stands, with its values; each is told in a way that cannot fail."""
    listed = (f"{name} = {value!s}" for name, value in values.items() if isinstance(value, str | int | float | tuple))
    return f"{template} ({', '.join(listed)})"


def fault_words(error: BaseException) -> Message:
    """Return what an error says that nobody raised on purpose, with its kind."""
    return say("fault_of_ours", "{kind}: {why}", kind=type(error).__name__, why=message_of(error))


def report_it(error: BaseException) -> Message:
    """Return the same as a request to report it."""
    return say("report_it", "{fault}: report it", fault=fault_words(error))


def as_told(value: Value, spec: str) -> str:
    """Return one value of a template as English and SI tell it."""
    if isinstance(value, tuple):
        return (spec or _LISTED).join(as_told(one, "") for one in value)
    if isinstance(value, datetime):
        return f"{value.astimezone(UTC):{spec or MINUTES}} UTC"
    if isinstance(value, str):
        return format(str(value), spec)
    number, unit, is_alone = parted(spec)
    if not unit:
        return format(value, number)
    shown = format(value / UNITS[unit][1], number)
    return shown if is_alone else f"{shown} {unit}"


def parted(spec: str) -> tuple[str, str, bool]:
    """Return what a field says of a number: how it is written, its unit or "", and whether the unit stays untold."""
    number, _, unit = spec.rpartition(" ")
    if unit not in UNITS:
        return spec, "", False
    return number.removesuffix(ALONE), unit, number.endswith(ALONE)


def filled(template: str, values: Mapping[str, Value], told: Callable[[Value, str], str]) -> str:
    """Return a template with each field as ``told(value, spec)`` tells it."""
    return "".join(
        text + ("" if name is None else told(values[name], spec)) for text, name, spec in fields(template, values)
    )


def fields(template: str, values: Mapping[str, Value]) -> Iterator[tuple[str, str | None, str]]:
    """Yield each text of a template with the field that follows it (None at the end) and its spec.

    A subject at the begin, or a reason at the end, that is "" is left out with its colon.
    """
    parts = list(_parsed(template))
    if len(parts) > 1 and not parts[0][0] and _is_left_out(values, parts[0][1]) and parts[1][0].startswith(_COLON):
        parts[:2] = [(parts[1][0].removeprefix(_COLON), *parts[1][1:])]
    if len(parts) > 0 and _is_left_out(values, parts[-1][1]) and parts[-1][0].endswith(_COLON):
        parts[-1] = (parts[-1][0].removesuffix(_COLON), None, "")
    for text, name, spec in parts:
        yield text, name, spec.format_map(values) if "{" in spec else spec


@lru_cache(maxsize=_TEMPLATES)
def _parsed(template: str) -> tuple[tuple[str, str | None, str], ...]:
    return tuple((text, name, spec or "") for text, name, spec, _ in string.Formatter().parse(template))


def _is_left_out(values: Mapping[str, Value], name: str | None) -> bool:
    return name is not None and values.get(name) == ""


def left_out(message: Message, names: Collection[str]) -> Message:
    """Return a message without these values: subjects or reasons that are told beside it."""
    values = {name: "" if name in names else value for name, value in message.values.items()}
    return Message(message.code, message.template, values, message.form)


def formed(text: str, form: Form) -> str:
    """Return a text as a sentence, a clause, a heading or an entry of a list."""
    if not form or not text:
        return text
    if form == "entry":
        return text.rstrip(".")
    if form == "heading":
        return text[:1].upper() + text[1:]
    if form == "clause":
        return text[:1].lower() + text[1:].rstrip().removesuffix(".")
    text = text.strip()
    return text[:1].upper() + text[1:] + ("" if text.endswith((".", "!", "?")) else ".")


def from_json(content: Mapping[str, Any]) -> Message:
    """Return the message that ``to_json`` described."""
    values = {name: _from_json(value) for name, value in content["values"].items()}
    return Message(content["code"], content["template"], values, content.get("form", ""))


def with_table(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return a document of lists and mappings with what its messages were made of, by their text, as ``messages``.

    JSON keeps a message as its text; ``restored`` makes it a message again.
    """
    alone = {name: member for name, member in document.items() if name != TABLE}
    table = {text: one.to_json() for text, one in _messages_in(alone)}
    return {**alone, TABLE: table} if table else alone


def messages_by_text(document: Any) -> dict[str, Message]:
    """Return the messages of a document of lists and mappings by their text; a column of numbers is not looked into."""
    return dict(_messages_in(document))


def restored(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return a document with each text that its table has as a message; one without a table as it is.

    What stands in the table and cannot be read stays a text.
    """
    table = dict(_read(document.get(TABLE) or {}))
    if not table:
        return dict(document)
    return {name: member if name == TABLE else _restored(member, table) for name, member in document.items()}


def _texts(value: Value) -> Iterator[str]:
    if isinstance(value, tuple):
        for one in value:
            yield from _texts(one)
    elif isinstance(value, str):
        yield value


def _changed(value: Value, by: Callable[[str], str | None]) -> Value:
    if isinstance(value, tuple):
        found = tuple(_changed(one, by) for one in value)
        return tuple(one for one in found if one != "")
    return changed(value, by) if isinstance(value, str) else value


def _messages_in(document: Any) -> Iterator[tuple[str, Message]]:
    if isinstance(document, Message):
        if document:
            yield str(document), document
    elif isinstance(document, Mapping | list | tuple) and document:
        members = list(document.values()) if isinstance(document, Mapping) else document
        if isinstance(document, Mapping) or not isinstance(members[0], float):  # a column of numbers
            for member in members:
                yield from _messages_in(member)


def _read(table: Mapping[str, Any]) -> Iterator[tuple[str, Message]]:
    for text, one in table.items():
        with contextlib.suppress(KeyError, TypeError, ValueError, AttributeError):  # of another version
            yield text, _written(text, one)


def _written(text: str, content: Mapping[str, Any]) -> Message:
    """Return a message whose text is known: that is quicker than making it, and stays as it was written."""
    made = str.__new__(Message, text)
    made.code, made.template, made.form = content["code"], content["template"], content.get("form", "")
    made.values = {name: _from_json(value) for name, value in content["values"].items()}
    return made


def _restored(document: Any, table: Mapping[str, Message]) -> Any:
    if isinstance(document, str):
        return table.get(document, document)
    if isinstance(document, Mapping):
        return {name: _restored(member, table) for name, member in document.items()}
    if isinstance(document, list | tuple) and document and not isinstance(document[0], float):
        return [_restored(member, table) for member in document]
    return document


def _to_json(value: Value) -> Any:
    """Return a value as strict JSON has it; a number of another library, or that is not finite, is one all the same."""
    if isinstance(value, Message):
        return value.to_json()
    if isinstance(value, datetime):
        return {"at": value.isoformat()}
    if isinstance(value, tuple):
        return [_to_json(one) for one in value]
    return _plain(value)


def _plain(value: object) -> Any:
    if isinstance(value, bool | int | str) or (isinstance(value, float) and math.isfinite(value)):
        return value
    if isinstance(value, numbers.Integral):
        return int(value)
    return {"number": str(float(value))} if isinstance(value, numbers.Real) else str(value)


def _from_json(value: Any) -> Value:
    if isinstance(value, Mapping):
        if "at" in value:
            return datetime.fromisoformat(value["at"])
        return float(value["number"]) if "number" in value else from_json(value)
    return tuple(_from_json(one) for one in value) if isinstance(value, list) else value
