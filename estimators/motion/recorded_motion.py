"""What both methods begin with: the samples, their phases, the uniform motion in them and the stops they touch."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, Protocol, runtime_checkable

import numpy as np

from estimators.base import Estimate, Outcome
from estimators.motion.phases import After, Phases, find_phases
from estimators.motion.stops import find_stops
from estimators.motion.uniform_motion import UniformMotion, fit_uniform_motion
from estimators.samples import BoolArray, Samples, prepare
from valve.nameplate import Action, Nameplate
from valve.parameters import TravelStops
from valve.recording import Recording

_YOUNG_ROWS: Final = 12
_TURNED_BACK: Final = 0.5  # of what the force went in the stem's direction: so much is a way back
_TRIFLE: Final = 0.05  # of the friction: a smaller preload does not spoil what assumes none


@dataclass(frozen=True, slots=True, eq=False)
class RecordedMotion:
    """Samples, phases, uniform motion (None where there is none, ``uniform_outcome`` says why) and stops."""

    samples: Samples
    phases: Phases
    uniform: UniformMotion | None
    uniform_outcome: Outcome | None
    stops: TravelStops | None
    action: Action
    moving_mass_kg: float | None
    command_only: bool
    recording: Recording | None = None  # what it was read from
    nameplate: Nameplate | None = None
    shared: dict[str, object] = field(default_factory=dict)  # what one method found and another may start from

    @property
    def first_moving_row(self) -> int:
        """First row in motion."""
        return self.phases.stretches[0].first

    @property
    def has_preload(self) -> bool:
        """Whether uniform motion surely shows a preload that is no trifle against the friction."""
        if self.uniform is None or self.uniform.preload_n is None:
            return False
        sure_n = 5.0 * float(self.uniform.std_error[2])
        return abs(self.uniform.preload_n) > max(sure_n, _TRIFLE * abs(self.uniform.friction_n))

    @property
    def one_direction(self) -> bool:
        """Whether the stem moved in one direction only."""
        return len(self.phases.directions) < 2

    @property
    def one_way_outcome(self) -> Outcome:
        """Why the stem moved in one direction only: no way back was asked for, or friction held it on that way."""
        sense, force_n = max(self.phases.directions), self.samples.force_n
        back_n = float(np.max(np.maximum.accumulate(sense * force_n) - sense * force_n))
        if self.one_direction and back_n > _TURNED_BACK * float(np.ptp(force_n)):
            return Outcome.HELD_ON_THE_WAY_BACK
        return Outcome.ONE_DIRECTION_ONLY


def read_motion(recording: Recording, nameplate: Nameplate) -> RecordedMotion | Outcome:
    """Return what the recording holds, or the outcome where it holds no motion to work on."""
    with np.errstate(all="ignore"):
        return _read(recording, nameplate)


@runtime_checkable
class MotionEstimator(Protocol):
    """An estimator that begins with what ``read_motion`` returns, so that several can share it."""

    def estimate_motion(self, motion: RecordedMotion | Outcome) -> Estimate:
        """Return the estimate."""
        ...


def _read(recording: Recording, nameplate: Nameplate) -> RecordedMotion | Outcome:
    samples = prepare(recording, nameplate)
    if isinstance(samples, Outcome):
        return samples
    if float(samples.force_n.max()) - float(samples.force_n.min()) <= 6.0 * samples.force_noise_n:
        return Outcome.NO_FORCE_CHANGE
    phases = find_phases(samples)
    if isinstance(phases, Outcome):
        return phases
    action = nameplate.actuator.action
    uniform = fit_uniform_motion(samples, phases, action)
    found = None if isinstance(uniform, Outcome) else uniform
    return RecordedMotion(
        samples=samples,
        phases=phases,
        uniform=found,
        uniform_outcome=uniform if isinstance(uniform, Outcome) else None,
        stops=None if found is None else find_stops(samples, phases, found),
        action=action,
        moving_mass_kg=nameplate.actuator.moving_mass_kg,
        command_only=recording.force_n is None and recording.pressure_pa is None,
        recording=recording,
        nameplate=nameplate,
    )


def young_rows(motion: RecordedMotion) -> BoolArray:
    """Rows, shape (n,), just after a breakaway where the stem may still creep below DV; none where noise hides that."""
    young = np.zeros(motion.samples.count, dtype=np.bool_)
    if motion.samples.position_noise_m > 0.0:
        return young
    for stretch in motion.phases.stretches:
        if stretch.after is After.BREAKAWAY:
            young[stretch.first : min(stretch.first + _YOUNG_ROWS, stretch.last + 1)] = True
    return young
