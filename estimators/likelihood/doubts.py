"""Why m, friction and DV are not given of a fit that explains the recording: the first doubt that there is."""

from __future__ import annotations

from typing import Final

from estimators.motion.hidden_jumps import HIDDEN_JUMPS

_NOT_ARRIVED: Final = (
    "the fit did not come to the bottom of its cost, a narrow valley of m, F_v, F_c, F_s and DV: "
    "repeat with ramps at several rates"
)
_ALONE: Final = (
    "the stem jumps, and searches from other starts did not come to as good a fit, so that a better one may be "
    "missing still: repeat with ramps at several rates"
)
_SPRING_OPEN: Final = (
    "the stem jumped to and fro between two places, and another spring, with friction that fits it, explains all of "
    "that as well: repeat with steps, or over several ranges, so that it comes to rest at other places too"
)
_STRAINED: Final = (
    "the position asks for another force than was measured, by more than the noise of its channel allows, and friction "
    "may stand in for what its lines miss: record it faster"
)
_TOO_HEAVY: Final = (
    "the fit has a mass that no valve's moving parts have, which stands in for what the model misses: look for what "
    "else moves or holds the stem"
)
_LARGEST_STRAIN: Final = 6.5  # standard deviations that one error of the measured input may be from none


def doubt_of(
    *, is_bottom: bool, is_spring_open: bool, hides: bool, is_confirmed: bool, strain: float, is_too_heavy: bool
) -> str:
    """Return the doubt, a clause without its full stop; "" where there is none.

    ``hides``: small jumps hide in the noise. ``strain``: of the measured input, in standard deviations.
    """
    if not is_bottom:
        return _NOT_ARRIVED
    if is_spring_open:
        return _SPRING_OPEN
    if hides:
        return HIDDEN_JUMPS
    if strain > _LARGEST_STRAIN:
        return _STRAINED
    if not is_confirmed:
        return _ALONE
    return _TOO_HEAVY if is_too_heavy else ""
