"""Whether the position carries a tone while the stem rests: what the sensor picks up, and no motion of the valve."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from estimators.samples import FloatArray, position_noise
from valve.messages import say
from valve.recording import Recording

# Own choices; tests/discrepancy/notes/test_tone_note.py has a rest, a vibration and a slow poll without a tone.
_WINDOW_S: Final = 1.0
_LEAST_WINDOWS: Final = 4
_SLOWEST_PERIOD_S: Final = 0.004  # 250 Hz: 60 Hz and its harmonic below half of it
_LOWEST_HZ: Final = 10.0
_HIGHEST: Final = 0.45  # of the sampling rate
_RESTS: Final = 1.0  # of the noise: how far a window's halves lie apart at most, beside the tone
_STANDS_OUT: Final = 30.0  # times the median power
_LEAST_AMPLITUDE: Final = 0.5  # of the noise
_MAINS_HZ: Final = (50.0, 60.0, 100.0, 120.0)
_NEAR_HZ: Final = 1.5


def tone_note(recordings: Sequence[Recording]) -> str:
    """Return frequency and amplitude of the strongest tone at rest, with what to do; "" where there is none."""
    tones = [tone for tone in map(_tone, recordings) if tone is not None]
    if not tones:
        return ""
    frequency_hz, amplitude_m = max(tones, key=lambda tone: tone[1])
    is_mains = min(abs(frequency_hz - mains_hz) for mains_hz in _MAINS_HZ) < _NEAR_HZ
    source = (
        say("picks_up_mains", "the sensor picks up the mains: look at its cable's screen and earth")
        if is_mains
        else say(
            "picks_up_or_shakes", "the sensor picks it up or its bracket shakes: look at bracket, cable and supply"
        )
    )
    return say(
        "tone_at_rest",
        "The position swings by {amplitude:.2g um} to either side at {frequency:.3g} Hz while the stem rests, where no "
        "friction lets it move: {source}. It is part of what the simulation misses.",
        amplitude=amplitude_m,
        frequency=frequency_hz,
        source=source,
    )


def _tone(recording: Recording) -> tuple[float, float] | None:
    """Frequency, Hz, and amplitude, m, of a tone at rest; None where there is none or it cannot be seen."""
    period_s = recording.sample_period_s if recording.samples > 1 else 1.0
    rows = np.flatnonzero(np.isfinite(recording.position_m))
    if period_s > _SLOWEST_PERIOD_S or rows.size * period_s < _LEAST_WINDOWS * _WINDOW_S:
        return None
    noise_m = position_noise(recording.time_s[rows], recording.position_m[rows], np.zeros(rows.size, dtype=np.intp))
    size = round(_WINDOW_S / period_s)
    taper = np.hanning(size)
    powers = [np.abs(np.fft.rfft(one * taper)) ** 2 for one in _rests(recording, size, period_s, noise_m)]
    if len(powers) < _LEAST_WINDOWS or noise_m <= 0.0:
        return None
    power = np.mean(powers, axis=0)
    frequency_hz = np.fft.rfftfreq(size, period_s)
    seen = (frequency_hz >= _LOWEST_HZ) & (frequency_hz <= _HIGHEST / period_s)
    best = int(np.argmax(np.where(seen, power, 0.0)))
    amplitude_m = 2.0 * float(np.sqrt(power[best])) / float(taper.sum())
    if power[best] < _STANDS_OUT * float(np.median(power[seen])) or amplitude_m < _LEAST_AMPLITUDE * noise_m:
        return None
    return float(frequency_hz[best]), amplitude_m


def _rests(recording: Recording, size: int, period_s: float, noise_m: float) -> Iterator[FloatArray]:
    """Positions less their mean, shape (size,), of each window without a gap in which the stem stays where it is."""
    quarter = size // 4
    for first in range(0, recording.samples - size + 1, size):
        own_m, own_s = recording.position_m[first : first + size], recording.time_s[first : first + size]
        if not np.isfinite(own_m).all() or own_s[-1] - own_s[0] > 1.01 * size * period_s:
            continue
        means_m = own_m[: 4 * quarter].reshape(4, quarter).mean(axis=1)
        if float(np.ptp(means_m)) < _RESTS * noise_m:
            yield own_m - own_m.mean()
