"""Baselines that an earlier engine analysed are analysed again, behind everything else.

Later tests are held against figures of the engine that analyses them: else a better engine would look like a valve that
changed. What is asked for is the recording's own analysis, so to do it twice does no harm.
"""

from __future__ import annotations

import asyncio
from typing import Final

import structlog
from sqlalchemy.exc import SQLAlchemyError

from service.config.plant import Plant
from service.model.analysis import ENGINE, can_be_analysed
from service.model.requester import Requester, RequesterKind
from service.runs.service import Runs
from service.runs.tasks import Background
from service.store.store import Store
from valve.errors import ValveError

#: Who asks, as the audit log and the analysis keep it.
RENEWAL: Final = Requester("renewal of baselines", RequesterKind.MACHINE)
_LOG = structlog.get_logger(__name__)
_FIRST_S: Final = 60.0
_PERIOD_S: Final = 3600.0  # a baseline that is chosen by hand may be an old test
_REST_S: Final = 5.0  # for so long nothing has run before one begins, and between two


class Renewal(Background):
    """Renews one baseline after the other while nothing else is under way.

    An analysis that is under way at the end ends with the runs, and is made again at the next start.
    """

    def __init__(
        self, plant: Plant, store: Store, runs: Runs, *, first_s: float = _FIRST_S, rest_s: float = _REST_S
    ) -> None:
        super().__init__(self._keep_renewing)
        self._plant = plant
        self._store = store
        self._runs = runs
        self._first_s = first_s
        self._rest_s = rest_s
        self._tried: set[str] = set()  # one that fails is not tried again before the next start

    async def _keep_renewing(self) -> None:
        pause_s = self._first_s
        while True:
            await asyncio.sleep(pause_s)
            pause_s = _PERIOD_S
            try:
                await self.renew()
            except (ValveError, SQLAlchemyError, OSError) as error:  # a database that is away comes back
                _LOG.warning("baselines not renewed", reason=str(error))

    async def renew(self) -> None:
        """Analyse again every baseline of this gateway that an earlier engine analysed and whose recording is here."""
        found = await asyncio.to_thread(self._store.figures.baselines_before, ENGINE)
        wanted = [test_id for tag, test_id in found if tag in self._plant.valves and self._plant.is_ours(tag)]
        for test_id in wanted:
            if test_id in self._tried:
                continue
            self._tried.add(test_id)
            run = await self._runs.get(test_id)
            if not can_be_analysed(run) or not self._store.recording_path(test_id).is_file():
                _LOG.warning(
                    "baseline of an earlier engine stays: its recording is gone", test=test_id, valve=run.valve
                )
                continue
            await self._nothing_runs()
            try:
                await self._runs.analyze(test_id, RENEWAL)
            except ValveError as error:
                _LOG.warning("baseline of an earlier engine stays", test=test_id, valve=run.valve, reason=str(error))
                continue
            while not (run := await self._runs.wait(test_id, _PERIOD_S)).state.finished:
                pass
            is_renewed = (run.analysis or {}).get("engine") == ENGINE
            say = _LOG.info if is_renewed else _LOG.warning
            say("baseline analysed again", test=test_id, valve=run.valve, renewed=is_renewed, reason=run.error)

    async def _nothing_runs(self) -> None:
        rested = False
        while not rested or self._runs.any_under_way():
            rested = not self._runs.any_under_way()
            await asyncio.sleep(self._rest_s)
