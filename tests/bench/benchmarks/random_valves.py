"""A thousand random valves, started from nothing but their recordings: right, silent or wrong, by method.

``BENCH_FIRST_SEED=3000`` draws other valves than those of the seeds from 0 on. All of them take hours:
``BENCH_JOURNAL=FILE`` keeps each answer as it comes, a line a test, and a run that was ended goes on from there. Delete
the file when the code has changed. ``RANDOM_METHODS`` names the methods (commas between). Times are of the processor,
not of the clock on the wall: another program beside it
does not lengthen them.
"""

from __future__ import annotations

import math
import os
import signal
import time
from collections import defaultdict
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import FrameType
from typing import Final

import numpy as np
from pydantic import TypeAdapter, ValidationError
from rich.table import Table

from estimators.base import NORMAL_95, Estimate, Status
from estimators.registry import ESTIMATORS
from tests.bench.benchmarks.bound import ONE_INSTANT, bound, delay_slope, relative_half_width
from tests.bench.parallel import each
from tests.support.random_valves import KINDS, UNINFORMATIVE, RandomTest, random_test
from valve.motion import simulate_motion
from valve.parameters import PARAMETER_SYMBOLS
from valve.recording import Acquisition
from valve.stem import FloatArray

TESTS: Final = 1000
FIRST_SEED: Final = int(os.environ.get("BENCH_FIRST_SEED", "0"))
MOST_Z: Final = 6.0  # own standard errors off the truth, and
LEAST_OFF: Final = 0.01  # this share of it: a wrong value
MOST_MISFIT: Final = 1.3  # times the noise: a wrong motion
SURELY_KNOWN: Final = 0.15  # bound's half width, half of the limit: a value that ought to be given
AS_LOW: Final = 25.0  # of the cost above the truth's: a fit that came to the right optimum is below it
LONGEST_S: Final = 60
JOURNAL: Final = os.environ.get("BENCH_JOURNAL", "")
LISTED: Final = 40


@dataclass(frozen=True, slots=True)
class Verdict:
    """One method's answer to one random test against the truth."""

    seed: int
    kind: str
    method: str
    status: str
    samples: int
    took_s: float
    wrong: tuple[str, ...] = ()  # what is wrong, in words
    withheld: tuple[str, ...] = ()  # parameters that the bound knows well and that are not given
    known: tuple[str, ...] = ()
    message: str = ""
    above_truth: float | None = None  # sum of squared residuals over that of the truth, in the noise's variance

    @property
    def arrived(self) -> bool:
        """Whether the fit explains the recording as well as the truth does: its search came to the right optimum."""
        return self.above_truth is not None and self.above_truth < AS_LOW

    @property
    def right(self) -> bool:
        """Whether all that the bound knows is given and nothing is wrong; of an immobile stem: that it is not ok."""
        return not self.wrong and not self.withheld


METHODS: Final = tuple(filter(None, os.environ.get("RANDOM_METHODS", "").split(","))) or tuple(ESTIMATORS)
_LAST: Final = METHODS[-1]
_LINE: Final = TypeAdapter(list[Verdict])


def judged(seed: int) -> list[Verdict]:
    """Return every method's verdict for the test of this seed, and keep it in the journal if there is one."""
    _warm()
    test = random_test(seed)
    known = known_symbols(test)
    verdicts = [_judged(method, test, known) for method in METHODS]
    if JOURNAL:
        with Path(JOURNAL).open("ab") as journal:  # one write a test: processes append to it side by side
            journal.write(_LINE.dump_json(verdicts) + b"\n")
    return verdicts


def _journal() -> dict[int, list[Verdict]]:
    """Return the verdicts that the journal holds, by seed; a line cut short by the end of a run is left out."""
    found: dict[int, list[Verdict]] = {}
    if not JOURNAL or not Path(JOURNAL).exists():
        return found
    for line in Path(JOURNAL).read_bytes().splitlines():
        with suppress(ValidationError):
            verdicts = _LINE.validate_json(line)
            found[verdicts[0].seed] = verdicts
    return found


def _judged(method: str, test: RandomTest, known: tuple[str, ...]) -> Verdict:
    begun_s = time.process_time()
    samples = test.recording.samples
    try:
        signal.signal(signal.SIGPROF, _too_long)
        signal.setitimer(signal.ITIMER_PROF, LONGEST_S)
        estimate = ESTIMATORS[method]().estimate(test.recording, test.nameplate)
    except Exception as error:  # noqa: BLE001 - what an estimator must not do is counted, and the others go on
        said = f"{type(error).__name__}: {error}".partition("\n")[0]
        took_s = time.process_time() - begun_s
        return Verdict(test.seed, test.kind, method, "raised", samples, took_s, (said,), known, known, said)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    took_s = time.process_time() - begun_s
    withheld = tuple(symbol for symbol in known if estimate.value(symbol) is None)
    wrong = what_is_wrong(estimate, test)
    status, said, above = str(estimate.status), estimate.message, above_truth(estimate, test)
    return Verdict(test.seed, test.kind, method, status, samples, took_s, wrong, withheld, known, said, above)


