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
    rate_words,
    told_once,
)
from service.shown.words import FIGURES, POSITION_NOISE, SAMPLES
from service.words.names import named
from service.words.reader import Reader
from service.words.sentences import together
from valve.messages import Message, say

_BY_METHOD: Final = "the parameters by "  # of a text that is no message
_NOT_GIVEN: Final = say("not_identifiable", "not identifiable")
_MET: Final = {
    True: say("permissive_met", "met"),
    False: say("permissive_not_met", "NOT met"),
    None: say("permissive_not_known", "not known"),
}
_STROKE_TIMES: Final = {
    "opening": say("stroke_time_opening", "Stroke time, opening"),
    "closing": say("stroke_time_closing", "Stroke time, closing"),
}
#: Where whoever tested the valve signs.
SIGN: Final = (say("sign_date", "Date"), say("sign_name", "Name"), say("sign_signature", "Signature"))
RATE: Final = say("sampling_rate", "Rate achieved")
JITTER: Final = say("sampling_jitter", "Jitter")
_STEP_BANDS: Final = (
    ("resolution_percent", say("step_resolution", "Resolution")),
    ("dead_band_percent", say("step_dead_band", "Dead band by steps")),
)
_LEAST_JITTER_S: Final = 1.0e-6
_GAIN_KEYS: Final = ("rmse_before_m", "rmse_after_m", "noise_floor_m")
_STEP_FIGURES: Final = (
    ("dead_time_s", say("step_dead_time", "Dead time"), "s"),
    ("t63_s", say("step_t63", "T63"), "s"),
    ("t86_s", say("step_t86", "T86"), "s"),
    ("overshoot_percent", say("step_overshoot", "Overshoot"), "percent"),
    ("steady_error_percent", say("step_error", "Error at the end of the hold"), "percent"),
)


def _cell_words(cell: Cell, unit: str, reader: Reader) -> str:
    """A method's value of a parameter, with how much the quantity itself varies."""
    if cell.value is None:
        return _NOT_GIVEN
    value = reader.measured(cell.value, cell.ci95, unit)
    return together([value, cell.scatter], ", ")


def document_of(source: ReportSource) -> dict[str, Any]:
    """Return the report: every text as it is read, and the pictures as SVG that needs no font and no other file."""
    analysis, reader = source.analysis, source.reader
    diagnosis, fitted = diagnosis_of(analysis), dict(_fitted(analysis))
    baseline = None if source.baseline is None else {"signature": source.baseline}
    rows, figures_missing = told_once(figure_rows(analysis, baseline))
    document = {
        "tag": source.tag,
        "subject": source.subject,
        "summary": summary_of(source),
        "stands": source.stands,
        "alarm": source.alarm,
        "methods": [{"name": name, "status": named(status)} for name, status in method_names(analysis)],
        "parameters": [
            {
                "symbol": row.symbol,
                "meaning": row.meaning,
                "cells": [
                    {"words": _cell_words(cell, row.unit, reader), "is_known": cell.value is not None}
                    for cell in row.cells
                ],
            }
            for row in parameter_rows(analysis)
        ],
        "missing": [{"what": symbols, "why": reason} for symbols, reason in missing_reasons(analysis)],
        "messages": [{"what": name, "why": message} for name, message in method_messages(analysis)],
        "figures": [
            {
                "name": row.words,
                "value": reader.measured(row.value, row.ci95, row.unit),
                "was": reader.measured(row.was, None, row.unit),
                "note": row.note or fitted.get(row.words) or row.tells,
            }
            for row in rows
        ],
        "has_baseline": any(row.was is not None for row in rows),
        "figures_missing": [{"what": names, "why": reason} for names, reason in figures_missing],
        "steps": _steps(analysis, reader),
        "diagnosis": {
            "headline": diagnosis.headline,
            "message": diagnosis.message,
            "causes": [
                {
                    "sentence": cause["sentence"],
                    "action": cause["action"],
                    "share": _share(cause.get("share_of_misfit")),
                }
                for cause in diagnosis.causes
            ],
            "others": list(diagnosis.others),
            "gain": _gain(diagnosis.gain if diagnosis.causes else None, reader),
            "where": ((analysis.get("discrepancy") or {}).get("misfit") or {}).get("where") or "",
            "separating": _separating(diagnosis.separating_test),
            "next": next_step(analysis, source.sequence),
            "notes": list(analysis.get("notes") or ()),
        },
        "sampling": [{"name": name, "value": value} for name, value in _sampling(analysis, reader)],
        "permissives": [permissive_row(one) for one in source.permissives],
        "comparison": list(source.comparison),
        "before": source.before,
        "sign": SIGN,
        "before_after": [asdict(row) | {"verdict": row.verdict} for row in source.before_after],
    }
    pictures = {name: _drawn(picture) for name, picture in _pictures(source) if picture is not None}
    told = {
        key: [{"name": reader.shown(name), "value": reader.shown(value)} for name, value in rows]
        for key, rows in (("facts", source.facts), ("valve", source.valve), ("head", source.head))
    }
    front = [name for name in _front(analysis, pictures) if name in pictures]
    return {
        **reader.all_told(document),
        **told,
        "note": source.note,
        "pictures": pictures,
        "front": front,
    }


