"""What can happen to the bytes of one transaction."""

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
    """What happens to the service's process."""

    KILL = "kill"
    TERM = "term"
    STOP_AND_CONT = "stop_and_cont"


@dataclass(frozen=True, slots=True)
class FaultAt:
    """A fault at the nth transaction (from 0) of a test."""

    fault: WireFault | ServiceFault
    index: int
    seed: int = 0
