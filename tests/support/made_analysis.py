"""Made-up analysis objects for pages: what stands in them is for reading, not for judging."""

from __future__ import annotations

from typing import Any

import numpy as np

from valve.messages import say
from valve.parameters import PARAMETER_SYMBOLS

FRICTION_N = 612.0
MISSING = "on ramps of one speed DV cannot be told from F_s"
ACTION = "Look at stem and packing there: a bent stem, galling, a deposit."
_VALUES = {"k": 52_500.0, "F_v": 612.0, "F_c": 590.0, "F_s": 1_400.0, "F_0": 12.5}


def made_analysis(friction_n: float = FRICTION_N, *, ne107: str | None = None) -> dict[str, Any]:
    """Return an analysis with every part that a page shows."""
    return {
        "schema": "breakaway/analysis/1",
        "recording": {
            "samples": 6001,
            "duration_s": 60.0,
            "sample_period_s": 0.01,
            "gaps": 3,
            "position_noise_m": 2.0e-5,
            "acquisition": "polled",
            "channels": ["command_pa", "pressure_pa", "position_m"],
            "sampling": {
                "rate_hz": 100.0,
                "jitter_rms_s": 1.0e-4,
                "largest_period_s": 0.011,
                "missed_slots": 1,
                "exchange_s": 1.0e-3,
            },
        },
        "estimates": [_estimate(method) for method in ("regression", "garcia", "maximum_likelihood")],
        "discrepancy": _discrepancy(),
        "signature": _signature(friction_n),
        "health": _health(friction_n, ne107),
    }


def _estimate(method: str) -> dict[str, Any]:
    parameters = {}
    for symbol, entry in PARAMETER_SYMBOLS.items():
        value = _VALUES.get(symbol)
        parameters[symbol] = {
            "value": value,
            "unit": entry.unit,
            "std_error": None if value is None else 0.005 * value,
            "ci95": None if value is None else [0.99 * value, 1.01 * value],
            "identifiable": value is not None,
            "note": "" if value is not None else MISSING,
        }
    status = "poor" if method == "garcia" else "ok"
    message = "The second cycle is short." if method == "garcia" else ""
    return {
        "method": method,
        "status": status,
        "message": message,
        "residual_rms_m": 2.0e-5,
        "parameters": parameters,
    }


def _discrepancy() -> dict[str, Any]:
    time_s = np.linspace(0.0, 60.0, 500)
    measured_m = 0.05 * (1.0 + np.sin(0.2 * time_s))
    travel_m = np.linspace(0.0, 0.1, 40)
    part_n = 80.0 * np.exp(-(((travel_m - 0.044) / 0.002) ** 2))
    return {
        "verdict": "named",
        "message": "",
        "causes": [
            {
                "cause": "local_friction",
                "sentence": say(
                    "tight_spot",
                    "Friction is {rise:g N} higher between {low:g} and {high:g} % travel, both ways: a tight spot.",
                    rise=80.0,
                    low=42,
                    high=46,
                ),
                "action": ACTION,
                "parameters": {"rise_n": {"value": 80.0, "ci95": [78.0, 82.0], "unit": "N"}},
                "share_of_misfit": 0.93,
            }
        ],
        "not_told_apart_from": [],
        "separating_test": None,
        "extended_model": {
            "schema": "breakaway/valve-model/2",
            "parameters": {"k": {"value": 52_480.0, "ci95": [52_470.0, 52_490.0], "unit": "N/m"}},
            "causes": {"local_friction": {"rise_n": {"value": 80.0, "ci95": [78.0, 82.0], "unit": "N"}}},
        },
        "gain": {"held_out": "the end", "rmse_before_m": 1e-3, "rmse_after_m": 3e-5, "noise_floor_m": 2e-5},
        "pictures": {
            "time": {
                "time_s": time_s.tolist(),
                "measured_m": measured_m.tolist(),
                "before_m": (measured_m + 1e-3 * np.sin(3.0 * time_s)).tolist(),
                "after_m": (measured_m + 2e-5 * np.sin(50.0 * time_s)).tolist(),
            },
            "coordinates": [
                {
                    "coordinate": "travel",
                    "unit": "m",
                    "direction": way,
                    "x": travel_m.tolist(),
                    "misfit_n": (sign * part_n + 3.0 * np.cos(500.0 * travel_m)).tolist(),
                    "part_n": (sign * part_n).tolist(),
                }
                for way, sign in (("opening", 1.0), ("closing", -1.0))
            ],
            "explained": {"travel": 0.9},
        },
    }


def _signature(friction_n: float) -> dict[str, Any]:
    travel_m = np.linspace(0.0, 0.1, 100)
    middle_pa = (52_500.0 * travel_m + 800.0) / 0.06452
    half_pa = friction_n / 0.06452
    return {
        "friction_mean_n": friction_n,
        "friction_max_n": friction_n + 80.0,
        "friction_min_n": None,
        "spring_rate_n_per_m": 52_500.0,
        "dead_band_percent": 22.4,
        "bench_set_pa": [12_400.0, 95_000.0],
        "intervals": {"friction_mean_n": {"std_error": 1.0, "ci95": [friction_n - 2.0, friction_n + 2.0]}},
        "notes": {"friction_min_n": "no variation over the travel beyond the noise"},
        "central_stroke_m": [0.01, 0.09],
        "curve": {
            "up": {"travel_m": travel_m.tolist(), "pressure_pa": (middle_pa + half_pa).tolist()},
            "down": {"travel_m": travel_m.tolist(), "pressure_pa": (middle_pa - half_pa).tolist()},
        },
        "steps": None,
    }


def _health(friction_n: float, ne107: str | None) -> dict[str, Any]:
    rise = friction_n / FRICTION_N - 1.0
    change = {"name": "friction_mean_n", "was": FRICTION_N, "now": friction_n, "change": rise}
    reasons = [f"Friction rose by {100.0 * rise:.0f} % since the baseline (limit 20 %): look at the packing."]
    return {
        "ne107": ne107,
        "reasons": reasons if ne107 not in (None, "N") else [],
        "acceptance": {"passed": True, "checks": []},  # the first one is the baseline of the others
        "changes": [{**change, "ci95": [rise - 0.01, rise + 0.01], "limit": 0.2, "kept": abs(rise) < 0.2}],
    }
