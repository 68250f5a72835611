"""What valve, air, sensors and device can do: the test ends, the valve is safe, and the reason is said."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Final

import numpy as np
import pytest

from drivers.addresses import MotionLimits, Point, Sampling, TcpAddress, ValveWiring, WatchdogChoice
from drivers.device import connect_valve
from drivers.outcome import Ended, PlayOutcome
from drivers.permissive_rules import PermissiveRules
from drivers.sequence import play_sequence
from drivers.transport import Transport
from simulator.assembly import SimulatedPlant, reference_unit
from simulator.faults import Fault, FaultKind
from simulator.listeners import TcpListener
from simulator.sensor import Sensor
from simulator.simulated_valve import SimulatedValve
from simulator.transducer import Transducer
from valve.errors import PermissiveError
from valve.parameter_sets import PARAMETER_SETS
from valve.recording import Provenance
from valve.waveform import Waveform, triangle

TAG: Final = "FV-1"
SPAN_PA: Final = 82_737.0
SAFE_PA: Final = 10_000.0
RATE_PA_PER_S: Final = 100_000.0
LIMITS: Final = MotionLimits((0.0, SPAN_PA), RATE_PA_PER_S, 60.0)
WIRING: Final = ValveWiring(
    TAG,
    Point("bus", 1, "reference"),
    SAFE_PA,
    LIMITS,
    Sampling("polled", 0.04),  # type: ignore[arg-type]  # the text is turned into a Mode
    watchdog=WatchdogChoice(timeout_s=2.0),
    permissives=PermissiveRules(position_m=(-0.01, 0.112), still_m=1.0e-3),
)
WHOLE: Final = triangle(3.0, 2, 0.0, SPAN_PA)


async def played(
    *faults: Fault,
    mode: str = "polled",
    wiring: ValveWiring = WIRING,
    waveform: Waveform = WHOLE,
    parameter_set: str = "nominal",
    noise_m: float = 5.0e-6,
    permit: str | None = None,
) -> tuple[PlayOutcome, SimulatedPlant]:
    """Play on a simulated valve with these faults; their times count from the plant's start."""
    chosen = PARAMETER_SETS[parameter_set]
    valve = SimulatedValve(
        TAG,
        chosen.parameters,
        chosen.nameplate,
        Transducer((0.0, SPAN_PA)),
        Sensor((-0.005, 0.107), noise_m),
        Sensor((-4000.0, 87000.0), 5.0),
        start_pa=SAFE_PA,
        faults=faults,
    )
    plant = SimulatedPlant([valve], {TcpListener(): [reference_unit(1, TAG)]})
    await plant.start(look_every_s=0.02)
    bus = Transport(TcpAddress("bus", "127.0.0.1", int(plant.addresses[0].rpartition(":")[2])))
    await bus.open()
    try:
        outcome = await play_sequence(
            connect_valve(wiring, {"bus": bus}),
            waveform,
            mode=mode,
            period_s=0.04 if mode == "polled" else 0.002,
            run_number=3,
            stop=asyncio.Event(),
            on_samples=lambda _: None,
            on_progress=lambda _share, _phase: None,
            limits=wiring.limits,
            provenance=Provenance(),
            permit=permit,
        )
        plant.look()
        return outcome, plant
    finally:
        await bus.close()
        await plant.stop()


def require_safe(outcome: PlayOutcome, plant: SimulatedPlant) -> None:
    assert outcome.safe_confirmed
    assert plant.records[TAG].track.asked_pa[-1] == pytest.approx(SAFE_PA, abs=100.0)


def fastest_pa_per_s(plant: SimulatedPlant, after_s: float) -> float:
    """Steepest change of the output between looks, a few looks apart so that single commands do not count."""
    track = plant.records[TAG].track
    late = track.time_s > after_s
    time_s, asked_pa = track.time_s[late], track.asked_pa[late]
    apart = 8
    return float(np.max(np.abs(asked_pa[apart:] - asked_pa[:-apart]) / (time_s[apart:] - time_s[:-apart] + 0.05)))


@pytest.mark.parametrize("mode", ["polled", "captured"])
async def test_a_stuck_stem_ends_the_test_and_the_pressure_goes_back_by_a_ramp(mode: str) -> None:
    outcome, plant = await played(Fault(FaultKind.STUCK_STEM, 0.01), mode=mode)
    require_safe(outcome, plant)
    assert outcome.ended is Ended.FAILED
    assert "did not break away" in str(outcome.error)
    assert fastest_pa_per_s(plant, 0.0) < 1.6 * RATE_PA_PER_S


async def test_a_frozen_sensor_is_told_from_a_stuck_stem() -> None:
    outcome, plant = await played(Fault(FaultKind.FROZEN_SENSOR, 1.5))
    require_safe(outcome, plant)
    assert "sensor is frozen" in str(outcome.error)


