"""Recordings of rough valves with the truth about each: the cases of the benchmarks, in one call."""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from simulator.grades import hunting_swing_pa, position_settings, pressure_settings
from simulator.packed_stem import Truth
from simulator.recorded import recorded
from simulator.sensor import Sensor
from simulator.simulated_valve import SimulatedValve
from simulator.transducer import Hunting, Transducer
from valve.diagnostic_waveform import diagnostic
from valve.effects import Effect
from valve.nameplate import Actuator, Nameplate, Signal
from valve.packing import packing_preset
from valve.parameter_sets import PARAMETER_SETS
from valve.parameters import ValveParameters
from valve.recording import Recording
from valve.waveform import Waveform, multi_rate_periods, multi_rate_triangle, sine, triangle

_BENCH_SET_PA: Final = (20.0e3, 100.0e3)
_MARGIN: Final = 0.05  # by which a sensor is wider than what it measures


def _globe(tag: str, travel_m: float, area_m2: float, parameters: ValveParameters) -> tuple[ValveParameters, Nameplate]:
    """A spring-opposed valve with a bench set of 20 to 100 kPa; its spring follows from that."""
    low_pa, high_pa = _BENCH_SET_PA
    parameters = replace(
        parameters, spring_rate_n_per_m=area_m2 * (high_pa - low_pa) / travel_m, preload_n=area_m2 * low_pa
    )
    actuator = Actuator(travel_m, area_m2, moving_mass_kg=parameters.mass_kg, bench_set_pa=_BENCH_SET_PA)
    return parameters, Nameplate(tag, actuator, Signal((4.0, 20.0), _BENCH_SET_PA))


# By name: the truth as made, and the nameplate. The small one has 0.8 kg and 20 mm, the large one 22 kg and 60 mm.
VALVES: Final[Mapping[str, tuple[ValveParameters, Nameplate]]] = {
    **{name: (entry.parameters, entry.nameplate) for name, entry in PARAMETER_SETS.items()},
    "small": _globe("SMALL", 0.02, 0.0226, ValveParameters(0.8, 0.0, 900.0, 60.0, 78.0, 1.5e-4)),
    "large": _globe("LARGE", 0.06, 0.155, ValveParameters(22.0, 0.0, 6000.0, 1120.0, 1400.0, 1.5e-4)),
}
# Not one of the six: in 20 s there and back it never slides, it slips some two hundred times.
SLIPPING: Final = _globe("SLIPPING", 0.04, 0.045, ValveParameters(2.0, 0.0, 500.0, 300.0, 390.0, 2.0e-4))
SEQUENCES: Final = ("triangle", "multi_rate")
DIAGNOSTIC: Final = "diagnostic"  # 140 s of several rates, rests and small loops
HELD_OUT: Final = "sine"  # a sequence to try a finding on
GRADES: Final = ("ideal", "mild", "usual", "hard")


@dataclass(frozen=True, slots=True, eq=False)
class RoughCase:
    """One recording, all that a finder sees beside it, and the truth.

    ``truth.parameters`` is what estimates are judged by (F_c and F_0 averaged over the travel swept and the time
    recorded, F_s the expectation of the law); ``truth.breakaways_s``, ``_m``, ``_n`` and ``rests_s`` judge a
    segmentation; ``settings`` is the valve as made, its packing and instruments.
    """

    recording: Recording
    nameplate: Nameplate
    truth: Truth
    settings: SimulatedValve
    waveform: Waveform


def sequence(name: str, nameplate: Nameplate) -> Waveform:
    """Return a minute of the sequence of this name: triangles of 20 s (the stiff graphite valve: 12 s), or many rates.

    From the pressure at which the valve begins to open, up to the end of its signal.
    """
    assert nameplate.signal is not None, "the cases' nameplates have one"
    assert nameplate.actuator.bench_set_pa is not None, "the cases' nameplates have one"
    low_pa, high_pa = nameplate.actuator.bench_set_pa[0], nameplate.signal.range_pa[1]
    if name == "triangle":
        # 20 s would drive the graphite valve at its limit velocity, where it moves in a hundred jumps
        period_s = 12.0 if nameplate.tag == "GRAPHITE" else 20.0
        return triangle(period_s, round(60.0 / period_s), low_pa, high_pa)
    if name == "multi_rate":
        return multi_rate_triangle(multi_rate_periods(2.0), low_pa, high_pa)
    if name == DIAGNOSTIC:
        return diagnostic(low_pa, high_pa, rate_pa_per_s=high_pa - low_pa, longest_s=140.0)
    if name == HELD_OUT:
        return sine(8.0, 4.0, low_pa, high_pa)
    raise KeyError(f"sequence {name!r}: choose one of {', '.join((*SEQUENCES, DIAGNOSTIC, HELD_OUT))}")


