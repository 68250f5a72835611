from __future__ import annotations

import math

import numpy as np
import pytest

from simulator.faults import Fault, FaultKind
from simulator.plant import SoftwareValve
from simulator.record import Happening
from tests.support.simulated_plants import valve
from valve.errors import ParameterError


def readings(fault: Fault, looks_s: list[float]) -> tuple[SoftwareValve, list[float], list[float]]:
    """True and read positions of a valve that rises from 1 s to 11 s."""
    software = SoftwareValve(valve(faults=(fault,)))
    true, read = [], []
    software.look(1.0)
    software.play(np.array([0.0, 10.0]), np.array([0.0, 82737.0]))
    for at_s in looks_s:
        software.look(at_s)
        true.append(software.stem.position_m)
        read.append(software.read_position_m())
    return software, true, read


def test_a_stuck_stem_stays_until_it_is_free_and_then_goes_where_the_pressure_wants_it() -> None:
    _, true, read = readings(Fault(FaultKind.STUCK_STEM, 5.0, 8.0), [5.0, 6.0, 7.9, 8.5, 20.0])
    assert true[0] == true[1] == true[2]
    assert true[0] > 0.01
    assert true[3] > true[2] + 0.02
    parameters = valve().parameters
    left_n = 0.06452 * 82737.0 - parameters.spring_rate_n_per_m * true[4]
    assert abs(left_n) <= parameters.static_friction_n * (1.0 + 1e-9)
    assert read == pytest.approx(true, abs=1e-6)


def test_a_frozen_sensor_shows_the_position_at_its_start_while_the_stem_moves() -> None:
    software, true, read = readings(Fault(FaultKind.FROZEN_SENSOR, 5.0, 8.0), [6.0, 7.9, 8.1])
    unhurt = readings(Fault(FaultKind.SENSOR_LOST, 90.0), [5.0])
    assert read[:2] == pytest.approx([unhurt[1][0]] * 2, abs=1e-6)
    assert true[1] > true[0] > read[0] + 0.005
    assert read[2] == pytest.approx(true[2], abs=1e-6)
    assert software.fault(FaultKind.FROZEN_SENSOR) is None


def test_a_lost_sensor_reads_nan_and_a_jumping_one_too_much() -> None:
    assert math.isnan(readings(Fault(FaultKind.SENSOR_LOST, 5.0), [6.0])[2][0])
    _, true, read = readings(Fault(FaultKind.SENSOR_JUMP, 5.0, 7.0, amount=0.003), [6.0, 8.0])
    assert np.subtract(read, true) == pytest.approx([0.003, 0.0], abs=2e-6)


def test_captured_samples_show_a_sensors_fault_at_its_own_times() -> None:
    software = SoftwareValve(valve(faults=(Fault(FaultKind.SENSOR_LOST, 2.0, 3.0),)))
    software.play(np.array([0.0, 10.0]), np.array([0.0, 82737.0]))
    samples = software.advance(5.0, np.linspace(0.0, 5.0, 51))
    assert samples is not None
    lost = np.flatnonzero(np.isnan(samples.sensed_m)) * 0.1
    assert lost == pytest.approx(np.arange(20, 30) * 0.1)
    assert np.isfinite(samples.position_m).all()


def test_lost_air_lets_the_pressure_fall_and_it_returns() -> None:
    software, true, _ = readings(Fault(FaultKind.AIR_LOST, 12.0, 30.0, amount=0.0), [12.0, 29.0, 60.0])
    assert true[0] > 0.05
    assert true[1] < 0.03
    assert true[2] == pytest.approx(true[0], abs=1e-4)
    assert software.asked_pa == pytest.approx(82737.0)


def test_a_reset_output_falls_by_itself_once() -> None:
    software, true, _ = readings(Fault(FaultKind.OUTPUT_RESET, 12.0), [11.9, 20.0])
    assert true[0] > 0.05
    assert true[1] < 0.03
    assert software.asked_pa == 0.0
    assert [event.happening for event in software.record.events] == [Happening.OUTPUT_RESET]
    assert software.record.events[0].time_s == 12.0


def test_a_fault_that_cannot_be_or_lies_in_the_past_is_refused() -> None:
    for wrong in ({"start_s": 2.0, "end_s": 1.0}, {"start_s": math.nan}, {"start_s": 0.0, "amount": math.inf}):
        with pytest.raises(ParameterError):
            Fault(FaultKind.STUCK_STEM, **wrong)
    with pytest.raises(ParameterError, match="exception code"):
        Fault(FaultKind.REFUSAL, 0.0)
    software = SoftwareValve(valve())
    software.look(5.0)
    with pytest.raises(ParameterError, match="later"):
        software.inject(Fault(FaultKind.STUCK_STEM, 4.0))
