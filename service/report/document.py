"""A report as words, tables and pictures: the same for HTML and PDF."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any, Final

from service.figures.canvas import Picture, svg_text
from service.figures.friction import friction_picture
from service.figures.methods import all_estimates, methods_picture
from service.figures.misfit import coordinate_picture, time_picture
from service.figures.signature import Drawing, Layer, signature_drawing
from service.figures.trend import trends_picture
from service.report.source import ReportSource
from service.report.summary import summary_of
from service.shown.next_step import most_telling, next_step
from service.shown.results import (
    Cell,
    diagnosis_of,
    figure_rows,
    method_messages,
    method_names,
    missing_reasons,
    parameter_rows,
    told_once,
)
from service.shown.words import FIGURES
from service.words.sentences import all_in_units
from service.words.units import UnitSystem, measured, quantity

_NOT_GIVEN: Final = "not identifiable"
_LEAST_JITTER_S: Final = 1.0e-6
_GAIN_KEYS: Final = ("rmse_before_m", "rmse_after_m", "noise_floor_m")
_STEP_FIGURES: Final = (
    ("dead_time_s", "Dead time", "s"),
    ("t63_s", "T63", "s"),
    ("t86_s", "T86", "s"),
    ("overshoot_percent", "Overshoot", "percent"),
    ("steady_error_percent", "Error at the end of the hold", "percent"),
)


def _cell_words(cell: Cell, unit: str, system: UnitSystem) -> str:
    """A method's value of a parameter, with how much the quantity itself varies."""
    if cell.value is None:
        return _NOT_GIVEN
    value = measured(cell.value, cell.ci95, unit, system)
    return f"{value}, {cell.scatter}" if cell.scatter else value


def document_of(source: ReportSource) -> dict[str, Any]:
    """Return the report: every text as it is read, and the pictures as SVG that needs no font and no other file."""
    analysis, system = source.analysis, source.system
    diagnosis, fitted = diagnosis_of(analysis), dict(_fitted(analysis))
    baseline = None if source.baseline is None else {"signature": source.baseline}
    rows, figures_missing = told_once(figure_rows(analysis, baseline))
    document = {
        "tag": source.tag,
        "subject": source.subject,
        "summary": summary_of(source),
        "stands": source.stands,
        "alarm": source.alarm,
        "methods": [{"name": name, "status": status} for name, status in method_names(analysis)],
        "parameters": [
            {
                "symbol": row.symbol,
                "meaning": row.meaning,
                "cells": [_cell_words(cell, row.unit, system) for cell in row.cells],
            }
            for row in parameter_rows(analysis)
        ],
        "missing": [{"what": symbols, "why": reason} for symbols, reason in missing_reasons(analysis)],
        "messages": [{"what": name, "why": message} for name, message in method_messages(analysis)],
        "figures": [
            {
                "name": row.words,
                "value": measured(row.value, row.ci95, row.unit, system),
                "was": measured(row.was, None, row.unit, system),
                "note": row.note or fitted.get(row.words) or row.tells,
            }
            for row in rows
        ],
        "has_baseline": any(row.was is not None for row in rows),
        "figures_missing": [{"what": names, "why": reason} for names, reason in figures_missing],
        "steps": _steps(analysis, system),
        "diagnosis": {
            "headline": diagnosis.headline,
            "message": diagnosis.message,
            "causes": [
                {
                    "sentence": cause["sentence"],
                    "action": cause["action"],
                    "share": f"{100.0 * cause['share_of_misfit']:.0f} %" if cause.get("share_of_misfit") else "",
                }
                for cause in diagnosis.causes
            ],
            "others": list(diagnosis.others),
            "gain": _gain(diagnosis.gain if diagnosis.causes else None, system),
            "where": str(((analysis.get("discrepancy") or {}).get("misfit") or {}).get("where") or ""),
            "separating": _separating(diagnosis.separating_test),
            "next": next_step(analysis, source.sequence),
            "notes": [str(note) for note in analysis.get("notes") or ()],
        },
        "sampling": [{"name": name, "value": value} for name, value in _sampling(analysis, system)],
        "permissives": [permissive_row(one) for one in source.permissives],
        "comparison": list(source.comparison),
        "before": source.before,
        "before_after": [asdict(row) | {"verdict": row.verdict} for row in source.before_after],
    }
    pictures = {name: _drawn(picture) for name, picture in _pictures(source) if picture is not None}
    told = {
        key: [{"name": name, "value": value} for name, value in rows]
        for key, rows in (("facts", source.facts), ("valve", source.valve), ("head", source.head))
    }
    front = [name for name in _front(analysis, pictures) if name in pictures]
    return {**all_in_units(document, system), **told, "note": source.note, "pictures": pictures, "front": front}


