"""``safe_value_pa`` of a valve: one kind of value or the other, and one fault where it is neither."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import BeforeValidator
from pydantic_core import PydanticCustomError

from service.settings_errors import SAFE_VALUE


def _pressure_or_entry(value: object) -> object:
    if value == "entry":
        return value
    if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
        return value
    raise PydanticCustomError(SAFE_VALUE, "it is neither a pressure nor an order")


SafeValue = Annotated[float | Literal["entry"], BeforeValidator(_pressure_or_entry)]