def _fitted(analysis: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield the figures that no loop shows, with the method that they are of and how well that fits."""
    intervals = (analysis.get("signature") or {}).get("intervals") or {}
    for key, words, _unit, _tells in FIGURES:
        origin: str = (intervals.get(key) or {}).get("from") or ""
        for one in analysis.get("estimates") or ():
            if _method_of(origin) == one["method"].replace("_", " "):
                yield (
                    words,
                    say("from_fit", "from {origin}, whose fit is {status}", origin=origin, status=named(one["status"])),
                )


def _method_of(origin: str) -> str:
    """Return the method whose parameters a figure is from; "" of any other."""
    if isinstance(origin, Message):
        return str(origin.values["method"]) if origin.code == "parameters_by" else ""
    return origin.removeprefix(_BY_METHOD) if origin.startswith(_BY_METHOD) else ""


def _drawn(picture: Picture | Drawing) -> dict[str, str]:
    if isinstance(picture, Drawing):
        return {"svg": picture.svg, "title": picture.title, "description": picture.description}
    return {"svg": svg_text(picture, text_as_paths=True), "title": picture.title, "description": picture.description}


def _pictures(source: ReportSource) -> Iterator[tuple[str, Picture | Drawing | None]]:
    reader, analysis = source.reader, source.analysis
    pictures = (analysis.get("discrepancy") or {}).get("pictures")
    latent = (analysis.get("discrepancy") or {}).get("latent_friction") or ()
    own = Layer(source.subject, analysis.get("signature") or {}, latent)
    yield "signature", signature_drawing([own, *source.behind], source.frame, reader)
    yield "trend", trends_picture(source.trends, reader)
    yield "methods", methods_picture(all_estimates(analysis), reader)
    yield "friction", friction_picture(latent, reader)
    yield "time", time_picture(pictures, reader)
    if diagnosis_of(analysis).verdict != "none":  # it would draw noise
        yield "coordinate", coordinate_picture(pictures, reader)


def _front(analysis: Mapping[str, Any], drawn: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the pictures of page one: the signature; where there is none the trend, and the misfit where one is."""
    if "signature" in drawn:
        return ("signature",)
    if diagnosis_of(analysis).verdict in ("none", "not_assessed"):
        return ("trend",)
    misfit = "time" if most_telling(analysis) is None or "coordinate" not in drawn else "coordinate"
    return "trend", misfit if misfit in drawn else "friction"


def _gain(gain: Mapping[str, Any] | None, reader: Reader) -> str:
    if gain is None:
        return ""
    before, after, noise = (reader.quantity(gain[key], "m", 3) for key in _GAIN_KEYS)
    return say(
        "tried_on",
        "Tried on {held_out}: the simulation misses the measured position by {before} rms without the cause and by "
        "{after} rms with it; the noise is {noise} rms.",
        held_out=gain["held_out"],
        before=before,
        after=after,
        noise=noise,
    )


def _share(share_of_misfit: float | None) -> str:
    return say("share", "{share:.0f %}", share=share_of_misfit) if share_of_misfit else ""


def _separating(test: Any) -> str:
    if not isinstance(test, Mapping):
        return ""
    run = say("run_separating", "Run the sequence separating to tell them apart.")
    return together([run, test.get("sentence") or ""])


def _steps(analysis: Mapping[str, Any], reader: Reader) -> list[dict[str, str]]:
    summary = ((analysis.get("signature") or {}).get("steps") or {}).get("summary") or {}
    rows = [
        {"name": words, "value": reader.quantity(summary[key], unit)}
        for key, words, unit in _STEP_FIGURES
        if summary.get(key) is not None
    ]
    stroke = summary.get("stroke_time_s") or {}
    rows += [
        {"name": _STROKE_TIMES[way], "value": reader.measured(one["value"], one["ci95"], "s")}
        for way in ("opening", "closing")
        if (one := stroke.get(way))
    ]
    for key, words in _STEP_BANDS:
        found = summary.get(key) or {}
        if found.get("value") is not None:
            ends = found.get("ci95")
            value = say("percent", "{percent:.3g} %", percent=found["value"])
            if ends is not None:
                value = say(
                    "percent_between",
                    "{percent:.3g} % (between {low:.3g} and {high:.3g} %)",
                    percent=found["value"],
                    low=ends[0],
                    high=ends[1],
                )
            rows.append({"name": words, "value": value})
    return rows


def _sampling(analysis: Mapping[str, Any], reader: Reader) -> Iterator[tuple[str, str]]:
    recording = analysis.get("recording") or {}
    sampling = recording.get("sampling") or {}
    if "samples" in recording:
        yield SAMPLES, samples_words(recording["samples"], recording.get("gaps", 0))
    if recording.get("duration_s") is not None:
        lasted_s, how = recording["duration_s"], named(recording.get("acquisition", ""))
        yield (
            say("sampling_duration", "Duration"),
            say("duration_how", "{lasted:.4g} s, {how}", lasted=lasted_s, how=how),
        )
    if sampling:
        yield RATE, rate_words(sampling)
        yield JITTER, jitter_words(sampling["jitter_rms_s"], sampling["largest_period_s"])
    if recording.get("channels"):
        yield say("sampling_channels", "Channels"), ", ".join(recording["channels"])
    if recording.get("position_noise_m") is not None:
        yield POSITION_NOISE, _rms(recording["position_noise_m"], reader)
    for one in analysis.get("held_out") or ():
        for method, rmse_m in one["rmse_m"].items():
            if rmse_m is not None:
                name = say("held_out_by", "Held out: {file}, {method}", file=one["file"], method=named(method))
                yield name, _rms(rmse_m, reader)


def _rms(length_m: float, reader: Reader) -> Message:
    return say("shown_rms", "{length} rms", length=reader.quantity(length_m, "m", 3))


def samples_words(samples: int, gaps: int) -> Message:
    """Return how many samples a recording has, and how many are missing."""
    return say("samples_of_them_missing", "{samples}, {gaps} of them missing", samples=samples, gaps=gaps)


def jitter_words(jitter_s: float, longest_s: float | None) -> str:
    """Return how uneven a recording was sampled, s rms, in milliseconds, with its longest period where it is known."""
    jitter = (
        say("jitter_rms", "{jitter:.3g ms} rms", jitter=jitter_s)
        if jitter_s >= _LEAST_JITTER_S
        else say("jitter_below", "below {least:g ms} rms", least=_LEAST_JITTER_S)
    )
    longest = "" if longest_s is None else say("longest_period", "longest period {longest:.4g ms}", longest=longest_s)
    return together([jitter, longest], ", ")


def permissive_row(one: Mapping[str, Any]) -> dict[str, str]:
    """Return a permissive as it was read before the motion, in words."""
    name = named(str(one.get("name", "")))
    value, limit = (_text(one.get(key, "")) for key in ("value", "limit"))
    return {"name": name, "met": _MET[one.get("met")], "value": value, "limit": limit}


def _text(value: object) -> str:
    return value if isinstance(value, str) else str(value)
