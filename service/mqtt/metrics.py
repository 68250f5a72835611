"""What Prometheus is told of the line to the broker: nobody else tells that MQTT has gone quiet."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

if TYPE_CHECKING:
    from service.mqtt.publisher import MqttPublisher


class BrokerCollector(Collector):
    """The line to the broker at one moment."""

    def __init__(self, publisher: MqttPublisher) -> None:
        self._publisher = publisher

    def collect(self) -> Iterator[Metric]:
        """Yield every family."""
        of = self._publisher
        yield GaugeMetricFamily("breakaway_mqtt_connected", "1 while the broker hears us", float(of.connected))
        yield GaugeMetricFamily("breakaway_mqtt_lost_seconds", "how long the broker has not heard it", of.lost_s)
        yield GaugeMetricFamily("breakaway_mqtt_waiting_valves", "valves that are still to be told of", of.waiting)
        yield CounterMetricFamily("breakaway_mqtt_published", "messages that the broker has taken", of.published)
