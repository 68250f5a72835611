"""One recording in, what is wrong with the valve out: friction as it varies, causes that explain a part, the gain."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np

from discrepancy.rough.accepted import NOTHING_NEW, Accepted, accepted_in
from discrepancy.rough.causes import HIDING_CAUSES, INPUT_CAUSES, SEEN_CAUSES
from discrepancy.rough.causes.command_loop import command_loop
from discrepancy.rough.causes.presliding import Presliding
from discrepancy.rough.causes.seen import Seen, SeenCause, View
from discrepancy.rough.creeping import moves_at_rest
from discrepancy.rough.evidence import Solved, fitted, problem_of, surely
from discrepancy.rough.findings import extended_model, findings
from discrepancy.rough.force_wander import wanders_alike
from discrepancy.rough.latent import latent_friction, strongest, way_words
from discrepancy.rough.misfit import misfit
from discrepancy.rough.observations import as_measured, is_settled, observations
from discrepancy.rough.pictures import pictures
from discrepancy.rough.prediction import Gain, Predictor
from discrepancy.rough.remarks import remarks
from discrepancy.rough.result import Finding, RoughDiagnosis, Verdict
from discrepancy.rough.saved_model import SavedModel
from discrepancy.rough.scale import wrong_scale
from discrepancy.rough.selection import NAMED, Selection, selected
from discrepancy.rough.separating import Undecided
from discrepancy.rough.setting import Setting, setting_of
from estimators.base import Estimate, Outcome
from estimators.engine.lateness import lag_after_corners
from estimators.engine.parameters import Known
from estimators.engine.reading import Reading
from estimators.engine.slips import lag_of_slips
from estimators.engine.yielding import WAY
from valve.messages import Message, joined, say
from valve.nameplate import Nameplate
from valve.recording import Recording

Named = tuple[str, Recording]

_FEWEST_BLOCKS: Final = 6
_FEWEST_SLIPS: Final = 4  # each way
_NO_SLIDES: Final = say(
    "stem_hardly_slides", "the stem hardly slides in this test: repeat it with a larger amplitude or a faster ramp"
)
_NEEDS_SLIDES: Final = say(
    "needs_slides", "What only a stem that slides shows could not be looked for: {why}.", why=_NO_SLIDES
)
_SHAKEN: Final = say(
    "hidden_by_shaking",
    "Friction is what the shaken stem shows, and what else is wrong could not be looked for: stop what shakes it, and "
    "repeat the test.",
)
_NO_FRICTION: Final = say(
    "friction_not_seen", "what the forces leave has no friction in it: check sensors and nameplate"
)
_ONE_WAY: Final = say("judged_one_way", "the stem moved in one direction only: repeat the test with both")
_LOOSE_PACKING: Final = say(
    "measure_bench_set",
    "Measure the bench set: the pressures at which the stem starts and ends, with the packing loose.",
)
_SLOW_S: Final = 0.1  # a lag that quick sweeps leave rows for
_SEVERAL: Final = 1.5  # times the slow rate of the force
_LATER: Final = 1.3  # times what corners show
_SHOWN_LAG_S: Final = 0.02
_LAG_OF_ENGINE: Final = 0.2  # of it: its error
_LAG_ERROR: Final = 0.1  # of a lag that the balance found with too short a settling
_KNOWN: Final = 0.05  # of F_c: its error
_KEPT: Final = 0.3  # of the blocks at least, with a longer one
# What packings in good order do at most, with a margin; beyond it is a finding.
_ROUGHEST: Final = 0.08  # of F_c, along the travel
_WANDERS: Final = 0.05  # of F_c, in time
_OF_FULL_FORCE: Final = 0.004  # or of the full force: what gauge and I/P leave
_SCATTERS: Final = 0.12  # of F_s, from breakaway to breakaway
_SOMETHING: Final = 25.0  # nats of a cause that is not believed: something is there
_ALIKE: Final = 0.05  # percent
_CREEPS: Final = 2.5  # limit velocities
_FEWEST_TO_SCATTER: Final = 6
_FEWEST_BESIDE_CAUSE: Final = 3  # that a cause which fits one of them cannot take up


def diagnose(
    recording: Recording,
    nameplate: Nameplate,
    estimate: Estimate | None = None,
    *,
    held_out: Sequence[Named] = (),
    model: SavedModel | None = None,
) -> RoughDiagnosis:
    """Return what is wrong with the valve of this recording.

    ``estimate`` is the engine's of the same recording, whose mass, damping and sensor's filter are used where it has
    them. ``held_out`` are recordings of the same valve, by name, that the gain is measured on; without any it is a part
    of the recording. ``model`` is the extended one that was accepted for the valve: its causes are part of the plain
    valve, and only what changed since or is new is told.
    """
    nameplate = nameplate if model is None else model.nameplate(nameplate)
    input_alone = partial(_by_input, recording, model)
    # behind a dead band or a loop the pressure is no delayed command: then it is read without
    followed = recording if command_loop(recording) is None else replace(recording, command_pa=None)
    reading = as_measured(followed, nameplate)
    if isinstance(reading, Outcome):
        return input_alone(
            say(
                "no_motion_to_judge",
                "the recording shows no motion that could be judged: {why}",
                why=reading.message.formed("clause"),
            )
        )
    if len(reading.segmentation.directions) < 2:
        return input_alone(_ONE_WAY)
    creeping_m_per_s = _CREEPS * _limit_velocity(estimate)
    lag = _lag(reading, estimate)
    null = _plain(reading, nameplate, lag, creeping_m_per_s)
    if null is None and lag.value > _SLOW_S:
        # quick sweeps leave no rows for a long settling
        lag = Known(_SLOW_S, lag.value)
        null = _plain(reading, nameplate, lag, creeping_m_per_s)
    slips = null is None
    if null is None:
        lag = lag_of_slips(reading)
        null = _plain(reading, nameplate, lag, 0.0, slips=True)
    if null is None:
        return input_alone(_NO_SLIDES)
    late = null.known("lag")
    if not slips and not is_settled(lag, late.value):
        # a heavily damped stem: its transients look like friction that falls with speed
        longer = Known(late.value, max(late.std_error, _LAG_ERROR * late.value))
        settled = _plain(reading, nameplate, longer, creeping_m_per_s, int(null.problem.rows.is_slide.sum()))
        null, lag = (null, lag) if settled is None else (settled, longer)
    setting = _setting(null, reading, nameplate, creeping_m_per_s)
    soft = Presliding().seen(View(recording, nameplate, reading, setting, null, estimate))
    if soft is not None:
        # what a stem does on its bristles is neither sliding nor a breakaway
        way_m = WAY * soft.fitted["deflection_m"].value
        firm = _plain(reading, nameplate, lag, creeping_m_per_s, yields_m=way_m)
        null, slips = (null, True) if firm is None else (firm, slips)
        setting = _setting(null, reading, nameplate, creeping_m_per_s)
    rows = null.problem.rows
    wrong = wrong_scale(null.known("k").value, nameplate) if rows.has_spring else None
    if wrong is not None:
        return RoughDiagnosis(Verdict.NOT_ASSESSED, wrong, latent=latent_friction(null))
    accepted = accepted_in(model, setting)
    if accepted.laws:
        null = fitted(null.problem, accepted.columns(null.problem))
    view = View(recording, nameplate, reading, setting, null, estimate)
    first = HIDING_CAUSES if rows.has_spring else ()
    seen = [(one, shown) for one in first if (shown := one.seen(view)) is not None]
    is_hidden = bool(seen)
    candidates = [] if is_hidden else [one for one in accepted.candidates(setting) if one.by_slips or not slips]
    selection = selected(null, [one for one in candidates if rows.has_spring or not one.needs_spring])
    view = replace(view, null=selection.null)
    for other in SEEN_CAUSES if rows.has_spring else ():
        shows_else = selection.rounds or any(cause not in INPUT_CAUSES for cause, _ in seen)
        free = other.by_slips if slips else not (other.is_last and shows_else)
        if free and (shown := other.seen(view)) is not None:
            seen.append((other, shown))
    if null.known("F_c").value <= 0.0 and not is_hidden and not any(cause.is_last for cause, _ in seen):
        return input_alone(_NO_FRICTION)
    found = _concluded(view, selection, seen, held_out, accepted)
    if is_hidden:
        return replace(found, not_looked_for=_SHAKEN)
    if not slips:
        return found
    if found.verdict is Verdict.NONE:
        # whether friction falls with speed, or grows at rest, does not show
        return replace(found, verdict=Verdict.NOT_ASSESSED, message=_cannot_tell(_NO_SLIDES))
    return replace(found, not_looked_for=_NEEDS_SLIDES)


def _lag(reading: Reading, estimate: Estimate | None) -> Known:
    """How late the stem follows, s: by its corners, or by the engine's F_v / k where that is clearly more.

    A stem that is damped so much that it rests at once where the force turns has no tail there, or a poor one. At one
    speed the engine has no other source either.
    """
    lag = lag_after_corners(reading)
    if estimate is None or not _at_several_speeds(reading):
        return lag
    damping, spring = (estimate.value(symbol) for symbol in ("F_v", "k"))
    if damping is None or not spring or damping / spring < _LATER * max(lag.value, _SHOWN_LAG_S):
        return lag
    return Known(damping / spring, _LAG_OF_ENGINE * damping / spring)


def _at_several_speeds(reading: Reading) -> bool:
    """Whether the force was driven through the moves at clearly different rates."""
    time_s, force_n = reading.time_s, reading.path.force_n
    moves = [one for one in reading.segmentation.moves if one.last > one.first]
    rates = [abs(float((force_n[m.last] - force_n[m.first]) / (time_s[m.last] - time_s[m.first]))) for m in moves]
    return bool(rates) and float(np.quantile(rates, 0.9)) > _SEVERAL * float(np.quantile(rates, 0.1))


def _setting(null: Solved, reading: Reading, nameplate: Nameplate, creeping_m_per_s: float) -> Setting:
    """The sizes of this valve, friction by the plain fit where that knows it."""
    setting = setting_of(null.problem.rows, reading, nameplate, creeping_m_per_s)
    setting = replace(setting, late_s=max(null.known("lag").value, 0.0))
    coulomb, static = null.known("F_c"), null.known("F_s")
    if coulomb.std_error < _KNOWN * coulomb.value:
        # least squares take what is viscous for dry friction
        setting = replace(setting, friction_n=coulomb.value, static_n=max(coulomb.value, static.value))
    return setting


def _plain(
    reading: Reading,
    nameplate: Nameplate,
    lag: Known,
    creeping_m_per_s: float,
    of: int = 0,
    *,
    slips: bool = False,
    yields_m: float = 0.0,
) -> Solved | None:
    """The plain valve whose stem follows that late; None with too little motion, as such and of so many blocks.

    ``slips``: also from what it does from rest to rest. ``yields_m``: so far from where the force turned the stem moves
    without sliding.
    """
    rows = observations(reading, lag, slips=slips).above(creeping_m_per_s)
    if yields_m > 0.0:
        rows = rows.beyond(reading, yields_m)
    slide = rows.is_slide
    fewest = max(_FEWEST_BLOCKS, _KEPT * of)
    ways = [int((rows.direction[slide] == way).sum()) for way in (1.0, -1.0)]
    if int(slide.sum()) < fewest or min(ways) < (_FEWEST_SLIPS if slips else 1):
        return None
    problem = problem_of(rows, setting_of(rows, reading, nameplate, creeping_m_per_s), lag)
    return fitted(problem, problem.no_columns)


def _limit_velocity(estimate: Estimate | None) -> float:
    """DV, m/s: 0 where the estimate saw nothing of it, infinite where nobody looked."""
    if estimate is None or "DV" not in estimate.parameters:
        return math.inf
    return estimate.parameters["DV"].value or 0.0


def _cannot_tell(reason: Message) -> Message:
    return say("cannot_tell", "Cannot tell: {why}.", why=reason)


def _not_looked_for(reason: Message) -> Message:
    return say("other_causes_not_looked_for", "Other causes could not be looked for: {why}.", why=reason)


def _by_input(recording: Recording, model: SavedModel | None, reason: Message) -> RoughDiagnosis:
    """What command and pressure show of a valve whose stem shows nothing, for that reason."""
    accepted = Accepted(model)
    seen = [(cause, one) for cause in INPUT_CAUSES if (one := cause.seen_in(recording)) is not None]
    found = tuple(
        Finding(cause.name, cause.told(one.fitted), cause.action, one.fitted)
        for cause, one in seen
        if accepted.has_changed(cause.name, one)
    )
    if not found:
        return RoughDiagnosis(Verdict.NOT_ASSESSED, _cannot_tell(reason))
    said = joined(" ", [one.sentence for one in found])
    return RoughDiagnosis(Verdict.NAMED, said, causes=found, not_looked_for=_not_looked_for(reason))


def _concluded(
    view: View,
    selection: Selection,
    seen: Sequence[tuple[SeenCause, Seen]],
    held_out: Sequence[Named],
    accepted: Accepted,
) -> RoughDiagnosis:
    null, model, setting = selection.null, selection.model, view.setting
    laws = tuple((one.cause, one.shape) for one in selection.causes)
    usual = tuple(one for cause, one in seen if not accepted.has_changed(cause.name, one))
    seen = [(cause, one) for cause, one in seen if accepted.has_changed(cause.name, one)]
    new = tuple(one for _, one in seen)
    predictor = Predictor(null, model, accepted.laws, laws, usual, new, setting, view.estimate, view.nameplate)
    gains: list[Gain] = []
    # without a spring a position that is simulated from the force drifts, as nothing draws it back
    if null.problem.rows.has_spring:
        gains = [gain for name, one in held_out if (gain := predictor.elsewhere(name, one)) is not None]
        if not gains and (own := predictor.left_out(view.reading)) is not None:
            gains = [own]
    found = findings(view, selection, seen, accepted)
    verdict, message, rivals = _verdict(view, selection, seen, found, gains)
    if verdict is Verdict.NONE and accepted.model is not None:
        message = joined(" ", (message, NOTHING_NEW))
    told = tuple(found) if verdict in {Verdict.NAMED, Verdict.LIKELY, Verdict.AMBIGUOUS} else ()
    with_causes = model if told else None
    missed = misfit(null, with_causes, view.reading.noise_m)
    return RoughDiagnosis(
        verdict,
        message,
        causes=told,
        not_told_apart_from=rivals,
        remarks=remarks(view, is_plain=not told),
        gain=gains[0] if gains else None,
        gains=tuple(gains),
        latent=latent_friction(null),
        latent_after=latent_friction(model) if told else (),
        misfit=missed,
        extended=extended_model(model, told, accepted.model) if told else None,
        pictures=pictures(null, with_causes, predictor.valves(), view.reading, missed),
        undecided=_undecided(view, selection, predictor, accepted) if verdict is Verdict.AMBIGUOUS else None,
        separating_test=_separating(rivals) if verdict is Verdict.AMBIGUOUS else None,
        details={
            "friction_varies_by": _variation(null),
            "tried": [
                {
                    "cause": one.cause.name,
                    "evidence_nats": one.evidence,
                    "size": one.size.value,
                    "error": one.size.std_error,
                }
                for one in selection.tried
            ],
        },
    )


def _undecided(view: View, selection: Selection, predictor: Predictor, accepted: Accepted) -> Undecided | None:
    """Return the first cause that has rivals, and them."""
    for number, part in enumerate(selection.rounds):
        if part.rivals:
            return Undecided(view, accepted, selection.causes[:number], part.best, part.rivals, predictor.valves()[1])
    return None


def _verdict(
    view: View,
    selection: Selection,
    seen: Sequence[tuple[SeenCause, Seen]],
    found: Sequence[Finding],
    gains: Sequence[Gain],
) -> tuple[Verdict, str, tuple[str, ...]]:
    rivals = tuple(one.cause.name for part in selection.rounds for one in part.rivals)
    refused = bool(gains) and all(gain.is_far_worse if seen else gain.is_worse for gain in gains)
    # a cause beside which so much changes in time stands in for what is in no catalogue
    beyond: Message | None = None
    if selection.causes and not seen:
        beyond = _unsteady(view, selection.model, _FEWEST_BESIDE_CAUSE)
    elif seen and all(cause.is_last for cause, _ in seen):
        beyond = _wanders(view, selection.null)
    if found and beyond is None and (moves := _what_moves_besides(view, selection, seen)) is not None:
        return Verdict.UNEXPLAINED, moves, ()
    if found and not refused and beyond is None:
        said = joined(" ", [one.sentence for one in found])
        if rivals:
            apart = say(
                "not_told_apart",
                "{finding} This test does not tell it apart from {rivals:, }.",
                finding=said,
                rivals=rivals,
            )
            return Verdict.AMBIGUOUS, apart, rivals
        weak = [one for one in selection.causes if one.evidence < NAMED]
        if weak and len(weak) == len(selection.causes) and not seen:
            return (
                Verdict.LIKELY,
                say("probably", "Probably: {finding} A second test would prove it.", finding=said),
                (),
            )
        return Verdict.NAMED, said, ()
    if beyond is None and seen and found:
        said = joined(" ", [one.sentence for one in found])
        return (
            Verdict.UNEXPLAINED,
            say(
                "seen_predicts_worse",
                "{finding} But with it what was left out of the fit is predicted worse than without: repeat the test.",
                finding=said,
            ),
            (),
        )
    if beyond is None:
        beyond = _beyond_class(view, selection.null)
    nearly = max([*selection.tried], key=lambda one: one.evidence, default=None)
    if beyond is not None:
        return Verdict.UNEXPLAINED, joined(" ", (beyond, _unexplained(selection))), ()
    if nearly is not None and nearly.evidence > _SOMETHING and nearly.swing_n > _ROUGHEST * view.setting.friction_n:
        return Verdict.UNEXPLAINED, _unexplained(selection), ()
    share = _variation(selection.null)
    if share > _ROUGHEST:
        varies = say(
            "friction_varies_more",
            "Friction varies by {share:.1f %} along the travel, more than packings usually do: see where.",
            share=share,
        )
    else:
        varies = say(
            "friction_varies", "Friction varies by {share:.1f %} along the travel, as packings do.", share=share
        )
    if 100.0 * share < _ALIKE:
        varies = say("friction_alike", "Friction is alike all along the travel.")
    return Verdict.NONE, say("no_fault", "No fault found. {how}", how=varies), ()


def _what_moves_besides(view: View, selection: Selection, seen: Sequence[tuple[SeenCause, Seen]]) -> Message | None:
    """What moves in time that is no friction and no stem: a cause may only stand in for it. None where nothing does."""
    if all(cause.name != Presliding.name for cause, _ in seen):
        moves = moves_at_rest(view.reading)
        if moves is not None:
            return moves
    # what else is seen, such as a stop, shows itself whatever wanders
    if not all(cause.is_last for cause, _ in seen):
        return None
    return wanders_alike(selection.null, selection.model, view.setting.full_force_n)


def _variation(null: Solved) -> float:
    """How much friction varies along the travel, as a share of F_c."""
    whole_n = float(np.hypot(null.hyperparameter("common"), null.hyperparameter("own")))
    return whole_n / max(null.known("F_c").value, 1.0e-9)


def _beyond_class(view: View, null: Solved) -> Message | None:
    """What of the friction's variation no packing in good order does; None where there is nothing."""
    setting = view.setting
    least_n = _OF_FULL_FORCE * setting.full_force_n
    rough_n = float(np.hypot(null.hyperparameter("common"), null.hyperparameter("own")))
    if rough_n > max(_ROUGHEST * setting.friction_n, least_n):
        return say(
            "friction_varies_much",
            "Friction varies by {share:.0f %} along the travel, more than packings do.",
            share=_variation(null),
        )
    return _unsteady(view, null, _FEWEST_TO_SCATTER)


