"""Elegoo's .goo files (V3.0): slices as runs of like pixels, read and written back with their settings."""

from __future__ import annotations

import struct
from collections.abc import Iterator

import numpy as np

from vamgpu.errors import SliceError

MAGIC = b"\7\0\0\0DLP\0"
HEAD = 195_477
"""Bytes before the first layer; among them the number of layers, columns, rows, and the height of a layer."""
COUNT, HEIGHT, DEFINITION, MARK = 195_310, 195_332, 64, b"\r\n"
LEVEL = 6
"""Byte of a layer's definition at which its height over the platform stands."""
END = b"\0\0\0\7\0\0\0DLP\0"
MOST = 0xFFFFFFF
"""Pixels of the longest run."""


class Goo:
    """The settings and the packed layers of a file. Raises `SliceError`."""

    place: str
    data: bytes
    count: int
    shape: tuple[int, int]
    height: float
    layers: tuple[tuple[bytes, int, int], ...]

    def __init__(self, data: bytes, place: str) -> None:
        self.place, self.data = place, data
        if len(data) < HEAD or data[4:12] != MAGIC:
            raise SliceError(f"{place!r} is not a .goo file of version 3, or is cut off: copy or export it again")
        self.count, columns, rows = struct.unpack_from(">IHH", data, COUNT)
        self.shape, self.height = (int(rows), int(columns)), float(struct.unpack_from(">f", data, HEIGHT)[0])
        self.layers = tuple(self._found())
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
        try:
            levels, lengths = _runs(packed)
        except IndexError:
            levels, lengths = [], []
        if sum(lengths) != out.size:
            raise SliceError(f"{self.place!r}: layer {number} has {sum(lengths):,} pixels; expected {out.size:,}: "
                             "export it again")  # fmt: skip
        out[...] = np.repeat(np.array(levels, np.uint8), lengths).reshape(out.shape)

    def head(self, layers: int) -> bytes:
        """What stands before the layers, for another number of them."""
        return self.data[:COUNT] + struct.pack(">I", layers) + self.data[COUNT + 4 : HEAD]

    def layer(self, number: int, packed: bytes) -> bytes:
        """A layer with its settings; those beyond the last have the settings of that one, each a layer higher."""
        definition = bytearray(self.layers[min(number, len(self.layers) - 1)][0])
        if number >= len(self.layers):
            struct.pack_into(">f", definition, LEVEL, self.height * (number + 1))
        return bytes(definition) + MARK + struct.pack(">I", len(packed)) + packed + MARK


def _runs(packed: bytes) -> tuple[list[int], list[int]]:
    """Levels and lengths. Raises `IndexError` where the bytes end too soon."""
    levels, lengths, at, level = [], [], 0, 0
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
        levels.append(level)
        lengths.append(length)
    return levels, lengths


def encode_goo(levels: np.ndarray, _: str = "") -> bytes:
    """Bytes of a layer's gray levels, uint8 [y, x], with mark and check sum."""
    flat = np.ascontiguousarray(levels).ravel()
    starts = np.concatenate([[0], np.flatnonzero(flat[1:] != flat[:-1]) + 1, [flat.size]])
    packed = bytearray()
    for first, end in zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True):
        level, left = int(flat[first]), end - first
        while left:
            length = min(left, MOST)
            more = (max(length.bit_length() - 4, 0) + 7) // 8
            kind = {0: 0, 0xFF: 3}.get(level, 1)
            packed.append(kind << 6 | more << 4 | length & 15)
            packed += bytes([level] if kind == 1 else []) + (length >> 4).to_bytes(more, "big")
            left -= length
    return b"\x55" + packed + bytes([~sum(packed) & 0xFF])
