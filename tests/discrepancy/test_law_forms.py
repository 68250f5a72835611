"""A cause whose law has another form than the usual one: it is named by itself, and nothing makes up for it."""

from __future__ import annotations

from functools import partial

import pytest

from discrepancy.diagnose import Verdict, diagnose
from discrepancy.gain import Gain
from discrepancy.law_forms import has_free_form
from discrepancy.registry import CAUSES
from tests.discrepancy.hidden import hidden
from valve.effects import effect_from_values

pytestmark = pytest.mark.long

short = partial(hidden, cycle_s=8.0, period_s=4.0e-3)

FORMS = {
    # a guide that adds to each of F_c and F_s in proportion, or to the sliding friction alone
    "in proportion": ("friction_gradient", {"gradient_n_per_m": 4.0e3, "reference_m": 0.05, "static_share": 1.2}),
    "sliding alone": ("friction_gradient", {"gradient_n_per_m": 3.0e3, "reference_m": 0.05, "static_share": 0.0}),
    "wears out": (
        "friction_drift",
        {"change_n": -140.0, "time_constant_s": 1.0e5, "span_s": 16.0, "static_share": 1.2},
    ),
    "more farther out": ("spring_hardening", {"hardening_n_per_m2": 4.0e4, "bend_n_per_m3": 8.0e5, "middle_m": 0.0}),
    "at the ends": ("position_nonlinearity", {"bow_m": 8.0e-4, "span_m": 0.1016, "ends": -0.22}),
}


@pytest.mark.parametrize("form", FORMS)
def test_a_cause_of_another_form_is_named_alone(form: str) -> None:
    cause, values = FORMS[form]
    case = short("nominal", effect_from_values(cause, values), seed=3)
    found = diagnose([case.recording], case.nameplate, held_out=[("sine", case.held_out)])
    assert found.verdict is Verdict.NAMED, found.message
    assert [finding.cause for finding in found.causes] == [cause]
    assert found.extended is not None
    assert has_free_form(found.extended, CAUSES[cause])
    sine = found.gains[0]
    assert isinstance(sine, Gain)
    assert sine.share > 0.95
