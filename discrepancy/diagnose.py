"""The diagnosis: how well the simulation fits, what is wrong with it, and what naming that gains."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from discrepancy.accepted import Standing, stand
from discrepancy.baseline import fit_baseline
from discrepancy.causes.base import Cause
from discrepancy.choice import Choice
from discrepancy.diagnosis import Diagnosis, Finding, Verdict
from discrepancy.doubts import doubt
from discrepancy.fine_rows import told_from
from discrepancy.from_balance import from_balance
from discrepancy.gain import Gain, held_out_gain, left_out_gain
from discrepancy.gauge_tone import gauge_tone
from discrepancy.intervals import fitted_values, may_be_nothing
from discrepancy.least_squares import Fit
from discrepancy.line_errors import with_line_errors
from discrepancy.observed import observe
from discrepancy.preload import PRELOAD, bent_instead, friction_instead, preload_offset
from discrepancy.pressure_findings import with_pressure_findings
from discrepancy.profile import at_the_lowest
from discrepancy.registry import CAUSES
from discrepancy.residuals import show
from discrepancy.saved_model import SavedModel
from discrepancy.selection import choose
from discrepancy.setting import setting_of
from discrepancy.significance import DONE_MISFIT, excess, least_rms, misfit, noise_factor, wander
from estimators.base import Estimate, Outcome
from valve.nameplate import Action, Nameplate
from valve.recording import Recording

Progress = Callable[[float, str], None]

# Own choices, from valves with hidden effects and from oddities of no catalogue (docs/diagnosis.md): what a right
# cause may leave, in the variance of the residuals and in that of the means of their pieces.
_LARGEST_MISFIT: Final = 1.3
# Several causes together can mimic one that is not among them: they must leave nothing but noise.
_LARGEST_FACTORS: Final = (2.5, 4.0, 1.5, 1.5)  # with no cause, one, two and three
_LARGE: Final = 2.0  # misfit beyond noise
_NEXT_TO_NOTHING: Final = 0.02  # of it
# What hangs together in the residuals over what the plain valve misses by, rms: what mimics a cause misses by more.
_NO_MIMICRY: Final = 2.0e-3
_WRONG_UNITS: Final = ((6894.757, "psi"), (1.0e5, "bar"), (1.0e3, "kPa"))
_NEAR_UNIT: Final = 2.0  # times; psi, kPa and bar are 6.9 apart
_SCALE_OFF: Final = 2.0  # of the spring rate: no effect of the catalogue goes so far
_NOTHING_NEW: Final = "Nothing beyond the model that was accepted for this valve."
_IN_DOUBT: Final = 3.0  # noises, by which the instants of a polled test's writes and looks move its positions
_ENDED_EARLY: Final = (
    " The search was ended early, at the most work that one diagnosis may take: causes that were not tried to the end "
    "may explain it yet."
)
_NO_FORCE: Final = "A drive without a spring is assessed by its balance of forces."


def diagnose(
    recordings: Sequence[Recording],
    nameplate: Nameplate,
    *,
    held_out: Sequence[tuple[str, Recording]] = (),
    estimate: Estimate | None = None,
    accepted: SavedModel | None = None,
    progress: Progress | None = None,
) -> Diagnosis:
    """Return what the simulation of this valve gets wrong in its recordings, why, and what mending it gains.

    The recordings are fitted together. ``held_out`` are named ones on which the gain is measured; ``estimate`` is the
    maximum-likelihood one of the first, from which the fit starts. ``accepted`` is the extended model that somebody
    accepted for this valve: its causes belong to the baseline, and only what changed since or is new is named. Odd
    recordings give ``not_assessed``.
    """
    tell = progress or (lambda _share, _phase: None)
    if not recordings:
        return Diagnosis(Verdict.NOT_ASSESSED, "There is no recording: give one.")
    doubted = doubt(recordings, nameplate)
    if doubted:
        return Diagnosis(Verdict.NOT_ASSESSED, doubted)
    if nameplate.actuator.action is Action.DOUBLE:
        return Diagnosis(Verdict.NOT_ASSESSED, _NO_FORCE)
    tell(0.0, "fitting the valve")
    with np.errstate(all="ignore"):
        nameplate = nameplate if accepted is None else accepted.nameplate(nameplate)
        observed = observe(recordings, nameplate)
        if isinstance(observed, Outcome):
            return Diagnosis(Verdict.NOT_ASSESSED, str(observed))
        baseline = fit_baseline(observed, estimate)
        if baseline is None:
            return Diagnosis(Verdict.NOT_ASSESSED, str(Outcome.UNPHYSICAL))
        unit = _unit_message(baseline)
        if unit:
            return Diagnosis(Verdict.NOT_ASSESSED, unit, before=show(baseline), baseline=baseline)
        if observed.doubt_in_noises > _IN_DOUBT:
            return with_pressure_findings(_of_doubtful_instants(baseline), baseline, recordings, nameplate, held_out)
        baseline = from_balance(with_line_errors(baseline))
        standing = None if accepted is None else stand(baseline, accepted)
        if standing is not None:
            baseline = standing.free
        known = [one for one in CAUSES.values() if one.is_visible(observed) and one.name not in baseline.model.causes]
        choice = choose(baseline, known, lambda share, phase: tell(0.15 + 0.65 * share, phase))
        choice = at_the_lowest(choice)
        tell(0.8, "measuring the gain")
        found = _concluded(choice, recordings, nameplate, held_out, standing)
        return with_pressure_findings(found, choice.best, recordings, nameplate, held_out)


def _concluded(
    choice: Choice,
    recordings: Sequence[Recording],
    nameplate: Nameplate,
    held_out: Sequence[tuple[str, Recording]],
    standing: Standing | None = None,
) -> Diagnosis:
    baseline, best = choice.baseline, choice.best
    changed = () if standing is None else standing.changed
    if standing is not None and changed:
        baseline = standing.held
    details: dict[str, Any] = {
        "misfit_before": misfit(baseline),
        "misfit_after": misfit(best),
        "noise_factor_after": noise_factor(best),
        "tried": [{"cause": name, "gain": gain} for name, gain in choice.tried],
    }
    pictures: dict[str, Any] = {"before": show(baseline), "baseline": baseline, "details": details}
    if not (explains(best, baseline) or explains(with_line_errors(best), baseline)):
        return Diagnosis(Verdict.UNEXPLAINED, unexplained_message(choice), **pictures)
    undone = gauge_tone(best)
    if undone:
        return Diagnosis(Verdict.UNEXPLAINED, undone, **pictures)
    findings = [] if standing is None else standing.findings(best)
    fine = told_from(best, recordings, nameplate)
    own = [finding_of(best, fine, baseline, cause) for cause in choice.causes]
    if any(may_be_nothing(cause, one.parameters) for cause, one in zip(choice.causes, own, strict=True)):
        message = (
            f"{_listed(choice.causes)} would explain the misfit, and its strength is known so badly that it may be "
            "nothing: no cause is named."
        )
        return Diagnosis(Verdict.UNEXPLAINED, message, **pictures)
    findings += own
    rivals, rival_fits = list(choice.rivals), list(choice.rival_fits)
    offset = preload_offset(best)
    if offset is not None:
        sentence = PRELOAD.sentence({"offset_n": offset}, setting_of(best))
        told = Finding(PRELOAD.name, sentence, PRELOAD.action, {"offset_n": offset}, 0.0)
        bent = bent_instead(best, CAUSES.values())
        instead = friction_instead(best)
        # the one that has rivals is told first
        place = 0 if not rivals and (bent or instead) else len(findings)
        findings.insert(place, told)
        rivals += [cause.name for cause, _ in (*bent, *instead)]
        rival_fits += [fit for _, fit in (*bent, *instead)]
    if not findings:
        return Diagnosis(Verdict.NONE, "" if standing is None else _NOTHING_NEW, **pictures)
    gains: list[Gain] = []
    if choice.causes or changed:
        measured = [held_out_gain(name, one, nameplate, baseline, best) for name, one in held_out]
        left = left_out_gain(baseline, best)
        gains = [gain for gain in (*measured, left) if gain is not None]
        if any(gain.is_worse or gain.is_none for gain in gains):
            named = _listed((*changed, *choice.causes))
            is_worse = any(gain.is_worse for gain in gains)
            gained = "worse than the plain valve does" if is_worse else "no better than the plain valve does"
            message = (
                f"{named} would explain the misfit, and predicts data that it was not fitted to {gained}: "
                "no cause is named."
            )
            return Diagnosis(Verdict.UNEXPLAINED, message, gains=tuple(gains), **pictures)
    return Diagnosis(
        Verdict.AMBIGUOUS if rivals else Verdict.NAMED,
        "",
        tuple(findings),
        tuple(rivals),
        tuple(gains),
        after=show(best),
        extended=fine,
        rival_fits=tuple(rival_fits),
        **pictures,
    )


def _of_doubtful_instants(baseline: Fit) -> Diagnosis:
    """Return the diagnosis of a polled test whose positions are known worse by their instants than by the sensor."""
    pictures: dict[str, Any] = {"before": show(baseline), "baseline": baseline}
    if explains(baseline):
        return Diagnosis(Verdict.NONE, "", **pictures)
    message = (
        "The instants of the polled writes and samples are known so badly that they move the positions in motion by "
        f"{baseline.model.observed.doubt_in_noises:.2g} times the sensor's noise, {_IN_DOUBT:g} times are allowed: no "
        'cause can be told from that. Capture in the device (acquisition mode "captured").'
    )
    return Diagnosis(Verdict.NOT_ASSESSED, message, **pictures)


def explains(fit: Fit, baseline: Fit | None = None) -> bool:
    """Whether what a fit leaves may be noise, or so little more that a name for the rest is not missed.

    The plain valve also where what hangs together is less than a cause would have to be; a single hard cause also where
    it leaves next to nothing of a ``baseline``'s large misfit, for slips follow the last digits of a fit; any causes
    also where no more than a five-hundredth of the misfit's size hangs together, and lies below the noise; or, of a
    single one, no more than its law's own error leaves of what hung together.
    """
    if misfit(fit) >= _LARGEST_MISFIT:
        return False
    causes = len(fit.model.causes)
    if causes == 0 and wander(fit) < least_rms(fit):
        return True
    if causes == 1 and baseline is not None and CAUSES[fit.model.causes[0]].is_hard:
        large = excess(baseline)
        if large > _LARGE and excess(fit) < _NEXT_TO_NOTHING * large:
            return True
    if causes > 0 and baseline is not None and misfit(fit) < DONE_MISFIT:
        missed = math.sqrt(excess(baseline))
        # what one cause does its law is not known better than to its own error
        own_error = CAUSES[fit.model.causes[0]].law_error if causes == 1 else 0.0
        if wander(fit) < max(_NO_MIMICRY * missed, own_error * wander(baseline)):
            return True
    return noise_factor(fit) < _LARGEST_FACTORS[min(causes, len(_LARGEST_FACTORS) - 1)]


def finding_of(best: Fit, fine: Fit, baseline: Fit, cause: Cause) -> Finding:
    """Return a cause with its sentence, its parameters by ``fine``, and the share of the misfit that all explain."""
    values = fitted_values(fine, cause)
    sentence = cause.sentence(values, setting_of(best))
    share = 1.0 - excess(best) / max(excess(baseline), excess(best), 1.0e-12)
    return Finding(cause.name, sentence, cause.action, values, min(max(share, 0.0), 1.0))


def unexplained_message(choice: Choice) -> str:
    """Return what a misfit that no cause explains is told as."""
    ratio = misfit(choice.best) ** 0.5
    told = f"The simulation misses the measurement by {ratio:.1f} times the noise"
    if ratio < 1.05:
        hanging = f"{wander(choice.best):.2g} times the noise"
        told = f"The simulation misses by no more than the noise, yet what it leaves hangs together ({hanging})"
    early = _ENDED_EARLY if choice.is_cut else ""
    if not choice.causes:
        return f"{told}, and no cause of the catalogue {'that was tried ' if early else ''}takes that away.{early}"
    share = 1.0 - excess(choice.best) / max(excess(choice.baseline), 1.0e-12)
    return (
        f"{told} with the nearest of the catalogue in it ({_listed(choice.causes)}, which takes {100.0 * share:.0f} % "
        f"of the misfit): something else is there, or besides, that has no name here.{early}"
    )


def _listed(causes: Sequence[Cause]) -> str:
    return " and ".join(cause.name for cause in causes)


def _unit_message(fit: Fit) -> str:
    """Return what is wrong with the pressure's unit where the spring rate says so."""
    nominal = fit.model.observed.nameplate.nominal_spring_rate_n_per_m
    if nominal is None:
        return ""
    ratio = fit.values["k"] / nominal
    for factor, unit in _WRONG_UNITS:
        for wrong, sense in ((1.0 / factor, f"is in {unit} and was read as Pa"), (factor, f"was taken for {unit}")):
            if ratio > 0.0 and abs(math.log(ratio / wrong)) < math.log(_NEAR_UNIT):
                return (
                    f"The spring is {ratio:.3g} times as stiff as the nameplate's bench set says: the pressure "
                    f"{sense}, it seems. Correct the pressure's unit."
                )
    if not 1.0 / _SCALE_OFF < ratio < _SCALE_OFF:
        return (
            f"The spring is {ratio:.3g} times as stiff as the nameplate's bench set says, so the misfit is a scale: "
            "correct the bench set, the travel, or the range of the pressure or the position."
        )
    return ""


__all__ = ["Diagnosis", "Finding", "Progress", "Verdict", "diagnose", "explains", "finding_of", "unexplained_message"]
