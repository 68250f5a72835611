"""How an answer is graded, and the table of figures beside what is asked."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from tests.bench.judge.effects import CATALOGUE
from tests.bench.judge.valves import Valve

MOST_IN_A_SET: Final = 3
_SAYS: Final = ("named", "likely", "ambiguous")
SYMBOLS: Final = ("k", "F_c", "F_s", "F_0", "F_v", "m")


def grade(
    verdict: str, causes: Sequence[str], rivals: Sequence[str], truth: Sequence[str], beside: Sequence[str] = ()
) -> str:
    """Return right, partly, vague, wrong, none, unexplained or not_assessed.

    Right: all that is hidden and nothing else, by name or in a set of at most three. Partly: some of it. Vague: in a
    larger set. Wrong: a name, or a set, of which nothing is there; for a healthy valve any name. What is ``beside``
    the truth may be named: an end of the travel that the stem came to rest on.
    """
    if verdict not in _SAYS or not causes:
        return verdict
    causes = [one for one in causes if one not in beside]
    if not causes:
        return "none"
    left = set(truth)
    sets = [{cause} for cause in causes]
    if verdict == "ambiguous":
        sets[0] |= set(rivals)
    vague = False
    for one in sets:
        meant = next((name for name in left if one & {name, *_kin(name)}), None)
        if meant is None:
            return "wrong"
        left.discard(meant)
        vague = vague or len(one) > MOST_IN_A_SET
    if vague:
        return "vague"
    return "partly" if left else "right"


def _kin(name: str) -> tuple[str, ...]:
    return CATALOGUE[name].kin if name in CATALOGUE else ()


def judged_estimate(parameters: Mapping[str, Any], truth: Valve, status: str) -> dict[str, Any]:
    """Return each parameter's value, interval and truth; whether it is given, held, and ``ok`` and wrong.

    Wrong: beyond twice the half width of its interval, on the side where it is.
    """
    out: dict[str, Any] = {}
    for symbol in SYMBOLS:
        entry, true = parameters[symbol], float(getattr(truth, symbol))
        value, limits = entry["value"], entry["ci95"]
        scale = truth.full_force_n if symbol == "F_0" else true  # which may be zero
        one: dict[str, Any] = {
            "value": value,
            "ci95": limits,
            "truth": true,
            "given": value is not None,
            "scale": scale,
        }
        if value is not None and limits is not None:
            reach = (limits[1] - value) if true > value else (value - limits[0])
            one["held"] = limits[0] <= true <= limits[1]
            one["wrong"] = status == "ok" and abs(true - value) > 2.0 * reach
            one["half_width"] = 0.5 * (limits[1] - limits[0])
        out[symbol] = one
    return out


def share_of_gain(before_m: float | None, after_m: float | None, true_m: float) -> float | None:
    """Return the gain beside the true mean model's; None where there is nothing to be gained."""
    if before_m is None or after_m is None or true_m > 0.8 * before_m:
        return None
    return (before_m - after_m) / (before_m - true_m)


