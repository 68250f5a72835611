"""``[valves.simulation.packing]`` and the tables of its instruments: how real a simulated valve is."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final, Literal

from pydantic import BaseModel, ConfigDict

from simulator.grades import hunting_swing_pa, position_settings, pressure_settings
from simulator.sensor import Sensor
from simulator.transducer import Hunting
from valve.packing import Packing, packing_preset

Grade = Literal["ideal", "mild", "usual", "hard"]
Span = tuple[float, float]
# From a table's key to the sensor's field; the others are called alike.
_FIELDS: Final = {
    "noise_m": "noise_rms",
    "noise_pa": "noise_rms",
    "coloured_noise_m": "coloured_rms",
    "coloured_noise_pa": "coloured_rms",
    "coloured_time_s": "coloured_s",
    "hum_m": "hum_rms",
    "hum_pa": "hum_rms",
}


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)
    preset: Grade | None = None

    def given(self) -> dict[str, Any]:
        """What stands in the file beside the preset."""
        return {name: value for name, value in self.model_dump().items() if value is not None and name != "preset"}


class PackingSection(_Section):
    """``[valves.simulation.packing]``: a preset, and single values in its place. Its preset is the instruments' too."""

    breakaway_scatter: float | None = None
    roughness: float | None = None
    roughness_length: float | None = None
    roughness_common: float | None = None
    roughness_law: Literal["matern", "smooth", "rough"] | None = None
    wander: float | None = None
    wander_time_s: float | None = None
    first_rise: float | None = None
    first_rise_time_s: float | None = None


class _SensorSection(_Section):
    filter_s: float | None = None
    adc_bits: int | None = None
    coloured_time_s: float | None = None
    hum_hz: float | None = None
    delay_s: float | None = None
    rate_ppm: float | None = None
    refresh_s: float | None = None
    dropouts_per_s: float | None = None
    dropout_s: float | None = None
    dropout_to: Literal["zero", "low", "gap"] | None = None


class PositionSection(_SensorSection):
    """``[valves.simulation.position_sensor]``."""

    noise_m: float | None = None
    coloured_noise_m: float | None = None
    hum_m: float | None = None


class PressureSection(_SensorSection):
    """``[valves.simulation.pressure_sensor]``."""

    noise_pa: float | None = None
    coloured_noise_pa: float | None = None
    hum_pa: float | None = None


class HuntingSection(_Section):
    """``[valves.simulation.hunting]``: the I/P's swing from end to end, and its period."""

    swing_pa: float | None = None
    period_s: float | None = None


# The tables of a simulation by their keys.
INSTRUMENTS: Final[dict[str, type[BaseModel]]] = {
    "packing": PackingSection,
    "position_sensor": PositionSection,
    "pressure_sensor": PressureSection,
    "hunting": HuntingSection,
}


def packing_from(section: PackingSection | None) -> Packing:
    """Return the packing of a file. Raises ParameterError for a size that is not physical."""
    if section is None:
        return Packing()
    return replace(packing_preset(section.preset or "ideal"), **section.given())


def position_from(
    section: PositionSection | None, packing: PackingSection | None, *, span_m: Span, travel_m: float, **general: Any
) -> Sensor:
    """Return the position sensor of a file over ``span_m``.

    What its table says counts before ``general`` (the simulation's own keys where they are not None), this before the
    preset. Raises ParameterError for a size that is not physical.
    """
    return _sensor(span_m, position_settings(_grade(section, packing), travel_m), section, general)


def pressure_from(
    section: PressureSection | None, packing: PackingSection | None, *, span_pa: Span, range_pa: Span, **general: Any
) -> Sensor:
    """Return the pressure gauge of a file over ``span_pa``; the rest as ``position_from``."""
    preset = pressure_settings(_grade(section, packing), range_pa[1] - range_pa[0])
    return _sensor(span_pa, preset, section, general)


def _sensor(span: Span, preset: dict[str, Any], section: _Section | None, general: dict[str, Any]) -> Sensor:
    kept = {name: value for name, value in general.items() if value is not None}
    own = {} if section is None else {_FIELDS.get(name, name): value for name, value in section.given().items()}
    return Sensor(span, **{**preset, **kept, **own})


def _grade(section: _Section | None, packing: PackingSection | None) -> str:
    if section is not None and section.preset is not None:
        return section.preset
    return "ideal" if packing is None or packing.preset is None else packing.preset


def hunting_from(section: HuntingSection | None, packing: PackingSection | None, range_pa: Span, seed: int) -> Hunting:
    """Return how the I/P of a file hunts. Raises ParameterError for a size that is not physical."""
    swing_pa = hunting_swing_pa(_grade(section, packing), range_pa[1] - range_pa[0])
    given = {} if section is None else section.given()
    return Hunting(**{"swing_pa": swing_pa, **given, "seed": seed})
