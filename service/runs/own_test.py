"""The test of a valve that somebody names to make something of it: a baseline, an accepted model."""

from __future__ import annotations

from service.model.run import Run, RunState
from service.runs.service import Runs
from valve.errors import RequestError
from valve.messages import say


async def completed_test_of(runs: Runs, tag: str, run_id: str) -> Run:
    """Return a completed test of this valve, with its analysis.

    Raises NotFoundError where there is no such test, RequestError where it is another valve's or not completed.
    """
    run = await runs.get(run_id)
    if run.valve != tag:
        raise RequestError(
            say(
                "test_of_other_valve",
                "test {test} is one of {valve}, not of {tag}: choose a test of this valve",
                test=run.id,
                valve=run.valve,
                tag=tag,
            )
        )
    if run.state is not RunState.COMPLETED or run.analysis is None:
        raise RequestError(
            say(
                "test_not_completed",
                "test {test} is {state}: choose a completed test",
                test=run.id,
                state=run.state.value,
            )
        )
    return run
