"""What can happen: to the bytes of one transaction, to the service's process, to what is around them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class WireFault(StrEnum):
    """One fault of the wire."""

    DROP_REQUEST = "drop_request"
    DROP_ANSWER = "drop_answer"
    DELAY_REQUEST = "delay_request"  # it is carried out when nobody waits any more
    DELAY_ANSWER = "delay_answer"
    DOUBLE_REQUEST = "double_request"
    DOUBLE_ANSWER = "double_answer"
    TRUNCATE_REQUEST = "truncate_request"
    TRUNCATE_ANSWER = "truncate_answer"
    FLIP_REQUEST = "flip_request"  # one bit
    FLIP_ANSWER = "flip_answer"
    ECHO = "echo"  # the request comes back, and nothing else
    BLACK_HOLE = "black_hole"  # from here on nothing passes, in no direction, for a while
    RESET = "reset"  # the connection is cut; on a serial line: noise instead of the answer


class ServiceFault(StrEnum):
    """What happens to the process that moves the valve, or to the service that asked it."""

    KILL_BOTH = "kill_both"
    KILL_MOTION = "kill_motion"
    KILL_SERVICE = "kill_service"
    TERM = "term"  # of what moves the valve, as the next ones
    STOP_AND_CONT = "stop_and_cont"
    HANG_UP = "hang_up"  # its terminal is closed: SIGHUP
    TERM_SERVICE = "term_service"  # as for an upgrade
    IDLE_SESSION = "idle_session"  # the session that watches is locked after its idle time; then Stop is pressed in it


class PlantFault(StrEnum):
    """What happens around the wire: to other buses, to the stem, to the store."""

    DEAD_CONTACTS = "dead_contacts"  # the bus of the permissives' contacts falls silent
    DEAD_GAUGE = "dead_gauge"  # the bus that the position comes from falls silent
    FLAPPING = "flapping"  # the position alternates between invalid and beyond its limits
    STUCK_STEM = "stuck_stem"  # the stem stays where it is, whatever the pressure
    FULL_DISK = "full_disk"  # nothing more can be written to the store
    DARK_DATABASE = "dark_database"  # PostgreSQL answers no more; then somebody asks for a stop


Fault = WireFault | ServiceFault | PlantFault


@dataclass(frozen=True, slots=True)
class FaultAt:
    """A fault at the nth transaction (from 0) of a test."""

    fault: Fault
    index: int
    seed: int = 0
