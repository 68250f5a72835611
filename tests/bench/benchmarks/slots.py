"""The slots of a polled recording: how late each was taken, and where the time of those that were missed went."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from valve.recording import Recording

FloatArray = npt.NDArray[np.float64]


def slots(recording: Recording, period_s: float) -> npt.NDArray[np.int64]:
    """Return the slot that each sample was taken for, shape (n,), as polled play chooses.

    Polled play looks at the clock a little after the answer that is recorded. Where its choice differed therefore is
    seen: a slot that has begun when the sample before has ended is taken within it, and this one waited for the next.
    """
    begun_s, ended_s = _begun_s(recording), recording.received_s
    assert ended_s is not None
    chosen = np.empty(begun_s.size, dtype=np.int64)
    slot, before_s, quickest_s = 0, -math.inf, 0.5 * period_s
    for index, (began_s, end_s) in enumerate(zip(begun_s.tolist(), ended_s.tolist(), strict=True)):
        slot += slot * period_s <= before_s and (slot + 1) * period_s <= began_s
        chosen[index] = slot
        before_s, quickest_s = end_s, min(quickest_s, end_s - began_s)
        slot = max(slot + 1, math.floor((end_s + quickest_s) / period_s))
    return chosen


def lateness_s(recording: Recording, period_s: float) -> FloatArray:
    """Return how long after its slot each sample's first transaction began, s."""
    return np.asarray(_begun_s(recording) - slots(recording, period_s) * period_s)


def missed_in_answers(recording: Recording, period_s: float) -> int:
    """Return how many slots were missed behind samples that spent most of their time waiting for answers.

    Behind the others it is the service that was late: with the sample's beginning, or between its transactions.
    """
    chosen = slots(recording, period_s)
    sent_s, received_s = recording.sent_s, recording.received_s
    written_s, write_sent_s = recording.written_s, recording.write_sent_s
    assert sent_s is not None
    assert received_s is not None
    assert written_s is not None
    assert write_sent_s is not None
    in_answers_s = (received_s - sent_s) + np.nan_to_num(written_s - write_sent_s)
    took_s = received_s - chosen * period_s
    missed = np.diff(chosen, append=chosen[-1] + 1) - 1
    return int(missed[2.0 * in_answers_s > took_s].sum())


def _begun_s(recording: Recording) -> FloatArray:
    """Beginning of each sample's first transaction, s; a command that was in force already was not written."""
    assert recording.sent_s is not None
    assert recording.write_sent_s is not None
    return np.fmin(recording.write_sent_s, recording.sent_s)