def _unsteady(view: View, model: Solved, fewest: int) -> Message | None:
    """What no packing in good order does from time to time; None where there is nothing.

    Their scatter counts by the low end of its interval.
    """
    wanders = _wanders(view, model)
    if wanders is not None:
        return wanders
    setting = view.setting
    scatter_n, count = model.hyperparameter("scatter"), int((~model.problem.rows.is_slide).sum())
    most_n = max(_SCATTERS * setting.static_n, _OF_FULL_FORCE * setting.full_force_n)
    if count >= fewest and surely(scatter_n, count) > most_n:
        return say(
            "breakaway_differs_much",
            "The force at which the stem breaks away differs by {share:.0f %} from one to the next.",
            share=scatter_n / setting.static_n,
        )
    return None


def _wanders(view: View, model: Solved) -> Message | None:
    """What of the friction changes in time by more than packings in good order do; None where it does not."""
    setting = view.setting
    wander_n = model.hyperparameter("wander")
    if wander_n > max(_WANDERS * setting.friction_n, _OF_FULL_FORCE * setting.full_force_n):
        return say(
            "friction_changes_much",
            "Friction changes by {share:.0f %} in time, more than packings do.",
            share=wander_n / setting.friction_n,
        )
    return None


def _unexplained(selection: Selection) -> Message:
    """Where the latent friction is strongest."""
    curve, at = strongest(selection.null)
    force_n, half_n = float(curve.force_n[at]), float(curve.half_n[at])
    if curve.coordinate == "travel_m":
        way = way_words(curve.direction)
        place = say("at_place_going", "at {at:.1f mm}, {way}", at=float(curve.at[at]), way=way)
    else:
        place = say("after_start", "{time:.0f} s after the start", time=float(curve.at[at]))
    return say(
        "friction_off_mean",
        "Friction is {force:+.3g N} (+-{half:.2g in N}) off its mean {place}; no known cause explains it.",
        force=force_n,
        half=half_n,
        place=place,
    )


def _separating(rivals: Sequence[str]) -> str | None:
    """Which test separates the causes; None where none is known."""
    if "spring_preload" in rivals or "friction_asymmetry" in rivals:
        return _LOOSE_PACKING
    return None
