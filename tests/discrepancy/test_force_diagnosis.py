from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

from discrepancy.force_diagnosis import diagnose_forces
from discrepancy.force_gain import ForceGain
from discrepancy.force_result import ForceDiagnosis
from discrepancy.rough.result import Verdict
from valve.nameplate import Action, Actuator, Nameplate
from valve.recording import FloatArray, Recording

EMPS = Path(__file__).resolve().parents[2] / ".." / "shared" / "data" / "emps"
DRIVE = Nameplate("DRIVE", Actuator(travel_m=0.25, action=Action.DOUBLE))
MASS_KG, VISCOUS, COULOMB_N = 95.0, 203.0, 20.4
PERIOD_S = 1.0e-3


def drive(
    seed: int, *, asymmetry: float = 0.0, spot_n: float = 0.0, drift_n: float = 0.0, swing_m: float = 0.1
) -> Recording:
    """A drive led along sines by a controller: the force is what the motion takes, by the equation itself."""
    rng = np.random.default_rng(seed)
    time_s: FloatArray = np.arange(14_000, dtype=np.float64) * PERIOD_S
    position_m = swing_m * np.sin(0.9 * time_s) + 0.02 * np.sin(3.1 * time_s + 0.4)
    velocity = 0.9 * swing_m * np.cos(0.9 * time_s) + 0.062 * np.cos(3.1 * time_s + 0.4)
    acceleration = -(0.9**2) * swing_m * np.sin(0.9 * time_s) - 3.1**2 * 0.02 * np.sin(3.1 * time_s + 0.4)
    level_n = COULOMB_N + drift_n * (1.0 - np.exp(-time_s / 6.0))
    level_n = level_n + spot_n * np.exp(-0.5 * ((position_m - 0.03) / 0.008) ** 2)
    viscous = VISCOUS * (1.0 + asymmetry * np.sign(velocity))
    force_n = MASS_KG * acceleration + viscous * velocity + level_n * np.sign(velocity)
    return Recording(
        time_s=time_s,
        position_m=position_m + 2.0e-6 * rng.standard_normal(time_s.size),
        force_n=force_n + 1.0 * rng.standard_normal(time_s.size),
    )


def spotted_drive(seed: int, *, rise_n: float, centre_m: float, width_m: float) -> Recording:
    plain = drive(seed)
    assert plain.force_n is not None
    way = np.sign(0.09 * np.cos(0.9 * plain.time_s) + 0.062 * np.cos(3.1 * plain.time_s + 0.4))
    spot_n = rise_n * np.exp(-0.5 * ((plain.position_m - centre_m) / width_m) ** 2)
    return Recording(time_s=plain.time_s, position_m=plain.position_m, force_n=plain.force_n + way * spot_n)


def bursting_drive(seed: int, from_s: float) -> Recording:
    plain = drive(seed)
    assert plain.force_n is not None
    way = np.sign(0.09 * np.cos(0.9 * plain.time_s) + 0.062 * np.cos(3.1 * plain.time_s + 0.4))
    burst_n = COULOMB_N * ((plain.time_s > from_s) & (plain.time_s < from_s + 1.2))
    return Recording(time_s=plain.time_s, position_m=plain.position_m, force_n=plain.force_n + way * burst_n)


def asked(recording: Recording, *held_out: Recording) -> ForceDiagnosis:
    return diagnose_forces([recording], DRIVE, held_out=[("held out", one) for one in held_out])


def test_a_healthy_drive_is_called_healthy() -> None:
    for seed in range(3):
        assert asked(drive(seed)).verdict is Verdict.NONE


@pytest.mark.parametrize(
    ("hides", "cause", "parameter", "value"),
    [
        ({"asymmetry": -0.18}, "friction_asymmetry", "viscous_asymmetry", -0.18),
        ({"drift_n": -5.0}, "friction_drift", "change_n", -5.0),
        ({"spot_n": 8.0}, "local_friction", "rise_n", 8.0),
    ],
)
def test_what_a_drives_force_hides_is_named_alone_and_predicts_another_motion(
    hides: dict[str, float], cause: str, parameter: str, value: float
) -> None:
    found = asked(drive(4, **hides), drive(5, swing_m=0.07, **hides))
    assert found.verdict is Verdict.NAMED
    assert [finding.cause for finding in found.causes] == [cause]
    assert found.causes[0].parameters[parameter].value == pytest.approx(value, rel=0.35)
    held_out, left_out = found.gains
    assert isinstance(held_out, ForceGain)
    assert isinstance(left_out, ForceGain)
    assert held_out.rmse_after_n < 0.8 * held_out.rmse_before_n
    assert not left_out.is_worse
    assert found.pictures is not None
    assert len(found.pictures["coordinates"]) == 5