FAULTS: Final[list[tuple[Fault, str]]] = [
    (Fault(FaultKind.SENSOR_LOST, 1.5), "no valid position"),
    (Fault(FaultKind.SENSOR_JUMP, 1.5, amount=-0.2), "sensor is frozen"),
    (Fault(FaultKind.SENSOR_SPIKES, 1.5, amount=0.02), "to and fro"),
    (Fault(FaultKind.PRESSURE_STUCK, 1.5), "actuator's pressure stayed"),
    (Fault(FaultKind.AIR_LOST, 1.5, amount=0.0), "air supply"),
    (Fault(FaultKind.LOOP_IN_AUTOMATIC, 1.5), "no longer in manual"),
    (Fault(FaultKind.INTERLOCK, 1.5), "interlock"),
    (Fault(FaultKind.OUTPUT_RESET, 2.2), "the device shows|capture"),
    (Fault(FaultKind.IGNORED_WRITES, 1.9, 3.2), "the device shows"),
]


@pytest.mark.parametrize("part", range(3))
async def test_each_fault_of_valve_air_sensor_and_device_ends_the_test_safely_and_is_said(part: int) -> None:
    faults = FAULTS[part::3]  # three at once: each mostly waits for its waveform
    ends = await asyncio.gather(*(played(fault) for fault, _ in faults))
    for (fault, said), (outcome, plant) in zip(faults, ends, strict=True):
        if fault.kind is FaultKind.OUTPUT_RESET and outcome.ended is Ended.COMPLETED:
            # The next command came first: what was seen meanwhile is no sample.
            assert outcome.recording is not None
            continue
        require_safe(outcome, plant)
        assert outcome.ended is Ended.FAILED, fault
        assert any(words in str(outcome.error) for words in said.split("|")), (fault, outcome.error)


@pytest.mark.parametrize("mode", ["polled", "captured"])
async def test_an_ip_that_runs_away_ends_the_test_and_the_valve_is_told_to_be_where_nobody_sent_it(mode: str) -> None:
    outcome, plant = await played(Fault(FaultKind.PRESSURE_RUNAWAY, 1.5, amount=1.1 * SPAN_PA), mode=mode)
    require_safe(outcome, plant)  # what the device was told: more cannot be done from here
    assert outcome.ended is Ended.FAILED
    assert "is outside 0 to 82737 Pa" in str(outcome.error)
    assert "the actuator's pressure stays at" in str(outcome.error)
    assert "keep away from the valve" in str(outcome.error)
    assert plant.records[TAG].track.pressure_pa[-1] == pytest.approx(1.1 * SPAN_PA)


async def test_a_failed_test_whose_valve_goes_to_its_safe_value_says_nothing_of_the_pressure() -> None:
    outcome, _ = await played(Fault(FaultKind.INTERLOCK, 1.5))
    assert outcome.ended is Ended.FAILED
    assert "pressure stays" not in str(outcome.error)


@pytest.mark.parametrize("kind", [FaultKind.LOOP_IN_AUTOMATIC, FaultKind.INTERLOCK, FaultKind.AIR_LOST])
async def test_a_missing_permissive_keeps_the_valve_where_it_is(kind: FaultKind) -> None:
    with pytest.raises(PermissiveError, match="nothing was moved"):
        await played(Fault(kind, 0.0))


async def test_a_permit_stands_for_the_manual_mode_where_the_plant_demands_one() -> None:
    wiring = replace(WIRING, permissives=replace(WIRING.permissives, permit=True))
    automatic = Fault(FaultKind.LOOP_IN_AUTOMATIC, 0.0)
    short = triangle(1.0, 1, 20_000.0, 60_000.0)
    with pytest.raises(PermissiveError, match="permit"):
        await played(automatic, wiring=wiring, waveform=short)
    outcome, plant = await played(automatic, wiring=wiring, waveform=short, permit="W-17")
    require_safe(outcome, plant)
    assert outcome.ended is Ended.COMPLETED, outcome.error


async def test_another_device_than_the_plant_names_is_not_moved() -> None:
    wiring = replace(WIRING, permissives=replace(WIRING.permissives, device_number=17))
    with pytest.raises(PermissiveError, match="another device answers"):
        await played(wiring=wiring)


async def test_a_stem_that_leaves_its_band_ends_the_test() -> None:
    wiring = replace(WIRING, limits=replace(LIMITS, band_m=0.02))
    outcome, plant = await played(wiring=wiring)
    require_safe(outcome, plant)
    assert "limits.band_m" in str(outcome.error)


@pytest.mark.parametrize("mode", ["polled", "captured"])
async def test_a_healthy_valve_on_the_wire_is_never_taken_for_a_faulty_one(mode: str) -> None:
    sets = ("vendor", "nominal", "rough")
    for outcome, plant in await asyncio.gather(*(played(parameter_set=name, mode=mode) for name in sets)):
        require_safe(outcome, plant)
        assert outcome.ended is Ended.COMPLETED, outcome.error
