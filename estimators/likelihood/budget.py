"""How much a search may compute: counted, not timed, so that the same recording always gives the same answer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from estimators.likelihood.model import StemModel

# About microseconds on one core: of a call, a row, and a change of the stem's mode.
_A_CALL: Final = 35.0
_A_ROW: Final = 0.04
_AN_EVENT: Final = 0.25
_AT_LEAST: Final = 150.0e3
_A_MEASURED_ROW: Final = 20.0
_MANY_EVENTS: Final = 75  # in a recording of which the budget is twice as large, and so on
_MOST_TIMES: Final = 5.0


@dataclass(slots=True)
class Budget:
    """``left`` of the work that a search may do, ``simulations`` and ``starts`` so far."""

    left: float
    simulations: int = 0
    starts: int = 0

    @classmethod
    def of(cls, model: StemModel) -> Budget:
        """Return the budget for this recording, all its rows given."""
        times = min(1.0 + model.events / _MANY_EVENTS, _MOST_TIMES)
        return cls(times * (_AT_LEAST + _A_MEASURED_ROW * model.time_s.size))

    def spend(self, model: StemModel, simulations: int) -> None:
        """Count simulations of this model."""
        each = _A_CALL + _A_ROW * model.time_s.size + _AN_EVENT * model.events
        self.left -= simulations * each
        self.simulations += simulations

    def allows(self, share: float, whole: float) -> bool:
        """Whether more than this share of the ``whole`` budget is left."""
        return self.left > share * whole
