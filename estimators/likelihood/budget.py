"""How much a search may compute: counted, not timed, so that the same recording always gives the same answer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from estimators.likelihood.model import StemModel

# About microseconds on one core: of a call, a row, and a change of the stem's mode.
_A_CALL: Final = 35.0
_A_ROW: Final = 0.04
_AN_EVENT: Final = 0.25
_A_CORNER: Final = 0.09
_AT_LEAST: Final = 150.0e3
_AT_LEAST_OF_JUMPS: Final = 600.0e3  # few rows show as many places of a stem that jumps as many do
_A_MEASURED_ROW: Final = 20.0
_MANY_EVENTS: Final = 75  # in a recording of which the budget is twice as large, and so on
_MOST_TIMES: Final = 4.0
_MORE_FOR_CORNERS: Final = 3.0
_FEWEST: Final = 600  # simulations, of a force with many corners too, but
_LONGEST_FEW: Final = 0.7e6
_LONGEST: Final = 3.0e6
_A_FEW: Final = 60


@dataclass(slots=True)
class Budget:
    """``left`` of the work that a search may do, ``simulations`` and ``starts`` so far."""

    whole: float
    left: float
    simulations: int = 0
    starts: int = 0

    @classmethod
    def of(cls, model: StemModel, *, jumps: bool = False) -> Budget:
        """Return the budget for this recording, all its rows given; ``jumps``: of a stem that sticks and slips."""
        times = min(1.0 + model.events / _MANY_EVENTS, _MOST_TIMES)
        usual = times * (_AT_LEAST + _A_MEASURED_ROW * model.time_s.size)
        # as many simulations of a force with many corners, up to a limit
        few = _A_CALL + _AN_EVENT * model.events
        usual *= min(1.0 + _A_CORNER * model.corner_count / few, _MORE_FOR_CORNERS)
        usual = max(usual, _AT_LEAST_OF_JUMPS) if jumps else usual
        whole = min(max(usual, min(_FEWEST * _each(model), _LONGEST_FEW)), _LONGEST)
        return cls(whole, whole)

    @classmethod
    def limited(cls, most: float) -> Budget:
        """Return a budget of so much."""
        return cls(most, most)

    @staticmethod
    def price(model: StemModel, simulations: int) -> float:
        """Return what these simulations cost."""
        return simulations * _each(model)

    def spend(self, model: StemModel, simulations: int) -> None:
        """Count simulations of this model."""
        self.left -= simulations * _each(model)
        self.simulations += simulations

    def most_simulations(self, model: StemModel, share: float) -> int:
        """How many simulations of this model this share of what is left pays for."""
        return int(share * self.left / _each(model))

    def most_at_once(self, model: StemModel, share: float) -> int:
        """How many simulations of this model this share of the whole budget pays for; enough for a few steps."""
        return max(_A_FEW, int(share * self.whole / _each(model)))

    def allows(self, share: float, whole: float) -> bool:
        """Whether more than this share of the ``whole`` budget is left."""
        return self.left > share * whole


def _each(model: StemModel) -> float:
    """Return what one simulation costs."""
    return _A_CALL + _A_ROW * model.time_s.size + _AN_EVENT * model.events + _A_CORNER * model.corner_count
