"""A mirror array behind real C functions of the ALP library, where wrong integer widths and bad pointers fail."""

from __future__ import annotations

import ctypes
import struct
from types import SimpleNamespace
from typing import Any

import numpy as np

from vamgpu.hosts.emulators.array import MICRO, ArrayModel, EmulatedArray, Queued, Stored
from vamgpu.hosts.emulators.clock import VirtualClock

NOT_ONLINE, NOT_IDLE, NOT_READY, INVALID, FULL, IN_USE, FAILED, REMOVED = 1001, 1002, 1004, 1005, 1007, 1008, 1011, 1012
N, U, P = ctypes.c_int32, ctypes.c_uint32, ctypes.c_void_p
LONGS, IDS = ctypes.POINTER(N), ctypes.POINTER(U)
ENTRIES: dict[str, tuple[Any, ...]] = {
    "AlpDevAlloc": (N, N, IDS),
    "AlpDevInquire": (U, N, LONGS),
    "AlpDevControl": (U, N, N),
    "AlpDevControlEx": (U, N, P),
    "AlpDevHalt": (U,),
    "AlpDevFree": (U,),
    "AlpSeqAlloc": (U, N, N, IDS),
    "AlpSeqFree": (U, U),
    "AlpSeqControl": (U, U, N, N),
    "AlpSeqTiming": (U, U, N, N, N, N, N),
    "AlpSeqInquire": (U, U, N, LONGS),
    "AlpSeqPut": (U, U, N, N, P),
    "AlpProjStart": (U, U),
    "AlpProjStartCont": (U, U),
    "AlpProjHalt": (U,),
    "AlpProjControl": (U, N, N),
    "AlpProjInquire": (U, N, LONGS),
    "AlpProjInquireEx": (U, N, P),
}


