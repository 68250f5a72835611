"""What a simulated valve is: the truth, its sensors and its transducer, before it begins to move."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from simulator.faults import Fault
from simulator.packed_stem import PackedStem
from simulator.sensor import Sensor
from simulator.stem import FollowedStem, PlainStem, StemWithEffects
from simulator.transducer import Transducer
from valve.effects import Effect, with_effects
from valve.errors import ParameterError
from valve.extended_valve import ExtendedValve, StopSlots
from valve.messages import say
from valve.nameplate import Nameplate
from valve.packing import Packing, drawn_roughness
from valve.parameters import TravelStops, ValveParameters

_OCCASION: Final = 1_000_003  # between the seeds of one occasion and the next


@dataclass(frozen=True, slots=True)
class SimulatedValve:
    """One valve of a simulated plant: the truth, and what stands between it and the wire.

    ``effects`` are what the valve has beside its parameters, hidden from whoever tests it; those of the transducer
    come on top of its own. ``packing`` says how its friction varies: along the travel by ``packing_seed``, in time and
    between breakaways by that and the ``occasion``. Pressure is None where there is no such sensor.
    Raises ParameterError without a diaphragm area and for effects that cannot be together.
    """

    tag: str
    parameters: ValveParameters
    nameplate: Nameplate
    transducer: Transducer
    position: Sensor
    pressure: Sensor | None = None
    stops: TravelStops = field(default_factory=TravelStops)
    start_pa: float | None = None  # pressure asked for at the start; the low end of the range by default
    faults: tuple[Fault, ...] = ()
    effects: tuple[Effect, ...] = ()
    packing: Packing = field(default_factory=Packing)
    packing_seed: int = 0
    occasion: int = 0
    extended: ExtendedValve = field(init=False, repr=False, compare=False)
    acting: Transducer = field(init=False, repr=False, compare=False)  # the transducer with those effects that are its

    def __post_init__(self) -> None:
        if self.nameplate.actuator.diaphragm_area_m2 is None:
            raise ParameterError(
                say(
                    "simulated_area_missing",
                    "{tag}: actuator.diaphragm_area_m2 is missing, a simulated valve needs it",
                    tag=self.tag,
                )
            )
        stops = StopSlots(self.stops.low_m, self.stops.high_m)
        extended = with_effects(ExtendedValve(self.parameters, stops=stops), self.effects)
        object.__setattr__(self, "extended", extended)
        object.__setattr__(self, "acting", self.transducer.with_path(extended.input, self.area_m2))

    @property
    def area_m2(self) -> float:
        """Diaphragm area, m2."""
        area_m2 = self.nameplate.actuator.diaphragm_area_m2
        assert area_m2 is not None  # checked when it was made
        return area_m2

    @property
    def is_packed(self) -> bool:
        """Whether its stem is followed by fixed steps: its friction varies, or its position sensor has a filter."""
        return not self.packing.is_ideal or self.position.filter_s > 0.0

    def rest_position_m(self, pressure_pa: float) -> float:
        """Where the stem rests with no friction at this pressure, m; 0 or the nearest stop without a spring."""
        force_n = self.area_m2 * pressure_pa - self.parameters.preload_n
        rate_n_per_m = self.parameters.spring_rate_n_per_m
        free_m = force_n / rate_n_per_m if rate_n_per_m > 0.0 else 0.0
        return min(max(free_m, self.extended.stops.low_m), self.extended.stops.high_m)

    def stem_at(self, position_m: float) -> FollowedStem:
        """Return its stem at rest there.

        Followed by fixed steps where it is packed, exactly where not.
        """
        if self.is_packed:
            coulomb_n, travel_m = self.parameters.coulomb_friction_n, self.nameplate.actuator.travel_m
            return PackedStem(
                self.extended,
                self.packing,
                drawn_roughness(self.packing, coulomb_n, travel_m, self.packing_seed),
                position_m,
                seed=self.packing_seed + _OCCASION * self.occasion,
                filter_s=self.position.filter_s,
            )
        if self.effects:
            return StemWithEffects(self.extended, position_m)
        return PlainStem(self.parameters, self.stops, position_m)
