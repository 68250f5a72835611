"""A friction that falls with speed: its fit is found along a valley, and looked for whatever the other causes took."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, Final

import numpy as np
import pytest

from discrepancy import falling_friction, rounds
from discrepancy.baseline import baseline_unknowns, fit_baseline
from discrepancy.causes.friction import LOCAL, STRIBECK
from discrepancy.falling_friction import SPEED, from_slow_slips, has_wide_limit, may_ring
from discrepancy.glancing import glance
from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.model import Model
from discrepancy.observed import Observed, observe
from discrepancy.refining import refined
from discrepancy.screening import Candidate, extended_model, refit, screen
from discrepancy.setting import setting_of
from discrepancy.significance import gain, is_noise, is_significant, misfit
from discrepancy.thinning import thinned
from tests.blind.cases import blind_case

pytestmark = pytest.mark.long

# Where short fits from the grid of starts end on this case: F_c is a third high, F_v 60 % low, v_s a third low.
STUCK = {
    "m": 1.5818, "k": 195880.0, "F_v": 20199.0, "F_c": 866.69, "d": 0.24857, "F_0": 2138.1, "DV": 1.1523e-4,
    "first_rise": 147.09, SPEED: 2.2031e-3,
}  # fmt: skip


def test_walks_along_the_speed_lead_a_fit_out_of_the_valley_in_which_steps_of_all_unknowns_stop() -> None:
    case = blind_case(7036, "triangle")
    observed = observe(case.recordings, case.nameplate)
    assert isinstance(observed, Observed)
    baseline = fit_baseline(observed)
    assert baseline is not None
    setting = setting_of(baseline)
    model = extended_model(baseline.model, STRIBECK, setting)
    stuck = descend(start_fit(model, model.unknowns.point({**baseline.values, **STUCK})), most_steps=12)
    assert misfit(stuck) > 2.0
    start = {name: stuck.values[name] for name in ("F_c", "F_v", "d", "DV")}
    start[STRIBECK.strength] = stuck.values[SPEED]
    found = refit(baseline, Candidate(STRIBECK, (start,), 0.5), setting)
    assert misfit(found) < 1.15
    assert found.values[SPEED] == pytest.approx(case.hidden[0].parameters["speed_m_per_s"], rel=0.15)
    assert found.values["F_c"] == pytest.approx(case.truth.parameters.coulomb_friction_n, rel=0.15)


def test_a_hard_cause_is_tried_where_the_ordinary_ones_took_all_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    tried = []

    def refit(fit: Any, candidate: Candidate, *_rest: Any) -> Any:
        tried.append(candidate.cause.name)
        return replace(fit, cost=float("inf"))

    monkeypatch.setattr(rounds, "refit", refit)
    monkeypatch.setattr(rounds, "share_of_work", lambda _fit: 1.0)
    monkeypatch.setattr(rounds, "_is_coarse", lambda _fit: False)
    rings: list[bool] = [False]
    monkeypatch.setattr(rounds, "may_ring", lambda _fit, _setting: rings[0])
    last = 1.0e8

    def tried_at(work: float) -> Sequence[str]:
        tried.clear()
        model: Any = SimpleNamespace(tally=SimpleNamespace(work=work))
        best = Fit(model, np.zeros(1), np.zeros(1), None, 1.0)
        candidates = [Candidate(cause, ({},), 0.5) for cause in (LOCAL, STRIBECK)]
        rounds.refits(best, candidates, setting=SimpleNamespace(), most=9, last=last)  # type: ignore[arg-type]
        return list(tried)

    assert tried_at(0.5 * last) == ["local_friction", "stribeck_friction"]
    assert tried_at(1.2 * last) == ["stribeck_friction"]
    assert tried_at(2.0 * last) == []
    rings[0] = True
    assert tried_at(0.5 * last) == ["stribeck_friction", "local_friction"]


def test_a_valve_without_damping_may_ring_and_one_with_a_wide_limit() -> None:
    setting: Any = SimpleNamespace(sliding_m_per_s=1.0e-2)

    def rings(viscous: float, limit: float) -> bool:
        fit: Any = SimpleNamespace(values={"m": 1.0, "k": 5.0e4, "F_v": viscous, "DV": limit})
        return may_ring(fit, setting)

    assert rings(0.4, 1.0e-4)
    assert rings(600.0, 9.0e-3)
    assert not rings(600.0, 1.0e-4)


# Where the plain valve ends on a case whose friction falls.
WIDE: Final = {
    "m": 1.304, "k": 46110.0, "F_v": 416.9, "F_c": 1829.0, "d": 0.333, "F_0": 250.4, "DV": 3.379e-3,
    "first_rise": 19.76, "x_0": -2.852e-5,
}  # fmt: skip
# Where the first short fits end on this case with the command alone: the stem is five times as heavy as the valve's,
# and what the mass takes of the slips is missing in the fall of the friction.
HEAVY: Final = {
    "m": 8.128, "k": 41700.0, "F_v": 1012.0, "F_c": 1692.0, "d": 0.2491, "F_0": 168.6, "DV": 1.261e-3,
    "first_rise": 6.685e-3, SPEED: 8.843e-3,
}  # fmt: skip


def test_a_fit_follows_the_mass_back_to_the_nameplates_where_a_heavy_stem_stood_in_for_the_fall_of_friction() -> None:
    case = blind_case(7001, "command")
    observed = observe(case.recordings, case.nameplate)
    assert isinstance(observed, Observed)
    baseline = fit_baseline(observed)
    assert baseline is not None
    model = extended_model(baseline.model, STRIBECK, setting_of(baseline))
    stuck = descend(start_fit(model, model.unknowns.point({**baseline.values, **HEAVY})), most_steps=12)
    assert misfit(stuck) > 1.8
    found = refined(stuck)
    assert misfit(found) < 1.2
    assert found.values["m"] == pytest.approx(case.truth.parameters.mass_kg, rel=0.4)
    assert found.values[SPEED] == pytest.approx(case.hidden[0].parameters["speed_m_per_s"], rel=0.25)


def test_a_wide_limit_velocity_of_the_plain_valve_leads_to_the_speed_at_which_friction_falls() -> None:
    """Slips of millimetres, of which the grid of starts leads none to its place: DV is a fourth of v_s."""
    case = blind_case(7435, "triangle")
    observed = observe(case.recordings, case.nameplate)
    assert isinstance(observed, Observed)
    unknowns = baseline_unknowns(observed, 9.2e-3, 2000.0)
    plain = start_fit(Model(observed, unknowns, thin=thinned(observed)), unknowns.point(WIDE))
    assert misfit(plain) > 1000.0
    setting = setting_of(plain)
    assert has_wide_limit(plain, setting)
    (candidate,) = screen(plain, [STRIBECK], setting)
    found = refit(plain, candidate, setting)
    assert misfit(found) < 1.1
    assert found.values[SPEED] == pytest.approx(case.hidden[0].parameters["speed_m_per_s"], rel=0.1)
    assert found.values["F_v"] == pytest.approx(case.truth.parameters.viscous_friction_n_s_per_m, rel=0.1)
    narrow = start_fit(plain.model, unknowns.point({**plain.values, "DV": 1.0e-4}))
    assert not has_wide_limit(narrow, setting)


def test_a_glance_at_what_noise_may_explain_begins_at_a_wide_limit_velocity() -> None:
    """A DV of twice the ramps' speed explains all but 400 of the cost."""
    case = blind_case(9430, "triangle")
    observed = observe(case.recordings, case.nameplate)
    assert isinstance(observed, Observed)
    baseline = fit_baseline(observed)
    assert baseline is not None
    plain = refined(baseline)
    assert is_noise(plain)
    setting = setting_of(plain)
    (candidate,) = screen(plain, [STRIBECK], setting)
    found = glance(plain, candidate, setting)
    assert is_significant(plain, found)
    assert gain(plain, found) > 300.0
    assert found.values[SPEED] == pytest.approx(case.hidden[0].parameters["speed_m_per_s"], rel=0.1)


