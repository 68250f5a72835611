"""The input's span: what 100 % is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from estimators.signature.scatter import Measured
from valve.messages import say
from valve.nameplate import Nameplate

_BY_SPRING: Final = say("span_by_spring", "the measured spring rate times rated travel")


@dataclass(frozen=True, slots=True)
class Span:
    """What 100 % of the input is: as force, N, and as pressure, Pa, with where it is from."""

    force_n: float
    low_pa: float | None
    high_pa: float | None
    source: str

    def to_json(self) -> dict[str, Any]:
        """Return the span as in the analysis object."""
        pressures = None if self.low_pa is None else [self.low_pa, self.high_pa]
        return {"force_n": self.force_n, "pressure_pa": pressures, "from": self.source}


def span_of(nameplate: Nameplate, spring: Measured | None) -> Span | None:
    """The input's span: the signal's range, else the bench set, else the measured spring over the rated travel."""
    area_m2 = nameplate.actuator.diaphragm_area_m2
    named = (
        (None if nameplate.signal is None else nameplate.signal.range_pa, "signal.range_pa"),
        (nameplate.actuator.bench_set_pa, "actuator.bench_set_pa"),
    )
    for range_pa, source in named:
        if range_pa is not None and area_m2 is not None:
            return Span(
                area_m2 * (range_pa[1] - range_pa[0]),
                range_pa[0],
                range_pa[1],
                say("span_of_nameplate", "the nameplate's {entry}", entry=source),
            )
    if spring is None or spring.value <= 0.0:
        return None
    return Span(spring.value * nameplate.actuator.travel_m, None, None, _BY_SPRING)
