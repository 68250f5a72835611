"""An earlier test as its figures are kept, and the one that later tests are held against."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from service.model.health_figures import Figures, figures_of


@dataclass(frozen=True, slots=True)
class PastTest:
    """An earlier test as its figures are kept; ``unmet`` names the acceptance checks that it did not meet."""

    test_id: str
    at: datetime
    figures: Figures
    causes: tuple[str, ...] = ()
    verdict: str = ""
    label: str | None = None
    ne107: str | None = None
    unmet: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Baseline:
    """The test that later ones are held against, and who chose it; ``set_by`` is empty where nobody did."""

    test: PastTest
    set_by: str = ""
    set_at: datetime | None = None


def is_good(analysis: Mapping[str, Any]) -> bool:
    """Whether a result can be a baseline: it shows friction and spring, or at least one of them with its size."""
    figures = figures_of(analysis)
    return any(name in figures for name in ("friction_mean_n", "friction_coulomb_n", "spring_rate_n_per_m"))
