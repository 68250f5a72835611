"""How good a valve's instruments are, by the same words as its packing: sensors' and the I/P's sizes.

Sizes are shares of the span that is measured, so that they suit a small valve and a large one.
"""

from __future__ import annotations

from typing import Any, Final

from valve.errors import NotFoundError
from valve.messages import say

# Shares of the span, but for what ends in _s, _hz or bits.
_POSITION: Final[dict[str, dict[str, float]]] = {
    "ideal": {},
    "mild": {"noise": 5.0e-5, "coloured": 1.0e-5, "coloured_s": 0.01, "filter_s": 0.002, "adc_bits": 14},
    "usual": {
        "noise": 1.0e-4, "coloured": 3.0e-5, "coloured_s": 0.02, "hum": 2.0e-5, "filter_s": 0.005, "adc_bits": 14,
    },
    "hard": {
        "noise": 2.0e-4, "coloured": 1.0e-4, "coloured_s": 0.05, "hum": 1.0e-4, "filter_s": 0.02, "adc_bits": 12,
    },
}  # fmt: skip
_PRESSURE: Final[dict[str, dict[str, float]]] = {
    "ideal": {},
    "mild": {"noise": 5.0e-5, "coloured": 5.0e-4, "coloured_s": 0.003, "filter_s": 0.003, "adc_bits": 14},
    "usual": {"noise": 1.0e-4, "coloured": 1.0e-3, "coloured_s": 0.008, "filter_s": 0.008, "adc_bits": 14},
    "hard": {"noise": 2.0e-4, "coloured": 3.0e-3, "coloured_s": 0.02, "filter_s": 0.02, "adc_bits": 12},
}
_HUNTING: Final = {"ideal": 0.0, "mild": 0.0, "usual": 1.0e-3, "hard": 3.0e-3}
GRADES: Final = tuple(_POSITION)


def _settings(sizes: dict[str, float], size: float) -> dict[str, Any]:
    shares = {"noise": "noise_rms", "coloured": "coloured_rms", "hum": "hum_rms"}
    settings: dict[str, Any] = {name: value for name, value in sizes.items() if name not in shares}
    settings |= {shares[name]: value * size for name, value in sizes.items() if name in shares}
    if "adc_bits" in settings:
        settings["adc_bits"] = int(settings["adc_bits"])
    return settings


def _known(name: str) -> str:
    if name not in GRADES:
        raise NotFoundError(
            say(
                "grade_unknown",
                "grade {grade} is unknown: choose one of {grades:, }",
                grade=repr(name),
                grades=tuple(GRADES),
            )
        )
    return name


def position_settings(name: str, travel_m: float) -> dict[str, Any]:
    """Settings of a position sensor of this grade, as ``Sensor`` takes them. Raises NotFoundError for another name."""
    return _settings(_POSITION[_known(name)], travel_m)


def pressure_settings(name: str, span_pa: float) -> dict[str, Any]:
    """Settings of a pressure gauge of this grade. Raises NotFoundError for another name."""
    return _settings(_PRESSURE[_known(name)], span_pa)


def hunting_swing_pa(name: str, span_pa: float) -> float:
    """By how much an I/P of this grade hunts, Pa. Raises NotFoundError for another name."""
    return _HUNTING[_known(name)] * span_pa