def test_a_constant_force_may_be_a_load_or_a_friction_that_differs_by_direction() -> None:
    plain = drive(6)
    assert plain.force_n is not None
    loaded = Recording(time_s=plain.time_s, position_m=plain.position_m, force_n=plain.force_n + 3.0)
    found = asked(loaded)
    assert found.verdict is Verdict.AMBIGUOUS
    assert (found.causes[0].cause, *found.not_told_apart_from) == ("friction_asymmetry", "spring_preload")


def test_a_constant_load_is_told_with_the_difference_that_it_makes() -> None:
    plain = drive(6)
    assert plain.force_n is not None
    found = asked(Recording(time_s=plain.time_s, position_m=plain.position_m, force_n=plain.force_n + 10.0))
    sentence = found.causes[0].sentence
    # the load stands on one side of each way: 10 N more than friction this way, 10 N less the other
    difference_n, load_n = (float(one) for one in re.findall(r"([0-9.]+) N", sentence))
    assert load_n == pytest.approx(10.0, abs=0.5)
    assert difference_n == pytest.approx(2.0 * load_n, abs=0.02)


def test_a_force_whose_sign_is_turned_round_is_told_and_no_cause_named() -> None:
    plain = drive(6)
    assert plain.force_n is not None
    found = asked(Recording(time_s=plain.time_s, position_m=plain.position_m, force_n=-plain.force_n))
    assert found.verdict is Verdict.NOT_ASSESSED
    assert "sign of the force" in found.message


@pytest.mark.parametrize("centre_m", [0.031, 0.041])
def test_the_height_of_a_narrow_spot_is_told_wherever_it_is(centre_m: float) -> None:
    found = asked(spotted_drive(9, rise_n=12.0, centre_m=centre_m, width_m=0.003))
    assert [finding.cause for finding in found.causes] == ["local_friction"]
    told = found.causes[0].parameters
    for name, value in (("rise_n", 12.0), ("centre_m", centre_m), ("width_m", 0.003)):
        assert told[name].low < value < told[name].high, name
        assert told[name].half_width < 0.25 * value


@pytest.mark.parametrize("from_s", [3.1, 5.2, 8.2])
def test_bursts_of_friction_are_unexplained(from_s: float) -> None:
    found = asked(bursting_drive(10, from_s))
    assert found.verdict is Verdict.UNEXPLAINED
    assert found.causes == ()
    assert any(said in found.message for said in ("comes and goes", "a few stretches of time", "is not known"))


def test_a_force_that_no_cause_explains_is_unexplained() -> None:
    plain = drive(7)
    assert plain.force_n is not None
    # a soft spring, which a drive without one does not have
    odd = Recording(time_s=plain.time_s, position_m=plain.position_m, force_n=plain.force_n + 150.0 * plain.position_m)
    found = asked(odd)
    assert found.verdict is Verdict.UNEXPLAINED
    assert found.causes == ()


def test_a_drive_whose_force_was_not_recorded_is_not_assessed() -> None:
    plain = drive(8)
    bare = Recording(time_s=plain.time_s, position_m=plain.position_m, command_pa=plain.force_n)
    found = diagnose_forces([bare], DRIVE)
    assert found.verdict is Verdict.NOT_ASSESSED
    assert "force_n" in found.message


def emps(file: str) -> Recording:
    data = {
        name: np.asarray(values, dtype=np.float64).ravel()
        for name, values in loadmat(EMPS / file).items()
        if name[0] != "_"
    }
    return Recording(time_s=data["t"], position_m=data["qm"], force_n=data["gtau"][0] * data["vir"])


@pytest.mark.skipif(not EMPS.exists(), reason="the EMPS records are not beside the checkout")
def test_the_asymmetry_that_the_authors_of_emps_name_is_found_and_gains_on_the_record_with_pulses() -> None:
    found = asked(emps("DATA_EMPS.mat"), emps("DATA_EMPS_PULSES.mat"))
    assert found.verdict is Verdict.NAMED
    assert [finding.cause for finding in found.causes] == ["friction_asymmetry"]
    # Janot, Gautier & Brunot (2019): 166.7 N s/m one way and 240.4 the other
    asymmetry = found.causes[0].parameters["viscous_asymmetry"]
    published = (166.7061 - 240.4236) / (166.7061 + 240.4236)
    assert asymmetry.low < published < asymmetry.high
    assert asymmetry.value == pytest.approx(published, rel=0.02)
    gain = found.gains[0]
    assert isinstance(gain, ForceGain)
    assert gain.rmse_after_n / gain.force_rms_n < 0.040
    assert gain.rmse_after_n < 0.87 * gain.rmse_before_n
