"""What is wrong with a configuration file: every fault by file, key, value, reason and remedy."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Generic, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import ErrorDetails

from service.config.units import Written, in_own_words, in_si, own_names
from service.words.spelling import known_keys, lowered, nearest
from valve.errors import ConfigurationError, ValveError
from valve.messages import Message, joined, lines_of, message_of, messages_in, say

Key = tuple[str | int, ...]
Model = TypeVar("Model", bound=BaseModel)
Part = TypeVar("Part")

# pydantic's names of faults
SAFE_VALUE: Final = "safe_value"
TEXT: Final = "text"

_REMEDIES: Final = {
    "float_type": say("give_number", "give a number without quotes and unit"),
    "int_type": say("give_whole_number", "give a whole number without quotes and unit"),
    "finite_number": say("give_finite_number", "give a finite number"),
    "bool_type": say("give_true_or_false", "give true or false"),
    "string_type": say("put_in_quotes", "put it in quotes"),
    "tuple_type": say("give_list", "give a list such as [low, high]"),
    "string_too_short": say("say_or_remove", "say something or remove it"),
    "string_too_long": say("shorten_it", "shorten it"),
    TEXT: say("write_in_one_line", "write it in one line of printable characters"),
    SAFE_VALUE: say("give_pa_or_entry", 'give Pa, or "entry"'),
}


class _One(BaseModel, Generic[Part]):
    """Carries one stdlib dataclass through pydantic, as strictly as the models."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, strict=True)
    part: Part


