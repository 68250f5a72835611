"""Keeps a broker told: retained messages of every valve of this gateway, and a last will of the gateway itself.

No test waits for a broker and none fails by it: what is to be said stands in the store until a broker listens.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from datetime import UTC, datetime
from typing import Final

import aiomqtt
import structlog
from sqlalchemy.exc import SQLAlchemyError

from service.config.plant import MqttSettings, Plant
from service.health.staleness import Staleness
from service.model.run import Run
from service.mqtt.messages import messages_of, topic_part
from service.store.conditions import valve_standings
from service.store.store import Store
from valve.errors import ConfigurationError

_LOG = structlog.get_logger(__name__)
_FIRST_WAIT_S: Final = 1.0
_LONGEST_WAIT_S: Final = 30.0
_KEEPALIVE_S: Final = 10  # a broker sends the last will after one and a half of these (MQTT 3.1.1, 3.1.2.10)
_ANSWER_S: Final = 5.0
_QOS: Final = 1
_LOST_S: Final = 60.0  # a broker that restarts is back by then; longer is said as an error
_LOOK_S: Final = 600.0  # how often it is looked which results have become too old: limits are days
_PAUSE_S: Final = 0.005  # between valves: a large plant's first round leaves the event loop to the tests


class MqttPublisher:
    """Publishes while the service serves. All methods belong to the event loop but ``note``."""

    def __init__(self, plant: Plant, settings: MqttSettings, store: Store, staleness: Staleness) -> None:
        self._settings = settings
        self._store = store
        self._staleness = staleness
        self._plant = plant
        self._root = f"{settings.prefix}/{topic_part(plant.service.gateway or 'gateway')}"
        self._waiting: dict[str, None] = {}  # valves to be told of, in their order
        #: By valve, as it was told of: whether its result was too old, and what its days in service said.
        self._told: dict[str, tuple[bool, str]] = {}
        self._something = asyncio.Event()
        self._loop = asyncio.get_running_loop()
        self._lost_at_s: float | None = time.monotonic()
        self._is_lost = False
        self.published = 0

    @property
    def status_topic(self) -> str:
        """Where ``online`` or ``offline`` stands."""
        return f"{self._root}/status"

    @property
    def connected(self) -> bool:
        """Whether the broker hears this gateway now."""
        return self._lost_at_s is None

    @property
    def lost_s(self) -> float:
        """How long the broker has not heard this gateway, s; 0 while it does."""
        return 0.0 if self._lost_at_s is None else time.monotonic() - self._lost_at_s

    @property
    def waiting(self) -> int:
        """How many valves are still to be told of."""
        return len(self._waiting)

    def note(self, run: Run) -> None:
        """Remember that a run was stored; from any thread."""
        with contextlib.suppress(RuntimeError):  # the loop is closed: the next start tells of it
            self._loop.call_soon_threadsafe(self._remember, run.valve)

    def _remember(self, tag: str) -> None:
        self._waiting[tag] = None
        self._something.set()

    async def run(self) -> None:
        """Connect, tell all, then what changes; again after every loss, at ever longer intervals up to 30 s."""
        wait_s = _FIRST_WAIT_S
        while True:
            try:
                async with self._client() as client:
                    wait_s = _FIRST_WAIT_S
                    await self._serve(client)
            except aiomqtt.MqttError as error:
                _LOG.warning("mqtt broker not reached", host=self._settings.host, reason=str(error), again_in_s=wait_s)
            except (ConfigurationError, OSError, SQLAlchemyError) as error:  # a database that is away comes back
                _LOG.error("mqtt not possible", reason=str(error), again_in_s=wait_s)
            finally:
                self._lost_at_s = time.monotonic() if self._lost_at_s is None else self._lost_at_s
            if self.lost_s > _LOST_S and not self._is_lost:
                self._is_lost = True
                _LOG.error(
                    "mqtt broker lost", host=self._settings.host, since_s=round(self.lost_s), valves=self.waiting
                )
            await asyncio.sleep(wait_s)
            wait_s = min(2.0 * wait_s, _LONGEST_WAIT_S)

    def _client(self) -> aiomqtt.Client:
        settings = self._settings
        return aiomqtt.Client(
            settings.host,
            settings.port,
            username=settings.username,
            password=settings.password(),
            will=aiomqtt.Will(self.status_topic, b"offline", _QOS, retain=True),
            keepalive=_KEEPALIVE_S,
            timeout=_ANSWER_S,
            tls_context=settings.tls_context(),
        )

    async def _serve(self, client: aiomqtt.Client) -> None:
        await self._publish(client, self.status_topic, b"online")
        _LOG.info("mqtt broker reached", host=self._settings.host, topics=f"{self._root}/#", after_s=round(self.lost_s))
        self._lost_at_s, self._is_lost = None, False
        for tag in [
            tag for tag in self._plant.valves if self._plant.is_ours(tag)
        ]:  # a broker that restarted may have forgotten what it retained
            self._remember(tag)
        # The client says that the line is lost only to whoever waits for messages; none was subscribed to.
        listening = asyncio.create_task(_listen(client))
        looking = asyncio.create_task(self._look_for_stale())
        try:
            while True:
                telling = asyncio.create_task(self._tell_all(client))
                done, _ = await asyncio.wait((telling, listening, looking), return_when=asyncio.FIRST_COMPLETED)
                if telling not in done:
                    telling.cancel()
                for task in done:
                    task.result()
        finally:
            listening.cancel()
            looking.cancel()
            if asyncio.current_task() is not None and self.connected:
                with contextlib.suppress(aiomqtt.MqttError, TimeoutError):
                    await asyncio.wait_for(self._publish(client, self.status_topic, b"offline"), 1.0)

    async def _tell_all(self, client: aiomqtt.Client) -> None:
        await self._something.wait()
        while self._waiting:
            tag = next(iter(self._waiting))
            del self._waiting[tag]
            try:
                for level, payload in await asyncio.to_thread(self._messages, tag):
                    await self._publish(client, f"{self._root}/valves/{topic_part(tag)}/{level}", payload)
            except BaseException:
                self._waiting[tag] = None
                raise
            await asyncio.sleep(_PAUSE_S)
        self._something.clear()

    async def _look_for_stale(self) -> None:
        """Tell again of each valve whose result has become too old, or whose days in service say other than then."""
        while True:
            await asyncio.sleep(_LOOK_S)
            standings = await asyncio.to_thread(valve_standings, self._store.engine)
            now = datetime.now(UTC)
            for tag, told in tuple(self._told.items()):
                completed_at = standings[tag].completed_at  # told of, so it was tested
                oldest = self._staleness.oldest(tag, now)
                if (oldest.is_stale(completed_at), oldest.watched) != told:
                    self._remember(tag)

    def _messages(self, tag: str) -> list[tuple[str, bytes]]:
        head = self._store.runs.valve_heads([tag]).get(tag)
        if head is None:
            return []
        now = datetime.now(UTC)
        oldest = self._staleness.oldest(tag, now)
        self._told[tag] = oldest.is_stale(head.completed_at), oldest.watched
        completed = None if head.completed_number is None else self._store.runs.last_completed(tag)
        return list(messages_of(head.last, completed, oldest.health(head.health, head.completed_at, now) or {}))

    async def _publish(self, client: aiomqtt.Client, topic: str, payload: bytes) -> None:
        await client.publish(topic, payload, _QOS, retain=True)
        self.published += 1


async def _listen(client: aiomqtt.Client) -> None:
    async for _ in client.messages:
        pass
