"""The signature and the step test of an analysis as tables, in units that a technician reads."""

from __future__ import annotations

from statistics import median
from typing import Any, Final

from rich.console import Console
from rich.table import Table
from rich.text import Text

from service.words.plain_numbers import half_width, plus_minus
from service.words.sentences import as_sentence, together
from valve.messages import Message, parts_of, say

_MOST_STEPS: Final = 20  # rows of the table of steps
_LARGE_SHARE: Final = 0.25  # of the largest change: the steps that the summary times too
_WIDE: Final = 100  # columns from which each figure's meaning has room
_ALL_FIGURES: Final = 9  # that can have a note, in N and percent counted once
_FRICTION: Final = (
    ("friction, mean", "friction_mean", "half of the loop's width"),
    ("friction, least", "friction_min", "where the stem goes easiest"),
    ("friction, greatest", "friction_max", "where the stem goes hardest"),
)
_BANDS: Final = (
    ("dead band", "dead_band_percent", "input turned back with no answer"),
    ("hysteresis + dead band", "hysteresis_percent", "widest part of the loop"),
    ("stick band S", "stick_band_percent", "breakaway plus friction in motion"),
    ("slip jump J", "slip_jump_percent", "breakaway less friction in motion"),
)


def print_signature(console: Console, signature: dict[str, Any]) -> None:
    """Print the signature's table, where it was measured, why a figure is missing, and the step test."""
    rows = [*_friction_rows(signature), *_spring_rows(signature), *_band_rows(signature)]
    if any(value for _, value, _, _ in rows):
        wide = console.width >= _WIDE
        table = Table(title="Signature (± is half of the 95 % interval)", title_justify="left")
        headings = (("figure", False), ("value", True), ("% of span", True), ("what it is", False))
        for heading, right in headings if wide else headings[:-1]:
            table.add_column(heading, justify="right" if right else "left", no_wrap=right)
        for name, value, share, meaning in rows:
            table.add_row(name, value or ("" if share else "not given"), share, *([meaning] if wide else []))
        console.print(table)
        console.print(Text(_where(signature)))
    for reason in _reasons(signature):
        console.print(Text(reason))
    if signature.get("steps") is not None:
        _print_steps(console, signature["steps"])


def _is_even(signature: dict[str, Any]) -> bool:
    """Whether friction is the same all over the travel: least and greatest tell nothing more."""
    mean = signature["friction_mean_n"]
    return mean is not None and mean == signature["friction_min_n"] == signature["friction_max_n"]


def _entry(signature: dict[str, Any], name: str, scale: float = 1.0) -> str:
    value = signature[name]
    if value is None:
        return ""
    return plus_minus(scale * value, half_width(signature["intervals"].get(name), scale))


def _percent(signature: dict[str, Any], name: str) -> str:
    return "" if signature[name] is None else plus_minus(signature[name], None)


def _friction_rows(signature: dict[str, Any]) -> list[tuple[str, str, str, str]]:
    rows = []
    for name, field, meaning in _FRICTION[:1] if _is_even(signature) else _FRICTION:
        value = _entry(signature, f"{field}_n")
        rows.append((name, f"{value} N" if value else "", _percent(signature, f"{field}_percent"), meaning))
    return rows


def _spring_rows(signature: dict[str, Any]) -> list[tuple[str, str, str, str]]:
    spring, bench = _entry(signature, "spring_rate_n_per_m", 1.0e-3), signature["bench_set_pa"]
    told = ""
    if bench is not None:
        intervals = signature["intervals"]["bench_set_pa"]["ci95"]
        ends = [
            plus_minus(1.0e-3 * end, None if ci95 is None else 0.5e-3 * (ci95[1] - ci95[0]))
            for end, ci95 in zip(bench, intervals, strict=True)
        ]
        told = f"{ends[0]}\nto {ends[1]} kPa"
    return [
        ("spring rate", f"{spring} N/mm" if spring else "", "", "slope of the loop's mid-line"),
        ("bench set", told, "", "mid-line at 0 and 100 % travel"),
    ]


