"""Whether the measured bench set says that the pressure's zero is another than the nameplate's.

The preload is what the pressure reads at the lower end of travel: P_0 = F_0 / S_a. A spring adjuster moves it by a few
kPa, and the diagnosis names that. A pressure that is recorded from vacuum is an atmosphere too high everywhere, and
nothing else of the recording shows it: the model explains it with a preload that no spring has.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from valve.messages import say
from valve.nameplate import Nameplate

_METHOD: Final = "maximum_likelihood"
#: Of the full force: the largest preload that the diagnosis takes for a spring's (valve.effects.spring_preload).
_NO_SPRING: Final = 0.3
#: The atmosphere from 1,300 m above the sea to a high at the shore, Pa.
_ATMOSPHERE_PA: Final = (86.0e3, 106.0e3)


def zero_doubt(analysis: Mapping[str, Any], nameplate: Nameplate) -> str:
    """Return that the bench set is further off than any spring; "" where it is not, or where nobody can tell."""
    actuator, nominal_n = nameplate.actuator, nameplate.nominal_preload_n
    channels = (analysis.get("recording") or {}).get("channels") or ()
    if nominal_n is None or "pressure_pa" not in channels or "force_n" in channels:
        return ""
    assert actuator.diaphragm_area_m2 is not None  # what a nominal preload is made of
    assert actuator.bench_set_pa is not None
    found = next((one for one in analysis.get("estimates") or () if one["method"] == _METHOD), None)
    if found is None or found["status"] != "ok" or found["parameters"]["F_0"]["ci95"] is None:
        return ""
    full_pa = max(*actuator.bench_set_pa, *(nameplate.signal.range_pa if nameplate.signal is not None else ()))
    own_pa, area_m2 = actuator.bench_set_pa[0], actuator.diaphragm_area_m2
    low_pa, high_pa = sorted(end / area_m2 - own_pa for end in found["parameters"]["F_0"]["ci95"])
    if low_pa <= _NO_SPRING * full_pa and high_pa >= -_NO_SPRING * full_pa:
        return ""
    off_pa = 0.5 * (low_pa + high_pa)
    apart = say(
        "bench_set_apart",
        "The bench set begins at {own:.4g kPa} by this recording and at {nameplate:.4g kPa} by the nameplate, further "
        "apart than a spring can be adjusted",
        own=own_pa + off_pa,
        nameplate=own_pa,
    )
    if _ATMOSPHERE_PA[0] < off_pa < _ATMOSPHERE_PA[1]:
        return say(
            "recorded_from_vacuum",
            "{apart}: the pressure is recorded from vacuum. Take the atmosphere off: write it as gauge pressure.",
            apart=apart,
        )
    return say(
        "check_zero_of_pressure",
        "{apart}: check the zero and the unit of the pressure, then actuator.bench_set_pa.",
        apart=apart,
    )
