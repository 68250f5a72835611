"""The packing of a valve: how much its friction differs from place to place, in time and between breakaways.

A stem that moves with direction s meets, beside k x, F_0 and F_v v, the friction F_c + w_s(x) + d(t); its n-th
breakaway needs (F_s + q (w_s(x) + d(t)) + E) (1 + z_n), q = F_s/F_c, and never less than what motion needs there.

* w_s: a Gaussian process over travel for each direction, in part the same for both: burrs, wear, a lens of grease.
* d: an Ornstein-Uhlenbeck process in time: temperature, lubrication, debris.
* z_n: normal and independent: the contact of this rest, which sets anew when the load turns over.
* E = first_rise F_s T/(T + T_r) after a rest of T: the packing sets.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np
import numpy.typing as npt

from valve.errors import NotFoundError, ParameterError
from valve.messages import say

FloatArray = npt.NDArray[np.float64]

POINTS_A_LENGTH: Final = 16  # of a table of the roughness: lines between them leave it by 0.4 % of its size
_LONGEST_TABLE: Final = 20_000


class RoughnessLaw(StrEnum):
    """How the roughness at one place resembles that at another one, r apart; l is the correlation length."""

    MATERN = "matern"  # (1 + sqrt(3) r/l) exp(-sqrt(3) r/l): bends anywhere, once differentiable
    SMOOTH = "smooth"  # exp(-r^2/(2 l^2)): waves
    ROUGH = "rough"  # exp(-r/l): a random walk that is held back


@dataclass(frozen=True, slots=True)
class Packing:
    """Sizes of what a packing does, as standard deviations; neutral by default.

    Raises ParameterError where a number is not physical.
    """

    breakaway_scatter: float = 0.0  # of F_s, from breakaway to breakaway
    roughness: float = 0.0  # of F_c, along the travel
    roughness_length: float = 0.03  # of travel
    roughness_common: float = 0.5  # share of the roughness' variance that is the same both ways
    roughness_law: RoughnessLaw = RoughnessLaw.MATERN
    wander: float = 0.0  # of F_c, in time
    wander_time_s: float = 60.0
    first_rise: float = 0.0  # of F_s, by which a breakaway after a very long rest is harder
    first_rise_time_s: float = 3600.0  # rest after which half of it is there

    def __post_init__(self) -> None:
        try:
            object.__setattr__(self, "roughness_law", RoughnessLaw(self.roughness_law))
        except ValueError:
            raise ParameterError(
                say(
                    "roughness_law_unknown",
                    "packing: roughness_law is {law}, choose one of {choices:, }",
                    law=repr(self.roughness_law),
                    choices=tuple(RoughnessLaw),
                )
            ) from None
        limits = {
            "breakaway_scatter": (0.0, 0.3),
            "roughness": (0.0, 0.3),
            "roughness_length": (1.0e-3, 1.0),
            "roughness_common": (0.0, 1.0),
            "wander": (0.0, 0.3),
            "wander_time_s": (0.1, 1.0e6),
            "first_rise": (0.0, 5.0),
            "first_rise_time_s": (1.0, 1.0e7),
        }
        for name, (least, most) in limits.items():
            value = getattr(self, name)
            if not (math.isfinite(value) and least <= value <= most):
                raise ParameterError(
                    say(
                        "packing_outside",
                        "packing: {name} is {value:g}, give {least:g} to {most:g}",
                        name=name,
                        value=value,
                        least=least,
                        most=most,
                    )
                )

    @property
    def is_ideal(self) -> bool:
        """Whether friction is the same everywhere, always and at every breakaway."""
        return not (self.breakaway_scatter or self.roughness or self.wander or self.first_rise)


# Sizes: the lower end of what valves in good order show, the middle, and the upper end.
PACKINGS: Final[dict[str, Packing]] = {
    "ideal": Packing(),
    "mild": Packing(breakaway_scatter=0.01, roughness=0.005, wander=0.003),
    "usual": Packing(breakaway_scatter=0.025, roughness=0.015, wander=0.006),
    "hard": Packing(breakaway_scatter=0.06, roughness=0.04, wander=0.015),
}


def packing_preset(name: str) -> Packing:
    """Return the packing of this name. Raises NotFoundError for another name."""
    if name not in PACKINGS:
        raise NotFoundError(
            say(
                "packing_unknown",
                "packing {name} is unknown: choose one of {choices:, }",
                name=repr(name),
                choices=tuple(PACKINGS),
            )
        )
    return PACKINGS[name]


@dataclass(frozen=True, slots=True, eq=False)
class RoughnessTable:
    """Friction that the travel adds, N, straight between evenly spaced places and held beyond them.

    ``opening_n`` and ``closing_n``, shape (n,): at ``start_m``, ``start_m + step_m`` and so on.
    """

    start_m: float
    step_m: float
    opening_n: FloatArray
    closing_n: FloatArray

    @property
    def places_m(self) -> FloatArray:
        """Where the values hold, m, shape (n,)."""
        return np.asarray(self.start_m + self.step_m * np.arange(self.opening_n.size))

    def mean_n(self, low_m: float, high_m: float, *, opening: bool) -> float:
        """Mean over the travel from ``low_m`` to ``high_m``, N; the value there if they are the same place."""
        values, places_m = self.opening_n if opening else self.closing_n, self.places_m
        if high_m <= low_m:
            return float(np.interp(low_m, places_m, values))
        inside = places_m[(places_m > low_m) & (places_m < high_m)]
        edges_m = np.concatenate(([low_m], inside, [high_m]))
        return float(np.trapezoid(np.interp(edges_m, places_m, values), edges_m) / (high_m - low_m))


NO_ROUGHNESS: Final = RoughnessTable(0.0, 1.0, np.zeros(2), np.zeros(2))


def drawn_roughness(
    packing: Packing, coulomb_friction_n: float, travel_m: float, seed: int, *, beyond: float = 0.15
) -> RoughnessTable:
    """Draw the roughness of one valve from ``beyond`` of the travel below its start to as much above its end."""
    length_m = packing.roughness_length * travel_m
    step_m, span_m = length_m / POINTS_A_LENGTH, (1.0 + 2.0 * beyond) * travel_m
    count = math.ceil(span_m / step_m) + 1
    if packing.roughness == 0.0 or coulomb_friction_n == 0.0:
        return NO_ROUGHNESS
    if count > _LONGEST_TABLE:
        raise ParameterError(
            say(
                "roughness_too_short",
                "packing: roughness_length {length:g} is too short, raise it",
                length=packing.roughness_length,
            )
        )
    rng = np.random.default_rng([seed, 0x57])
    common, opening, closing = (_drawn_process(packing.roughness_law, count, rng) for _ in range(3))
    alike, own = math.sqrt(packing.roughness_common), math.sqrt(1.0 - packing.roughness_common)
    size_n = packing.roughness * coulomb_friction_n
    return RoughnessTable(
        -beyond * travel_m, step_m, size_n * (alike * common + own * opening), size_n * (alike * common + own * closing)
    )


def _drawn_process(law: RoughnessLaw, count: int, rng: np.random.Generator) -> FloatArray:
    """Draw a stationary process of variance 1, POINTS_A_LENGTH points a correlation length, shape (count,).

    From its spectrum on a circle that is long enough for its two ends to be strangers to each other.
    """
    around = 2 * (count + 12 * POINTS_A_LENGTH)
    places = np.arange(around, dtype=np.float64)
    apart = np.minimum(places, around - places) / POINTS_A_LENGTH
    if law is RoughnessLaw.MATERN:
        covariance = (1.0 + math.sqrt(3.0) * apart) * np.exp(-math.sqrt(3.0) * apart)
    elif law is RoughnessLaw.SMOOTH:
        covariance = np.exp(-0.5 * apart**2)
    else:
        covariance = np.exp(-apart)
    power = np.maximum(np.fft.fft(covariance).real, 0.0)
    white = rng.standard_normal(around) + 1j * rng.standard_normal(around)
    drawn = np.fft.fft(np.sqrt(power / around) * white)
    return np.ascontiguousarray(drawn.real[:count])