def rough_valve(
    valve: str,
    grade: str,
    seed: int,
    *,
    occasion: int = 0,
    packing: Mapping[str, Any] | None = None,
    position: Mapping[str, Any] | None = None,
    pressure: Mapping[str, Any] | None = None,
    path: Mapping[str, Any] | None = None,
    effects: Sequence[Effect] = (),
) -> SimulatedValve:
    """Return a valve of this grade; mappings replace single fields of its Packing, Sensors and Transducer."""
    parameters, nameplate = SLIPPING if valve == "slipping" else VALVES[valve]
    assert nameplate.signal is not None, "the cases' nameplates have one"
    low_pa, high_pa = nameplate.signal.range_pa
    travel_m, span_pa = nameplate.actuator.travel_m, high_pa - low_pa
    # another valve of the same seed is rough at other places
    seed = 4 * (1_000_003 * seed + zlib.crc32(f"{valve} {grade}".encode()))
    noisy = seed + 1_000_003_007 * occasion
    hunting = Hunting(hunting_swing_pa(grade, span_pa), seed=noisy + 3)
    transducer = Transducer((low_pa, high_pa), supply_pa=2.0 * high_pa, dac_bits=24, hunting=hunting)
    position_span_m = (-_MARGIN * travel_m, (1.0 + _MARGIN) * travel_m)
    pressure_span_pa = (low_pa - _MARGIN * span_pa, high_pa + _MARGIN * span_pa)
    ideal_bits = {"adc_bits": 24} if grade == "ideal" else {}
    return SimulatedValve(
        nameplate.tag,
        parameters,
        nameplate,
        replace(transducer, **(path or {})),
        Sensor(
            position_span_m,
            **{**ideal_bits, **position_settings(grade, travel_m), "seed": noisy + 1, **(position or {})},
        ),
        Sensor(
            pressure_span_pa,
            **{**ideal_bits, **pressure_settings(grade, span_pa), "seed": noisy + 2, **(pressure or {})},
        ),
        effects=tuple(effects),
        packing=replace(packing_preset(grade), **(packing or {})),
        packing_seed=seed,
        occasion=occasion,
    )


def case(
    valve: str,
    sequence_name: str = "triangle",
    grade: str = "usual",
    period_s: float = 1.0e-3,
    seed: int = 0,
    *,
    jitter_s: float = 0.0,
    **changes: Any,
) -> RoughCase:
    """Return one recording with its nameplate and truth; the same arguments give the same case.

    ``valve``: vendor, nominal, rough, graphite, small or large. ``sequence_name``: triangle or multi_rate, or sine to
    try a finding on. ``grade``: ideal, mild, usual or hard, of packing, sensors and I/P alike. ``period_s``: 1 ms as
    captured, 20 ms as polled; rows are even, or each up to ``jitter_s`` later.

    ``changes`` as in ``rough_valve``. ``occasion``: the same valve at another time, so with the same roughness and
    other breakaways, wander and noise. Single sizes: ``packing={"breakaway_scatter": 0.0, "roughness_law": "smooth"}``,
    ``position={"noise_rms": 2.0e-6, "refresh_s": 0.05}``, ``pressure={"filter_s": 0.0}``, ``path={"lag_s": 0.2,
    "dead_time_s": 0.1, "hunting": Hunting(0.0)}`` (usual hunts by 0.1 % of the range, hard by 0.3 %),
    ``effects=[EFFECTS["local_friction"](...)]``.

    Truth: w (roughness) is averaged evenly over the travel that each direction swept, d (wander) evenly over the time
    recorded; a fit's own averages have to be the same to be judged by it.

    >>> found = case("nominal", "multi_rate", "usual", seed=7)
    >>> found.recording, found.nameplate, found.truth.parameters.coulomb_friction_n  # doctest: +SKIP
    """
    settings = rough_valve(valve, grade, seed, **changes)
    wave = sequence(sequence_name, settings.nameplate)
    recording, truth = recorded(settings, wave, period_s, jitter_s=jitter_s)
    return RoughCase(recording, settings.nameplate, truth, settings, wave)
