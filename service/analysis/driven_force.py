"""The force of a drive without a spring whose chambers' pressures were recorded instead of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from valve.messages import say
from valve.nameplate import Action, Nameplate
from valve.recording import Recording

NOTE: Final = say(
    "force_from_difference",
    "The force is taken as the diaphragm area times pressure_pa, which is the difference of both chambers' pressures: "
    "an area that differs between the two sides makes it wrong; give force_n then.",
)


def with_driven_forces(recordings: Sequence[Recording], nameplate: Nameplate) -> tuple[list[Recording], list[str]]:
    """Return the recordings, of a drive without a spring with its force, and the note that says what it was made of.

    Only a pressure that takes both signs is such a difference (``Recording.takes_both_signs``).
    """
    area_m2 = nameplate.actuator.diaphragm_area_m2
    if nameplate.actuator.action is not Action.DOUBLE or area_m2 is None:
        return list(recordings), []
    given = []
    for recording in recordings:
        pressure_pa = recording.pressure_pa
        if recording.force_n is not None or pressure_pa is None or not recording.takes_both_signs:
            return list(recordings), []
        given.append(replace(recording, force_n=area_m2 * pressure_pa))
    return given, [NOTE] if given else []
