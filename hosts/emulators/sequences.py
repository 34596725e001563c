"""Sequences of pictures in an emulated mirror array's memory, as the ALP library's functions handle them."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np

from vamgpu.hosts.emulators.array import MICRO, ArrayModel, EmulatedArray, Stored
from vamgpu.hosts.emulators.clock import VirtualClock

INVALID, _, FULL, IN_USE = range(1005, 1009)


class EmulatedSequences(EmulatedArray):
    """The memory: sequences by their numbers, with limits, times and data."""

    def __init__(self, clock: VirtualClock, model: ArrayModel = ArrayModel()) -> None:
        super().__init__(clock, model)
        self._stored: dict[int, Stored] = {}
        self._next_id = 1

    def free_planes(self) -> int:
        """How many bit planes fit now."""
        return self.model.planes - sum(stored.bits * stored.count for stored in self._stored.values())

    def _AlpSeqAlloc(self, _: int, bits: int, count: int, answer: Any) -> int:  # noqa: N802
        if not 1 <= bits <= 8 or count < 1:
            return INVALID
        if bits * count > self.free_planes():
            return FULL
        self._stored[self._next_id] = Stored(bits, count, bits, count - 1)
        answer[0] = self._next_id
        self._next_id += 1
        return 0

    def _in_use(self, sequence: int) -> bool:
        return any(entry.sequence == sequence for entry in self._queue)

    def _AlpSeqFree(self, _: int, sequence: int) -> int:  # noqa: N802
        if sequence not in self._stored:
            return INVALID
        if self._in_use(sequence):
            return IN_USE
        del self._stored[sequence]
        return 0

    def _AlpSeqControl(self, _: int, sequence: int, kind: int, value: int) -> int:  # noqa: N802
        stored = self._stored.get(sequence)
        if stored is None:
            return INVALID
        if self._in_use(sequence):
            return IN_USE
        if kind == 2100 and value >= 1:
            stored.repeat = value
        elif kind == 2102 and 0 <= value < stored.count:
            stored.last = value
        elif kind == 2103 and 1 <= value <= stored.bits:
            stored.shown_bits = value
        elif kind == 2104 and value in (2105, 2106) and stored.shown_bits == 1:
            stored.uninterrupted = value == 2106
        elif kind == 2110 and value in (0, 2):
            stored.format = value
        else:
            return INVALID
        return 0

    def _AlpSeqTiming(self, _: int, sequence: int, lit: int, picture: int, *rest: int) -> int:  # noqa: N802
        stored = self._stored.get(sequence)
        if stored is None or min(lit, picture, *rest) < 0:
            return INVALID
        if self._in_use(sequence):
            return IN_USE
        least = self.model.least_picture_us(stored.shown_bits)
        if picture == 0:
            picture = max(lit + 1, least) if lit else max(33334, least)
        if lit == 0:
            lit = picture
        if picture < least or lit > picture or lit < least - 1 or picture > 10_000_000 or rest[2] > 130_000:
            return INVALID
        stored.picture_us, stored.illuminate_us, stored.delay_us = picture, lit, rest[2]
        return 0

    def _AlpSeqInquire(self, _: int, sequence: int, kind: int, answer: Any) -> int:  # noqa: N802
        stored = self._stored.get(sequence)
        if stored is None:
            return INVALID
        least = self.model.least_picture_us(stored.shown_bits)
        lit_us = self._lit_ns(stored) // MICRO
        known = {2200: stored.bits, 2201: stored.count, 2203: stored.picture_us, 2204: stored.illuminate_us}
        known |= {2207: stored.delay_us, 2210: 130_000, 2211: least, 2212: max(least - 1, 1), 2213: 10_000_000}
        known |= {2214: lit_us, 2215: stored.picture_us - lit_us, 2103: stored.shown_bits}
        if kind not in known:
            return INVALID
        answer[0] = known[kind]
        return 0

    def _AlpSeqPut(self, _: int, sequence: int, first: int, count: int, address: int) -> int:  # noqa: N802
        stored = self._stored.get(sequence)
        if stored is None or first < 0 or first + count > stored.count or not address:
            return INVALID
        if self._in_use(sequence):
            return IN_USE
        rows, row_bytes = self.model.height, self.model.row_bytes
        size = rows * (row_bytes * stored.bits if stored.format == 2 else self.model.width)
        raw = np.frombuffer(ctypes.string_at(address, size * count), np.uint8)
        for i, data in enumerate(raw.reshape(count, size)):
            stored.pictures[first + i] = self._planes(data, stored)
        self.counts["uploaded"] += count
        self.counts["upload_bytes"] += size * count
        if self.model.bytes_per_s:
            self.clock.sleep(round(size * count / self.model.bytes_per_s * 1e9))
        return 0

    def _planes(self, data: np.ndarray, stored: Stored) -> np.ndarray:
        """Bit planes, the most significant first, of one picture as it was sent."""
        rows, row_bytes = self.model.height, self.model.row_bytes
        if stored.format == 2:
            return data.reshape(stored.bits, rows, row_bytes)
        planes = np.zeros((stored.bits, rows, row_bytes), np.uint8)
        for plane in range(stored.bits):
            lit = np.packbits(data.reshape(rows, -1) >> (7 - plane) & 1, axis=-1)
            planes[plane, :, : lit.shape[1]] = lit
        return planes
