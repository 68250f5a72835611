"""What is wrong with a configuration file: every fault by file, key, value, reason and remedy."""

from __future__ import annotations

import json
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Generic, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import ErrorDetails

from service.spelling import known_keys, nearest
from valve.errors import ConfigurationError, ValveError

Key = tuple[str | int, ...]
Model = TypeVar("Model", bound=BaseModel)
Part = TypeVar("Part")

SAFE_VALUE: Final = "safe_value"  # pydantic's name of the fault

_REMEDIES: Final = {
    "float_type": "give a number without quotes and unit",
    "int_type": "give a whole number without quotes and unit",
    "finite_number": "give a finite number",
    "bool_type": "give true or false",
    "string_type": "put it in quotes",
    "tuple_type": "give a list such as [low, high]",
    SAFE_VALUE: 'give Pa, or "entry"',
}


class _One(BaseModel, Generic[Part]):
    """Carries one stdlib dataclass through pydantic, as strictly as the models."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, strict=True)
    part: Part


def read_toml(path: Path) -> dict[str, Any]:
    """Return the content of a TOML file. Raises ConfigurationError where it cannot be read or is no TOML."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigurationError(f"{path}: it cannot be read ({error.strerror}): give an existing file") from error
    except UnicodeDecodeError as error:
        raise ConfigurationError(f"{path.name}: byte {error.start} is no UTF-8: save the file as UTF-8") from error
    except tomllib.TOMLDecodeError as error:
        raise ConfigurationError(f"{path.name}: it is no valid TOML: {error}: correct it there") from error


def _written(key: Key) -> str:
    text = ""
    for part in key:
        text += f"[{part}]" if isinstance(part, int) else f".{part}"
    return text.lstrip(".") or "the file"


def _spelling(word: str, known: list[str]) -> str:
    close = nearest(word, known)
    return f"write {close}" if close else f"remove it; known here are {', '.join(known)}"


@dataclass(frozen=True, slots=True)
class Fault:
    """One thing that is wrong with a file; ``remedy`` is "" where the reason says what to do."""

    file: str
    key: str
    value: str | None
    reason: str
    remedy: str = ""

    def __str__(self) -> str:
        """Return it as one line."""
        place = self.key if self.value is None else f"{self.key} = {self.value}"
        return ": ".join(part for part in (self.file, place, self.reason, self.remedy) if part)

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
    """Faults of one file, gathered so that all can be mended at once."""

    def __init__(self, file: str) -> None:
        self._file = file
        self._faults: dict[Fault, None] = {}  # each once, in order

    def __len__(self) -> int:
        return len(self._faults)

    @property
    def faults(self) -> tuple[Fault, ...]:
        """Everything that was found."""
        return tuple(self._faults)

    def add(self, key: Key, value: object, reason: str, remedy: str) -> None:
        """Note one fault."""
        self._faults[Fault(self._file, _written(key), _shown(value), reason, remedy)] = None

    def add_error(self, key: Key, error: ValveError) -> None:
        """Note faults that a dataclass found in itself, one a line; each names value, limit and remedy already."""
        for line in str(error).splitlines():
            self._faults[Fault(self._file, _written(key), None, line)] = None

    def error(self) -> ConfigurationError:
        """Return all faults as one error, one line each."""
        return ConfigurationError("\n".join(str(fault) for fault in self._faults))

    def model(self, kind: type[Model], raw: dict[str, Any], key: Key) -> Model | None:
        """Return ``raw`` as a pydantic model, or None with its faults noted."""
        return self._validated(kind, raw, key, kind)

    def part(self, kind: type[Part], raw: dict[str, Any], key: Key) -> Part | None:
        """Return ``raw`` as a stdlib dataclass, or None with its faults noted."""
        carrier = self._validated(_One[kind], {"part": raw}, key, kind)  # type: ignore[valid-type]  # a runtime type
        return None if carrier is None else carrier.part

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
            self.add(key, one["input"], "this key is unknown", _spelling(str(key[-1]), known_keys(kind)))
        elif one["type"] in ("missing", "missing_argument"):
            self._faults[Fault(self._file, _written(key), None, "it is missing", "add it")] = None
        else:
            reason = one["msg"][0].lower() + one["msg"][1:]
            self.add(key, one["input"], reason, _REMEDIES.get(one["type"], "correct it"))


def _shown(value: object) -> str:
    text = json.dumps(value, default=str)
    return text if len(text) <= 80 else f"{text[:77]}..."