def read_toml(path: Path, text: str | None = None) -> dict[str, Any]:
    """Return the content of a TOML file, or of the ``text`` that it would have.

    Raises ConfigurationError where it cannot be read or is no TOML.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8") if text is None else text)
    except OSError as error:
        raise ConfigurationError(
            say(
                "give_existing_file",
                "{path}: it cannot be read ({reason}): give an existing file",
                path=str(path),
                reason=str(error.strerror),
            )
        ) from error
    except UnicodeDecodeError as error:
        raise ConfigurationError(
            say(
                "file_no_utf8",
                "{file}: byte {byte} is no UTF-8: save the file as UTF-8",
                file=path.name,
                byte=error.start,
            )
        ) from error
    except tomllib.TOMLDecodeError as error:
        raise ConfigurationError(
            say(
                "file_no_toml",
                "{file}: it is no valid TOML: {why}: correct it there",
                file=path.name,
                why=message_of(error),
            )
        ) from error


def _written(key: Key) -> str:
    text = ""
    for part in key:
        text += f"[{part}]" if isinstance(part, int) else f".{part}"
    return text.lstrip(".") or "the file"


def _spelling(word: str, known: list[str], with_unit: Collection[str]) -> str:
    close = nearest(word, [*known, *with_unit])
    if close:
        return say("write_close", "write {close}", close=close)
    return say("remove_unknown", "remove it; known here are {known:, }", known=tuple(known))


def _judged(reason: str) -> str:
    """Return the key that a reason judges, which it has as its value ``key``; "" where it judges none."""
    keys = (one.values.get("key") for one in messages_in(reason))
    return next((str(key) for key in keys if type(key) is str), "")


@dataclass(frozen=True, slots=True)
class Fault:
    """One thing that is wrong with a file; ``remedy`` is "" where the reason says what to do.

    ``place`` is the key as its parts; ``named`` is the key below it that the reason judges, with its table, where a
    table judged itself.
    """

    file: str
    key: str
    value: str | None
    reason: str
    remedy: str = ""
    place: Key = ()
    named: str = ""

    def __str__(self) -> str:
        """Return it as one line."""
        return str(self.message)

    @property
    def message(self) -> Message:
        """It as one line."""
        place = (
            self.key if self.value is None else say("key_has_value", "{key} = {value}", key=self.key, value=self.value)
        )
        return joined(": ", [part for part in (self.file, place, self.reason, self.remedy) if part])

    def to_json(self) -> dict[str, str | None]:
        """Return it as the command line shows it to machines."""
        return {
            "file": self.file,
            "key": self.key,
            "value": self.value,
            "reason": self.reason,
            "remedy": self.remedy,
            "message": str(self),
        }


class Findings:
    """Faults of one file, gathered so that all can be mended at once; each names key and value as they stand there."""

    def __init__(self, file: str) -> None:
        self._file = file
        self._faults: dict[Fault, None] = {}  # each once, in order
        self._written: dict[Key, Written] = {}  # by their SI keys, what stands in the file with a unit
        self._left_open: set[Key] = set()  # SI keys that are missing because what was given for them is refused

    def __len__(self) -> int:
        return len(self._faults)

    @property
    def faults(self) -> tuple[Fault, ...]:
        """Everything that was found."""
        return tuple(self._faults)

    def add(self, key: Key, value: object, reason: str, remedy: str) -> None:
        """Note one fault."""
        reason, remedy = self._in_own_words(key, reason), self._in_own_words(key, remedy)
        own = self._written.get(key)
        value = value if own is None else own.value
        self._note_at(self._own_key(key), _shown(value), reason, remedy)

    def add_error(self, key: Key, error: ValveError) -> None:
        """Note faults that a dataclass found in itself, one a line; each names value, limit and remedy already."""
        for line in lines_of(message_of(error)):
            self._note_at(self._own_key(key), None, self._in_own_words(key, line), named=_judged(line))

    def _note_at(self, place: Key, value: str | None, reason: str, remedy: str = "", named: str = "") -> None:
        self._faults[Fault(self._file, _written(place), value, reason, remedy, place, named)] = None

    def error(self) -> ConfigurationError:
        """Return all faults as one error, one line each."""
        return ConfigurationError(joined("\n", [fault.message for fault in self._faults]))

    def si_table(
        self, kind: Any, raw: Mapping[str, Any], key: Key, ends: Mapping[str, str] | None = None
    ) -> dict[str, Any]:
        """Return a table with its values in the units of its SI keys; what has no fitting unit is noted and left out.

        ``model`` and ``part`` do it by themselves; it is for who reads the table before they check it. ``ends`` are
        those of keys without one: {"quantity": "_pa"}.
        """
        table = in_si(kind, raw, ends or {})
        self._written |= {(*key, *path): one for path, one in table.written.items()}
        for one in table.faults:
            place = (*key, *one.path)
            self._left_open |= {(*place[:-1], name) for name in one.si_names}
            self.add(place, one.value, one.reason, one.remedy)
        return table.values

    def model(self, kind: type[Model], raw: dict[str, Any], key: Key) -> Model | None:
        """Return ``raw`` as a pydantic model, or None with its faults noted."""
        before = len(self)
        values = self.si_table(kind, raw, key)
        model = self._validated(kind, values, key, kind)
        return model if len(self) == before else None

    def part(
        self, kind: type[Part], raw: dict[str, Any], key: Key, ends: Mapping[str, str] | None = None
    ) -> Part | None:
        """Return ``raw`` as a stdlib dataclass, or None with its faults noted; ``ends`` as in ``si_table``."""
        before = len(self)
        values = self.si_table(kind, raw, key, ends)
        carrier = self._validated(_One[kind], {"part": values}, key, kind)  # type: ignore[valid-type]  # a runtime type
        return carrier.part if carrier is not None and len(self) == before else None

    def _validated(self, model: type[Model], raw: dict[str, Any], key: Key, kind: Any) -> Model | None:
        try:
            # By way of JSON: there strict means exactly TOML's types, lists for tuples and strings for choices.
            return model.model_validate_json(json.dumps(raw, default=str))
        except ValidationError as error:
            for one in error.errors(include_url=False):
                self._note(key, one, kind)
        except ValveError as error:
            self.add_error(key, error)
        return None

    def _note(self, outer: Key, one: ErrorDetails, kind: Any) -> None:
        key = (*outer, *(part for part in one["loc"] if part != "part"))
        if one["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
            with_unit = own_names(kind) if isinstance(one["input"], str | list) else ()
            self.add(
                key,
                one["input"],
                say("key_unknown", "this key is unknown"),
                _spelling(str(key[-1]), known_keys(kind), with_unit),
            )
        elif one["type"] in ("missing", "missing_argument"):
            if key not in self._left_open:
                self._note_at(key, None, say("it_is_missing", "it is missing"), say("add_it", "add it"))
        else:
            reason = lowered(one["msg"])
            remedy = _REMEDIES.get(one["type"], say("correct_it", "correct it"))
            own = next((own for own, names in own_names(kind).items() if key[-1] in names), None)
            if isinstance(one["input"], str) and own is not None and not in_si(kind, {own: one["input"]}).faults:
                remedy = say(
                    "or_write", "{remedy}, or write {key} = {value}", remedy=remedy, key=own, value=_shown(one["input"])
                )
            self.add(key, one["input"], reason, remedy)

    def _own_key(self, key: Key) -> Key:
        """Return a key as it stands in the file."""
        own = list(key)
        for end in range(1, len(key) + 1):
            if key[:end] in self._written:
                own[end - 1] = self._written[key[:end]].name
        return tuple(own)

    def _in_own_words(self, key: Key, text: str) -> str:
        """Return a message with the names that stand in the file, by those of the same table or valve."""
        near = [(path[2:], one) for path, one in self._written.items() if path[:2] == key[:2] and len(path) > 2]
        return in_own_words(text, ((tuple(map(str, path)), one) for path, one in near)) if near else text


def _shown(value: object) -> str:
    text = json.dumps(value, default=str)
    return text if len(text) <= 80 else f"{text[:77]}..."
