"""Recordings of different sampling periods: the methods read those alike, each row of the other would be a gap."""

from __future__ import annotations

from service.analysis.analysis import analyze_recordings
from service.analysis.like_periods import of_like_periods, periods_note
from tests.support.nominal_recordings import NOMINAL, triangle_test


def test_of_two_rates_the_group_with_most_samples_is_read() -> None:
    fast, slow = triangle_test(0.002), triangle_test(0.02)
    assert of_like_periods([fast, fast]) == [0, 1]
    assert of_like_periods([slow, fast]) == [1]
    assert of_like_periods([fast, slow, fast]) == [0, 2]
    assert of_like_periods([slow, triangle_test(0.025)]) == [0, 1]
    assert periods_note([fast, fast], [0, 1]) == ""
    assert "recording 2 (every 2 ms) alone: recording 1 (every 20 ms)" in periods_note([slow, fast], [1])


def test_a_captured_and_a_polled_recording_are_estimated_as_the_captured_one() -> None:
    # else each slow row is a gap after which the stem begins anew: 800 unknowns, and minutes of processor time
    fast, slow = triangle_test(0.002, noise_m=2.0e-5), triangle_test(0.02, noise_m=2.0e-5)
    alone, both = (analyze_recordings(given, NOMINAL.nameplate) for given in ([fast], [fast, slow]))
    assert both["estimates"] == alone["estimates"]
    assert both["recording"]["samples"] == fast.samples + slow.samples
    assert both["recording"]["sampling"] == alone["recording"]["sampling"]
    assert any("every 20 ms" in note for note in both["notes"])