def table(cases: Sequence[Mapping[str, Any]]) -> str:
    """Return figures beside what is asked, one line each."""
    lines = [f"{'what':58s} {'cases':>5s}  {'reached':48s} asked (floor)"]

    def count(chosen: Iterable[Mapping[str, Any]], what: str, asked: str) -> None:
        own = list(chosen)
        if not own:
            return
        grades = [one["grade"] for one in own]
        shares = {name: grades.count(name) for name in sorted(set(grades))}
        said = ", ".join(f"{name} {100 * number / len(own):.1f}%" for name, number in shares.items())
        lines.append(f"{what:58s} {len(own):5d}  {said:48s} {asked}")

    of = {kind: [one for one in cases if one["kind"] == kind] for kind in dict.fromkeys(one["kind"] for one in cases)}
    hidden = of.get("hidden", [])
    count(of.get("healthy", []), "healthy, all", "named 2 / unexplained 8 %")
    for name in ("ideal", "mild", "usual", "hard"):
        count((c for c in of.get("healthy", []) if c["packing"] == name), f"  {name}", "")
    count((c for c in hidden if 3 <= c["strength"][0] < 10), "hidden, strength 3 to 10", "right 75 / wrong 4 %")
    count((c for c in hidden if c["strength"][0] >= 10), "hidden, strength above 10", "right 88 / wrong 3 %")
    for name in dict.fromkeys(one["truth"][0] for one in hidden):
        count((c for c in hidden if c["truth"][0] == name and c["strength"][0] >= 3), f"  {name}", "")
    count(of.get("play", []), "play of 0.5 % and more, diagnostic", "right 85 %")
    count((c for c in of.get("pairs", []) if min(c["strength"]) >= 10), "pairs, each above 10", "right 55 / wrong 5 %")
    count((c for c in of.get("perfect", []) if c["truth"]), "perfect valves, triangle", "right 85 / wrong 1 %")
    count((c for c in of.get("perfect", []) if not c["truth"]), "perfect and healthy", "named 0.5 %")
    count(of.get("odd", []), "in no catalogue", "wrong 5 %")
    count((c for c in of.get("slips", []) if c["truth"]), "stems that slip, of any strength", "")
    count((c for c in of.get("slips", []) if not c["truth"]), "stems that slip and are healthy", "named 2 %")
    gains = [c["gain"]["share"] for c in cases if c.get("gain") and c["gain"].get("share") is not None]
    if gains:
        worse = np.mean([share < -0.02 for share in gains])
        lines.append(
            f"{'gain beside the true mean model, of named and likely':58s} {len(gains):5d}  "
            f"{f'median {np.median(gains):.2f}, worse {100 * worse:.0f}%':48s} 0.80; worse 2 %"
        )
    bands = [c["gain"]["inside"] for c in cases if c.get("gain") and c["gain"].get("inside") is not None]
    if bands:
        lines.append(
            f"{'held-out rows inside the 95 % band':58s} {len(bands):5d}  "
            f"{f'median {100 * np.median(bands):.0f}%, lowest tenth {100 * np.quantile(bands, 0.1):.0f}%':48s} 85-99 %"
        )
    lines += _estimates([c for c in cases if c["kind"] == "healthy"])
    for period_s in (0.001, 0.02):
        took = [c["seconds"] for c in cases if c["period_s"] == period_s]
        if took:
            lines.append(
                f"{f'processor seconds, rows of {1000 * period_s:g} ms':58s} {len(took):5d}  "
                f"{f'median {np.median(took):.1f}, worst {max(took):.0f}':48s} 8 / 30; 4"
            )
    return "\n".join(lines)


def _estimates(cases: Sequence[Mapping[str, Any]]) -> list[str]:
    lines = []
    for grades in (("ideal",), ("mild", "usual"), ("hard",)):
        own = [c["estimates"] for c in cases if c["packing"] in grades and c.get("estimates")]
        for symbol in SYMBOLS if own else ():
            given = [one[symbol] for one in own if one[symbol]["given"]]
            with_limits = [one for one in given if "held" in one]
            held = np.mean([one["held"] for one in with_limits]) if with_limits else float("nan")
            wrong = sum(one["wrong"] for one in with_limits)
            off = [abs(one["value"] - one["truth"]) / one["scale"] for one in given]
            wide = [one["half_width"] / one["scale"] for one in with_limits]
            said = f"given {100 * len(given) / len(own):.0f}%, held {100 * held:.0f}%, ok and wrong {wrong}"
            if off:
                said += f", off {100 * np.median(off):.2f}%, half width {100 * np.median(wide or [np.nan]):.2f}%"
            lines.append(f"{'estimate ' + symbol + ', ' + '+'.join(grades):58s} {len(own):5d}  {said}")
    return lines
