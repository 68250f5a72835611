"""The parameters of the Karnopp valve (Romano & Garcia 2007, Eq. 1-2), with their physics checked."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from valve.errors import ParameterError
from valve.messages import say


@dataclass(frozen=True, slots=True)
class ParameterSymbol:
    """One parameter as the paper and the analysis object call it."""

    symbol: str
    field: str
    unit: str
    meaning: str


# Every parameter of the model, in the order of the analysis object.
PARAMETER_SYMBOLS: Final[dict[str, ParameterSymbol]] = {
    entry.symbol: entry
    for entry in (
        ParameterSymbol("m", "mass_kg", "kg", "mass of the moving parts"),
        ParameterSymbol("k", "spring_rate_n_per_m", "N/m", "spring rate"),
        ParameterSymbol("F_v", "viscous_friction_n_s_per_m", "N*s/m", "viscous friction coefficient"),
        ParameterSymbol("F_c", "coulomb_friction_n", "N", "Coulomb friction"),
        ParameterSymbol("F_s", "static_friction_n", "N", "static friction"),
        ParameterSymbol("DV", "limit_velocity_m_per_s", "m/s", "limit velocity"),
        ParameterSymbol("F_0", "preload_n", "N", "preload of the spring at zero travel"),
    )
}


@dataclass(frozen=True, slots=True)
class ValveParameters:
    """m, k, F_v, F_c, F_s, DV and F_0 of a Karnopp valve, SI.

    ``spring_rate_n_per_m`` may be 0 (a double-acting drive). Raises ParameterError
    unless m > 0, k >= 0, F_v >= 0, F_s >= F_c >= 0, DV > 0 and all are finite.
    """

    mass_kg: float
    spring_rate_n_per_m: float
    viscous_friction_n_s_per_m: float
    coulomb_friction_n: float
    static_friction_n: float
    limit_velocity_m_per_s: float
    preload_n: float = 0.0

    def __post_init__(self) -> None:
        for entry in PARAMETER_SYMBOLS.values():
            value = getattr(self, entry.field)
            if not math.isfinite(value):
                raise ParameterError(
                    say(
                        "parameter_not_finite",
                        "{name} is {value}, it must be a finite number: correct it",
                        name=entry.field,
                        value=value,
                    )
                )
        for field in ("mass_kg", "limit_velocity_m_per_s"):
            if getattr(self, field) <= 0.0:
                raise ParameterError(
                    say(
                        "value_not_positive",
                        "{name} is {value:g}, it must be above 0: correct it",
                        name=field,
                        value=getattr(self, field),
                    )
                )
        for field in ("spring_rate_n_per_m", "viscous_friction_n_s_per_m", "coulomb_friction_n"):
            if getattr(self, field) < 0.0:
                raise ParameterError(
                    say(
                        "value_negative",
                        "{name} is {value:g}, it must not be negative: correct it",
                        name=field,
                        value=getattr(self, field),
                    )
                )
        if self.static_friction_n < self.coulomb_friction_n:
            raise ParameterError(
                say(
                    "static_below_coulomb",
                    "static_friction_n is {static:g N}, below the Coulomb friction of {coulomb:g N}: raise it to at "
                    "least that",
                    static=self.static_friction_n,
                    coulomb=self.coulomb_friction_n,
                )
            )

    def by_symbol(self) -> dict[str, float]:
        """Return the values under the paper's symbols (m, k, F_v, F_c, F_s, DV, F_0)."""
        return {symbol: getattr(self, entry.field) for symbol, entry in PARAMETER_SYMBOLS.items()}


def parameters_from_symbols(values: dict[str, float]) -> ValveParameters:
    """Make ValveParameters from values under the paper's symbols; F_0 may be left out.

    Raises ParameterError for a symbol that there is not, one that is missing, or an unphysical value.
    """
    unknown = sorted(set(values) - set(PARAMETER_SYMBOLS))
    if unknown:
        raise ParameterError(
            say(
                "parameter_unknown",
                "{parameter}: no such parameter; there are {known:, }",
                parameter=unknown[0],
                known=tuple(PARAMETER_SYMBOLS),
            )
        )
    missing = [symbol for symbol in PARAMETER_SYMBOLS if symbol not in values and symbol != "F_0"]
    if missing:
        raise ParameterError(
            say(
                "parameters_missing",
                "{missing:, }: missing; only F_0 may be left out: add them",
                missing=tuple(missing),
            )
        )
    return ValveParameters(**{PARAMETER_SYMBOLS[symbol].field: value for symbol, value in values.items()})


@dataclass(frozen=True, slots=True)
class TravelStops:
    """Rigid ends of the travel, m; either may be absent (infinite)."""

    low_m: float = -math.inf
    high_m: float = math.inf

    def __post_init__(self) -> None:
        if not self.low_m < self.high_m:
            raise ParameterError(
                say(
                    "travel_stops_crossed",
                    "travel stops are {low:g in m} and {high:g m}, the low one must lie below the high one",
                    low=self.low_m,
                    high=self.high_m,
                )
            )
