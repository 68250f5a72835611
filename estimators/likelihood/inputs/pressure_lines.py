"""The measured pressure or force as straight lines: a polyline, and what its noise leaves unknown of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from estimators.base import Outcome
from estimators.likelihood.inputs.answered_lines import answered_corners
from estimators.likelihood.inputs.nuisance import Nuisance
from estimators.likelihood.lines.stretches import ROWS_A_STEP, Corners, KnownCorners, Stretch, find_stretches
from estimators.motion.channels import ONE_INSTANT
from estimators.samples import FloatArray
from valve.recording import Acquisition, Recording

MOST_VARIATIONS: Final = 100
_DELAY_PERIODS: Final = 5.0
_DELAY_S: Final = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPath:
    """The actuator force from a measured channel; ``delay_s`` is how much later it acts than its time stamps say.

    ``noise_n`` is the noise of the channel, one standard deviation, 0 where it is computed. ``breaks_s``, shape
    (b, 2), are times, on the channel's own clock, between which the force is not known: the stem has to be started
    anew after each. There, before the first row and after the last, its lines go on as far as a delay may ask.
    """

    stretches: tuple[Stretch, ...]
    delay: Nuisance
    noise_n: float
    breaks_s: FloatArray
    _plain: Corners = field(init=False)

    def __post_init__(self) -> None:
        # they are asked for at each of some thousand simulations
        object.__setattr__(self, "_plain", self._joined([stretch.corners() for stretch in self.stretches], 0.0))

    @property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """The delay between the channels."""
        return (self.delay,)

    def corners(self, values: FloatArray) -> Corners:
        """Corner times, s, and force, N, shape (n,), for this delay."""
        time_s, force_n = self._plain
        return time_s + float(values[0]), force_n

    def variations(self, values: FloatArray) -> Iterator[Corners]:
        """Corners changed by one sigma along each independent direction of the fitted lines' errors.

        A line has two such directions, its level and its slope, which are independent of all other lines; pieces
        that pass smoothly into each other, and lines behind a lag, have the eigen-directions of their covariance. Of
        more than 100 those with the largest change of force are kept.
        """
        plain = [stretch.corners() for stretch in self.stretches]
        sized = [
            (float(size), number, direction)
            for number, stretch in enumerate(self.stretches)
            for direction, size in enumerate(stretch.sizes())
        ]
        for _, number, direction in sorted(sized, reverse=True)[:MOST_VARIATIONS]:
            changed = list(plain)
            changed[number] = self.stretches[number].corners(direction)
            yield self._joined(changed, float(values[0]))

    def _joined(self, parts: list[Corners], delay_s: float) -> Corners:
        time_s, force_n = held_together(parts, self.breaks_s, self.delay.upper + _DELAY_S)
        return time_s + delay_s, force_n


def held_together(parts: list[Corners], breaks_s: FloatArray, lead_s: float, *, settled: bool = False) -> Corners:
    """Put stretches one after the other, the last line of each drawn on for ``lead_s``, and the first one back.

    A delay between the channels asks for the force beyond the rows that tell it, where a ramp has not ended with the
    recording. No line goes farther than the middle of a break; it holds its value from there. What is ``settled``
    before its first row is held there.
    """
    times: list[FloatArray] = []
    forces: list[FloatArray] = []
    for number, (time_s, force_n) in enumerate(parts):
        begin_s = time_s[0] - lead_s if number == 0 else 0.5 * float(breaks_s[number - 1].sum())
        end_s = time_s[-1] + lead_s if number == len(parts) - 1 else 0.5 * float(breaks_s[number].sum())
        back_s, on_s = min(lead_s, max(time_s[0] - begin_s, 0.0)), min(lead_s, max(end_s - time_s[-1], 0.0))
        before_n = force_n[0] - (0.0 if settled else back_s * _rate(time_s[:2], force_n[:2]))
        after_n = force_n[-1] + on_s * _rate(time_s[-2:], force_n[-2:])
        before_s = np.unique([min(begin_s, time_s[0]), time_s[0] - back_s])
        after_s = np.unique([time_s[-1] + on_s, max(end_s, time_s[-1])])
        times += [before_s, time_s, after_s]
        forces += [np.full(before_s.size, before_n), force_n, np.full(after_s.size, after_n)]
    return np.concatenate(times), np.concatenate(forces)


def _rate(time_s: FloatArray, force_n: FloatArray) -> float:
    """Rate of the line between two corners, N/s; 0 of one corner, and of a step."""
    lasts_s = float(time_s[-1] - time_s[0])
    return float(force_n[-1] - force_n[0]) / lasts_s if lasts_s > 0.0 else 0.0


def measured_path(recording: Recording, force_n: FloatArray) -> MeasuredPath | Outcome:
    """Return the polyline of the measured force, shape (n,), N, NaN where it is missing; or why there is none.

    A computed channel (noise below 1e-9 of its span) gives its corners to rounding. A noisy one is cut into as few
    lines as its noise allows; lines cross at corners. Curves are lines behind a first-order lag where that leaves no
    more than the noise, as an I/P makes them, and else cubics; they are drawn with chords. Where values
    are missing the pieces on both sides are drawn on to their crossing; where they do not cross, where more than
    0.5 s (and 25 rows) are missing about a corner, or where time jumps by 5 periods without a row (as between two
    recordings that were put together) there is a break. A polled pressure that its command tells between the rows
    is drawn as that has it, through all gaps.
    """
    answered = answered_corners(recording, force_n)
    if answered is not None:
        return MeasuredPath((KnownCorners(*answered),), _delay(recording), 0.0, np.empty((0, 2)))
    found = find_stretches(recording, force_n, ROWS_A_STEP)
    if isinstance(found, Outcome):
        return found
    stretches, breaks_s, noise_n = found
    return MeasuredPath(stretches, _delay(recording), noise_n, breaks_s)


def _delay(recording: Recording) -> Nuisance:
    period_s = recording.sample_period_s
    most_s = max(_DELAY_PERIODS * period_s, _DELAY_S)
    return Nuisance("delay_s", 0.0, 0.1 * period_s, -most_s, most_s, delay_prior_s(recording))


def delay_prior_s(recording: Recording) -> float:
    """What is known beforehand of the delay between the channels, one standard deviation, s.

    Captured: a device takes all channels of a sample at one instant (docs/reference-map.md, "Capture"); 0.5 % of a
    period is left to its converter. That is a claim that matters: the delay is the twin of F_v / k where the stem
    follows without slipping, and hides m. Polled: half an exchange, within which both were read. A period where
    nothing is said.
    """
    period_s = recording.sample_period_s
    provenance = recording.provenance
    if provenance.acquisition in {Acquisition.CAPTURED, Acquisition.SIMULATED}:
        return ONE_INSTANT * period_s
    if provenance.timing_uncertainty_s is not None:
        return max(provenance.timing_uncertainty_s, ONE_INSTANT * period_s)
    exchange_s = recording.sampling_quality().median_exchange_s
    return period_s if exchange_s is None else max(0.5 * exchange_s, ONE_INSTANT * period_s)
