"""What the forces of a recording give without its motion: by slides, by slips, or by the rests between steps."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from estimators.base import (
    Outcome,
)
from estimators.engine.balance import Balance, Blocks, balance, driven_blocks, swept
from estimators.engine.brackets import brackets, static_friction_between
from estimators.engine.breakaways import StaticFriction, breakaways, static_friction
from estimators.engine.commanded import command_path, with_likely_path
from estimators.engine.lateness import coasting, lag_after_breakaways, stops_at
from estimators.engine.laws import PathToFit
from estimators.engine.parameters import Known
from estimators.engine.reading import Reading
from estimators.engine.rests import balance_of_rests
from estimators.engine.slips import balance_of_slips, lag_of_slips, mostly_slips
from estimators.engine.stepped import Stepped
from estimators.engine.yielding import MOST_YIELD, WAY, Held, driven_of, gave_way, sliding_blocks, yielding
from estimators.samples import resolution

_YIELDS: Final = 2.0e-5  # of the travel: less changes m and F_v by no more than they are known
_SLOWLY_YIELDS: Final = 1.0e-4  # the same of a heavily damped stem: it starts so slowly that its bristles hardly show
_SLOW_S: Final = 0.1
_LEFT_OF_BRISTLES: Final = 0.004  # of F_c: what they leave in the rows of a stem that slides
_UNSEEN_PATH_S: Final = 0.2  # what an I/P is late by, with twice as much of error, where no slide shows it
_LAG_SHARE: Final = 0.5  # how well the stem's lag is known by how late it slides


@dataclass(frozen=True, slots=True, eq=False)
class Basis:
    """What the forces alone give, and what the motion's fit begins with; ``leaps``: the force has no path to follow."""

    reading: Reading
    lag: Known
    path: PathToFit | None
    found: Balance
    static: StaticFriction | None
    stepped: bool = False
    leaps: bool = False
    on_stop: bool = False
    unsure_n: Mapping[str, float] = field(default_factory=dict)  # what neither balance nor motion knows, by symbol
    yields_m: float = 0.0  # before it breaks away
    limit_share: float | None = None  # of the ramp's speed, that corners show where they do not show the lag


def of_slides(reading: Reading) -> Basis | Outcome:
    """Return the balance of a stem that slides or slips under a force that ramps."""
    coasts = coasting(reading)
    lag, limit_share = coasts.lag, None
    if mostly_slips(reading):
        # no slip is a slide that has settled, however long a damped stem takes for it
        lag = max(lag, lag_of_slips(reading), key=lambda one: one.value)
        if reading.samples.is_commanded:  # and of the I/P's lag nothing shows
            lag = Known(lag.value + _UNSEEN_PATH_S, math.hypot(lag.std_error, 2.0 * _UNSEEN_PATH_S))
    reading, lag, path = _with_path(reading, lag)
    found = _balance(reading, lag, driven_blocks(reading, lag))
    if found is not None and path is None and (soft := _on_bristles(reading, lag, found)) is not None:
        return soft
    late = None
    if found is not None and "k" in found.symbols and not coasts.is_tail:
        late = lag_after_breakaways(reading, lag, found)
    if late is not None:
        settled = _balance(reading, late, driven_blocks(reading, late))
        if settled is not None:
            found, lag, limit_share = settled, late, stops_at(late.value, lag.value)
    if found is None:
        if path is None:
            found, lag = balance_of_slips(reading), lag_of_slips(reading)
        else:
            found = balance_of_slips(reading, lag)
    if found is None:
        return Outcome.NO_UNIFORM_MOTION
    static = static_friction(breakaways(reading), found, lag if path else None)
    if path is None:
        return Basis(reading, lag, None, found, static, limit_share=limit_share)
    # a command is known no better than to its treads, uniform within
    tread_n = resolution(reading.samples.force_n) / math.sqrt(12.0)
    return Basis(reading, lag, path, found, static, unsure_n={"F_c": tread_n, "F_s": tread_n})


def of_steps(reading: Reading, steps: Stepped) -> Basis | Outcome:
    """Return the balance of the rests between the steps of a force; breakaways lie between two of its levels."""
    rests = balance_of_rests(reading, steps)
    if rests is None:
        return of_slides(reading) if steps.is_fine else Outcome.TOO_FEW_STEPS
    found, on_stop = rests
    between = static_friction_between(brackets(steps, found, on_stop), found)
    lag = Known(steps.lateness_s, _LAG_SHARE * steps.lateness_s)
    if steps.leaps(found.known("F_c").value):
        return Basis(reading, lag, None, found, between, stepped=True, leaps=True, on_stop=bool(on_stop))
    static = static_friction(breakaways(reading), found) or between
    unsure = {"F_c": steps.short_n(found.known("k").value)}
    return Basis(reading, lag, None, found, static, stepped=True, on_stop=bool(on_stop), unsure_n=unsure)


def _with_path(reading: Reading, lag: Known) -> tuple[Reading, Known, PathToFit | None]:
    """The reading with a likely path where the command stands in for the pressure, and the path to fit."""
    if not reading.samples.is_commanded:
        return reading, lag, None
    likely, left = with_likely_path(reading, lag)
    return likely, left, command_path(reading, likely, lag)


def _on_bristles(reading: Reading, lag: Known, found: Balance) -> Basis | None:
    """What a stem gives that yields before it breaks away; None for one that does not."""
    if "k" not in found.symbols or found.known("k").value <= 0.0:
        return None
    spring, preload_n, coulomb_n = (found.known(symbol).value for symbol in ("k", "F_0", "F_c"))
    driven, held = driven_of(reading), Held(spring, preload_n, coulomb_n, lag.value)
    soft = yielding(driven, held)
    least = _SLOWLY_YIELDS if lag.value > _SLOW_S else _YIELDS
    if soft is None or not least * reading.travel_m <= soft.value <= MOST_YIELD * reading.travel_m:
        return None
    way_m = WAY * soft.value
    slid = _balance(reading, lag, sliding_blocks(reading, driven_blocks(reading, lag), found, way_m))
    unsure = {"F_c": _LEFT_OF_BRISTLES * coulomb_n}
    known = slid or found
    static = static_friction(gave_way(driven, held, soft.value), known)
    return Basis(reading, lag, None, known, static, unsure_n=unsure, yields_m=soft.value)


def _balance(reading: Reading, lag: Known, blocks: Blocks) -> Balance | None:
    return balance(
        blocks,
        noise_m=reading.noise_m,
        travel_m=reading.travel_m,
        has_spring=reading.spring_n_per_m > 0.0,
        force_noise_n=reading.path.noise_n,
        lag=lag,
        over=swept(reading),
    )
