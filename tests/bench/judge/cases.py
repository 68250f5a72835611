"""Cases by kind and seed: what is recorded, what is hidden in it, and how strong it is."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from tests.bench.judge.effects import CATALOGUE, ODD, TRIANGLE, Effect
from tests.bench.judge.recordings import Hidden, Run, Setting, nameplate, run, true_mean
from tests.bench.judge.strength import best_mean_law, healthy_misfit, sized
from tests.bench.judge.valves import GRADES, VALVES, Valve, drawn, stem_of
from valve.recording import Recording

KINDS: Final = ("healthy", "hidden", "play", "pairs", "perfect", "odd", "slips")
_LAG_S: Final = (0.010, 0.030)  # of a healthy I/P
_DEAD_TIME_S: Final = (0.0, 0.010)
_FRICTIONS: Final = (
    "friction_asymmetry",
    "stribeck_friction",
    "local_friction",
    "friction_gradient",
    "friction_drift",
    "dwell_dependent_breakaway",
    "breakaway_scatter",
)
# Hidden in stems that stick and slip: what changes their forces.
_SLIPS: Final = (
    "friction_asymmetry",
    "local_friction",
    "friction_gradient",
    "friction_drift",
    "dwell_dependent_breakaway",
    "pressure_dependent_friction",
    "spring_preload",
    "spring_hardening",
    "dual_rate_spring",
    "diaphragm_area_change",
    "position_nonlinearity",
    "position_backlash",
)
_DAMPING: Final = 0.12  # of the valves' own, in stems that slip
_PLAYS: Final = (0.005, 0.03)  # of the travel
_STRONG: Final = (10.0, 40.0)
_MIDDLE: Final = (3.0, 10.0)
# What one sees on any valve, in more than one law each; partners are never of one of these groups.
_GROUPS: Final = (
    ("friction_asymmetry", "spring_preload"),
    ("friction_gradient", "pressure_dependent_friction"),
    ("spring_hardening", "position_nonlinearity", "diaphragm_area_change", "flow_force", "dual_rate_spring"),
    ("transducer_lag", "transducer_dead_time", "position_lag", "positioner_dead_band", "transducer_hysteresis"),
    ("local_friction",),
    ("friction_drift",),
    ("travel_stop_high", "travel_stop_low"),
    ("supply_saturation", "actuator_leak"),
)


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """What is handed in, and what is known of it; ``truth`` where the estimates can be judged."""

    recording: Recording
    held_out: Recording | None
    nameplate: str
    facts: dict[str, Any]
    truth: Valve | None
    true_rmse_m: float | None  # of the true mean law with its causes, on the held-out recording


def case(kind: str, seed: int, only: str = "", sizes: tuple[float, ...] = ()) -> Case:
    """Return the case of a kind and a seed; ``only``: this cause is hidden.

    ``sizes`` are those of the causes where the case was made before (its ``size``): most of the time goes into finding
    them. Their strengths are not asked for again, and ``nan``.
    """
    rng = np.random.default_rng([seed, *kind.encode()])
    effects = _chosen(kind, rng, only, seed)
    setting = _setting(kind, effects, rng, seed)
    period_s = (
        0.001 if kind == "perfect" or rng.random() < (0.3 if setting.sequence == "diagnostic" else 0.55) else 0.02
    )
    strong = kind in {"pairs", "play"} or rng.random() < 0.5
    band = _STRONG if strong else _MIDDLE
    if kind == "odd":
        band = (3.0, 40.0)
    target = float(np.exp(rng.uniform(np.log(band[0] * 1.1), np.log(band[1] * 0.8))))
    path = any(effect.path for effect in effects)
    if sizes:
        hidden, strengths = tuple(zip(effects, sizes, strict=True)), [math.nan] * len(sizes)
        made = run(setting, hidden)
    else:
        hidden, strengths, made = _hidden(effects, setting, band, target=target, play=rng if kind == "play" else None)
    shares = {"mass": bool(rng.random() < 0.5), "bench_set": bool(rng.random() < 0.8)}
    if any(effect.name in _GROUPS[0] for effect in effects):
        shares["bench_set"] = True
    with_command = path or bool(rng.random() < 0.6)
    facts = {
        "kind": kind,
        "seed": seed,
        "valve": setting.valve.name,
        "packing": next(name for name, grade in GRADES.items() if grade == setting.grade),
        "sequence": setting.sequence,
        "period_s": period_s,
        "command": with_command,
        **shares,
        "truth": [effect.name for effect in effects],
        "size": [size for _, size in hidden],
        "strength": strengths,
        "beside": _ends_reached(made, effects),
    }
    held_out, true_rmse_m = None, None
    foretold = {"friction_drift", "breakaway_scatter", "vibration"}
    if kind in {"hidden", "play", "pairs", "slips"} and not path and not foretold & {effect.name for effect in effects}:
        tried = run(setting, hidden, number=1, name="held_out")
        held_out = tried.recording(period_s, with_command)
        true_rmse_m = _true_rmse(setting, made, tried, hidden)
    return Case(
        made.recording(period_s, with_command),
        held_out,
        nameplate(setting, **shares),
        facts,
        None if effects else true_mean(setting, made),
        true_rmse_m,
    )


def _chosen(kind: str, rng: np.random.Generator, only: str, seed: int) -> tuple[Effect, ...]:
    """Return what is hidden; causes take turns by the seed, so that all of them come up."""
    if only:
        return tuple({**CATALOGUE, **ODD}[name] for name in only.split("+"))
    if kind == "healthy" or (kind in {"perfect", "slips"} and rng.random() < 0.2):
        return ()
    if kind == "play":
        return (CATALOGUE["position_backlash"],)
    if kind == "pairs":
        groups = rng.choice(len(_GROUPS), 2, replace=False)
        return tuple(CATALOGUE[str(rng.choice(_GROUPS[group]))] for group in groups)
    names = {"hidden": tuple(CATALOGUE), "perfect": TRIANGLE, "odd": tuple(ODD), "slips": _SLIPS}[kind]
    turn = np.random.default_rng([len(names), seed // len(names)]).permutation(len(names))
    return ({**CATALOGUE, **ODD}[names[turn[seed % len(names)]]],)


def _setting(kind: str, effects: tuple[Effect, ...], rng: np.random.Generator, seed: int) -> Setting:
    names = list(VALVES)
    if any(effect.name == "seat_friction" for effect in effects):
        names = ["vendor", "small"]  # their friction lets them close
    elif any(effect.name in _FRICTIONS for effect in effects) and kind != "perfect":
        names.remove("vendor")  # whose friction nobody minds
    if kind == "slips":
        names = ["nominal", "rough", "small", "large"]
    valve = drawn(str(rng.choice(names)), rng)
    if kind == "slips":
        valve = replace(valve, F_v=_DAMPING * valve.F_v)
    packing = "usual"
    if kind == "healthy":
        packing = str(rng.choice(["ideal", "mild", "usual", "usual", "hard"]))
    elif kind == "perfect":
        packing = "ideal"
    elif kind == "odd":
        packing = str(rng.choice(["mild", "usual"]))
    asked = next((effect.sequence for effect in effects if effect.sequence), "")
    if kind == "perfect":
        asked = "triangle"
    elif kind == "healthy":
        asked = str(rng.choice(["triangle", "multi_rate", "multi_rate", "diagnostic"]))
    name = asked or str(rng.choice(["triangle", "multi_rate", "diagnostic"], p=[0.3, 0.5, 0.2]))
    ends = (float(rng.uniform(0.0, 0.04)), float(rng.uniform(0.94, 1.0)))
    if any(effect.name == "seat_friction" for effect in effects):
        ends = (0.0, ends[1])
    return Setting(
        valve, GRADES[packing], name, float(rng.uniform(*_LAG_S)), float(rng.uniform(*_DEAD_TIME_S)), ends, 1000 * seed
    )


def _hidden(
    effects: tuple[Effect, ...],
    setting: Setting,
    band: tuple[float, float],
    *,
    target: float,
    play: np.random.Generator | None,
) -> tuple[Hidden, list[float], Run]:
    """Return effects with their sizes, how strong each is by itself, and the run with all."""
    if not effects:
        return (), [], run(setting)
    hidden: list[tuple[Effect, float]] = []
    strengths: list[float] = []
    made: Run | None = None
    for effect in effects:
        healthy_m = healthy_misfit(setting, by_command=effect.path)
        if play is not None:  # by its size, however strong
            size = float(np.exp(play.uniform(*np.log(_PLAYS))))
            made = run(setting, ((effect, size),))
            strength = best_mean_law(made, setting.valve, by_command=False)[1] / healthy_m
        else:
            size, strength, made = sized(setting, effect, band, healthy_m, target)
        hidden.append((effect, size))
        strengths.append(round(strength, 2))
    if len(hidden) > 1 or made is None:
        made = run(setting, tuple(hidden))
    return tuple(hidden), strengths, made


def _ends_reached(made: Run, effects: tuple[Effect, ...]) -> list[str]:
    """Return the stops that the stem came to rest on and that nobody hid: the ends of its travel."""
    ends = (
        ("travel_stop_low", made.stem_m.min() <= made.at_m[1]),
        ("travel_stop_high", made.stem_m.max() >= made.at_m[-2]),
    )
    return [name for name, reached in ends if reached and name not in {effect.name for effect in effects}]


def _true_rmse(setting: Setting, made: Run, tried: Run, hidden: Hidden) -> float:
    mean = stem_of(true_mean(setting, made))
    alone = run(setting, hidden, number=1, name="held_out", mean=mean)
    return float(np.sqrt(np.mean((alone.position_m - tried.position_m) ** 2)))
