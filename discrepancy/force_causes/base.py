"""What a cause is to the balance of forces of a drive without a spring: columns beside the drive's own."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from discrepancy.force_causes.fitted import Fitted
from discrepancy.force_record import ForceRecord
from estimators.samples import FloatArray
from valve.messages import Message

Shape = Mapping[str, float]  # what of a cause is not linear, by name, SI
Values = Mapping[str, tuple[float, float]]  # value and standard error
Found = tuple[tuple[float, float], ...]  # coefficient and standard error of each column


@dataclass(frozen=True, slots=True)
class ForceCause:
    """A cause as a force.

    ``shapes`` are those to try on a record, beside what the plain balance leaves, (n,). ``columns`` makes a record's
    columns (n, q) of a shape, unfiltered. ``read`` says what their coefficients mean, None where that is not physical.
    ``free`` are the parts of a shape that are moved to where they explain most: "" moves by a ratio, the name of
    another part by shares of that part. ``action`` is what a fitter does about it.
    """

    name: str
    shapes: Callable[[ForceRecord, FloatArray], Iterator[Shape]]
    columns: Callable[[ForceRecord, Shape], FloatArray]
    read: Callable[[Values, Found, Shape], dict[str, Fitted] | None]
    sentence: Callable[[Mapping[str, Fitted], Values], Message]
    action: Message
    free: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class ForceStart:
    """A cause with its shape fixed."""

    cause: ForceCause
    shape: Shape

    def columns(self, record: ForceRecord) -> FloatArray:
        """Return its columns of a record, (n, q), unfiltered."""
        return self.cause.columns(record, self.shape)


def fitted_value(value: float, error: float, unit: str) -> Fitted:
    """Return a value with its 95 % interval."""
    return Fitted(value, value - 1.96 * error, value + 1.96 * error, unit)


def one_column(values: FloatArray) -> FloatArray:
    """Return values, shape (n,), in any unit, as the only column, shape (n, 1)."""
    return np.asarray(values[:, None])


def swept(record: ForceRecord) -> tuple[float, float]:
    """Return the lowest position and the length of the range that was swept, m."""
    position_m = record.samples.position_m[record.rows]
    return float(position_m.min()), float(np.ptp(position_m))
