"""Chitubox's .ctb files, versions 2 to 5: slices as runs of like pixels, read and written back with their settings."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from itertools import accumulate

import numpy as np

from vamgpu.curethrough.runs import runs, unpack
from vamgpu.errors import SliceError

PLAIN, LOCKED, OLDER = (0x12FD0086, 0x12FD0106), 0x12FD0107, 0x12FD0019
HEAD, ROW, BESIDE = 112, 36, 84
"""Bytes of the header, of a layer's row in the table, and, from version 3 on, of its settings before the pixels."""
HEIGHT, TOTAL, COLUMNS, TABLE, COUNT, KEY, SLICER = 32, 28, 52, 64, 68, 100, 104
"""Offsets in the header: layer height, part height, pixels, table of layers, number of layers, key, other settings."""
ADDRESSES = (60, 72, 84, SLICER)
FOURTH, LAST = 64, 52
"""Offsets: in the slicer's settings, the address of those of version 4; in these, the number of the last layer."""
WORD = 1 << 32


class Ctb:
    """The settings and the packed layers of a file. Raises `SliceError`."""

    def __init__(self, data: bytes, place: str) -> None:
        self.place: str = place
        self.data: bytes = data
        magic = int.from_bytes(data[:4], "little")
        if magic == LOCKED:
            raise SliceError(f"{place!r} is an encrypted .ctb file, which only its maker's programs read; expected "
                             "a plain one: export it for another printer, as .goo or as pictures")  # fmt: skip
        if magic == OLDER:
            raise SliceError(f"{place!r} is of the older kind .cbddlp or .photon; expected a .ctb file: export it "
                             "again, or as pictures")  # fmt: skip
        if len(data) < HEAD or magic not in PLAIN:
            raise SliceError(f"{place!r} is not a .ctb file, or is cut off: copy or export it again")
        self.version: int = self._at(4)
        self.table: int = self._at(TABLE)
        self.count: int = self._at(COUNT)
        self.key: int = self._at(KEY)
        self.shape: tuple[int, int] = self._at(COLUMNS + 4), self._at(COLUMNS)
        self.height: float = float(struct.unpack_from("<f", data, HEIGHT)[0])
        if not self.count or 0 in self.shape:
            raise SliceError(f"{place!r} has {self.count} layers of {self.shape} pixels; expected more than 0")
        if self.table + ROW * self.count > len(data):
            raise SliceError(f"{place!r} ends within its table of {self.count} layers: copy or export it again")
        self.beside: int = BESIDE if self.version >= 3 else 0
        self.layers: tuple[tuple[int, int], ...] = tuple(map(self._layer, range(self.count)))

    def _at(self, place: int) -> int:
        return int.from_bytes(self.data[place : place + 4], "little")

    def _layer(self, number: int) -> tuple[int, int]:
        """First byte and end of a layer's pixels."""
        row = self.table + ROW * number
        first, size, page = (self._at(row + place) for place in (12, 16, 20))
        first += page * WORD
        if not size or first < HEAD + self.beside or first + size > len(self.data):
            raise SliceError(f"{self.place!r} ends or is damaged at layer {number} of {self.count}: copy or export it "
                             "again")  # fmt: skip
        return first, first + size

    def decode(self, number: int, out: np.ndarray) -> None:
        """Write the levels of a layer into uint8 ``out`` [y, x]."""
        first, end = self.layers[number]
        unpack(_runs(self._keyed(self.data[first:end], number)), out, f"{self.place!r}: layer {number}")

    def _keyed(self, packed: bytes, number: int) -> bytes:
        """Bytes of a layer combined with the file's key, which is its own inverse."""
        if not self.key:
            return packed
        step = (self.key * 0x2D83CDAC + 0xD8A83423) % WORD
        start = (number * 0x1E1530CD + 0xEC3D47CD) * step % WORD
        words = (start + step * np.arange(-(-len(packed) // 4), dtype=np.uint64)).astype("<u4")
        return (np.frombuffer(packed, np.uint8) ^ words.view(np.uint8)[: len(packed)]).tobytes()

    @staticmethod
    def encode(levels: np.ndarray, _: str = "") -> bytes:
        """Bytes of a layer's gray levels, uint8 [y, x], of which seven bits are kept."""
        packed = bytearray()
        for level, length in runs(levels >> 1):
            if length == 1:
                packed.append(level)
                continue
            more = next(more for more in range(4) if length < 1 << 7 * (more + 1))
            packed.append(level | 0x80)
            packed += (length | (0, 0x80, 0xC0, 0xE0)[more] << 8 * more).to_bytes(more + 1, "big")
        return bytes(packed)

    def packed(self, layers: Sequence[bytes]) -> Iterator[bytes]:
        """The file with other layers; those beyond the last have the settings of that one, each a layer higher."""
        if max(self._at(place) for place in ADDRESSES) >= self.table:
            raise SliceError(f"{self.place!r} has settings behind its layers; expected them before: write a folder")
        yield self._head(len(layers))
        sizes = [self.beside + len(packed) for packed in layers]
        starts = list(accumulate(sizes, initial=self.table + ROW * len(layers)))
        rows = []
        for number, (start, packed) in enumerate(zip(starts, layers, strict=False)):
            last = min(number, self.count - 1)
            row = bytearray(self.data[self.table + ROW * last : self.table + ROW * (last + 1)])
            struct.pack_into("<f", row, 0, struct.unpack_from("<f", row)[0] + (number - last) * self.height)
            page, first = divmod(start + self.beside, WORD)
            struct.pack_into("<3I", row, 12, first, len(packed), page)
            rows.append(bytes(row))
        yield b"".join(rows)
        for number, (row, packed) in enumerate(zip(rows, layers, strict=True)):
            first, _ = self.layers[min(number, self.count - 1)]
            size = struct.pack("<I", self.beside + len(packed))
            beside = row + size + self.data[first - self.beside + ROW + len(size) : first] if self.beside else b""
            yield beside + self._keyed(packed, number)

    def _head(self, layers: int) -> bytes:
        """What stands before the table, for another number of layers."""
        head = bytearray(self.data[: self.table])
        struct.pack_into("<I", head, COUNT, layers)
        struct.pack_into("<f", head, TOTAL, struct.unpack_from("<f", self.data, TOTAL)[0]
                         + (layers - self.count) * self.height)  # fmt: skip
        fourth = self._at(self._at(SLICER) + FOURTH) if self.version >= 4 else 0
        if HEAD <= fourth <= self.table - LAST - 4:
            struct.pack_into("<I", head, fourth + LAST, layers - 1)
        return bytes(head)


def _runs(packed: bytes) -> Iterator[tuple[int, int]]:
    """Level and length of each run. Raises `IndexError` where the bytes end too soon."""
    at = 0
    while at < len(packed):
        code, at, length = packed[at], at + 1, 1
        if code & 0x80:
            first = packed[at]
            more = next((more for more in range(4) if first >> 7 - more == (1 << more + 1) - 2), 4)
            packed[at + more]
            length = int.from_bytes(packed[at : at + more + 1], "big") & ((1 << 7 * (more + 1)) - 1)
            at += more + 1
        level = code & 0x7F
        yield level << 1 | (level > 0), length
