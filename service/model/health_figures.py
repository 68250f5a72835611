"""The main figures of an analysis: what trends are drawn of and what health is judged by."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

from estimators.base import NORMAL_95
from valve.messages import say


@dataclass(frozen=True, slots=True)
class FigureKind:
    """A figure that is kept of each test: its key, what people call it, its SI unit."""

    key: str
    words: str
    unit: str


FIGURE_KINDS: Final = {
    kind.key: kind
    for kind in (
        FigureKind("friction_mean_n", say("friction_mean_n", "friction, mean"), "N"),
        FigureKind("friction_max_n", say("friction_max_n", "friction, highest"), "N"),
        FigureKind("friction_coulomb_n", say("friction_coulomb_n", "friction, Coulomb"), "N"),
        FigureKind("spring_rate_n_per_m", say("spring_rate_n_per_m", "spring rate"), "N/m"),
        FigureKind("bench_low_pa", say("bench_low_pa", "bench set, low end"), "Pa"),
        FigureKind("bench_high_pa", say("bench_high_pa", "bench set, high end"), "Pa"),
        FigureKind("travel_m", say("travel_m", "travel"), "m"),
        FigureKind("dead_band_percent", say("dead_band_percent", "dead band"), "percent"),
        FigureKind("response_t63_s", say("response_t63_s", "response, T63"), "s"),
        FigureKind("transducer_lag_s", say("transducer_lag_s", "lag of the I/P"), "s"),
    )
}
#: What lists and metrics show of a test.
MAIN_FIGURES: Final = ("friction_mean_n", "dead_band_percent", "travel_m")
_MEASURED: Final = "measured"  # how the signature says that a figure came from the loop itself
_PEAKS: Final = 10.0  # how far noise spreads two extremes of a long recording, in rms: 5 each
_GOOD: Final = "ok"
_BEST: Final = "maximum_likelihood"


@dataclass(frozen=True, slots=True)
class Figure:
    """A value, SI, with its 95 % interval where it is known."""

    value: float
    ci95: tuple[float, float] | None = None

    @property
    def half_width(self) -> float | None:
        """The wider half of the interval."""
        return None if self.ci95 is None else max(self.ci95[1] - self.value, self.value - self.ci95[0])


Figures = Mapping[str, Figure]


def figures_of(analysis: Mapping[str, Any]) -> dict[str, Figure]:
    """Return the figures that the analysis can stand for, by key.

    A figure that was taken from a fit which did not succeed is left out; where a cause was named, what the fit with
    that cause says takes its place: the plain fits are then wrong by what the cause does. The interval of a friction
    holds what friction varies by in the test: it does so from one test to the next as well.
    """
    model = (analysis.get("discrepancy") or {}).get("extended_model")
    area_m2 = _area(analysis)
    found = dict(_of_signature(analysis))
    parameters = None if model is None else model["parameters"]
    if parameters is None:
        parameters = next(
            (one["parameters"] for one in analysis.get("estimates") or () if _is_good(one) and one["method"] == _BEST),
            None,
        )
    if parameters is not None:
        found.update(_filled(found, "friction_coulomb_n", parameters.get("F_c")))
        found.update(_filled(found, "spring_rate_n_per_m", parameters.get("k")))
        if area_m2 is not None:
            found.update(_filled(found, "bench_low_pa", parameters.get("F_0"), 1.0 / area_m2))
    found = {key: _varying(figure, key, analysis) for key, figure in found.items()}
    found.update(_filled(found, "transducer_lag_s", _transducer_lag(analysis)))
    return found


def widened(figures: Figures, scatter: Mapping[str, float]) -> dict[str, Figure]:
    """Return the figures with what each differs by from one test to the next in its interval.

    ``scatter`` is a standard deviation in the figure's unit. Of it and the interval of the test the wider one holds.
    """
    return {key: _no_narrower(figure, NORMAL_95 * scatter.get(key, 0.0)) for key, figure in figures.items()}


def _no_narrower(figure: Figure, half: float) -> Figure:
    if figure.ci95 is None:
        return figure
    low, high = figure.ci95
    return Figure(figure.value, (min(low, figure.value - half), max(high, figure.value + half)))


def _transducer_lag(analysis: Mapping[str, Any]) -> Mapping[str, Any] | None:
    found = analysis.get("discrepancy") or {}
    told = [*(found.get("causes") or ()), *(found.get("remarks") or ())]
    lags = (one.get("parameters") or {} for one in told if one["cause"] == "transducer_lag")
    return next((one["lag_s"] for one in lags if "lag_s" in one), None)


def _varying(figure: Figure, key: str, analysis: Mapping[str, Any]) -> Figure:
    """Return a friction with the scatter of F_c, by the best method that has one, in its interval."""
    if not key.startswith("friction") or figure.ci95 is None:
        return figure
    scatters = [
        one["parameters"]["F_c"].get("scatter")
        for one in sorted(analysis.get("estimates") or (), key=lambda one: bool(one["method"] != _BEST))
        if (one.get("parameters") or {}).get("F_c") is not None
    ]
    scatter_n = next((float(one) for one in scatters if one is not None), 0.0)
    low, high = figure.ci95
    below, above = (math.hypot(half, NORMAL_95 * scatter_n) for half in (figure.value - low, high - figure.value))
    return Figure(figure.value, (figure.value - below, figure.value + above))


def _is_good(estimate: Mapping[str, Any]) -> bool:
    return bool(estimate.get("status") == _GOOD)


def _of_signature(analysis: Mapping[str, Any]) -> Iterator[tuple[str, Figure]]:
    signature = analysis.get("signature") or {}
    intervals = signature.get("intervals") or {}
    good = [str(one["method"]) for one in analysis.get("estimates") or () if _is_good(one)]

    def is_sound(key: str) -> bool:
        source = str((intervals.get(key) or {}).get("from") or _MEASURED)
        return source.startswith(_MEASURED) or any(source.replace(" ", "_").endswith(method) for method in good)

    for key in ("friction_mean_n", "friction_max_n", "spring_rate_n_per_m", "dead_band_percent"):
        figure = _figure(signature.get(key), (intervals.get(key) or {}).get("ci95"))
        if figure is not None and is_sound(key):
            yield key, figure
    bench = signature.get("bench_set_pa")
    if bench and is_sound("bench_set_pa"):
        ends = (intervals.get("bench_set_pa") or {}).get("ci95") or (None, None)
        for key, value, ci95 in zip(("bench_low_pa", "bench_high_pa"), bench, ends, strict=True):
            figure = _figure(value, ci95)
            if figure is not None:
                yield key, figure
    recording = analysis.get("recording") or {}
    reached = recording.get("stroke_m")
    if reached:
        travel_m, noise_m = float(reached[1] - reached[0]), recording.get("position_noise_m")
        reach_m = None if noise_m is None else _PEAKS * noise_m
        yield "travel_m", Figure(travel_m, None if reach_m is None else (travel_m - reach_m, travel_m + reach_m))
    t63 = _figure(((signature.get("steps") or {}).get("summary") or {}).get("t63_s"), None)
    if t63 is not None:
        yield "response_t63_s", t63


def _filled(found: Figures, key: str, entry: Mapping[str, Any] | None, scale: float = 1.0) -> dict[str, Figure]:
    """Return the figure of a fitted parameter, unless the loop itself gave it."""
    if key in found or entry is None:
        return {}
    figure = _figure(entry.get("value"), entry.get("ci95"), scale)
    return {} if figure is None else {key: figure}


def _figure(value: Any, ci95: Any, scale: float = 1.0) -> Figure | None:
    if value is None:
        return None
    ends = None if ci95 is None or None in ci95 else (scale * float(ci95[0]), scale * float(ci95[1]))
    return Figure(scale * float(value), ends)


def _area(analysis: Mapping[str, Any]) -> float | None:
    """Diaphragm area, m2, as the span of the signature has it; None without one."""
    span = (analysis.get("signature") or {}).get("span") or {}
    force_n, pressure_pa = span.get("force_n"), span.get("pressure_pa")
    if not force_n or not pressure_pa:
        return None
    return float(force_n) / float(pressure_pa[1] - pressure_pa[0])
