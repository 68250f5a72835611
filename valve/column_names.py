"""What a column with an unknown name probably is, and how it becomes one that is read."""

from __future__ import annotations

from typing import Final

from valve.messages import say
from valve.units import PASCAL_PER_BAR, PASCAL_PER_PSI

# by the first word of a name the column that it becomes, and its usual other units with what a value is multiplied by
_QUANTITIES: Final[dict[str, tuple[str, dict[str, float]]]] = {
    "time": ("time_s", {"ms": 1.0e-3, "min": 60.0}),
    "t": ("time_s", {"ms": 1.0e-3, "min": 60.0}),
    "position": ("position_m", {"mm": 1.0e-3, "cm": 1.0e-2, "in": 0.0254, "um": 1.0e-6}),
    "travel": ("position_m", {"mm": 1.0e-3, "cm": 1.0e-2, "in": 0.0254, "um": 1.0e-6}),
    "pressure": ("pressure_pa", {"bar": PASCAL_PER_BAR, "psi": PASCAL_PER_PSI, "kpa": 1.0e3, "mbar": 100.0}),
    "command": ("command_pa", {"bar": PASCAL_PER_BAR, "psi": PASCAL_PER_PSI, "kpa": 1.0e3, "mbar": 100.0}),
    "force": ("force_n", {"kn": 1.0e3, "lbf": 4.4482216}),
}
_PERCENT: Final = ("percent", "pct", "%")
_ANGLE: Final = ("deg", "degree", "degrees", "rad")
_PERCENT_REMEDY: Final = {
    "position_m": say("write_position_from_percent", "write it as position_m, percent / 100 times the travel in m"),
    "command_pa": say(
        "write_current_from_percent",
        "write it as command_ma, 4 + 0.16 times percent, and give [signal] of the nameplate",
    ),
    "pressure_pa": say(
        "write_pressure_from_percent", "write it as pressure_pa, percent / 100 times the pressure's range in Pa"
    ),
}
_ANGLE_REMEDY: Final = say(
    "write_position_from_angle",
    "write it as position_m, the way of the actuator's stem or the angle in rad times the lever in m, "
    "and actuator.travel_m likewise",
)


def remedy(name: str) -> str:
    """Return what to do about a column of this name that is not read, as an imperative."""
    words = name.strip().lower().replace(" ", "_").replace("[", "_").replace("]", "").replace("(", "_").replace(")", "")
    parts = [part for part in words.split("_") if part]
    if len(parts) > 1 and parts[0] in _QUANTITIES:
        column, factors = _QUANTITIES[parts[0]]
        unit = parts[-1]
        if unit in _PERCENT and column in _PERCENT_REMEDY:
            return _PERCENT_REMEDY[column]
        if unit in _ANGLE and column == "position_m":
            return _ANGLE_REMEDY
        if unit in factors:
            return say(
                "multiply_and_rename",
                "multiply it by {factor:.9g} and call it {column}",
                factor=float(factors[unit]),
                column=column,
            )
    return say("rename_or_leave_out", "rename it or leave it out")
