"""A mirror array behind the ALP library's own functions: memory of bit planes, limits, a queue, triggers and light.

``FakeAlp.library`` has real C functions, made with declarations of their own, so the driver crosses a true C border:
wrong widths of integers or bad pointers fail here as they would there. What the mirrors did is handed to ``on_shown``
when each picture is over.
"""

from __future__ import annotations

import ctypes
from types import SimpleNamespace
from typing import Any

import numpy as np

from vamgpu.hosts.emulators.array import ArrayModel, Queued
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.sequences import INVALID, EmulatedSequences

N, U, P = ctypes.c_int32, ctypes.c_uint32, ctypes.c_void_p
LONGS, IDS = ctypes.POINTER(N), ctypes.POINTER(U)
ENTRIES = {
    "AlpDevAlloc": (N, N, IDS),
    "AlpDevInquire": (U, N, LONGS),
    "AlpDevControl": (U, N, N),
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
NOT_ONLINE, NOT_IDLE, _, NOT_READY = range(1001, 1005)
FAILED, REMOVED = 1011, 1012


class FakeAlp(EmulatedSequences):
    """The device; ``library`` is what a driver is given in place of the maker's library.

    ``removed`` set to True is a plug pulled: every call fails from then on, and triggers do nothing. ``crash`` keeps
    what went wrong in Python during a call.
    """

    def __init__(self, clock: VirtualClock, model: ArrayModel = ArrayModel()) -> None:
        super().__init__(clock, model)
        self.allocated = self.floating = False
        self.rising = True
        self.crash: Exception | None = None
        self._next_queue = 1
        self.library = SimpleNamespace(**{name: self._entry(name, types) for name, types in ENTRIES.items()})

    def _entry(self, name: str, types: tuple[Any, ...]) -> Any:
        """A C function that calls the method of its name."""
        method = getattr(self, "_" + name)

        def called(*arguments: Any) -> int:
            if self.removed:
                return REMOVED
            if name != "AlpDevAlloc" and not self.allocated:
                return NOT_ONLINE
            try:
                with self.clock.lock:
                    self.advance(self.clock.now())
                    return method(*arguments) or 0
            except BaseException as error:  # C code cannot pass it on, a key that was pressed as little
                self.crash = error
                return FAILED

        return ctypes.CFUNCTYPE(N, *types)(called)

    # the library: devices

    def forsake(self) -> None:
        """The process that held it is gone, and the system took it back: dark, and all pictures forgotten."""
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

    def _AlpDevInquire(self, _: int, kind: int, answer: Any) -> int:  # noqa: N802
        known = {2000: self.model.serial, 2003: self.free_planes(), 2057: self.model.height, 2021: 3}
        known |= {2058: self.model.width, 2005: 2009 if self.rising else 2008, 2064: int(self.floating)}
        if kind not in known:
            return INVALID
        answer[0] = known[kind]
        return 0

    def _AlpDevControl(self, _: int, kind: int, value: int) -> int:  # noqa: N802
        if kind == 2005 and value in (2008, 2009):
            self.rising = value == 2009
        elif kind == 2014 and value in (0, 1):
            self.time_out = value == 0
        elif kind == 2064 and value in (0, 1):
            if self._queue:
                return NOT_IDLE
            self.floating = value == 1
        else:
            return INVALID
        return 0

    def _AlpDevHalt(self, _: int) -> None:  # noqa: N802
        self._cut()

    def _AlpDevFree(self, _: int) -> int:  # noqa: N802
        if self._queue:
            return NOT_IDLE
        self.allocated = False
        self._stored.clear()
        return 0

    # projection

    def _start(self, sequence: int, forever: bool) -> int:
        stored = self._stored.get(sequence)
        if stored is None or self.floating:
            return INVALID
        if not self.queueing and self._queue:
            return NOT_IDLE
        if len(self._queue) >= 256:
            return NOT_READY
        iterations = None if forever else stored.repeat
        self._queue.append(Queued(self._next_queue, sequence, stored, iterations, stored.last + 1))
        self._next_queue += 1
        now = self.clock.now()
        if len(self._queue) == 1:
            self._last_trigger = now
            if not self.slave and self._current is None:
                self._show(now)
        return 0

    def _AlpProjStart(self, _: int, sequence: int) -> int:  # noqa: N802
        return self._start(sequence, forever=False)

    def _AlpProjStartCont(self, _: int, sequence: int) -> int:  # noqa: N802
        return self._start(sequence, forever=True)

    def _AlpProjHalt(self, _: int) -> None:  # noqa: N802
        self._cut()

    def _AlpProjControl(self, _: int, kind: int, value: int) -> int:  # noqa: N802
        if self._queue:
            return NOT_IDLE
        if kind == 2300 and value in (2301, 2302):
            self.slave = value == 2302
        elif kind == 2314 and value in (0, 1):
            self.queueing = value == 1
        elif kind != 2319:
            return INVALID
        return 0

    def _AlpProjInquire(self, _: int, kind: int, answer: Any) -> int:  # noqa: N802
        known = {2300: 2302 if self.slave else 2301, 2400: 1200 if self._queue else 1201, 2314: int(self.queueing)}
        known |= {2317: 256 - len(self._queue), 2315: self._next_queue - 1}
        if kind not in known:
            return INVALID
        answer[0] = known[kind]
        return 0

    def _AlpProjInquireEx(self, _: int, kind: int, address: int) -> int:  # noqa: N802
        if kind != 2318 or not address:
            return INVALID
        words = np.zeros(9, np.uint32)
        if not self._queue:
            words[8] = 1
        else:
            head = self._queue[0]
            left = 0 if head.iterations == 0 else head.frames - head.next
            words[:6] = head.queue_id, head.sequence, len(self._queue) - 1, head.iterations or 0, 0, left
            words[6:] = head.stored.picture_us, head.frames, 4 if head.iterations is None else 0
        ctypes.memmove(address, words.tobytes(), 36)
        return 0
