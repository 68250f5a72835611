"""Healthy valves of every kind under the abort rules, in simulated time: a test of minutes takes a moment."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, Final

import pytest

from drivers import abort_rules
from drivers.abort_rules import AbortRules
from drivers.addresses import MotionLimits, Point, Sampling, TcpAddress, ValveWiring, WatchdogChoice
from drivers.device import connect_valve
from drivers.maps.reference import StatusBit
from drivers.outcome import Sample
from drivers.permissive_rules import PermissiveRules
from drivers.permissive_watch import PermissiveWatch
from drivers.transport import Transport
from service.model.sequences import build_waveform
from simulator.plant import SoftwareValve
from simulator.sensor import Sensor
from simulator.simulated_valve import SimulatedValve
from simulator.transducer import Transducer
from valve.effects import Effect
from valve.errors import EquipmentError, MeasurementError
from valve.nameplate import Nameplate
from valve.parameter_sets import PARAMETER_SETS
from valve.parameters import TravelStops, ValveParameters

_EXCHANGE_S: Final = 0.002
_GLANCE_S: Final = 0.1  # how often a captured test is looked at


@dataclass(frozen=True, slots=True)
class Healthy:
    """A valve in good order, and how it is measured. ``seen`` tells whether the actuator's pressure is."""

    name: str
    parameters: ValveParameters
    nameplate: Nameplate
    lag_s: float = 0.0
    position_noise: float = 5.0e-5  # of the travel
    seen: bool = True
    stops: bool = False
    effects: tuple[Effect, ...] = ()

    def simulated(self) -> SimulatedValve:
        """Return it with its sensors."""
        low_pa, high_pa = self.range_pa
        travel_m, margin_pa = self.nameplate.actuator.travel_m, 0.05 * (high_pa - low_pa)
        return SimulatedValve(
            self.name,
            self.parameters,
            self.nameplate,
            Transducer((low_pa, high_pa), self.lag_s, supply_pa=1.7 * high_pa),
            Sensor((-0.1 * travel_m, 1.1 * travel_m), self.position_noise * travel_m, seed=3),
            Sensor((low_pa - margin_pa, high_pa + margin_pa), 5.0, seed=4) if self.seen else None,
            TravelStops(0.0, travel_m) if self.stops else TravelStops(),
            start_pa=low_pa,
            effects=self.effects,
        )

    @property
    def range_pa(self) -> tuple[float, float]:
        """The signal's range at the actuator, Pa."""
        assert self.nameplate.signal is not None
        return self.nameplate.signal.range_pa

    def wiring(self, *, steps: bool) -> ValveWiring:
        """Return how it is wired, with the limits that its plant file would have."""
        low_pa, high_pa = self.range_pa
        travel_m = self.nameplate.actuator.travel_m
        return ValveWiring(
            self.name,
            Point("bus", 1, "reference"),
            low_pa,
            MotionLimits((low_pa, high_pa), 0.75 * (high_pa - low_pa), 300.0, steps_allowed=steps),
            Sampling("polled", 0.02),  # type: ignore[arg-type]  # the text is turned into a Mode
            watchdog=WatchdogChoice(timeout_s=2.0),
            permissives=PermissiveRules(position_m=(-0.1 * travel_m, 1.1 * travel_m), still_m=0.01 * travel_m),
        )


def of_set(name: str, **changes: Any) -> Healthy:
    """Return a published valve as it is."""
    chosen = PARAMETER_SETS[name]
    return Healthy(name, chosen.parameters, chosen.nameplate, **changes)


def with_friction(name: str, dead_band: float, viscous_n_s_per_m: float, **changes: Any) -> Healthy:
    """Return the nominal valve with this dead band, F_s + F_c in shares of the span's force, and this F_v."""
    chosen = PARAMETER_SETS["nominal"]
    area_m2 = chosen.nameplate.actuator.diaphragm_area_m2
    assert area_m2 is not None
    assert chosen.nameplate.signal is not None
    both_n = dead_band * area_m2 * (chosen.nameplate.signal.range_pa[1] - chosen.nameplate.signal.range_pa[0])
    parameters = replace(
        chosen.parameters,
        static_friction_n=0.52 * both_n,
        coulomb_friction_n=0.48 * both_n,
        viscous_friction_n_s_per_m=viscous_n_s_per_m,
    )
    return Healthy(name, parameters, chosen.nameplate, **changes)


@contextmanager
def _clock(now: list[float]) -> Iterator[None]:
    class Clock:
        @staticmethod
        def monotonic() -> float:
            return now[0]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(abort_rules, "time", Clock)
        yield


def verdict(
    healthy: Healthy, sequence: str, overrides: Mapping[str, Any], *, period_s: float | None
) -> EquipmentError | MeasurementError | None:
    """Play a sequence on a valve; why the rules would end the test, None where they do not.

    ``period_s`` is that of polling; None: the device plays and is only watched.
    """
    wiring = healthy.wiring(steps=sequence == "steps")
    waveform = build_waveform(sequence, overrides, healthy.nameplate, wiring.limits)
    device = connect_valve(wiring, {"bus": Transport(TcpAddress("bus", "127.0.0.1", 1))})
    valve = SoftwareValve(healthy.simulated(), start_s=1.0)
    now = [1.0]

    def look() -> Sample:
        sent_s = now[0]
        valve.advance(sent_s + 0.5 * _EXCHANGE_S)
        now[0] = sent_s + _EXCHANGE_S
        pressure_pa = valve.read_pressure_pa() if healthy.seen else math.nan
        status = 1 << StatusBit.LOOP_IN_MANUAL
        return Sample(sent_s, now[0], valve.read_position_m(), pressure_pa, valve.asked_pa, status, valve.supply_pa)

    with _clock(now):
        rules = AbortRules(device, wiring.limits, waveform.duration_s + 10.0, period_s or _GLANCE_S)
        looks = [look() for _ in range(4)]
        unrest_m = max(one.position_m for one in looks) - min(one.position_m for one in looks)
        rules.begin(looks[-1], unrest_m, PermissiveWatch(device, permitted=False))
        start_s = now[0]
        if period_s is None:
            valve.play(waveform.time_s, waveform.pressure_pa)
        slot = 0
        while now[0] < start_s + waveform.duration_s:
            now[0] = max(now[0], start_s + slot * (period_s or _GLANCE_S))
            if period_s is not None:
                asked_pa = float(waveform.at(now[0] - start_s))
                rules.commanded(asked_pa)
                valve.advance(now[0])
                valve.ask(asked_pa)
            fault = rules.fault(look(), follows=period_s is not None)
            if fault is not None:
                return fault
            slot += 1
    return None