def _band_rows(signature: dict[str, Any]) -> list[tuple[str, str, str, str]]:
    span = signature["span"]
    rows = []
    for name, field, meaning in _BANDS:
        share, value = _percent(signature, field), ""
        if share and span is not None and span["pressure_pa"] is not None:
            low_pa, high_pa = span["pressure_pa"]
            value = f"{_entry(signature, field, 1.0e-5 * (high_pa - low_pa))} kPa"
        elif share and span is not None:
            value = f"{_entry(signature, field, 1.0e-2 * span['force_n'])} N"
        rows.append((name, value, share, meaning))
    return rows


def _where(signature: dict[str, Any]) -> str:
    """From what, over which stroke, at which speed, and what 100 % is."""
    parts = [say("signature_from", "Signature {origin}", origin=_origin(signature["from"]))]
    stroke = signature.get("central_stroke_m")
    if stroke is not None:
        low_m, high_m = stroke
        parts.append(say("over_travel", "over {low:.1f in mm} to {high:.1f mm} of travel", low=low_m, high=high_m))
    if signature.get("speed_m_per_s") is not None:
        parts.append(say("at_speed", "at {speed:.3g mm/s}", speed=signature["speed_m_per_s"]))
    if signature.get("cycles"):
        cycles = signature["cycles"]
        parts.append(say("cycles", "{n} cycles", n=cycles) if cycles > 1 else say("one_cycle", "1 cycle"))
    if _is_even(signature):
        parts.append(say("friction_even", "friction even over it"))
    if signature.get("stick_slip"):
        parts.append(say("slips_in_jumps", "the stem slips in jumps of {jump:.3g mm}", jump=signature["slip_m"]))
    span, sentence = signature["span"], as_sentence(together(parts, ", "))
    if span is None:
        return sentence
    if span["pressure_pa"] is None:
        whole = say("whole_force", "100 % is {force:.4g N} ({origin}).", force=span["force_n"], origin=span["from"])
    else:
        low_pa, high_pa = span["pressure_pa"]
        whole = say("whole_span", "100 % is {span:.4g kPa} ({origin}).", span=high_pa - low_pa, origin=span["from"])
    return together([sentence, whole])


def _origin(told: str | None) -> str:
    """How the figures came about, to follow the word signature: measured, taken from the parameters, or both."""
    if told is None:
        return say("not_measured", "not measured")
    parts = parts_of(told) if isinstance(told, Message) else told.split("; ")
    return together(
        (one if one.startswith("measured") else say("taken_from", "taken from {it}", it=one) for one in parts), " and "
    )


def _reasons(signature: dict[str, Any]) -> list[str]:
    """Each note once, after the figures that it belongs to; a percentage has its own only where the force has none."""
    whose: dict[str, list[str]] = {}
    even = ("friction_min", "friction_max") if _is_even(signature) else ()
    for field, note in signature["notes"].items():
        if even and field.startswith(even):
            continue
        name = field.removesuffix("_n").removesuffix("_percent").removesuffix("_pa").removesuffix("_n_per_m")
        if field.endswith("_percent") and signature.get(f"{name}_n") is not None and signature[field] is None:
            name = "percent of span"
        named = whose.setdefault(note, [])
        if name not in named:
            named.append(name)
    return [_reason(names, note) for note, names in whose.items()]


def _reason(names: list[str], note: str) -> str:
    if len(names) >= _ALL_FIGURES:
        return say("signature_reason", "Signature: {note}", note=note)
    figures = tuple(name.replace("_", " ") for name in names)
    return say("figures_reason", "Signature, {figures:, }: {note}", figures=figures, note=note)


