"""The composition root: a plant becomes a service."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from importlib.metadata import version
from typing import Any, Final
from urllib.parse import urlsplit

from fastapi import FastAPI
from fastapi.responses import HTMLResponse
from pydantic import BaseModel

from drivers.addresses import Mode
from drivers.motion.audit_log import AuditLog
from drivers.motion.orders import MotionLink
from service.access.access import Access, access_of
from service.access.authentication import Authentication
from service.access.needs import OPEN_TO_ALL, rights
from service.access.stop_grants import stoppers_known
from service.audit.service_life import note_end, note_start
from service.config.plant import Plant
from service.figures.drawer import Drawer
from service.health.earlier import EarlierResults
from service.health.staleness import Staleness
from service.http.body_limits import BodyLimits
from service.http.errors import install_error_handlers
from service.http.given import give
from service.http.head_requests import HeadRequests
from service.http.hosts import Hosts
from service.http.read_turns import ReadTurns
from service.meters import Meters
from service.mqtt.broker import broker_told
from service.mqtt.metrics import BrokerCollector
from service.recordings.conversion import Converter
from service.reload import Reloader
from service.routes.access import router as access_routes
from service.routes.access import session_router as session_routes
from service.routes.alarms import router as alarm_routes
from service.routes.docs_page import docs_page
from service.routes.health import router as health_routes
from service.routes.metrics import router as metrics_routes
from service.routes.models import router as model_routes
from service.routes.openapi import openapi_of
from service.routes.reanalyses import router as reanalysis_routes
from service.routes.recordings import router as recording_routes
from service.routes.reload import router as reload_routes
from service.routes.report import router as report_routes
from service.routes.runs import router as test_routes
from service.routes.safety import router as safety_routes
from service.routes.schedules import router as schedule_routes
from service.routes.valves import router as valve_routes
from service.routes.watched import router as watched_routes
from service.runs.analyst import Analyst
from service.runs.live_estimates import EstimateWorker
from service.runs.motion_watch import MotionWatch
from service.runs.reanalyses import Reanalyses
from service.runs.renewal import Renewal
from service.runs.service import Runs
from service.schedules.lifespan import running_schedules
from service.schedules.nightly import Nightly
from service.schedules.watched import WatchedDays
from service.store.store import Store, open_store
from service.tablet.install import install_tablet
from service.workers.polling import Polling
from service.workers.worker_pool import WorkerPool

VERSION: Final = version("breakaway")
_ROUTERS: Final = (
    safety_routes,
    report_routes,
    test_routes,
    recording_routes,
    model_routes,
    health_routes,
    watched_routes,
    valve_routes,
    alarm_routes,
    schedule_routes,
    reanalysis_routes,
    reload_routes,
    session_routes,
    access_routes,
    metrics_routes,
)
_DESCRIPTION: Final = """\
Vendor-neutral control-valve diagnostics: drives a valve through a test over Modbus and estimates its friction.