def _fitted(analysis: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield the figures that no loop shows, with the method that they are of and how well that fits."""
    intervals = (analysis.get("signature") or {}).get("intervals") or {}
    for key, words, _unit, _tells in FIGURES:
        origin = str((intervals.get(key) or {}).get("from") or "")
        for one in analysis.get("estimates") or ():
            if origin == f"the parameters by {one['method'].replace('_', ' ')}":
                yield words, f"from {origin}, whose fit is {one['status']}"


def _drawn(picture: Picture | Drawing) -> dict[str, str]:
    if isinstance(picture, Drawing):
        return {"svg": picture.svg, "title": picture.title, "description": picture.description}
    return {"svg": svg_text(picture, text_as_paths=True), "title": picture.title, "description": picture.description}


def _pictures(source: ReportSource) -> Iterator[tuple[str, Picture | Drawing | None]]:
    system, analysis = source.system, source.analysis
    pictures = (analysis.get("discrepancy") or {}).get("pictures")
    latent = (analysis.get("discrepancy") or {}).get("latent_friction") or ()
    own = Layer(source.subject, analysis.get("signature") or {}, latent)
    yield "signature", signature_drawing([own, *source.behind], source.frame, system)
    yield "trend", trends_picture(source.trends, system, source.zone)
    yield "methods", methods_picture(all_estimates(analysis), system)
    yield "friction", friction_picture(latent, system)
    yield "time", time_picture(pictures, system)
    if diagnosis_of(analysis).verdict != "none":  # it would draw noise
        yield "coordinate", coordinate_picture(pictures, system)


def _front(analysis: Mapping[str, Any], drawn: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the pictures of page one: the signature; where there is none the trend, and the misfit where one is."""
    if "signature" in drawn:
        return ("signature",)
    if diagnosis_of(analysis).verdict in ("none", "not_assessed"):
        return ("trend",)
    misfit = "time" if most_telling(analysis) is None or "coordinate" not in drawn else "coordinate"
    return "trend", misfit if misfit in drawn else "friction"


def _gain(gain: Mapping[str, Any] | None, system: UnitSystem) -> str:
    if gain is None:
        return ""
    before, after, noise = (quantity(gain[key], "m", system, 3) for key in _GAIN_KEYS)
    return (
        f"Tried on {gain['held_out']}: the simulation misses the measured position by {before} rms without the cause "
        f"and by {after} rms with it; the noise is {noise} rms."
    )


def _separating(test: Any) -> str:
    if not isinstance(test, Mapping):
        return ""
    sentence = str(test.get("sentence") or "")
    return f"Run the sequence separating to tell them apart. {sentence}".strip()


def _steps(analysis: Mapping[str, Any], system: UnitSystem) -> list[dict[str, str]]:
    summary = ((analysis.get("signature") or {}).get("steps") or {}).get("summary") or {}
    rows = [
        {"name": words, "value": quantity(summary[key], unit, system)}
        for key, words, unit in _STEP_FIGURES
        if summary.get(key) is not None
    ]
    stroke = summary.get("stroke_time_s") or {}
    rows += [
        {"name": f"Stroke time, {way}", "value": measured(one["value"], one["ci95"], "s", system)}
        for way in ("opening", "closing")
        if (one := stroke.get(way))
    ]
    for key, words in (("resolution_percent", "Resolution"), ("dead_band_percent", "Dead band by steps")):
        found = summary.get(key) or {}
        if found.get("value") is not None:
            ends = found.get("ci95")
            between = "" if ends is None else f" (between {ends[0]:.3g} and {ends[1]:.3g} %)"
            rows.append({"name": words, "value": f"{found['value']:.3g} %{between}"})
    return rows


def _sampling(analysis: Mapping[str, Any], system: UnitSystem) -> Iterator[tuple[str, str]]:
    recording = analysis.get("recording") or {}
    sampling = recording.get("sampling") or {}
    if "samples" in recording:
        yield "Samples", f"{recording['samples']}, {recording.get('gaps', 0)} of them missing"
    if recording.get("duration_s") is not None:
        yield "Duration", f"{recording['duration_s']:.4g} s, {recording.get('acquisition', '')}"
    if sampling:
        yield "Rate achieved", f"{sampling['rate_hz']:.4g} Hz, {sampling['missed_slots']} slots missed"
        yield (
            "Jitter",
            f"{jitter_words(sampling['jitter_rms_s'])}, longest period {1e3 * sampling['largest_period_s']:.4g} ms",
        )
    if recording.get("channels"):
        yield "Channels", ", ".join(recording["channels"])
    if recording.get("position_noise_m") is not None:
        yield "Position noise", f"{quantity(recording['position_noise_m'], 'm', system, 3)} rms"
    for one in analysis.get("held_out") or ():
        for method, rmse_m in one["rmse_m"].items():
            if rmse_m is not None:
                yield f"Held out: {one['file']}, {method.replace('_', ' ')}", f"{quantity(rmse_m, 'm', system, 3)} rms"


def jitter_words(jitter_s: float) -> str:
    """Return how uneven a recording was sampled, s rms, in milliseconds."""
    return f"{1e3 * jitter_s:.3g} ms rms" if jitter_s >= _LEAST_JITTER_S else "below 0.001 ms rms"


def permissive_row(one: Mapping[str, Any]) -> dict[str, str]:
    """Return a permissive as it was read before the motion, in words."""
    met = {True: "met", False: "NOT met", None: "not known"}[one.get("met")]
    name = str(one.get("name", "")).replace("_", " ")
    return {"name": name, "met": met, "value": str(one.get("value", "")), "limit": str(one.get("limit", ""))}
