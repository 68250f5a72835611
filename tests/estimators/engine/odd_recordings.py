"""Odd recordings, as people upload them: each kind of oddness from one seed, with what may be said of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Final

import numpy as np
import numpy.typing as npt

from tests.support.rough_valves import case
from valve.nameplate import Action, Actuator, Nameplate
from valve.recording import Recording

FloatArray = npt.NDArray[np.float64]
Made = tuple[Recording, Nameplate]

DRIVE: Final = Nameplate("drive", Actuator(travel_m=0.1, action=Action.DOUBLE))


@cache
def _valve(valve: str, sequence: str, period_s: float) -> Made:
    made = case(valve, sequence, "usual", period_s, seed=3)
    return made.recording, made.nameplate


def _drawn(random: np.random.Generator) -> Made:
    valve = str(random.choice(["nominal", "small", "rough"]))
    return _valve(valve, str(random.choice(["triangle", "multi_rate"])), 2.0e-2)


def _short(random: np.random.Generator) -> Made:
    recording, nameplate = _drawn(random)
    first, rows = int(random.integers(0, recording.samples - 400)), int(random.choice([1, 2, 3, 10, 39, 45, 120, 400]))
    return recording.rows(slice(first, first + rows)), nameplate


def _gaps(random: np.random.Generator) -> Made:
    recording, nameplate = _drawn(random)
    position_m, pressure_pa = recording.position_m.copy(), np.array(recording.pressure_pa)
    share = float(random.choice([0.1, 0.5, 0.95, 1.0]))
    channel = position_m if random.random() < 0.5 else pressure_pa
    channel[random.random(position_m.size) < share] = np.nan
    return replace(recording, position_m=position_m, pressure_pa=pressure_pa), nameplate


def _constant(random: np.random.Generator) -> Made:
    recording, nameplate = _drawn(random)
    noise_m = float(random.choice([0.0, 1.0e-5])) * random.standard_normal(recording.samples)
    if random.random() < 0.5:
        return replace(recording, position_m=0.03 + noise_m), nameplate
    return replace(recording, pressure_pa=np.full(recording.samples, 5.0e4), command_pa=None), nameplate


def _scaled(random: np.random.Generator) -> Made:
    recording, nameplate = _drawn(random)
    scale, offset = float(random.choice([-1.0, 1.0e-6, 1.0e3, 1.0])), float(random.choice([0.0, 1.0e3, -50.0]))
    pressure = float(random.choice([1.0, -1.0, 1.0e-5, 1.0e5])), float(random.choice([0.0, 1.0e7]))
    assert recording.pressure_pa is not None
    return replace(
        recording,
        position_m=scale * recording.position_m + offset,
        pressure_pa=pressure[0] * recording.pressure_pa + pressure[1],
        command_pa=None,
    ), nameplate


def _clipped(random: np.random.Generator) -> Made:
    recording, nameplate = _drawn(random)
    low_m, high_m = np.quantile(recording.position_m, np.sort(random.random(2)))
    pressure_pa = np.array(recording.pressure_pa)
    if random.random() < 0.5:
        pressure_pa = np.clip(pressure_pa, *np.quantile(pressure_pa, np.sort(random.random(2))))
    return replace(
        recording, position_m=np.clip(recording.position_m, low_m, high_m), pressure_pa=pressure_pa
    ), nameplate


def _noise(random: np.random.Generator) -> Made:
    recording, nameplate = _drawn(random)
    pure = random.standard_normal(recording.samples)
    if random.random() < 0.5:
        pure = np.cumsum(pure)
    return replace(recording, position_m=0.01 * pure / np.abs(pure).max()), nameplate


def _other_action(random: np.random.Generator) -> Made:
    recording, nameplate = _drawn(random)
    force_n = recording.actuator_force_n(nameplate)
    kind = int(random.integers(0, 3))
    if kind == 0:  # a valve with a spring that is said to have none
        return Recording(recording.time_s, recording.position_m, force_n=force_n), DRIVE
    if kind == 1:
        return recording, replace(
            nameplate, actuator=replace(nameplate.actuator, action=Action.DOUBLE, bench_set_pa=None)
        )
    time_s = recording.time_s  # a drive that is said to have a spring
    position_m = 0.04 * np.sin(0.7 * time_s) + 1.0e-5 * random.standard_normal(time_s.size)
    force_n = 100.0 * np.sign(np.cos(0.7 * time_s)) + random.standard_normal(time_s.size)
    return Recording(time_s, position_m, force_n=force_n), replace(
        nameplate, actuator=replace(nameplate.actuator, action=Action.SPRING)
    )


def _drive(random: np.random.Generator) -> Made:
    time_s = np.arange(0.0, float(random.choice([2.0, 20.0])), float(random.choice([0.005, 0.05])))
    position_m = float(random.choice([0.0, 1.0e-4, 0.05])) * np.sin(float(random.uniform(0.5, 8.0)) * time_s)
    force_n = float(random.choice([0.0, 10.0])) * np.sign(np.gradient(position_m)) + random.standard_normal(time_s.size)
    return Recording(time_s, position_m + 1.0e-6 * random.standard_normal(time_s.size), force_n=force_n), DRIVE


def _uneven(random: np.random.Generator) -> Made:
    recording, nameplate = _drawn(random)
    kept = random.random(recording.samples) < float(random.choice([0.05, 0.3, 0.8]))
    kept[:3] = True
    return recording.rows(kept), nameplate


def _steps(random: np.random.Generator) -> Made:
    recording, nameplate = _drawn(random)
    coarse = float(random.choice([0.002, 0.02, 0.2])) * nameplate.actuator.travel_m
    return replace(recording, position_m=coarse * np.round(recording.position_m / coarse)), nameplate


def _one_way(random: np.random.Generator) -> Made:
    recording, nameplate = _drawn(random)
    top = int(np.argmax(recording.position_m))
    part = recording.rows(slice(0, top) if top > 100 else slice(top, top + 400))
    return (replace(part, pressure_pa=None) if random.random() < 0.5 else part), nameplate


def _shuffled(random: np.random.Generator) -> Made:
    """A position of another test than the pressure's."""
    recording, nameplate = _drawn(random)
    return replace(recording, position_m=np.roll(recording.position_m, int(random.integers(50, 900)))), nameplate


def _alone(random: np.random.Generator) -> Made:
    recording, nameplate = _drawn(random)
    command_pa = np.array(recording.command_pa)
    if random.random() < 0.5:
        command_pa = np.repeat(command_pa[::50], 50)[: command_pa.size]  # in steps
    return replace(recording, pressure_pa=None, command_pa=command_pa), nameplate


KINDS: Final[dict[str, Callable[[np.random.Generator], Made]]] = {
    make.__name__.strip("_"): make
    for make in (
        _short, _gaps, _constant, _scaled, _clipped, _noise, _other_action, _drive, _uneven, _steps, _one_way,
        _shuffled, _alone,
    )
}  # fmt: skip


def odd_recording(kind: str, seed: int) -> Made:
    """Return an odd recording of this kind, and its nameplate."""
    return KINDS[kind](np.random.default_rng([seed, *kind.encode()]))
