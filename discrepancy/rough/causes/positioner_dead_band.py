"""A pressure that does not follow until the command has turned back by some way."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from typing_extensions import override

from discrepancy.rough.causes.base import Fitted
from discrepancy.rough.causes.command_loop import LoopLaw, command_loop
from discrepancy.rough.causes.seen import InputCause, Seen
from valve.messages import say
from valve.recording import Recording


class PositionerDeadBand(InputCause):
    """The measured pressure stands still after each turn of the command, up to 12 % of the command's range."""

    name: ClassVar[str] = "positioner_dead_band"
    action: ClassVar[str] = say(
        "positioner_dead_band_action",
        "Look at the positioner: its dead band setting, a worn pilot valve or relay, loose linkage.",
    )

    @override
    def seen_in(self, recording: Recording) -> Seen | None:
        """Return the dead band where the pressure follows behind one and behind no delay or loop as well."""
        found = command_loop(recording)
        return Seen({"dead_band_pa": found[1]}, None) if found is not None and found[0] is LoopLaw.DEAD_BAND else None

    @override
    def told(self, fitted: Mapping[str, Fitted]) -> str:
        """Return what a fitter is told."""
        return say(
            "follows_after_dead_band",
            "The pressure follows only when the command has turned back by {band}: a dead band.",
            band=fitted["dead_band_pa"].in_words("kPa"),
        )
