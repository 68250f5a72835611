"""The service on its socket: started, told to end, and ended with every valve safe."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import signal
import socket
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Final

import structlog
import uvicorn
from fastapi import FastAPI

from drivers.motion.audit_log import AuditLog
from drivers.motion.client import MotionClient
from drivers.motion.service_manager import ServiceManager
from service.app import create_app
from service.config.plant import Plant, ServiceSettings
from service.http.given import part_if_given
from service.http.http_protocol import BoundedHttp, provide_files
from service.mqtt.broker import require_client
from service.reload import Reloader
from service.runs.service import Runs
from service.server.certificates import Certificates
from service.server.first_use import use_once
from service.store.store import open_store
from valve.errors import ConfigurationError
from valve.messages import say

_LOG = structlog.get_logger(__name__)
# A closed terminal, and Ctrl-\, too: each would end the process at once, and leave a valve where it stands.
_ENDING_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
_END_S: Final = 30  # for requests that wait for the end of a test, which is being stopped


class _Server(uvicorn.Server):
    """Ends by a signal as it should: exit code 0, tests stopped before connections are waited for."""

    def __init__(self, config: uvicorn.Config, app: FastAPI) -> None:
        super().__init__(config)
        self._application = app
        self._loop: asyncio.AbstractEventLoop | None = None
        self._manager = ServiceManager()
        self._beside: list[asyncio.Task[None]] = []
        self._certificates: Certificates | None = None

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start, and say where."""
        self._loop = asyncio.get_running_loop()
        if self.config.ssl is not None:
            assert self.config.ssl_certfile is not None
            assert self.config.ssl_keyfile is not None, "settings ask for both"
            self._certificates = Certificates(Path(self.config.ssl_certfile), Path(self.config.ssl_keyfile))
            self._certificates.show_on(self.config.ssl)
        await super().startup(sockets=sockets)
        for listener in sockets or []:
            host, port = listener.getsockname()[:2]
            scheme = "https" if self.config.is_ssl else "http"
            _LOG.info("listening", url=f"{scheme}://{f'[{host}]' if ':' in host else host}:{port}")
        if self.started:
            settle_memory()
            self._manager.say("READY=1")
            self._beside = [
                asyncio.create_task(self._manager.keep_alive()),
            ]
            if self._certificates is not None:
                self._beside.append(asyncio.create_task(self._certificates.keep_fresh()))

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End; the service manager hears that it is meant, and that it goes on."""
        self._manager.say("STOPPING=1")
        await super().shutdown(sockets=sockets)
        for task in self._beside:
            task.cancel()

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Leave the signals as they are: uvicorn would give them back while valves are still brought to safe."""
        yield

    @contextlib.contextmanager
    def hearing_signals(self) -> Iterator[None]:
        """Hear the signals that end a service, those too that uvicorn does not know of, until nothing runs any more.

        One that whoever started us had ignored stays so: nohup asks for it.
        """
        heard = [one for one in _ENDING_SIGNALS if signal.getsignal(one) is not signal.SIG_IGN]
        former = {one: signal.signal(one, self.handle_exit) for one in heard}
        try:
            yield
        finally:
            for one, handler in former.items():
                signal.signal(one, handler)

    def handle_exit(self, sig: int, _frame: FrameType | None) -> None:
        """Stop the tests at once; the second signal no longer waits for anybody.

        A service manager asks by SIGHUP that the plant file is read again; a terminal that is closed sends it, too, and
        then the service ends.
        """
        if sig == signal.SIGHUP and self._manager.listens and not self.should_exit:
            reloader = part_if_given(self._application, Reloader)
            if reloader is not None and self._loop is not None and not self._loop.is_closed():
                self._loop.call_soon_threadsafe(reloader.on_signal)
            return
        self.force_exit = self.should_exit and sig == signal.SIGINT
        self.should_exit = True
        runs = part_if_given(self._application, Runs)
        if runs is not None and self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(runs.begin_shutdown)


def settle_memory() -> None:
    """Take what stays for ever out of the garbage collector's rounds.

    With 5,000 valves a full round took 0.1 s in which no request was answered (benchmark ``store``).
    """
    gc.collect()
    gc.freeze()


def _listen(settings: ServiceSettings) -> socket.socket:
    family = socket.AF_INET6 if ":" in settings.bind else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((settings.bind, settings.port))
    except OSError as error:
        listener.close()
        raise ConfigurationError(
            say(
                "port_unusable",
                "service.bind {bind} port {port} cannot be used ({reason}): choose another address or port, or end "
                "what uses it",
                bind=settings.bind,
                port=settings.port,
                reason=str(error.strerror),
            )
        ) from error
    return listener


def serve_plant(plant: Plant) -> None:
    """Serve until a signal ends it. Raises BusyError where another service has the store, ConfigurationError."""
    require_client(plant)
    BoundedHttp.most_connections = provide_files()
    with _listen(plant.service) as listener:
        store = open_store(plant.service)
        AuditLog(store.folder / "audit", plant.service.gateway or "gateway")  # one that is broken is said here
        motion = MotionClient(plant.service.motion_socket, store.folder / "journals")
        app = create_app(plant, motion, store=store)
        use_once(app)
        access = plant.service.access
        if not access.sign_in and not access.loopback:
            _LOG.warning("no sign-in: whoever reaches this address may move valves", bind=plant.service.bind)
        config = uvicorn.Config(
            app,
            loop="uvloop",
            http=BoundedHttp,
            lifespan="on",
            ws="none",
            log_config=None,
            access_log=False,
            server_header=False,
            timeout_graceful_shutdown=_END_S,
            ssl_certfile=access.tls_certificate,
            ssl_keyfile=access.tls_key,
            proxy_headers=access.behind_proxy,  # otherwise anybody could name another address as their own
            forwarded_allow_ips=list(access.proxy_addresses),
        )
        server = _Server(config, app)
        with server.hearing_signals():
            server.run(sockets=[listener])
    _LOG.info("ended")