def _too_long(_number: int, _frame: FrameType | None) -> None:
    raise TimeoutError(f"more than {LONGEST_S} s")


@cache
def _warm() -> None:
    """Load what is compiled, once a process, so that no test's time holds it."""
    test = random_test(1, "captured")
    for method in METHODS:
        ESTIMATORS[method]().estimate(test.recording, test.nameplate)


def what_is_wrong(estimate: Estimate, test: RandomTest) -> tuple[str, ...]:
    """Return what is given and wrong: values off by far more than they admit, a motion that does not fit."""
    found = []
    truth = test.truth.by_symbol()
    for symbol, one in estimate.parameters.items():
        if one.value is None or one.std_error is None:
            continue
        error = one.value - truth[symbol]
        scale = max(abs(truth["F_0"]), truth["F_s"]) if symbol == "F_0" else truth[symbol]
        own = one.std_error
        if one.ci95 is not None:  # a bent interval counts on the side of the truth
            own = max(own, (one.value - one.ci95[0] if error > 0.0 else one.ci95[1] - one.value) / NORMAL_95)
        if abs(error) > MOST_Z * own and abs(error) > LEAST_OFF * scale:
            z = f"z {error / own:+.0f}" if own > 0.0 else "no error"
            found.append(f"{symbol} {100.0 * error / scale:+.2g} % ({z})")
    rms_m = estimate.residual_rms_m
    if estimate.status is Status.OK:
        if rms_m is not None and rms_m > MOST_MISFIT * test.noise_m:
            found.append(f"misfit {rms_m / test.noise_m:.1f} x noise")
        if test.kind == UNINFORMATIVE:
            found.append("ok of a stem that hardly moved")
    return tuple(found)


def above_truth(estimate: Estimate, test: RandomTest) -> float | None:
    """Return by how much the fit's squared residuals exceed those of the truth, in the noise's variance; None of none.

    About minus the number of parameters at the right optimum, and thousands at most others. The fit's are those of all
    measured rows: the classic methods' are not.
    """
    if estimate.residual_rms_m is None:
        return None
    time_s, position_m = test.recording.time_s, test.recording.position_m
    motion = simulate_motion(test.truth, *acting_force(test), time_s, stops=test.stops, initial=test.initial)
    off_m = (position_m - motion.position_m)[np.isfinite(position_m)]
    return off_m.size * (estimate.residual_rms_m**2 - float(np.mean(off_m**2))) / test.noise_m**2


def known_symbols(test: RandomTest) -> tuple[str, ...]:
    """Return the parameters that the bound knows well; the noise of a measured pressure is not counted in it."""
    if test.kind == UNINFORMATIVE:
        return ()
    corners, time_s = acting_force(test), test.recording.time_s[np.isfinite(test.recording.position_m)]
    truth, stops, initial = test.truth, test.stops, test.initial
    nuisances = [(delay_slope(truth, corners, time_s, stops=stops, initial=initial), delay_known_s(test))]
    if test.kind == "command_only":
        nuisances.append((_lag_slope(test, corners, time_s), math.inf))
    errors = bound(truth, corners, time_s, test.noise_m, stops=stops, initial=initial, nuisances=nuisances)
    return tuple(s for s in PARAMETER_SYMBOLS if relative_half_width(s, errors[s], test.truth) < SURELY_KNOWN)


def acting_force(test: RandomTest) -> tuple[FloatArray, FloatArray]:
    """Corners of the force from the recording's first time on, s and N."""
    first_s = test.recording.time_s[0]
    later = test.force_time_s > first_s
    begin_n = np.interp(first_s, test.force_time_s, test.force_n)
    return np.concatenate([[first_s], test.force_time_s[later]]), np.concatenate([[begin_n], test.force_n[later]])


def delay_known_s(test: RandomTest) -> float:
    """What the recording says of the delay between its channels, one standard deviation, s."""
    provenance = test.recording.provenance
    if test.kind == "command_only":
        return math.inf
    if provenance.acquisition is Acquisition.CAPTURED:
        return ONE_INSTANT * test.period_s
    return provenance.timing_uncertainty_s or test.period_s


def _lag_slope(test: RandomTest, corners: tuple[FloatArray, FloatArray], time_s: FloatArray) -> FloatArray:
    """Change of the position by a little more lag of the I/P, m/s, shape (n,); dF = -dT F', F' of each line."""
    force_s, force_n = corners
    late_n = 1.0e-5 * np.concatenate([[0.0], np.diff(force_n) / np.maximum(np.diff(force_s), 1.0e-12)])
    sides = []
    for changed_n in (force_n - late_n, force_n + late_n):
        motion = simulate_motion(test.truth, force_s, changed_n, time_s, stops=test.stops, initial=test.initial)
        sides.append(motion.position_m)
    return np.asarray((sides[0] - sides[1]) / 2.0e-5)


