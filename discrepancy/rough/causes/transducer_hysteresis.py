"""A pressure that differs between rising and falling command."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from typing_extensions import override

from discrepancy.rough.causes.base import Fitted
from discrepancy.rough.causes.command_loop import LoopLaw, command_loop
from discrepancy.rough.causes.seen import InputCause, Seen
from valve.messages import say
from valve.recording import Recording


class TransducerHysteresis(InputCause):
    """The measured pressure goes up below and down above the command's line, up to 12 % of the command's range apart.

    It begins to turn with the command at once, so it is no dead band; both ways meet at the ends of the range.
    """

    name: ClassVar[str] = "transducer_hysteresis"
    action: ClassVar[str] = say(
        "transducer_hysteresis_action", "Calibrate the I/P up and down; replace it if the difference stays."
    )

    @override
    def seen_in(self, recording: Recording) -> Seen | None:
        """Return the loop's width where the pressure shows a loop and no delay or dead band as well."""
        found = command_loop(recording)
        return Seen({"width_pa": found[1]}, None) if found is not None and found[0] is LoopLaw.HYSTERESIS else None

    @override
    def told(self, fitted: Mapping[str, Fitted]) -> str:
        """Return what a fitter is told."""
        return say(
            "transducer_has_hysteresis",
            "At the same command the pressure is up to {width} higher falling than rising: hysteresis of the I/P.",
            width=fitted["width_pa"].in_words("kPa"),
        )
