"""Check sums of the line protocols."""

from __future__ import annotations


def crc16_arc(data: bytes) -> int:
    """CRC-16/ARC: polynomial 0x8005 reflected, start 0; 0xBB3D for ``123456789``. A frame with its own is 0."""
    value = 0
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = (value >> 1) ^ 0xA001 if value & 1 else value >> 1
    return value


def _ccitt(high: int) -> int:
    """What a byte in the upper half of a CRC-16/CCITT comes to after eight bits."""
    value = high << 8
    for _ in range(8):
        value = ((value << 1) ^ 0x1021) & 0xFFFF if value & 0x8000 else value << 1
    return value


_CCITT = tuple(map(_ccitt, range(256)))  # every poll of a print takes two such sums


def crc16_ccitt(data: bytes) -> int:
    """CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xFFFF; 0x29B1 for ``123456789``."""
    value = 0xFFFF
    for byte in data:
        value = (value << 8 & 0xFFFF) ^ _CCITT[value >> 8 ^ byte]
    return value


def lrc(data: bytes) -> int:
    """The byte that brings the sum of all bytes to a multiple of 256."""
    return -sum(data) & 0xFF
