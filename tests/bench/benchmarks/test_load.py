"""The load benchmark's own reckoning: a slot that is told wrongly would make every later sample look late."""

from __future__ import annotations

import numpy as np

from tests.bench.benchmarks.callers import Tablet
from tests.bench.benchmarks.slots import lateness_s, missed_in_answers
from valve.recording import Recording


def _recording(begun_s: list[float], ended_s: list[float]) -> Recording:
    begun, ended = np.array(begun_s), np.array(ended_s)
    still = np.zeros(ended.size)
    return Recording(ended, still, still, sent_s=begun, received_s=ended, write_sent_s=begun, written_s=ended)


def test_a_sample_is_late_by_what_it_began_after_its_slot() -> None:
    recording = _recording([0.001, 0.023, 0.041], [0.005, 0.026, 0.044])
    np.testing.assert_allclose(lateness_s(recording, 0.02), [0.001, 0.003, 0.001], atol=1.0e-12)


def test_a_late_sample_begins_at_once_and_skips_the_slots_that_are_over() -> None:
    recording = _recording([0.0, 0.075, 0.0801], [0.004, 0.079, 0.084])
    np.testing.assert_allclose(lateness_s(recording, 0.02), [0.0, 0.055, 0.0001], atol=1.0e-12)


def test_a_slot_that_began_during_a_delay_is_taken_late() -> None:
    recording = _recording([0.0, 0.036, 0.046], [0.004, 0.038, 0.048])
    np.testing.assert_allclose(lateness_s(recording, 0.02), [0.0, 0.016, 0.006], atol=1.0e-12)


def test_a_missed_slot_is_the_answers_or_the_services_fault_by_where_the_time_went() -> None:
    answers = _recording([0.0, 0.02, 0.0631], [0.004, 0.063, 0.067])
    assert missed_in_answers(answers, 0.02) == 1
    service = _recording([0.0, 0.059, 0.069], [0.004, 0.063, 0.073])
    assert missed_in_answers(service, 0.02) == 0


def test_a_slot_that_was_given_up_after_the_answer_came_makes_no_later_sample_late() -> None:
    recording = _recording([0.0, 0.0201, 0.0601, 0.0801], [0.004, 0.0499, 0.064, 0.084])
    np.testing.assert_allclose(lateness_s(recording, 0.02), [0.0, 0.0001, 0.0001, 0.0001], atol=1.0e-12)


def test_an_event_in_two_pieces_counts_once() -> None:
    tablet = Tablet(b"")
    for piece in (b"HTTP/1.1 200 OK\r\n\r\nid: 1\neve", b"nt: a\ndata: 1\n\n", b"id: 2\nevent:", b" b\ndata: 2\n\n"):
        tablet.data_received(piece)
    assert tablet.events == 2
    assert tablet.failed == 0
