"""Units: SI inside; these are the only conversions."""

from __future__ import annotations

from typing import Final

PASCAL_PER_PSI: Final = 6894.757293168  # NIST SP 811, table B.8
PASCAL_PER_BAR: Final = 1.0e5
METRE_PER_INCH: Final = 0.0254

# The multiplier from each unit that a configuration may name to its SI unit.
SI_FACTORS: Final[dict[str, tuple[str, float]]] = {
    "m": ("m", 1.0),
    "mm": ("m", 1.0e-3),
    "um": ("m", 1.0e-6),
    "inch": ("m", METRE_PER_INCH),
    "Pa": ("Pa", 1.0),
    "kPa": ("Pa", 1.0e3),
    "bar": ("Pa", PASCAL_PER_BAR),
    "psi": ("Pa", PASCAL_PER_PSI),
    "mA": ("A", 1.0e-3),
    "A": ("A", 1.0),
    "V": ("V", 1.0),
    "N": ("N", 1.0),
    "s": ("s", 1.0),
    "percent": ("1", 0.01),
    "1": ("1", 1.0),
}


def linear(value: float, from_range: tuple[float, float], to_range: tuple[float, float]) -> float:
    """Map ``value`` from one range onto another, straight and without clamping."""
    from_low, from_high = from_range
    to_low, to_high = to_range
    return to_low + (value - from_low) * (to_high - to_low) / (from_high - from_low)
