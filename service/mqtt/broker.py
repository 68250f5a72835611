"""Whether a plant's broker is told: what speaks to it is an extra, loaded where ``[mqtt]`` names a broker."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib.util import find_spec

from service.config.errors import Fault
from service.config.plant import Plant
from service.health.staleness import Staleness
from service.mqtt.metrics import BrokerCollector
from service.store.store import Store
from valve.errors import ConfigurationError
from valve.messages import say


def client_fault(plant: Plant) -> Fault | None:
    """Return that a broker is named and the library that speaks to it is not installed; None where all is well."""
    if plant.mqtt is None or find_spec("aiomqtt") is not None:
        return None
    return Fault(
        plant.file.name,
        "mqtt.host",
        json.dumps(plant.mqtt.host),
        say("mqtt_not_installed", "no broker can be told, as the extra mqtt is not installed"),
        say("install_mqtt", "run make mqtt in breakaway's folder, or pip install 'breakaway[mqtt]'"),
    )


def require_client(plant: Plant) -> None:
    """Raise ConfigurationError where a broker is named and nothing can speak to it."""
    fault = client_fault(plant)
    if fault is not None:
        raise ConfigurationError(fault.message)


@asynccontextmanager
async def broker_told(plant: Plant, store: Store, staleness: Staleness) -> AsyncIterator[BrokerCollector | None]:
    """Publish as long as the context lasts, and give what counts it; None for a plant without ``[mqtt]``."""
    if plant.mqtt is None:
        yield None
        return
    require_client(plant)
    from service.mqtt.publisher import MqttPublisher

    publisher = MqttPublisher(plant, plant.mqtt, store, staleness)
    store.runs.listen(publisher.note)
    task = asyncio.create_task(publisher.run())
    try:
        yield BrokerCollector(publisher)
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task
