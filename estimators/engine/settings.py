"""Which steps of the engine are taken: all of them, but where a benchmark asks what one of them gains."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class Settings:
    """One switch a step; off, the engine does without it.

    ``roughness_by_motion``: the hyperparameters maximise the motion's likelihood, not only the balance's.
    ``roughness_spread``: their own uncertainty is in the intervals. ``beside``: a section's rows hold the motions
    before and after it. ``heated``: a fit begins with larger noise. ``recoloured``: the coloured noise is found from
    what is left in motion. ``several_starts``: times of stem and filter of several kinds. ``permuted``: the likeliest
    fit's times change places. ``creeping``: wider intervals near the limit velocity. ``slow_rows``: wider ones where
    rows are slower than the stem. ``force_scale``: the gauge's noise in the force's gain. ``tempered``: fits that are
    much less likely still count. ``understood``: motions that a fit does not explain are left out. ``doubted``: wider
    intervals of m, F_v, k and F_0 where friction varies.
    """

    roughness_by_motion: bool = True
    roughness_spread: bool = True
    beside: bool = True
    heated: bool = True
    recoloured: bool = True
    several_starts: bool = True
    permuted: bool = True
    creeping: bool = True
    slow_rows: bool = True
    force_scale: bool = True
    tempered: bool = True
    understood: bool = True
    doubted: bool = True


USUAL: Final = Settings()
