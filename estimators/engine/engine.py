"""The engine: one recording in, one estimate out, with friction that scatters as part of the model."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from estimators.base import (
    LARGEST_RELATIVE_HALF_WIDTH,
    NO_JUMP,
    NORMAL_95,
    Estimate,
    Outcome,
    ParameterEstimate,
    Status,
    absent,
    failed,
    in_order,
    of_creep,
)
from estimators.drive.recording import estimate_force_recording
from estimators.engine.balance import Balance, repeats_to_n
from estimators.engine.basis import Basis, of_slides, of_steps
from estimators.engine.breakaways import StaticFriction
from estimators.engine.commanded import with_gauged_path
from estimators.engine.dynamic import Dynamic, Quantity, dynamic, latent_friction
from estimators.engine.force_path import Source
from estimators.engine.nodes import Sections
from estimators.engine.parameters import Known
from estimators.engine.reading import Reading, read
from estimators.engine.rows import MeasuredRows, measured_rows
from estimators.engine.segmentation import moving_mean
from estimators.engine.settings import USUAL, Settings
from estimators.engine.stepped import stepped
from estimators.engine.stops import ran_into_a_stop
from valve.messages import Message, joined, say
from valve.nameplate import Action, Nameplate
from valve.recording import Recording

METHOD: Final = "maximum_likelihood"
_NO_MOTION: Final = say(
    "balance_alone", "the balance of forces alone is given: the motion after the breakaways does not fit it"
)
_LEAPS: Final = say(
    "force_leaps",
    "the force leaps from level to level, and the rests between the steps do not show it: repeat with a ramp",
)
_COMMANDED: Final = say(
    "pressure_from_command",
    "The pressure was not measured: it is taken for the command behind a lag and a dead time that were fitted, with "
    "the gain that the signal range says.",
)
_HIDDEN: Final = say(
    "lag_of_transducer_hides", "the I/P's lag hides it where friction varies: measure the pressure at the actuator"
)
_SLOW_STEPS: Final = say(
    "lag_after_steps_hides",
    "the pressure's own lag after each step hides it where friction varies: repeat with several ramps",
)
_ONE_SPEED: Final = say("takes_acceleration", "it takes a drive that is accelerated, and several speeds")
_JUMPS_HIDDEN: Final = say(
    "jumps_hidden_mass", "noise hides the stem's jumps, and friction that varies how it starts: faster ramps show more"
)
_CREEPING: Final = say(
    "driven_at_limit_velocity",
    "the stem was driven at hardly more than its limit velocity: repeat with faster ramps",
)
_FEW_BREAKAWAYS: Final = say("few_breakaways", "fewer than two breakaways from rest were seen")
_SPRINGLESS: Final = say("springless", "the actuator has no spring")
_NO_LIMIT: Final = say("limit_without_friction", "where F_c is not known, nothing tells at what speed the stem stops")
_UNKNOWN: Final = say("interval_beyond_value", "not known from this test: its interval is wider than its value")
_SMOOTHED_S: Final = 0.05
_TURNED: Final = 0.1  # of the force's range
_HIDDEN_BANDS: Final = 1.5
_SLOW_ROWS_S: Final = 0.05  # no slip shows in slower ones
_SEEN: Final = 0.03  # of F_c
_UNRESOLVED_S: Final = 0.004  # the times of a stem and of a sensor's filter: slower rows do not show them
_MASSES_KG: Final = (0.005, 450.0)  # of all moving parts, stem valves from the smallest to the largest
_STOP_ROWS: Final = 0.2  # of the stem's lag F_v / k: slower rows do not show at what speed it stops
_NO_MASS_S: Final = 0.01  # rows so slow show friction that varies as a mass
_CREEPS: Final = 0.01  # of F_c, that creeping leaves open
_ONE_RAMP: Final = 0.8  # of the fastest ramp's speed
_CLEARLY_BELOW: Final = 0.25  # of the fastest ramp's speed: a DV below it made no stem creep there
_FAR: Final = 3.5  # standard errors
_NEAR_SHARE: Final = 0.05  # of the balance's value: so near the motion was understood
_FAR_BETTER: Final = 2.0  # times as wide as the balance's: then the motion does not have what the balance has
_BESIDE_MOTION: Final = 1.4  # where both are there the balance's interval holds too little of the friction's variation


@dataclass(frozen=True, slots=True)
class RoughFrictionEstimator:
    """Estimates m, k, F_v, F_c, F_s, DV and F_0 of a valve whose friction scatters."""

    settings: Settings = USUAL

    @property
    def method(self) -> str:
        """Name in the analysis object."""
        return METHOD

    def estimate(self, recording: Recording, nameplate: Nameplate) -> Estimate:
        """Return the estimate; its status and message say what is wrong with a recording."""
        rows = measured_rows(recording)
        is_driven = nameplate.actuator.action is Action.DOUBLE and recording.force_n is not None
        drive = estimate_force_recording(rows.recording, nameplate) if is_driven else None
        if drive is not None and drive.value("F_c") is not None:
            return replace(drive, message=joined(" ", [part for part in (drive.message, *_said(rows)) if part]))
        reading = read(rows.recording, nameplate)
        if isinstance(reading, Outcome):
            return failed(METHOD, reading)
        steps = stepped(reading, rows.recording)
        if len(reading.segmentation.directions if steps is None else steps.directions) < 2:
            return _one_way(reading)
        basis = of_slides(reading) if steps is None else of_steps(reading, steps)
        if isinstance(basis, Outcome):
            return failed(METHOD, basis)
        reading, found, static = basis.reading, basis.found, basis.static
        if any(_surely_negative(found.known(symbol)) for symbol in ("k", "F_c") if symbol in found.symbols):
            return failed(METHOD, Outcome.UNPHYSICAL)
        whole = None
        if static is not None and not basis.leaps and not basis.yields_m:
            whole = _motion(basis, reading, static, self.settings)
            late = reading.path.by_converter
            if late is not None:
                whole = _likelier(whole, _motion(basis, replace(reading, path=late), static, self.settings))
        if whole is not None and _disagree(found, whole):
            whole = None
        said = _said(rows)
        if basis.on_stop:
            said.insert(0, Outcome.STOP_INSIDE_SWEEP.message)
        if static is not None and steps is None and "k" in found.symbols:
            held_n = static.mean_n, static.scatter_n or 0.0
            if ran_into_a_stop(reading, found.known("k").value, found.known("F_0").value, held_n):
                said.insert(0, Outcome.STOP_INSIDE_SWEEP.message)
        estimate = _concluded(basis, whole, said)
        return _at_one_speed(estimate, drive) if drive is not None else estimate


def _motion(basis: Basis, reading: Reading, static: StaticFriction, settings: Settings) -> Dynamic | None:
    """Return what the motion shows with the force of this reading."""
    driven, path = (reading, basis.path) if basis.path else with_gauged_path(reading)
    return dynamic(driven, basis.lag, basis.found, static, path, limit_share=basis.limit_share, settings=settings)


def _likelier(one: Dynamic | None, other: Dynamic | None) -> Dynamic | None:
    """Return the motion that leaves fewer out, of alike ones the likelier."""
    if one is None or other is None:
        return one or other
    return min((one, other), key=lambda each: (-each.best.model.sections.count, each.best.surprise))


def _surely_negative(known: Known) -> bool:
    """Whether not even a valve of no friction, or no spring, would show this."""
    return known.value + NORMAL_95 * known.std_error < 0.0


def _disagree(found: Balance, whole: Dynamic) -> bool:
    """Whether the motion's spring rate or friction is far from the balance's: then the motion was not understood."""
    for symbol in ("k", "F_c"):
        known, moved = found.known(symbol), whole.quantities[symbol]
        far = _FAR * math.hypot(_BESIDE_MOTION * known.std_error, moved.std_error)
        if abs(moved.value - known.value) > max(far, _NEAR_SHARE * abs(known.value)):
            return True
    return False


def _quantities(
    found: Balance, static: StaticFriction | None, whole: Dynamic | None, is_open: tuple[bool, bool]
) -> dict[str, Quantity]:
    """What the motion gives, and of k, F_c and F_0 what the balance gives where it knows them far better.

    Rows too slow for the motion after a breakaway leave F_v open there, and with it F_c. What a creeping stem leaves
    open the balance knows no better. Of k and F_0 slow rows say in motion what their instants are off by: the balance
    leaves out what has not settled. ``is_open``: rows are slow; the force is a gauge's lines, whose corners an I/P may
    have rounded.
    """
    quantities: dict[str, Quantity] = {} if whole is None else dict(whole.quantities)
    coulomb = found.known("F_c")
    # at several speeds the balance sees by itself what creeping does
    is_seen = coulomb.std_error < _SEEN * coulomb.value
    creeping = {} if whole is None or is_seen else whole.creeping
    for symbol in ("k", "F_c", "F_0"):
        if symbol not in found.symbols:
            continue
        known = found.over_travel(symbol)
        error = known.std_error if "k" in found.symbols else math.hypot(known.std_error, repeats_to_n(found))
        if whole is not None:
            error = math.hypot(_BESIDE_MOTION * error, creeping.get(symbol, 0.0))
            by_balance = symbol != "F_c" and (is_open[0] or is_open[1])
            if whole.quantities[symbol].std_error < _FAR_BETTER * error and not by_balance:
                continue
        half = NORMAL_95 * error
        quantities[symbol] = Quantity(known.value, error, (known.value - half, known.value + half))
    if static is not None and whole is None:
        quantities["F_s"] = Quantity(static.mean_n, static.std_error_n, static.ci95_n)
    return quantities


def _widened(quantities: dict[str, Quantity], unsure_n: Mapping[str, float]) -> dict[str, Quantity]:
    """The quantities with what is unsure of some of them besides, one standard deviation, N."""
    out = dict(quantities)
    for symbol, more_n in unsure_n.items():
        if symbol in out and more_n > 0.0:
            one = out[symbol]
            half_n = math.hypot(0.5 * (one.ci95[1] - one.ci95[0]), NORMAL_95 * more_n)
            error_n = math.hypot(one.std_error, more_n)
            out[symbol] = Quantity(one.value, error_n, (one.value - half_n, one.value + half_n))
    return out


def _said(rows: MeasuredRows) -> list[Message]:
    """What is said of rows that were left out."""
    said = []
    if rows.dropped:
        said.append(
            say(
                "rows_dropped",
                "{count} rows are drop-outs of the position and were left out.",
                count=int(rows.dropped),
            )
        )
    if rows.held > 1:
        said.append(
            say("rows_held", "The device held each value for {count} rows: one of each was used.", count=int(rows.held))
        )
    return said


def _at_one_speed(estimate: Estimate, drive: Estimate) -> Estimate:
    """Return the balance of a drive whose inertia and damping hardly show: F_c at the speed that it had."""
    parameters = {**estimate.parameters, "k": drive.parameters["k"]}
    for symbol in ("m", "F_v", "DV"):
        known = drive.parameters[symbol]
        parameters[symbol] = known if known.value is None and drive.status is not Status.FAILED else absent(_ONE_SPEED)
    said = joined(" ", [part for part in (Outcome.ONE_SPEED.message, estimate.message) if part])
    return replace(estimate, status=Status.POOR, message=said, parameters=parameters)


def _one_way(reading: Reading) -> Estimate:
    """Return what a stem that moved in one direction tells: without a spring the sum of friction and offset."""
    estimate = failed(METHOD, Outcome.HELD_ON_THE_WAY_BACK if _turned_back(reading) else Outcome.ONE_DIRECTION_ONLY)
    moves = [move for move in reading.segmentation.moves if move.last - move.first > 2]
    if reading.spring_n_per_m > 0.0 or not moves:
        return estimate
    # a tenth at either end belongs to starting and stopping
    inner = [((move.last - move.first) // 10, move) for move in moves]
    force_n = np.concatenate([reading.path.force_n[move.first + cut : move.last - cut + 1] for cut, move in inner])
    sign = "+" if moves[0].direction > 0 else "-"
    together = say(
        "mean_force_in_motion",
        "the mean force in motion, F_0 {sign} F_c with F_v v in it, is {force:.4g N}",
        sign=sign,
        force=float(force_n.mean()),
    )
    parameters = dict(estimate.parameters)
    for symbol in ("F_c", "F_0"):
        parameters[symbol] = absent(
            say("known_is_sum", "{why} Known is their sum: {sum}.", why=parameters[symbol].note, sum=together)
        )
    message = say("known_is", "{why} Known is: {sum}.", why=estimate.message, sum=together)
    return replace(estimate, status=Status.POOR, message=message, parameters=parameters)


def _turned_back(reading: Reading) -> bool:
    """Whether the force went back by a good part of its range after the stem had moved one way."""
    way = reading.segmentation.moves[0].direction * reading.samples.force_n
    smooth = moving_mean(way, 2 * (max(1, round(_SMOOTHED_S / reading.samples.period_s)) // 2) + 1)
    return float((np.maximum.accumulate(smooth) - smooth).max()) > _TURNED * float(np.ptp(smooth))


def _concluded(basis: Basis, whole: Dynamic | None, said: Sequence[Message]) -> Estimate:
    reading, found, static = basis.reading, basis.found, basis.static
    is_open = reading.samples.period_s > _UNRESOLVED_S, reading.path.source is Source.LINES
    quantities = _widened(_quantities(found, static, whole, is_open), basis.unsure_n)
    friction_n = max((quantities[symbol].value for symbol in ("F_s", "F_c") if symbol in quantities), default=0.0)
    parameters = {
        symbol: _parameter(quantity, friction_n if symbol == "F_0" else 0.0) for symbol, quantity in quantities.items()
    }
    rough = found.roughness
    scatters = {
        "F_s": None if static is None else static.scatter_n if whole is None else whole.scatter_n,
        "F_c": math.sqrt(rough.common_n**2 + rough.own_n**2 + rough.wander_n**2),
    }
    for symbol, scatter in scatters.items():
        if symbol in parameters and parameters[symbol].value is not None:
            parameters[symbol] = replace(parameters[symbol], scatter=scatter)
    if whole is None:
        for symbol in ("m", "F_v", "DV"):
            parameters[symbol] = absent(_without_motion(basis))
    commanded = reading.samples.is_commanded
    if (commanded or basis.stepped) and whole is not None and whole.best.model.fields.count:
        for symbol in ("m", "F_v", "DV"):
            parameters[symbol] = absent(_HIDDEN if commanded else _SLOW_STEPS)
    if reading.samples.period_s > _SLOW_ROWS_S and whole is not None:
        for symbol in ("m", "DV"):
            parameters[symbol] = absent(Outcome.TRANSIENTS_NOT_RESOLVED.message)
    if whole is not None and _hides_stops(reading, whole):
        parameters["DV"] = absent(Outcome.TRANSIENTS_NOT_RESOLVED.message)
    if reading.samples.period_s > _NO_MASS_S and whole is not None and whole.best.model.fields.count:
        parameters["m"] = absent(Outcome.TRANSIENTS_NOT_RESOLVED.message)
    if whole is not None and whole.creeping.get("F_c", 0.0) > _CREEPS * found.known("F_c").value:
        parameters["m"] = absent(_CREEPING)
    if "m" in quantities and not _MASSES_KG[0] < quantities["m"].value < _MASSES_KG[1]:
        parameters["m"] = absent(
            say(
                "mass_of_no_valve",
                "the motion looks like that of {mass:.3g kg}: something else moves the stem so",
                mass=quantities["m"].value,
            )
        )
    if "DV" in parameters and "F_c" in parameters and parameters["F_c"].value is None:
        parameters["DV"] = absent(_NO_LIMIT)
    if "F_s" not in parameters:
        parameters["F_s"] = absent(_without_motion(basis) if basis.yields_m else _FEW_BREAKAWAYS)
    hidden = hidden_jumps(reading.segmentation.band_m, quantities)
    if hidden and parameters.get("F_c") is not None and parameters["F_c"].value is not None:
        parameters["F_c"] = replace(parameters["F_c"], note=hidden)
        if whole is not None and whole.best.model.fields.count:
            parameters["m"] = absent(_JUMPS_HIDDEN)
    parameters = in_order(parameters)
    has_spring = reading.spring_n_per_m > 0.0
    if not has_spring:
        parameters["k"] = absent(_SPRINGLESS)
    missing = [s for s in (("k", "F_c", "F_s") if has_spring else ("F_c", "F_s")) if parameters[s].value is None]
    creeps = parameters["F_c"].value is not None and _may_creep(basis, whole, quantities)
    if creeps:
        parameters["F_c"] = of_creep(parameters["F_c"])
        parameters.update({symbol: absent(_CREEPING) for symbol in ("m", "F_v")})
    status = Status.POOR if missing or commanded or creeps else Status.OK
    told: list[Message] = [_COMMANDED, *said] if commanded else [*said]
    if creeps:
        told.insert(0, Outcome.MAY_CREEP.message)
    if missing:
        why = parameters[missing[0]].note
        told.insert(0, say("missing_for", "{symbols:, }: {why}", symbols=tuple(missing), why=why))
    if whole is not None and whole.best.model.sections.left_out:
        told.append(_not_explained(whole.best.model.sections))
    latent = [] if whole is None else latent_friction(whole.best)
    # what a simulation takes for values that are known too badly to be given
    fitted = {} if whole is None else {symbol: quantity.value for symbol, quantity in whole.quantities.items()}
    diagnostics = {
        "roughness": found.roughness,
        "dynamic": whole,
        "latent_friction": latent,
        "stand_ins": {symbol: value for symbol, value in fitted.items() if parameters[symbol].value is None},
    }
    residual_m = None if whole is None else whole.residual_rms_m
    return Estimate(METHOD, status, joined(" ", told), residual_m, parameters, diagnostics)


def _hides_stops(reading: Reading, whole: Dynamic) -> bool:
    """Whether the rows are too slow to show at what speed a stem of this lag stops."""
    return reading.samples.period_s > _STOP_ROWS * whole.best.unknowns.dynamics.lag_s


def _may_creep(basis: Basis, whole: Dynamic | None, quantities: Mapping[str, Quantity]) -> bool:
    """Whether friction on all ramps is as large as F_s, and the stem may have been slower than DV on each of them.

    A stem that creeps below DV feels F_s, or rests again and again, too shortly to be seen. One ramp with less, slow or
    fast, shows that it slides. The balance alone is held by the slowest: it knows no DV, and F_s only to its interval,
    as slow rows on one ramp do.
    """
    if whole is not None:
        is_slow = _hides_stops(basis.reading, whole)
        quantities = whole.quantities
        rates = np.array([np.median(np.abs(one.rate_n_per_s)) for one in whole.best.model.sections.sections])
        fastest = float(rates.max()) / quantities["k"].value
        if not is_slow and quantities["DV"].ci95[1] < _CLEARLY_BELOW * fastest:
            return False
        slowest = float(rates.min()) / quantities["k"].value
        slow_n, fast_n = (quantities["F_c"].value + quantities["F_v"].value * one for one in (slowest, fastest))
        static = quantities["F_s"]
        least_n = static.ci95[0] if is_slow and slowest > _ONE_RAMP * fastest else static.value
        return least_n < (1.0 + NO_JUMP) * slow_n and static.value > (1.0 - NO_JUMP) * fast_n
    if basis.stepped or basis.yields_m or not {"k", "F_c", "F_s"} <= quantities.keys():
        return False
    moving_n = quantities["F_c"].value + basis.lag.value * float(np.abs(basis.found.blocks.rate_n_per_s).min())
    return quantities["F_s"].ci95[0] < (1.0 + NO_JUMP) * moving_n


def _not_explained(sections: Sections) -> Message:
    """What is said of motions that the fit of the others does not explain."""
    return say(
        "motions_left_out",
        "{left} of {count} motions were left out: what the others show does not explain them, as where a stem rested "
        "on its way too shortly to be seen.",
        left=sections.left_out,
        count=sections.left_out + sections.count,
    )


def _without_motion(basis: Basis) -> str:
    """Why the balance of forces alone is given."""
    if basis.yields_m:
        return say(
            "yields_before_breakaway",
            "the stem yields by {way:.2g mm} before it breaks away: how it starts shows it not",
            way=float(basis.yields_m),
        )
    return _LEAPS if basis.leaps else _NO_MOTION


def hidden_jumps(band_m: float, quantities: Mapping[str, Quantity]) -> str:
    """Return what is said where the noise hides the jumps that the stem may make, "" where a jump is proven.

    ``band_m`` (m) is what the noise hides; k in N/m, F_c and F_s in N. A jump is proven that is longer than 1.5 bands
    by more than its own 95 % interval.
    """
    spring = quantities.get("k")
    static, coulomb = quantities.get("F_s"), quantities.get("F_c")
    if spring is None or coulomb is None or spring.value <= 0.0:
        return ""
    if static is not None:
        unsure_n = NORMAL_95 * math.hypot(static.std_error, coulomb.std_error)
        if static.value - coulomb.value - unsure_n > _HIDDEN_BANDS * band_m * spring.value:
            return ""
    return say(
        "jumps_hidden",
        "Jumps of less than {band:.2g mm} cannot be told from sliding in this noise: if the stem makes them, F_c is an "
        "effective friction between F_c and F_s.",
        band=float(band_m),
    )


def _parameter(quantity: Quantity, scale: float) -> ParameterEstimate:
    """The quantity as the contract has it; ``scale`` is what a quantity that may be zero is judged against."""
    low, high = quantity.ci95
    half, limit = 0.5 * (high - low), LARGEST_RELATIVE_HALF_WIDTH * max(abs(quantity.value), scale)
    if not half <= limit:
        share = half / max(abs(quantity.value), 1.0e-300)
        if share > 1.0:
            return absent(_UNKNOWN)
        return absent(
            say(
                "known_badly_alone",
                "known to +-{share:.0f %} only, the limit is {limit:.0f %}",
                share=share,
                limit=LARGEST_RELATIVE_HALF_WIDTH,
            )
        )
    return ParameterEstimate(quantity.value, quantity.std_error, (low, high))
