"""How much of a motion the mean law misses, before and with the causes, and where it misses most."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from discrepancy.rough.evidence import Solved
from discrepancy.rough.latent import strongest, way_words
from valve.messages import Message, say


@dataclass(frozen=True, slots=True)
class RoughMisfit:
    """Root mean square, m, of what the mean law leaves in driven motion, over the spring rate; ``noise_m`` is of a row.

    ``rms_after_m`` is None where no cause is in the model; ``where`` says where friction is most off its mean.
    """

    rms_before_m: float
    rms_after_m: float | None
    noise_m: float
    where: str

    def to_json(self) -> dict[str, Any]:
        """Return it as the analysis object's ``misfit``."""
        return asdict(self)


def misfit(null: Solved, model: Solved | None, noise_m: float) -> RoughMisfit | None:
    """Return what the plain valve's law misses, and what it misses with the causes in it.

    None where no spring turns a force that is missed into a length.
    """
    if not null.problem.rows.has_spring or null.known("k").value <= 0.0:
        return None
    after_m = None if model is None else _rms_m(model)
    before_m = _rms_m(null)
    return RoughMisfit(before_m, after_m, noise_m, _in_words(null, before_m))


def _rms_m(model: Solved) -> float:
    rows = model.problem.rows
    left_n, weight = model.left_n[rows.is_slide], rows.duration_s[rows.is_slide]
    return float(np.sqrt(weight @ left_n**2 / weight.sum())) / max(model.known("k").value, 1.0e-9)


def _in_words(null: Solved, rms_m: float) -> Message:
    curve, place = strongest(null)
    at, force_n = float(curve.at[place]), float(curve.force_n[place])
    if curve.coordinate == "travel_m":
        where = say("at_travel_going", "{at:.1f mm} {way}", at=at, way=way_words(curve.direction))
    else:
        where = say("at_time", "{at:.0f} s", at=at)
    return say(
        "mean_law_misses",
        "The mean law misses by {misfit:.0f um} rms in motion, most at {where}, where friction is {force:+.3g N} off "
        "its mean.",
        misfit=rms_m,
        where=where,
        force=force_n,
    )
