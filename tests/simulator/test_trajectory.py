from __future__ import annotations

import numpy as np
import pytest

from simulator.plant import SoftwareValve
from simulator.trajectory import Trajectory
from simulator.transducer import Transducer
from tests.support.simulated_plants import valve


def test_what_is_to_come_is_replaced_and_what_was_is_kept() -> None:
    trajectory = Trajectory(0.0, 1.0)
    trajectory.replace_from(2.0, np.array([0.0, 4.0]), np.array([10.0, 30.0]))
    trajectory.step_to(4.0, 5.0)
    assert [trajectory.at(t) for t in (0.0, 1.9, 2.0, 3.0, 3.999, 4.0, 9.0)] == pytest.approx(
        [1.0, 1.0, 10.0, 15.0, 19.995, 5.0, 5.0]
    )
    assert not trajectory.is_held_from(3.9)
    assert trajectory.is_held_from(4.0)
    trajectory.step_to(6.0, 7.0)
    assert [trajectory.at(t) for t in (3.0, 5.9, 6.0)] == pytest.approx([15.0, 5.0, 7.0])


def test_a_piece_begins_after_a_step_and_ends_before_one() -> None:
    trajectory = Trajectory(0.0, 0.0)
    trajectory.step_to(1.0, 10.0)
    trajectory.step_to(2.0, 20.0)
    for from_s, to_s, times_s, pressures_pa in (
        (1.0, 2.0, [1.0, 2.0], [10.0, 10.0]),
        (0.5, 2.5, [0.5, 1.0, 1.0, 2.0, 2.0, 2.5], [0.0, 0.0, 10.0, 10.0, 20.0, 20.0]),
        (2.0, 2.0, [2.0, 2.0], [20.0, 20.0]),
    ):
        time_s, pressure_pa = trajectory.between(from_s, to_s)
        assert time_s.tolist() == times_s
        assert pressure_pa.tolist() == pressures_pa


def test_a_step_at_the_time_of_another_replaces_it() -> None:
    trajectory = Trajectory(0.0, 0.0)
    trajectory.step_to(1.0, 10.0)
    trajectory.step_to(1.0, 20.0)
    time_s, pressure_pa = trajectory.between(0.0, 3.0)
    assert time_s.tolist() == [0.0, 1.0, 1.0, 3.0]
    assert pressure_pa.tolist() == [0.0, 0.0, 20.0, 20.0]


@pytest.mark.parametrize(
    "settings", [Transducer((0.0, 1e5)), Transducer((0.0, 1e5), dead_time_s=0.35), Transducer((0.0, 1e5), lag_s=0.2)]
)
def test_forgetting_keeps_the_memory_small_and_the_answers_as_they_were(settings: Transducer) -> None:
    software = SoftwareValve(valve(transducer=settings))
    for i in range(2000):
        software.look(0.1 * i)
        software.ask(5.0e4 + 10.0 * (i % 7))
    assert software.asked.corners < 20
    software.look(201.0)
    assert software.pressure_pa == pytest.approx(5.0e4 + 10.0 * (1999 % 7), abs=1.0)
