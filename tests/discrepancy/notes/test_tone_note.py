"""A tone that the position's sensor picks up is told; a stem that shakes, or a plain rest, has none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from discrepancy.notes.tone_note import tone_note
from tests.support.nominal_recordings import triangle_test
from valve.recording import Recording


def with_tone(recording: Recording, frequency_hz: float, amplitude_m: float) -> Recording:
    tone_m = amplitude_m * np.sin(2.0 * np.pi * frequency_hz * recording.time_s + 0.3)
    return replace(recording, position_m=recording.position_m + tone_m)


@pytest.mark.parametrize(("frequency_hz", "word"), [(50.0, "mains"), (60.0, "mains"), (23.0, "bracket")])
def test_a_tone_at_rest_is_told_with_its_frequency_and_size(frequency_hz: float, word: str) -> None:
    said = tone_note([with_tone(triangle_test(noise_m=2.0e-5), frequency_hz, 4.0e-5)])
    assert f"{frequency_hz:.0f} Hz" in said
    amplitude_um = float(said.partition("swings by ")[2].partition(" um")[0])
    assert amplitude_um == pytest.approx(40.0, rel=0.05)
    assert word in said


def test_a_quiet_position_has_no_tone() -> None:
    assert not tone_note([triangle_test(), triangle_test(noise_m=2.0e-5), triangle_test(0.02, noise_m=2.0e-5)])


def test_what_shakes_the_stem_in_motion_alone_is_no_tone_of_the_sensor() -> None:
    recording = triangle_test(noise_m=2.0e-5)
    shaken = with_tone(recording, 20.0, 4.0e-5)
    rests = np.abs(np.gradient(triangle_test().position_m, recording.time_s)) < 1.0e-4
    position_m = np.where(rests, recording.position_m, shaken.position_m)
    assert not tone_note([replace(recording, position_m=position_m)])
