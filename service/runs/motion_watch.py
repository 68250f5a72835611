"""Asks the motion process every two seconds whether it is there, and whether it has read the same plant file."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Final

import structlog

from drivers.motion.orders import MotionLink, MotionLostError
from drivers.motion.plant_read import PlantRead, plant_read
from service.config.plant import Plant
from service.model.plant_alarm import AlarmKind, PlantAlarm, no_motion_process, other_plant_file
from service.runs.tasks import Background
from valve.errors import ValveError
from valve.messages import message_of, say

_EVERY_S: Final = 2.0
_ANSWER_S: Final = 5.0  # a process that hangs has a connection and says nothing
_LOG = structlog.get_logger(__name__)
_Differing = tuple[tuple[str, ...], tuple[str, ...]]


class MotionWatch(Background):
    """Keeps the alarms of the plant. All methods belong to the event loop."""

    def __init__(
        self, plant: Plant, motion: MotionLink, *, clock: Callable[[], datetime] = lambda: datetime.now(UTC)
    ) -> None:
        super().__init__(self._keep_looking)
        self._plant = plant
        self._motion = motion
        self._clock = clock
        self._alarms: dict[AlarmKind, PlantAlarm] = {}
        self._suspected: _Differing = ((), ())

    @property
    def alarms(self) -> tuple[PlantAlarm, ...]:
        """What stands now, the worst first."""
        return tuple(self._alarms[kind] for kind in AlarmKind if kind in self._alarms)

    async def _keep_looking(self) -> None:
        while True:
            await self.look()
            await asyncio.sleep(_EVERY_S)

    async def look(self) -> None:
        """Ask once; raise or clear the alarms by what is heard."""
        try:
            async with asyncio.timeout(_ANSWER_S):
                theirs = await self._motion.plant_read(self._ours().digest)
        except TimeoutError:
            self._lost(say("nothing_heard", "nothing heard for {answer_s:g s}", answer_s=_ANSWER_S))
        except MotionLostError as error:
            self._lost(error.why)
        except ValveError as error:  # of another version, or it belongs to another service
            self._lost(message_of(error))
        else:
            self._clear(AlarmKind.MOTION_PROCESS)
            self._compare(theirs)

    def _ours(self) -> PlantRead:
        plant = self._plant
        wirings = [valve.wiring for tag, valve in plant.valves.items() if plant.is_ours(tag)]
        return plant_read(wirings, plant.buses)

    def _lost(self, reason: str) -> None:
        self._raise(no_motion_process(self._clock(), reason))
        self._suspected = ((), ())
        self._clear(AlarmKind.PLANT_FILE)  # what comes back may have read another one

    def _compare(self, theirs: PlantRead | None) -> None:
        # The plant may have changed while the answer was on its way, and a reload takes the two one after the other.
        differing: _Differing = ((), ()) if theirs is None else self._ours().differing(theirs)
        was, self._suspected = self._suspected, differing
        valves, buses = differing
        if not valves:
            self._clear(AlarmKind.PLANT_FILE)
        elif was == differing:
            self._raise(other_plant_file(self._clock(), valves, buses))

    def _raise(self, alarm: PlantAlarm) -> None:
        standing = self._alarms.get(alarm.kind)
        if standing is None or standing.valves != alarm.valves:
            self._alarms[alarm.kind] = alarm
            _LOG.error("alarm", alarm=alarm.kind.value, sentence=alarm.sentence, remedy=alarm.remedy)

    def _clear(self, kind: AlarmKind) -> None:
        alarm = self._alarms.pop(kind, None)
        if alarm is not None:
            _LOG.warning("alarm cleared", alarm=kind.value, since=alarm.since.isoformat())
