"""The check of Modbus frames on a serial line, which captured windows and live blocks carry too."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from drivers.registers import words_to_bytes


def _crc_of_byte(byte: int) -> int:
    for _ in range(8):
        byte = (byte >> 1) ^ 0xA001 if byte & 1 else byte >> 1
    return byte


_CRC_OF_BYTE: Final = tuple(_crc_of_byte(byte) for byte in range(256))


def crc16(data: bytes) -> int:
    """CRC-16/MODBUS of ``data`` (Modbus over Serial Line 1.02, 6.2.2): polynomial 0xA001, start 0xFFFF."""
    crc = 0xFFFF
    for byte in data:
        crc = (crc >> 8) ^ _CRC_OF_BYTE[(crc ^ byte) & 0xFF]
    return crc


def words_crc16(words: Sequence[int]) -> int:
    """CRC-16/MODBUS of words in wire order (high byte first)."""
    return crc16(words_to_bytes(words))
