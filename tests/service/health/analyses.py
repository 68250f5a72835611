"""Analysis objects with the figures that health is judged by."""

from __future__ import annotations

from typing import Any

from service.health.changes import ValveFacts
from service.model.health_limits import HealthLimits

FACTS = ValveFacts(rated_travel_m=0.1016, span_pa=82737.0, available_pa=82737.0)
LIMITS = HealthLimits()
SPOT = {
    "cause": "local_friction",
    "sentence": "Friction is 260 N higher between 45.7 and 52.7 % travel: a tight spot.",
    "action": "Look at stem and packing there.",
    "parameters": {},
    "share_of_misfit": 1.0,
}


def analysis(
    *,
    friction_n: float | None = 500.0,
    half_n: float = 1.0,
    spring_n_per_m: float = 52500.0,
    bench_pa: tuple[float, float] = (0.0, 82700.0),
    travel_m: float = 0.09,
    stroke_m: tuple[float, float] | None = None,
    signal_percent: tuple[float, float] | None = None,
    stops_m: tuple[float | None, float | None] | None = None,
    dead_band_percent: float = 20.0,
    **others: Any,
) -> dict[str, Any]:
    """Return an analysis of a test that was measured well; ``others`` stand for its further keys.

    Without ``signal_percent`` nothing is known of how far the signal went: no end of the travel is judged.
    """
    ends = None if friction_n is None else [friction_n - half_n, friction_n + half_n]
    measured = "measured on the recording"
    signature = {
        "friction_mean_n": friction_n,
        "spring_rate_n_per_m": spring_n_per_m,
        "bench_set_pa": list(bench_pa),
        "dead_band_percent": dead_band_percent,
        "span": {"force_n": 0.06452 * 82737.0, "pressure_pa": [0.0, 82737.0]},
        "intervals": {
            "friction_mean_n": {"ci95": ends, "from": measured},
            "spring_rate_n_per_m": {"ci95": [spring_n_per_m - 50.0, spring_n_per_m + 50.0], "from": measured},
            "bench_set_pa": {"ci95": [[one - 20.0, one + 20.0] for one in bench_pa], "from": measured},
            "dead_band_percent": {"ci95": [dead_band_percent - 0.1, dead_band_percent + 0.1], "from": measured},
        },
        "input_percent": None if signal_percent is None else list(signal_percent),
        "stops_m": None if stops_m is None else list(stops_m),
        "notes": {} if friction_n is not None else {"friction_mean_n": "the stem moved one way only"},
        "steps": None,
    }
    return {
        "schema": "breakaway/analysis/1",
        "recording": {"stroke_m": list(stroke_m or (0.0, travel_m)), "position_noise_m": 1.0e-5},
        "estimates": [],
        "discrepancy": {"verdict": "none", "causes": []},
        "signature": signature,
        "health": {"ne107": None, "reasons": []},
    } | others


def named(**figures: Any) -> dict[str, Any]:
    """Return an analysis in which a tight spot was found."""
    return analysis(discrepancy={"verdict": "named", "causes": [SPOT]}, **figures)
