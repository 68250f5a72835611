"""Requests and the only answers that fit them: nothing that came is believed before it is checked here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

from drivers.crc import crc16
from drivers.faults import BadAnswerError, EchoError, GarbledError, refusal
from drivers.registers import MAX_READ_WORDS, MAX_WRITE_WORDS, Table, bytes_to_words
from valve.errors import ConfigurationError, ValveError
from valve.messages import say

READ_HOLDING: Final = 3
READ_INPUT: Final = 4
WRITE_ONE: Final = 6
WRITE: Final = 16
READ_WRITE: Final = 23
_FUNCTIONS: Final = (READ_HOLDING, READ_INPUT, WRITE_ONE, WRITE, READ_WRITE)
STRAY_BYTES: Final = 2  # before a frame that are taken for noise: a driver that turns the line round makes one
_MBAP_BYTES: Final = 7
_RTU_OVERHEAD: Final = 3  # device id and CRC


@dataclass(frozen=True, slots=True)
class Request:
    """One transaction. Raises ConfigurationError where the wire could not or must not carry it."""

    device_id: int
    function: int
    read_address: int = 0
    read_count: int = 0
    write_address: int = 0
    words: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if not 0 <= self.device_id <= 0xFF:  # which of them a line has, its address says
            raise ConfigurationError(
                say(
                    "device_id_outside",
                    "device id {device_id} is outside 0 to 255: correct it in plant.toml",
                    device_id=self.device_id,
                )
            )
        if not 0 <= self.read_count <= MAX_READ_WORDS or len(self.words) > MAX_WRITE_WORDS:
            raise ConfigurationError(
                say(
                    "transaction_too_long",
                    "device {device}: {read} words to read and {written} to write, one transaction carries "
                    "{most_read} and {most_written}",
                    device=self.device_id,
                    read=self.read_count,
                    written=len(self.words),
                    most_read=MAX_READ_WORDS,
                    most_written=MAX_WRITE_WORDS,
                )
            )
        if self.function == WRITE_ONE and len(self.words) != 1:
            raise ConfigurationError(
                say(
                    "function_6_of_many_words",
                    "device {device}: {words} words to write at {address}, function 6 carries one: use function "
                    "16, or registers of 16 bits",
                    device=self.device_id,
                    words=len(self.words),
                    address=self.write_address,
                )
            )
        if self.read_count == 0 and not self.words:
            raise ConfigurationError(
                say("transaction_empty", "device {device}: a transaction of no words", device=self.device_id)
            )

    @property
    def is_read(self) -> bool:
        """Whether the answer brings words."""
        return self.read_count > 0

    @property
    def answer_bytes(self) -> int:
        """Length of the answer without what the carrier adds: function, count, words; or the echo of a write."""
        return 2 + 2 * self.read_count if self.is_read else 5

    @property
    def request_bytes(self) -> int:
        """Length of the request without what the carrier adds."""
        fixed = {READ_HOLDING: 5, READ_INPUT: 5, WRITE_ONE: 3, WRITE: 6, READ_WRITE: 10}
        return fixed[self.function] + 2 * len(self.words)

    @property
    def subject(self) -> str:
        """Words for errors: which device, which registers."""
        address, count = (self.read_address, self.read_count) if self.is_read else (self.write_address, len(self.words))
        if self.is_read:
            return say(
                "reading_words",
                "device {device}, reading {count} words at {address}",
                device=self.device_id,
                count=count,
                address=address,
            )
        return say(
            "writing_words",
            "device {device}, writing {count} words at {address}",
            device=self.device_id,
            count=count,
            address=address,
        )


@lru_cache(maxsize=512)  # a test asks for the same registers thousands of times
def read_request(device_id: int, table: Table, address: int, count: int) -> Request:
    """Read ``count`` words of a table (function 3 or 4)."""
    function = READ_HOLDING if table is Table.HOLDING else READ_INPUT
    return Request(device_id, function, read_address=address, read_count=count)


def rtu_answer(request: Request, heard: bytes) -> bytes:
    """Function and data of a serial answer. Raises BadAnswerError unless ``heard`` is that frame and nothing else."""
    if not _is_rtu_frame(heard):
        raise BadAnswerError(
            say(
                "crc_wrong",
                "{asked}: {bytes} bytes came whose CRC is wrong: check the line",
                asked=request.subject,
                bytes=len(heard),
            )
        )
    if heard[0] != request.device_id:
        raise BadAnswerError(_asked(request, _other_device(request, heard[0])))
    return heard[1:-2]


def rtu_answer_in(request: Request, heard: bytes) -> bytes:
    """Return the answer's whole frame, CRC included, where ``heard`` ends with it; b"" where it is not there (yet).

    Up to STRAY_BYTES of noise may stand before it. It has the device, the function and the length that are due, or is
    an exception to that function.
    """
    lengths = {request.function: request.answer_bytes + _RTU_OVERHEAD, request.function | 0x80: 2 + _RTU_OVERHEAD}
    for start in range(STRAY_BYTES + 1):
        frame = heard[start:]
        is_due = len(frame) > 1 and frame[0] == request.device_id and len(frame) == lengths.get(frame[1])
        if is_due and _is_rtu_frame(frame):
            return frame
    return b""


def rtu_damage(request: Request, heard: bytes) -> BadAnswerError | None:
    """Return what is wrong with a serial answer that is complete; None while nothing shows that it is.

    It is a GarbledError where the damaged bytes are evidently the answer to this request: they have its length and
    all but one byte of its head. Then no other answer is under way.
    """
    if _is_rtu_frame(heard) and heard[0] == request.device_id and heard[1] & 0x7F in _FUNCTIONS:
        try:
            checked_words(request, rtu_answer(request, heard))
        except BadAnswerError as error:
            return error
        except ValveError:
            return None  # an exception: rtu_answer_in has it
    due = request.answer_bytes + _RTU_OVERHEAD
    if len(heard) > due and rtu_answer_in(request, heard[:due]):
        more = len(heard) - due
        return BadAnswerError(
            say(
                "bytes_behind_answer",
                "{asked}: {bytes} bytes came behind the answer: check for a second master",
                asked=request.subject,
                bytes=more,
            )
        )
    if not due <= len(heard) <= due + STRAY_BYTES:
        return None
    head = bytes((request.device_id, request.function)) + bytes((2 * request.read_count,) if request.is_read else ())
    frames = [heard[start : start + due] for start in range(len(heard) - due + 1)]
    if any(map(_is_rtu_frame, frames)):
        return None  # whole, and another device's
    for frame in frames:
        if sum(one != other for one, other in zip(head, frame, strict=False)) <= 1:
            return GarbledError(
                say(
                    "no_frame_with_crc",
                    "{asked}: {bytes} bytes came and no frame whose CRC is right: check baud_rate, parity and "
                    "stop_bits, the line and its ends",
                    asked=request.subject,
                    bytes=len(heard),
                )
            )
    return None


def is_echo(sent: bytes, heard: bytes) -> bool:
    """Whether a line returns what was sent on it. Of a write by function 6 nobody can say: its answer is the same."""
    return heard.find(sent, 0, len(sent) + STRAY_BYTES) >= 0


def without_echo(sent: bytes, heard: bytes) -> bytes | None:
    """Return what follows the echo of ``sent`` on a line that returns it; None while the echo is not complete.

    Raises EchoError where something else came in its place.
    """
    if len(heard) < len(sent):
        return None
    start = heard.find(sent, 0, len(sent) + STRAY_BYTES)
    if start >= 0:
        return heard[start + len(sent) :]
    if len(heard) < len(sent) + STRAY_BYTES and any(sent.startswith(heard[k:]) for k in range(1, STRAY_BYTES + 1)):
        return None
    raise EchoError(
        say(
            "echo_missing",
            "the line did not return what was sent, and echo = true says that it does: remove echo where "
            "the adapter suppresses it, otherwise check the line and look for a second master",
        )
    )


def mbap_answer(request: Request, transaction_id: int, heard: bytes) -> bytes:
    """Function and data of the answer with our transaction id among what was heard. Raises BadAnswerError otherwise."""
    frames = _mbap_frames(heard)
    for frame in frames:
        if int.from_bytes(frame[:2], "big") != transaction_id:
            continue
        if frame[6] != request.device_id:
            raise BadAnswerError(_asked(request, _other_device(request, frame[6])))
        return frame[_MBAP_BYTES:]
    if frames:
        raise BadAnswerError(_asked(request, _other_frame(request, transaction_id, frames[0])))
    came = say("no_whole_frame", "{bytes} bytes came and no whole frame", bytes=len(heard))
    raise BadAnswerError(_asked(request, came))


def mbap_answer_in(request: Request, transaction_id: int, heard: bytes) -> tuple[bytes, int]:
    """Return the frame among what was heard that has our transaction and device, b"" where there is none (yet).

    And how many bytes of other whole frames stand before it. Device 0 is whatever answers at the address.
    """
    foreign = 0
    for frame in _mbap_frames(heard):
        if int.from_bytes(frame[:2], "big") == transaction_id and request.device_id in (0, frame[6]):
            return frame, foreign
        foreign += len(frame)
    return b"", foreign


def instead_of_answer(request: Request, transaction_id: int | None, pieces: Sequence[bytes]) -> str:
    """Return what came where the answer to ``request`` did not, with the remedy; "" where nothing came.

    ``pieces`` are what the line brought, one after the other; ``transaction_id`` is None on a serial line.
    """
    whole = b"".join(pieces[-1:])
    if transaction_id is None:
        for piece in reversed(pieces):
            if _is_rtu_frame(piece):
                return _other_device(request, piece[0]) if piece[0] != request.device_id else _strange(piece[1:-2])
        due = request.answer_bytes + _RTU_OVERHEAD
        if 0 < len(whole) < due and whole[0] == request.device_id:
            return say("bytes_came_on_line", "{bytes} of {due} bytes came: check the line", bytes=len(whole), due=due)
        remedy = say("check_line_settings", "check baud_rate, parity and stop_bits, the line and its ends")
        if not whole:
            return ""
        return say(
            "bytes_without_crc",
            "{bytes} bytes came and no frame whose CRC is right: {remedy}",
            bytes=len(whole),
            remedy=remedy,
        )
    for piece in pieces:
        for frame in _mbap_frames(piece):
            return _other_frame(request, transaction_id, frame)
    if len(whole) > _MBAP_BYTES and whole[2:4] != b"\x00\x00":
        return say(
            "bytes_of_no_modbus",
            "{bytes} bytes came that are no Modbus/TCP: check host and port, another service may listen there",
            bytes=len(whole),
        )
    if not whole:
        return ""
    due = _MBAP_BYTES + request.answer_bytes
    return say(
        "bytes_came_on_network", "{bytes} of {due} bytes came: check device and network", bytes=len(whole), due=due
    )


def _is_rtu_frame(heard: bytes) -> bool:
    return len(heard) >= _RTU_OVERHEAD + 2 and crc16(heard[:-2]) == int.from_bytes(heard[-2:], "little")


def _mbap_frames(heard: bytes) -> list[bytes]:
    """Whole frames at the beginning of what was heard, headers included."""
    frames: list[bytes] = []
    rest = heard
    while len(rest) > _MBAP_BYTES:
        length = int.from_bytes(rest[4:6], "big")
        frame, rest = rest[: 6 + length], rest[6 + length :]
        if length < 2 or len(frame) < 6 + length or frame[2:4] != b"\x00\x00":
            break
        frames.append(frame)
    return frames


def _other_frame(request: Request, transaction_id: int, frame: bytes) -> str:
    transaction, device_id = int.from_bytes(frame[:2], "big"), frame[6]
    if transaction != transaction_id:
        return say(
            "other_transaction",
            "an answer to transaction {came} came, {asked} was asked: the device or gateway gives "
            "answers to other requests, or a late one: check for a second client, and the firmware",
            came=transaction,
            asked=transaction_id,
        )
    if device_id != request.device_id:
        return _other_device(request, device_id)
    return _strange(frame[_MBAP_BYTES:])


def _asked(request: Request, came: str) -> str:
    return say("asked_and_came", "{asked}: {came}", asked=request.subject, came=came)


def _other_device(request: Request, device_id: int) -> str:
    return say(
        "other_device",
        "device {came} answered, {asked} was asked: correct device_id, or let the device or its "
        "gateway answer as {asked}; on a serial line check for a second master",
        came=device_id,
        asked=request.device_id,
    )


def _strange(answer: bytes) -> str:
    return say(
        "unreadable_answer",
        "an answer to function {function} came that cannot be read: check that the device speaks Modbus",
        function=answer[0],
    )


def checked_words(request: Request, answer: bytes) -> tuple[int, ...]:
    """Words of an answer (function and data), empty for a write.

    Raises the error of an exception, or BadAnswerError where function, length, address or count do not fit.
    """
    if len(answer) == 2 and answer[0] == request.function | 0x80:
        raise refusal(request.subject, request.function, answer[1])
    if answer[:1] != bytes((request.function,)) or len(answer) != request.answer_bytes:
        raise BadAnswerError(
            say(
                "answer_of_other_length",
                "{asked}: an answer of {bytes} bytes to function {function_came} came, {due} bytes to "
                "function {function} were due",
                asked=request.subject,
                bytes=len(answer),
                function_came=answer[0],
                due=request.answer_bytes,
                function=request.function,
            )
        )
    if request.is_read:
        if answer[1] != 2 * request.read_count:
            raise BadAnswerError(
                say(
                    "answer_counts_otherwise",
                    "{asked}: the answer counts {bytes} bytes",
                    asked=request.subject,
                    bytes=answer[1],
                )
            )
        return bytes_to_words(answer[2:])
    address, count = int.from_bytes(answer[1:3], "big"), int.from_bytes(answer[3:5], "big")
    if request.function == WRITE_ONE:
        if (address, count) != (request.write_address, request.words[0]):
            raise BadAnswerError(
                say(
                    "confirms_other_word",
                    "{asked}: the device confirms the word {word} at {address}",
                    asked=request.subject,
                    word=count,
                    address=address,
                )
            )
        return ()
    if (address, count) != (request.write_address, len(request.words)):
        raise BadAnswerError(
            say(
                "confirms_other_words",
                "{asked}: the device confirms {count} words at {address}",
                asked=request.subject,
                count=count,
                address=address,
            )
        )
    return ()
