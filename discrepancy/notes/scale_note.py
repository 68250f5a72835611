"""Whether the moving mass gives a wrong diaphragm area, or a wrong range of a channel, away.

All that a recording with pressure tells of forces is in proportion to the area S_a of the nameplate, and so are the
spring rate and the mass: S_a P = k x + F_0 + F_f + m a. The bench set is a pressure, so its spring rate is in
proportion to S_a too: a wrong area cancels there and stays in the mass. A wrong range of the pressure or the position
stays in both, by one factor.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from valve.messages import say
from valve.nameplate import Nameplate

_METHOD: Final = "maximum_likelihood"
_PRELOAD: Final = "spring_preload"
#: The spring rate may be 5 % off and the bench set as well before health tells of either (docs/health.md).
_AGREES: Final = 1.1
#: A third of the spring moves as well, and the medium with the plug: own choice.
_MASS_OFF: Final = 1.2


def scale_note(analysis: Mapping[str, Any], nameplate: Nameplate) -> str:
    """Return what mass and spring rate say of the area and the channels' ranges; "" where they agree or cannot tell.

    Told only where the plain valve explains a recording with pressure, and the mass stands on the nameplate: any cause
    but the spring's preload that was found or is left may show in the mass as well.
    """
    mass_kg, rate = nameplate.actuator.moving_mass_kg, nameplate.nominal_spring_rate_n_per_m
    channels = (analysis.get("recording") or {}).get("channels") or ()
    if mass_kg is None or rate is None or "pressure_pa" not in channels or "force_n" in channels:
        return ""
    found = next((one for one in analysis.get("estimates") or () if one["method"] == _METHOD), None)
    if found is None or found["status"] != "ok" or not _is_plain(analysis.get("discrepancy") or {}):
        return ""
    mass, spring = found["parameters"]["m"], found["parameters"]["k"]
    if mass["ci95"] is None or spring["value"] is None:
        return ""
    low, high = (end / mass_kg for end in mass["ci95"])
    times, spring_times = mass["value"] / mass_kg, spring["value"] / rate
    if 1.0 / _AGREES < spring_times < _AGREES:
        if low <= _MASS_OFF and high >= 1.0 / _MASS_OFF:
            return ""
        return say(
            "mass_is_off",
            "The moving mass is {times:.2g} ({low:.2g} to {high:.2g}) times the nameplate's {mass:g kg}, and the "
            "spring rate is what the bench set says: the nameplate's mass is wrong, or its diaphragm area is as many "
            "times the true one, and every force here with it. Check both.",
            times=times,
            low=low,
            high=high,
            mass=mass_kg,
        )
    beyond = low > _AGREES or high < 1.0 / _AGREES
    if beyond and low / _AGREES <= spring_times <= high * _AGREES:
        return say(
            "mass_and_spring_off",
            "Spring rate and moving mass are both {times:.2g} times what the nameplate says, as a wrong range of the "
            "pressure or of the position makes them: check both ranges, then the nameplate.",
            times=spring_times,
        )
    return ""


def _is_plain(discrepancy: Mapping[str, Any]) -> bool:
    causes = {one["cause"] for one in discrepancy.get("causes") or ()}
    return discrepancy.get("verdict") == "none" or (discrepancy.get("verdict") == "named" and causes == {_PRELOAD})