class EmulatedAlp(EmulatedArray):
    """The emulated device; a driver gets its ``library``. ``removed``: a pulled plug; ``crash``: an error in a call."""

    def __init__(self, clock: VirtualClock, model: ArrayModel = ArrayModel()) -> None:
        super().__init__(clock, model)
        self._stored: dict[int, Stored] = {}
        self._next_id = self._next_queue = 1
        self.allocated: bool = False
        self.floating: bool = False
        self.gates: dict[int, bytes] = {}  # what was set of each gated synch output
        self.rising: bool = True
        self.crash: BaseException | None = None
        entries = {name: self._entry(name, types) for name, types in ENTRIES.items()}
        self.library: SimpleNamespace = SimpleNamespace(**entries)

    def _entry(self, name: str, types: tuple[Any, ...]) -> Any:
        """A C function that calls the method of its name."""

        def called(*arguments: Any) -> int:
            if self.removed:
                return REMOVED
            if name != "AlpDevAlloc" and not self.allocated:
                return NOT_ONLINE
            try:
                with self.clock.lock:
                    self.advance(self.clock.now())
                    return self._call(name, *arguments)
            except BaseException as error:  # C code cannot pass on an exception or Ctrl-C
                self.crash = error
                return FAILED

        return ctypes.CFUNCTYPE(N, *types)(called)

    def _call(self, name: str, device: int, *arguments: Any) -> int:
        """Call a method, with its sequence if there is one, and answer inquiries from its table."""
        if "Seq" in name and name != "AlpSeqAlloc":
            stored = self._stored.get(arguments[0])
            if stored is None:
                return INVALID
            if name != "AlpSeqInquire" and any(entry.sequence == arguments[0] for entry in self._queue):
                return IN_USE
            if name == "AlpSeqFree":
                del self._stored[arguments[0]]
                return 0
            arguments = (stored, *arguments[1:])
        method = getattr(self, "_" + name)
        if not name.endswith("Inquire"):
            return method(*((device, *arguments) if name == "AlpDevAlloc" else arguments)) or 0
        *given, kind, answer = arguments
        known = method(*given)
        if kind not in known:
            return INVALID
        answer[0] = known[kind]
        return 0

    # sequences

    def free_planes(self) -> int:
        """Bit planes that fit now."""
        return self.model.planes - sum(stored.bits * stored.count for stored in self._stored.values())

    def _AlpSeqAlloc(self, bits: int, count: int, answer: Any) -> int:  # noqa: N802
        if not 1 <= bits <= 8 or count < 1:
            return INVALID
        if bits * count > self.free_planes():
            return FULL
        self._stored[self._next_id] = Stored(bits, count, count - 1)
        answer[0] = self._next_id
        self._next_id += 1
        return 0

    def _AlpSeqControl(self, stored: Stored, kind: int, value: int) -> int:  # noqa: N802
        if kind == 2102 and 0 <= value < stored.count:
            stored.last = value
        elif kind == 2104 and value in (2105, 2106) and stored.bits == 1:
            stored.uninterrupted = value == 2106
        elif kind == 2110 and value == 2:
            stored.packed = True
        else:
            return INVALID
        return 0

    def _AlpSeqTiming(self, stored: Stored, lit: int, frame: int, *rest: int) -> int:  # noqa: N802
        if min(lit, frame, *rest) < 0:
            return INVALID
        least = self.model.least_picture_us(stored.bits)
        frame = frame or (max(lit + 1, least) if lit else max(33334, least))
        lit = lit or frame
        if frame < least or lit > frame or lit < least - 1 or frame > 10_000_000 or rest[2] > 130_000:
            return INVALID
        stored.picture_us, stored.illuminate_us, stored.delay_us = frame, lit, rest[2]
        return 0

    def _AlpSeqInquire(self, stored: Stored) -> dict[int, int]:  # noqa: N802
        least, lit_us = self.model.least_picture_us(stored.bits), self._lit_ns(stored) // MICRO
        return {
            2203: stored.picture_us, 2204: stored.illuminate_us, 2211: least, 2213: 10_000_000, 2214: lit_us,
        }  # fmt: skip

    def _AlpSeqPut(self, stored: Stored, first: int, count: int, address: int) -> int:  # noqa: N802
        if first < 0 or first + count > stored.count or not address or not stored.packed:
            return INVALID
        size = self.model.height * self.model.row_bytes * stored.bits
        raw = np.frombuffer(ctypes.string_at(address, size * count), np.uint8)
        for i, data in enumerate(raw.reshape(count, size)):
            stored.frames[first + i] = self._planes(data, stored)
        self.counts["uploaded"] += count
        self.counts["upload_bytes"] += size * count
        if self.model.bytes_per_s:
            self.clock.sleep(round(size * count / self.model.bytes_per_s * 1e9))
        return 0

    def _planes(self, data: np.ndarray, stored: Stored) -> np.ndarray:
        """Bit planes, the most significant first, of one frame as it was sent."""
        return data.reshape(stored.bits, self.model.height, self.model.row_bytes)

    # the device

    def disconnect(self) -> None:
        """The process that used it has ended, and the system released it: dark, without frames."""
        with self.clock.lock:
            self.advance(self.clock.now())
            self._queue.clear()
            self._stored.clear()
            self.allocated = False

    def _AlpDevAlloc(self, number: int, _: int, answer: Any) -> int:  # noqa: N802
        if number not in (0, self.model.serial):
            return NOT_ONLINE
        if self.allocated:
            return NOT_READY
        self.allocated = True
        answer[0] = 77
        return 0

    def _AlpDevInquire(self) -> dict[int, int]:  # noqa: N802
        return {
            2000: self.model.serial, 2003: self.free_planes(), 2005: 2009 if self.rising else 2008, 2021: 3,
            2057: self.model.height, 2058: self.model.width, 2064: int(self.floating),
        }  # fmt: skip

    def _AlpDevControl(self, kind: int, value: int) -> int:  # noqa: N802
        if kind == 2005 and value in (2008, 2009):
            self.rising = value == 2009
        elif kind == 2014 and value in (0, 1):
            self.time_out: bool = value == 0
        elif kind == 2064 and value in (0, 1):
            if self._queue:
                return NOT_IDLE
            self.floating = value == 1
        else:
            return INVALID
        return 0

    def _AlpDevControlEx(self, kind: int, address: int) -> int:  # noqa: N802
        gate = ctypes.string_at(address, 18)
        if kind not in (2023, 2024, 2025) or gate[0] > 16 or gate[1] > 1 or max(gate[2 : 2 + gate[0]], default=0) > 1:
            return INVALID
        self.gates[kind - 2022] = gate
        return 0

    _AlpDevHalt = _AlpProjHalt = EmulatedArray._cut

    def _AlpDevFree(self) -> int:  # noqa: N802
        if self._queue:
            return NOT_IDLE
        self.allocated = False
        self._stored.clear()
        return 0

    # projection

    def _start(self, stored: Stored, sequence: int, iterations: int | None) -> int:
        if not self.queueing and self._queue:
            return NOT_IDLE
        if len(self._queue) >= 256:
            return NOT_READY
        self._queue.append(Queued(self._next_queue, sequence, stored, iterations, stored.last + 1))
        self._next_queue += 1
        now = self.clock.now()
        if len(self._queue) == 1:
            self._last_trigger = now
            if not self.slave and self._current is None:
                self._show(now)
        return 0

    def _AlpProjStart(self, sequence: int, forever: bool = False) -> int:  # noqa: N802
        stored = self._stored.get(sequence)
        if stored is None or self.floating:
            return INVALID
        return self._start(stored, sequence, None if forever else 1)

    def _AlpProjStartCont(self, sequence: int) -> int:  # noqa: N802
        return self._AlpProjStart(sequence, forever=True)

    def _AlpProjControl(self, kind: int, value: int) -> int:  # noqa: N802
        if self._queue:
            return NOT_IDLE
        if kind == 2300 and value in (2301, 2302):
            self.slave: bool = value == 2302
        elif kind == 2314 and value in (0, 1):
            self.queueing: bool = value == 1
        elif kind != 2319:
            return INVALID
        return 0

    def _AlpProjInquire(self) -> dict[int, int]:  # noqa: N802
        return {
            2300: 2302 if self.slave else 2301, 2400: 1200 if self._queue else 1201, 2314: int(self.queueing),
            2315: self._next_queue - 1, 2317: 256 - len(self._queue),
        }  # fmt: skip

    def _AlpProjInquireEx(self, kind: int, address: int) -> int:  # noqa: N802
        if kind != 2318 or not address:
            return INVALID
        words = (0,) * 8 + (1,)
        if self._queue:
            head = self._queue[0]
            left = 0 if head.iterations == 0 else head.frames - head.next
            words = (head.queue_id, head.sequence, len(self._queue) - 1, head.iterations or 0, 0, left,
                     head.stored.picture_us, head.frames, 4 if head.iterations is None else 0)  # fmt: skip
        ctypes.memmove(address, struct.pack("=9I", *words), 36)
        return 0
