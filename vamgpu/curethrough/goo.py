"""Elegoo's .goo files (V3.0): slices as runs of like pixels, read and written back with their settings."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence

import numpy as np

from vamgpu.curethrough.runs import runs, unpack
from vamgpu.errors import SliceError

MAGIC = b"\7\0\0\0DLP\0"
HEAD = 195_477
"""Bytes before the first layer; among them the number of layers, columns, rows, and the height of a layer."""
COUNT, HEIGHT, DEFINITION, MARK = 195_310, 195_332, 64, b"\r\n"
LEVEL = 6  # offset of a layer's height above the platform in its definition
END = b"\0\0\0\7\0\0\0DLP\0"
MOST = 0xFFFFFFF  # pixels of the longest run


class Goo:
    """The settings and the packed layers of a file. Raises `SliceError`."""

    def __init__(self, data: bytes, place: str) -> None:
        self.place: str = place
        self.data: bytes = data
        if len(data) < HEAD or data[4:12] != MAGIC:
            raise SliceError(f"{place!r} is not a .goo file of version 3, or is cut off: copy or export it again")
        count, columns, rows = struct.unpack_from(">IHH", data, COUNT)
        self.count: int = count
        self.shape: tuple[int, int] = rows, columns
        self.height: float = struct.unpack_from(">f", data, HEIGHT)[0]
        self.layers: tuple[tuple[bytes, int, int], ...] = tuple(self._found())
        if not self.layers or 0 in self.shape:
            raise SliceError(f"{place!r} has {self.count} layers of {columns} × {rows} pixels; expected more than 0")

    def _found(self) -> Iterator[tuple[bytes, int, int]]:
        """Definition, first byte and end of each layer."""
        at = HEAD
        for number in range(self.count):
            size = int.from_bytes(self.data[at + DEFINITION + 2 : at + DEFINITION + 6], "big")
            first = at + DEFINITION + 6
            marks = self.data[first - 6 : first - 4] + self.data[first + size : first + size + 2]
            if marks != 2 * MARK or size < 2:
                raise SliceError(f"{self.place!r} ends or is damaged at layer {number} of {self.count}: copy or export "
                                 "it again")  # fmt: skip
            yield self.data[at : at + DEFINITION], first, first + size
            at = first + size + 2

    def decode(self, number: int, out: np.ndarray) -> None:
        """Write the levels of a layer into uint8 ``out`` [y, x]."""
        _, first, end = self.layers[number]
        packed = self.data[first + 1 : end - 1]
        if self.data[first] != 0x55 or (sum(packed) + self.data[end - 1]) & 0xFF != 0xFF:
            raise SliceError(f"{self.place!r}: the check sum of layer {number} is wrong: copy or export it again")
        unpack(_runs(packed), out, f"{self.place!r}: layer {number}")

    @staticmethod
    def encode(levels: np.ndarray, _: str = "") -> bytes:
        """Bytes of a layer's gray levels, uint8 [y, x], with mark and check sum."""
        packed = bytearray()
        for level, left in runs(levels):
            while left:
                length = min(left, MOST)
                more = (max(length.bit_length() - 4, 0) + 7) // 8
                kind = {0: 0, 0xFF: 3}.get(level, 1)
                packed.append(kind << 6 | more << 4 | length & 15)
                packed += bytes([level] if kind == 1 else []) + (length >> 4).to_bytes(more, "big")
                left -= length
        return b"\x55" + packed + bytes([~sum(packed) & 0xFF])

    def packed(self, layers: Sequence[bytes]) -> Iterator[bytes]:
        """The file with other layers; those beyond the last have the settings of that one, each a layer higher."""
        yield self.data[:COUNT] + struct.pack(">I", len(layers)) + self.data[COUNT + 4 : HEAD]
        for number, packed in enumerate(layers):
            definition = bytearray(self.layers[min(number, len(self.layers) - 1)][0])
            if number >= len(self.layers):
                struct.pack_into(">f", definition, LEVEL, self.height * (number + 1))
            yield bytes(definition) + MARK + struct.pack(">I", len(packed)) + packed + MARK
        yield END


def _runs(packed: bytes) -> Iterator[tuple[int, int]]:
    """Level and length of each run. Raises `IndexError` where the bytes end too soon."""
    at, level = 0, 0
    while at < len(packed):
        head, at = packed[at], at + 1
        if head >> 6 == 2:  # a step from the level before
            length = 1
            if head & 0x10:
                length, at = packed[at], at + 1
            level = (level - (head & 15) if head & 0x20 else level + (head & 15)) & 0xFF
        else:
            if head >> 6 == 1:
                level, at = packed[at], at + 1
            else:
                level = 0xFF if head >> 6 else 0
            more = head >> 4 & 3
            packed[at + more - 1]
            length, at = (head & 15) + (int.from_bytes(packed[at : at + more], "big") << 4), at + more
        yield level, length
