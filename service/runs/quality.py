"""How evenly a recording was sampled, as it is stored with its test."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from valve.recording import Recording


def recording_quality(recording: Recording, notes: tuple[str, ...]) -> Mapping[str, Any]:
    """How evenly a recording was sampled, with the driver's notes; None for what it cannot say."""
    if recording.samples < 2:
        return {"samples": recording.samples, "notes": list(notes)}
    quality = {"samples": recording.samples, "gaps": recording.gaps, **asdict(recording.sampling_quality())}
    numbers = {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in quality.items()
    }
    return {**numbers, "notes": list(notes)}
