"""What a choice of causes has come to: on its way, and at its end."""

from __future__ import annotations

from dataclasses import dataclass

from discrepancy.causes.base import Cause
from discrepancy.least_squares import Fit


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """What was chosen: the fits from the baseline on, the last with all ``causes``, and the first one's near rivals.

    ``is_cut``: the work of a search was done before it came to its end.
    """

    baseline: Fit
    best: Fit
    causes: tuple[Cause, ...]
    rivals: tuple[str, ...]
    rival_fits: tuple[Fit, ...]
    tried: tuple[tuple[str, float], ...]
    is_cut: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Way:
    """How far a forward choice has come: its last fit, what is in it, the last one's rivals, and whether it ends.

    ``fitted`` names what was fitted in the last one's place.
    """

    best: Fit
    chosen: tuple[Cause, ...] = ()
    rivals: tuple[tuple[Cause, Fit], ...] = ()
    is_done: bool = False
    fitted: frozenset[str] = frozenset()