def _print_steps(console: Console, steps: dict[str, Any]) -> None:
    largest = max(abs(one["change_percent"]) for one in steps["each"])
    large = [one for one in steps["each"] if one["moved"] and abs(one["change_percent"]) >= _LARGE_SHARE * largest]
    shown = (large or steps["each"])[:_MOST_STEPS]
    table = Table(
        title=say("step_test_input", "Step test (input: {channel})", channel=steps["input"].partition("_")[0]),
        title_justify="left",
    )
    unsettled = any(not one["settled"] for one in shown)
    for heading in ("at s", "step %", "travel %", "T_d ms", "T63 ms", "T86 ms", "over %", "error %"):
        table.add_column(heading, justify="right", no_wrap=True)
    if unsettled:
        table.add_column("")
    for one in shown:
        table.add_row(
            f"{one['time_s']:.2f}",
            _signed(one["step_percent"]),
            _signed(one["change_percent"]),
            _dead_time(one),
            _milliseconds(one, "t63"),
            _milliseconds(one, "t86"),
            "" if one["overshoot_percent"] is None else f"{one['overshoot_percent']:.1f}",
            _signed(one["steady_error_percent"]),
            *([] if not unsettled else ["" if one["settled"] else "not settled"]),
        )
    console.print(table)
    console.print(Text("T_d: dead time; over: overshoot of the change; error: travel less input, both in %."))
    left = len(steps["each"]) - len(shown)
    if left > 0:
        still = steps["summary"]["count"] - steps["summary"]["moved"]
        console.print(
            Text(
                say(
                    "steps_not_shown",
                    "Not shown: {left} steps, {still} of which moved nothing; the JSON object has them all.",
                    left=left,
                    still=still,
                )
            )
        )
    console.print(Text(_certainty(shown)))
    for sentence in _summary(steps["summary"]):
        console.print(Text(sentence))


def _dead_time(one: dict[str, Any]) -> str:
    below_s = one["dead_time_below_s"]
    return _milliseconds(one, "dead_time") if below_s is None else f"< {plus_minus(1e3 * below_s, None, digits=2)}"


def _milliseconds(one: dict[str, Any], key: str) -> str:
    value_s = one[f"{key}_s"]
    return "" if value_s is None else plus_minus(1e3 * value_s, None, digits=3)


def _certainty(each: list[dict[str, Any]]) -> str:
    """How well the times of a usual step are known, by sampling and noise."""
    told = []
    for name, key in (("T_d", "dead_time"), ("T63", "t63"), ("T86", "t86")):
        errors_s = [one[f"{key}_std_error_s"] for one in each if one[f"{key}_std_error_s"] is not None]
        if errors_s:
            told.append(f"{name} ± {1.96e3 * median(errors_s):.2g} ms")
    if not told:
        return say("no_step_timed", "No step could be timed.")
    return say("usual_step", "Of a usual step, by sampling and noise (95 %): {told:, }.", told=tuple(told))


def _signed(value: float | None) -> str:
    return "" if value is None else f"{round(value, 2) + 0.0:+.2f}"


def _summary(summary: dict[str, Any]) -> list[str]:
    medians = [
        f"{name} {1e3 * summary[key]:.3g} ms"
        for name, key in (("T_d", "dead_time_s"), ("T63", "t63_s"), ("T86", "t86_s"))
        if summary[key] is not None
    ]
    if summary["dead_time_s"] is None and summary["dead_time_below_s"] is not None:
        medians.insert(0, f"T_d below {1e3 * summary['dead_time_below_s']:.2g} ms")
    told: list[str] = [
        say(
            "medians_of_steps",
            "Step test, medians of {timed} large steps of {all}: {medians:, }.",
            timed=summary["timed"],
            all=summary["count"],
            medians=tuple(medians) or (say("none_timed", "none could be timed"),),
        )
    ]
    for name, key in (("Resolution", "resolution_percent"), ("Dead band by steps", "dead_band_percent")):
        found = summary[key]
        if found["value"] is None:
            told.append(say("figure_not_given", "{name}: not given, {note}.", name=name, note=found["note"]))
        else:
            low, high = found["ci95"]
            bounds = (
                say(
                    "figure_between",
                    "{name}: between {low:.3g} and {high:.3g} % of span",
                    name=name,
                    low=low,
                    high=high,
                )
                if low > 0.0
                else say("figure_at_most", "{name}: at most {high:.3g} % of span", name=name, high=high)
            )
            note = found["note"]
            told.append(as_sentence(say("with_note", "{said} ({note})", said=bounds, note=note) if note else bounds))
    return told
