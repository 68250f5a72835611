"""A test beside the model that was accepted for its valve: what of it still holds, and what has changed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from discrepancy.baseline import DYNAMIC, held_fit
from discrepancy.causes.base import Cause, Fitted
from discrepancy.diagnosis import Finding
from discrepancy.intervals import fitted_values
from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.refining import refined
from discrepancy.saved_model import SavedModel
from discrepancy.screening import extended_model
from discrepancy.setting import setting_of
from discrepancy.significance import excess, is_noise, is_significant

# Own choice: a strength that moved by less than this share has not changed, whatever its interval.
TOLERANCE: Final = 0.1
_BLURS_S: Final = (1.0, 0.1, 0.0)
_STEPS: Final = (8, 6, 12)
# What every recording begins anew.
_OWN_OF_A_RECORDING: Final = ("phase_rad",)


@dataclass(frozen=True, slots=True, eq=False)
class Standing:
    """``held``: the accepted causes as they were; ``free``: fitted anew; ``changed``: those that differ."""

    model: SavedModel
    held: Fit
    free: Fit
    changed: tuple[Cause, ...]

    @property
    def baseline(self) -> Fit:
        """The fit that further causes are tried on."""
        return self.free

    def findings(self, best: Fit) -> list[Finding]:
        """Return what has changed, with what it was, for a fit that may have more causes."""
        found = []
        for cause in self.changed:
            values = fitted_values(best, cause)
            was, now = self.model.causes[cause.name][cause.strength], values[cause.strength]
            share = 1.0 - excess(best) / max(excess(self.held), excess(best), 1.0e-12)
            if _is_gone(was, now):
                sentence = f"What was accepted as {cause.name} is gone: {cause.strength} was {_number(was)}."
            else:
                change = f"Since its model was accepted {cause.strength} went from {_number(was)} to {_number(now)}."
                sentence = f"{cause.sentence(values, setting_of(best))} {change}"
            found.append(Finding(cause.name, sentence, cause.action, values, min(max(share, 0.0), 1.0)))
        return found


def stand(plain: Fit, accepted: SavedModel) -> Standing | None:
    """Return how an accepted model stands in a recording, from the plain valve's fit; None where it cannot move."""
    observed = plain.model.observed
    causes = tuple(cause for cause in accepted.fitted_causes() if cause.is_visible(observed))
    values, setting = accepted.values(), setting_of(plain)
    model = plain.model
    for cause in causes:
        model = extended_model(model, cause, setting)
    model = replace(model, held={name: values.get(name, value) for name, value in model.held.items()})
    free = _followed(start_fit(model, model.unknowns.point({**plain.values, **values})))
    if not free.is_followed:
        return None
    held = _held(free, causes, accepted)
    changed: tuple[Cause, ...] = ()
    if not held.is_followed or is_significant(held, free):
        changed = tuple(cause for cause in causes if _has_changed(cause, free, accepted))
    return Standing(accepted, held, free, changed)


def _followed(fit: Fit) -> Fit:
    for span_s, steps in zip(_BLURS_S, _STEPS, strict=True):
        fit = descend(fit, most_steps=steps, span_s=span_s, held=DYNAMIC if span_s > 0.0 else frozenset())
    return fit if is_noise(fit) or not fit.is_followed else refined(fit)


def _held(free: Fit, causes: tuple[Cause, ...], accepted: SavedModel) -> Fit:
    """Return the fit with these causes held as they were accepted."""
    own = {cause.own(name) for cause in causes for name in _OWN_OF_A_RECORDING}
    names = {cause.own(name) for cause in causes for name in accepted.causes[cause.name]} - own
    values = accepted.values()
    fixed = {name: values[name] for name in names if name in free.model.unknowns.names}
    return _followed(held_fit(free, **fixed)) if fixed else free


def _has_changed(cause: Cause, free: Fit, accepted: SavedModel) -> bool:
    """Whether the strength lies beyond the tolerance and beyond both intervals."""
    was, now = accepted.causes[cause.name][cause.strength], fitted_values(free, cause)[cause.strength]
    if _is_gone(was, now):
        # what is gone has no place and no width: its interval says nothing, and whether it may be as it was does
        as_it_was = _held(free, (cause,), accepted)
        return not as_it_was.is_followed or is_significant(as_it_was, free)
    moved = abs(now.value - was.value)
    return moved > TOLERANCE * abs(was.value) and moved > was.half_width + now.half_width


def _is_gone(was: Fitted, now: Fitted) -> bool:
    """Whether a strength may be none: next to nothing, or with 0 in its interval."""
    return abs(now.value) < TOLERANCE * abs(was.value) or now.low <= 0.0 <= now.high


def _number(entry: Fitted) -> str:
    unit = "" if entry.unit == "1" else f" {entry.unit}"
    return f"{entry.value:.4g}{unit}"
