"""A number of the input that is fitted together with the valve's parameters, and is none of them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Nuisance:
    """Name, start, and limits of a nuisance, all in its SI unit.

    ``scale`` is a change that matters: the step of differences and of the trust region. ``prior_sd`` is what is
    known beforehand, one standard deviation about ``start``; math.inf where nothing is.
    """

    name: str
    start: float
    scale: float
    lower: float
    upper: float
    prior_sd: float