def test_slips_that_damping_makes_slow_lead_from_the_first_of_them_to_the_whole_record() -> None:
    """Read every 20 ms, forty times critical damping: no rest is seen, and the plain valve leaves 43 of the noise."""
    case = blind_case(9262, "polled")
    observed = observe(case.recordings, case.nameplate)
    assert isinstance(observed, Observed)
    plain = fit_baseline(observed)
    assert plain is not None
    assert misfit(plain) > 30.0
    setting = setting_of(plain)
    found = from_slow_slips(plain, extended_model(plain.model, STRIBECK, setting), setting)
    assert found is not None
    assert misfit(found) < 1.3
    assert found.values[SPEED] == pytest.approx(case.hidden[0].parameters["speed_m_per_s"], rel=0.15)
    quick = start_fit(plain.model, plain.model.unknowns.point({**plain.values, "F_v": 100.0}))
    assert from_slow_slips(quick, found.model, setting) is None


def test_a_start_lies_within_a_quarter_octave_of_every_usual_speed(monkeypatch: pytest.MonkeyPatch) -> None:
    """From half an octave off and more the slips stay out of phase, whatever else is fitted."""
    begun: list[dict[str, float]] = []

    def start(model: Any, point: dict[str, float]) -> Fit:
        begun.append(point)
        return Fit(model, np.zeros(1), np.zeros(1), None, float(len(begun)))

    monkeypatch.setattr(falling_friction, "start_fit", start)
    monkeypatch.setattr(falling_friction, "descend", lambda fit, **_: fit)
    monkeypatch.setattr(falling_friction, "scanned", lambda fit, *_: fit)
    plain: Any = SimpleNamespace(values={"m": 1.3, "DV": 3.4e-3})
    model: Any = SimpleNamespace(tally=SimpleNamespace(work=0.0), unknowns=SimpleNamespace(point=lambda values: values))
    motion = SimpleNamespace(moving_mass_kg=1.2)
    setting: Any = SimpleNamespace(observed=SimpleNamespace(motions=(motion,)), sliding_m_per_s=9.2e-3)
    assert falling_friction.from_wide_limit(plain, model, setting) is not None
    for mass_kg in (1.2, 1.3):
        octaves = np.array([math.log2(one[SPEED] / 3.4e-3) for one in begun if one["m"] == mass_kg])
        for octave in np.linspace(-1.0, 1.0, 21):
            assert np.abs(octaves - octave).min() < 0.27, f"v_s of {2.0**octave:.2f} DV has no start"
        assert octaves.max() == pytest.approx(2.0)
