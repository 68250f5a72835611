"""From a stored recording to the analysis that is stored with its test."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from service.config.plant import PlantValve
from service.health.judge import health_of
from service.model.analysis import ENGINE, TOGETHER
from service.model.run import Run
from service.runs.room import room_to_json
from service.store.store import Store
from valve.messages import with_table
from valve.nameplate import Nameplate


class Analyst(Protocol):
    """Analyses a stored recording somewhere else than on the event loop."""

    async def analyze(
        self,
        recording_path: Path,
        nameplate: Nameplate,
        progress: Callable[[float, str], None] | None = None,
        *,
        together: Sequence[Path] = (),
        held_out: Sequence[tuple[str, Path]] = (),
        accepted: Mapping[str, Any] | None = None,
        room: Mapping[str, float] | None = None,
        upload: bool = False,
        behind: bool = False,
        mapping: Mapping[str, str] | None = None,
    ) -> dict[str, Any]:
        """Return the analysis object; ``progress`` is told the share done, 0 to 1. Raises ValveError.

        ``together`` are other recordings of the same valve, ``held_out`` named ones that are not fitted, ``accepted``
        is the extended model that somebody accepted for this valve, ``room`` what a further test of it may use;
        an ``upload`` is no test of this plant and goes behind all that are; what is ``behind`` is repeated for nobody
        who waits and goes behind them too. ``mapping``, also an empty one, says that
        the files are as their owners have them (``service.own_files``).
        """


async def assessed(
    analyst: Analyst,
    run: Run,
    valve: PlantValve,
    sequence: str,
    store: Store,
    *,
    together: Sequence[str],
    progress: Callable[[float, str], None],
    behind: bool = False,
) -> dict[str, Any]:
    """Return the analysis of a run's recording with the valve's health, and what its sentences were made of.

    ``together`` are ids of tests beside it.

    ``sequence`` is what was played. Raises ValveError.
    """
    accepted = await asyncio.to_thread(store.models.current, run.valve)
    analysis = await analyst.analyze(
        store.recording_path(run.id),
        valve.nameplate,
        progress,
        together=[store.recording_path(other) for other in together],
        accepted=None if accepted is None else accepted.model,
        room=room_to_json(valve.nameplate, valve.wiring.limits, run.overrides),
        behind=behind,
    )
    if together:
        analysis = {**analysis, TOGETHER: {"sequence": sequence, "tests": list(together)}}
    if accepted is not None:
        analysis = {**analysis, "accepted_model": {"number": accepted.number, "test": accepted.test}}
    health = await asyncio.to_thread(health_of, store.figures, valve, run, analysis)
    return with_table({**analysis, "engine": ENGINE, "health": health})