This service is not a safety function and never writes to a safety-instrumented device.
Errors are problem documents (RFC 9457, application/problem+json).
Every number is in SI units (m, Pa, N, s), in the words of a problem document too, unless a request names `units`."""


class Health(BaseModel):
    """The service lives."""

    status: str
    version: str


def create_app(
    plant: Plant, motion: MotionLink, *, store: Store | None = None, analyst: Analyst | None = None
) -> FastAPI:
    """Return the service of a plant whose valves ``motion`` moves; ``analyst`` stands in for the analysis in tests.

    The application owns ``store`` and closes it. Without one it opens the plant's own when it starts: BusyError
    where another process has it.
    """

    software = f"breakaway {VERSION}"

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        opened = store if store is not None else await asyncio.to_thread(open_store, plant.service)
        polling = app.state.polling = Polling()
        pool = WorkerPool(polling=polling) if analyst is None else None
        converter = Converter()
        chosen = pool if pool is not None else analyst
        assert chosen is not None
        audit = await asyncio.to_thread(AuditLog, opened.folder / "audit", plant.service.gateway or "gateway")
        meters = Meters(plant)
        opened.runs.listen(meters.note)
        so_far = EstimateWorker() if analyst is None else None
        runs = Runs(
            plant,
            opened,
            motion,
            chosen,
            software=software,
            audit=audit,
            on_samples=meters.note_samples,
            estimator=so_far,
            polling=polling,
        )
        access = access_of(opened.engine, plant.service.access, audit)
        nightly = Nightly(plant, opened, runs)
        stale = Staleness(plant)
        at_once = pool.most_behind if pool is not None else 1
        reanalyses = Reanalyses(plant, opened, runs, software=software, audit=audit, at_once=at_once)
        watch = MotionWatch(plant, motion)
        drawer = Drawer()
        reloader: Reloader | None = None
        give(
            app,
            {
                Plant: plant,
                Store: opened,
                Runs: runs,
                Analyst: chosen,
                Converter: converter,
                Access: access,
                AuditLog: audit,
                Nightly: nightly,
                Staleness: stale,
                EarlierResults: EarlierResults(),
                Meters: meters,
                MotionLink: motion,
                Reanalyses: reanalyses,
                MotionWatch: watch,
                Drawer: drawer,
            },
        )
        try:
            await asyncio.to_thread(note_start, audit, plant, software)
            if pool is not None and so_far is not None:
                if any(valve.wiring.acquisition.mode is Mode.POLLED for valve in plant.valves.values()):
                    await so_far.start()  # a second of a core, before anything moves
                pool.start()
            await runs.recover()
            tell = (partial(stale.read, plant), partial(meters.read, plant), nightly.schedules_changed)
            reloader = Reloader(plant, runs, motion, audit, tell)
            give(app, {Reloader: reloader})
            renewal = Renewal(plant, opened, runs)
            watched = WatchedDays(plant, opened, stale, pool, software)
            async with (
                broker_told(plant, opened, stale) as broker,
                running_schedules(nightly, reanalyses, plant, opened, runs),
                stoppers_known(runs.any_under_way, access.note_known),
            ):
                if broker is not None:
                    give(app, {BrokerCollector: broker})
                renewal.start()
                watch.start()
                watched.start()
                try:
                    yield
                finally:
                    await watched.close()
                    await watch.close()
                    await renewal.close()
        finally:
            await runs.shut_down()
            await motion.close()
            if reloader is not None:
                await reloader.close()
            await converter.close()
            access.close()
            await asyncio.to_thread(note_end, audit)
            await drawer.close()
            if pool is not None and so_far is not None:
                await so_far.close()
                await pool.close()
            opened.close()

    app = FastAPI(
        # As they are: to include a router would resolve each route's parameters anew, for a prefix that none is given.
        routes=[route for router in _ROUTERS for route in router.routes],
        title="breakaway",
        version=VERSION,
        description=_DESCRIPTION,
        lifespan=lifespan,
        redirect_slashes=False,
        docs_url=None,  # FastAPI's own pages load their scripts from elsewhere
        redoc_url=None,
    )
    # The last one sees a request first: nobody waits for a turn whose name, size or credentials are refused anyway.
    app.add_middleware(ReadTurns)
    app.add_middleware(Authentication)
    app.add_middleware(BodyLimits)
    app.add_middleware(HeadRequests)
    app.add_middleware(Hosts, allowed_hosts=_hosts(plant))
    install_error_handlers(app)
    install_tablet(app)

    @app.get("/healthz", tags=["service"], dependencies=[OPEN_TO_ALL])
    async def healthz() -> Health:
        """Say that the service lives."""
        return Health(status="ok", version=VERSION)

    @app.get("/docs", include_in_schema=False)
    async def docs() -> HTMLResponse:
        return HTMLResponse(docs_page(app.openapi()))

    needed = list(rights(app))

    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.openapi_schema = openapi_of(app, needed)
        return app.openapi_schema

    app.openapi = openapi  # type: ignore[method-assign]  # the way that FastAPI documents
    return app


def _hosts(plant: Plant) -> list[str]:
    """Return the names that the service answers to beside the loopback's: those configured, its own address's too."""
    address = plant.gateways.get(plant.service.gateway)
    named = [] if address is None else [urlsplit(address).hostname or ""]
    return [host for host in (*plant.service.access.allowed_hosts, *named) if host]