def run(count: int | None = None) -> list[Table]:
    """Return the counts by method and kind, what is wrong, and what is withheld."""
    tests = TESTS if count is None else count
    seeds = range(FIRST_SEED, FIRST_SEED + tests)
    kept = _journal()
    new = each(judged, [seed for seed in seeds if seed not in kept], "random valves")
    by_seed = kept | {verdicts[0].seed: verdicts for verdicts in new}
    found = [verdict for seed in seeds for verdict in by_seed[seed]]
    return [_counts(found, seeds), _wrongs(found), _withheld(found)]


def _counts(found: list[Verdict], seeds: range) -> Table:
    table = Table(
        title=f"{len(seeds)} random valves (seeds {seeds[0]} to {seeds[-1]}), started from nothing but the recording",
        caption="Right: nothing wrong, nothing withheld; nothing wrong: right, or honestly silent or wide. "
        "Arrived: it explains the recording as well as the truth does "
        f"({AS_LOW:g} of the cost), whatever is given of it. Wrong: a value off by more than {MOST_Z:g} of its own "
        f"standard errors and {100 * LEAST_OFF:g} %, or ok with a misfit above {MOST_MISFIT:g} x noise. Withheld: the "
        f"bound's half width is below {100 * SURELY_KNOWN:.0f} %, and it is not given. Processor times: medians, "
        "at least 40,000 and at most 8,000 samples; the longest of all.",
        title_justify="left",
    )
    for heading in (
        "method",
        "kind",
        "tests",
        "right",
        "nothing wrong",
        "arrived",
        "ok",
        "poor",
        "failed",
        "ok and wrong",
        "poor and wrong",
        "withheld",
    ):
        table.add_column(heading, justify="left" if heading in ("method", "kind") else "right")
    for heading in ("60,000", "6,000", "longest"):
        table.add_column(heading, justify="right")
    for method in METHODS:
        own = [verdict for verdict in found if verdict.method == method]
        by_kind: dict[str, list[Verdict]] = defaultdict(list)
        for verdict in own:
            by_kind[verdict.kind].append(verdict)
        for kind in KINDS:
            table.add_row(method, kind, *_row(by_kind[kind]))
        table.add_row(method, "all", *_row(own), end_section=True, style="bold")
    return table


def _row(found: list[Verdict]) -> list[str]:
    def count(*statuses: str, wrong: bool = False) -> str:
        return str(sum(v.status in statuses and (bool(v.wrong) or not wrong) for v in found))

    known, withheld = sum(len(v.known) for v in found), sum(len(v.withheld) for v in found)
    long_s = [v.took_s for v in found if v.samples >= 40_000]
    short_s = [v.took_s for v in found if v.samples <= 8_000]
    return [
        str(len(found)),
        str(sum(v.right for v in found)),
        str(sum(not v.wrong for v in found)),
        str(sum(v.arrived for v in found)) if any(v.method == _LAST for v in found) else "-",
        count("ok"),
        count("poor"),
        count("failed", "raised"),
        count("ok", "raised", wrong=True),
        count("poor", wrong=True),
        f"{withheld} of {known}",
        *(f"{np.median(times):.3g} s" if times else "-" for times in (long_s, short_s)),
        f"{max((v.took_s for v in found), default=0.0):.3g} s",
    ]


def _wrongs(found: list[Verdict]) -> Table:
    table = Table("method", "seed", "kind", "status", "what is wrong", title="Wrong", title_justify="left")
    order = {"raised": 0, "ok": 1}
    wrong = sorted((v for v in found if v.wrong), key=lambda v: (-_place(v.method), order.get(v.status, 2)))
    for verdict in wrong[:LISTED]:
        table.add_row(verdict.method, str(verdict.seed), verdict.kind, verdict.status, "; ".join(verdict.wrong))
    if len(wrong) > LISTED:
        table.add_row("...", "", "", "", f"{len(wrong) - LISTED} more")
    return table


def _withheld(found: list[Verdict]) -> Table:
    title = "Withheld by the last method, or failed, although the bound knows it"
    table = Table("method", "seed", "kind", "status", "withheld", "its message", title=title, title_justify="left")
    silent = [v for v in found if v.method == _LAST and v.withheld]
    for verdict in sorted(silent, key=lambda v: -len(v.withheld))[:LISTED]:
        message = verdict.message if len(verdict.message) < 90 else f"{verdict.message[:87]}..."
        names = ", ".join(verdict.withheld)
        table.add_row(verdict.method, str(verdict.seed), verdict.kind, verdict.status, names, message)
    if len(silent) > LISTED:
        table.add_row("...", "", "", "", "", f"{len(silent) - LISTED} more")
    return table


def _place(method: str) -> int:
    return METHODS.index(method)
