"""The one table of the dynamic fit's parameters: their order, transforms, limits and what is known beforehand."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

# Places in the vector of parameters. LN_: the natural logarithm of the value in SI units.
LN_M, LN_V, LN_K, LN_FILTER, FO, FC, FS, LN_DV, LEAD = range(9)
GLOBALS: Final = 9
FLAT: Final = 1.0e12  # a spread that says nothing


@dataclass(frozen=True, slots=True)
class Known:
    """A value and its standard error."""

    value: float
    std_error: float


@dataclass(frozen=True, slots=True)
class Entry:
    """One parameter: its name, the limits that hold it in a fit, and how far one step may lead."""

    name: str
    low: float
    high: float
    longest_step: float


TABLE: Final = (
    Entry("mass", math.log(1.0e-3), math.log(500.0), 1.0),  # all moving parts of the largest globe valves
    Entry("damping", math.log(1.0e-2), math.log(1.0e8), 1.0),
    Entry("spring rate", math.log(1.0), math.log(1.0e9), 0.5),
    Entry("sensor's filter", math.log(1.0e-5), math.log(2.0), 1.0),
    Entry("preload", -math.inf, math.inf, math.inf),
    Entry("Coulomb friction", 0.0, math.inf, math.inf),
    Entry("static friction", 0.0, math.inf, math.inf),
    Entry("limit velocity", math.log(1.0e-7), math.log(0.1), 1.0),
    Entry("lead of the force", -1.0, 1.0, 0.02),
)
LOW: Final = np.array([entry.low for entry in TABLE])
HIGH: Final = np.array([entry.high for entry in TABLE])
LONGEST: Final = np.array([entry.longest_step for entry in TABLE])


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """Means and standard deviations of the parameters beforehand, shape (9,)."""

    mean: FloatArray
    spread: FloatArray


# What is known of any valve: medians and standard deviations of logarithms.
_MASS_KG, _MASS_SPREAD = 2.0, 2.0
_DAMPING_SPREAD: Final = 2.0  # about what coasting after corners shows: a stem may stop at DV, sooner
_FILTER_S, _FILTER_SPREAD = 0.002, 2.5
_LIMIT_M_PER_S, _LIMIT_SPREAD = 2.0e-4, 1.5


def prior_of(damping_n_s_per_m: float, lead_s: tuple[float, float]) -> Prior:
    """Return the priors; the lead's mean and standard deviation, s, come from the force's path."""
    mean = np.zeros(GLOBALS)
    spread = np.full(GLOBALS, FLAT)
    for at, value, width in (
        (LN_M, math.log(_MASS_KG), _MASS_SPREAD),
        (LN_V, math.log(damping_n_s_per_m), _DAMPING_SPREAD),
        (LN_FILTER, math.log(_FILTER_S), _FILTER_SPREAD),
        (LN_DV, math.log(_LIMIT_M_PER_S), _LIMIT_SPREAD),
        (LEAD, *lead_s),
    ):
        mean[at], spread[at] = value, width
    return Prior(mean, spread)
