"""Lines to emulated machines, which ``receive`` bytes and give bytes to ``take``: cables, and their faults."""

from __future__ import annotations

import errno
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

from vamgpu.hosts.emulators.clock import VirtualClock

SECOND = 1_000_000_000


class LineDevice:
    """An emulated machine on a line, with received and outgoing bytes."""

    def __init__(self, latency_us: float, byte_ns: int = 0) -> None:
        self._buffer: bytearray = bytearray()
        self._out = Outbox(byte_ns, round(latency_us * 1000))

    def lines(self, data: bytes) -> Iterator[bytes]:
        """The lines that are complete after bytes were received, without their ends."""
        self._buffer += data
        while (end := self._buffer.find(b"\n")) >= 0:
            line = bytes(self._buffer[:end]).replace(b"\r", b"")
            del self._buffer[: end + 1]
            if line:
                yield line

    def receive(self, data: bytes, now: int) -> None:
        raise NotImplementedError

    def take(self, now: int) -> bytes:
        """Return the bytes sent by now."""
        return self._out.take(now)

    def ready(self) -> int | None:
        """Time at which the next bytes are sent; None if there are none."""
        return self._out.ready()

    def due(self) -> int | None:
        """None: it has no events."""
        return None

    def advance(self, now: int) -> None:
        """Do nothing, because nothing changes with time."""


class Outbox:
    """Outgoing bytes, each with the time at which it is sent."""

    def __init__(self, byte_ns: int = 0, latency_ns: int = 0) -> None:
        self.byte_ns = byte_ns
        self.latency_ns = latency_ns
        self._pieces: deque[tuple[int, bytes]] = deque()  # start time of the first byte of a piece
        self._last = 0

    def put(self, data: bytes, now: int) -> None:
        """Queue bytes after those still being sent."""
        if data:
            start = max(now + self.latency_ns, self._last)
            self._last = start + len(data) * self.byte_ns
            self._pieces.append((start, data))

    def take(self, now: int) -> bytes:
        """The sent bytes."""
        taken = b""
        while (first := self.ready()) is not None and first <= now:
            start, data = self._pieces.popleft()
            left = (now - start) // self.byte_ns if self.byte_ns else len(data)
            taken += data[:left]
            if left < len(data):
                self._pieces.appendleft((start + left * self.byte_ns, data[left:]))
        return taken

    def ready(self) -> int | None:
        """Time at which the next byte is sent."""
        return self._pieces[0][0] + self.byte_ns if self._pieces else None


@dataclass
class Faults:
    """Faults of a line: bytes dropped or with a bit flipped, by their number since the start; or a dead line."""

    drop_in: frozenset[int] = frozenset()
    flip_in: frozenset[int] = frozenset()
    drop_out: frozenset[int] = frozenset()
    flip_out: frozenset[int] = frozenset()
    dead: bool = False
    _count: dict[str, int] = field(default_factory=lambda: {"in": 0, "out": 0})

    def spoiled(self, data: bytes, way: Literal["in", "out"]) -> bytes:
        """The bytes that arrive despite the faults, on their way into the machine or out of it."""
        first, drop, flip = self._count[way], getattr(self, f"drop_{way}"), getattr(self, f"flip_{way}")
        self._count[way] += len(data)
        if self.dead:
            return b""
        if not drop and not flip:
            return data
        kept = [(byte ^ 1 if first + i in flip else byte) for i, byte in enumerate(data) if first + i not in drop]
        return bytes(kept)


class Cable:
    """One direction of a line: bytes arrive at a machine after their transfer time."""

    def __init__(self, machine: LineDevice, baud: int = 0) -> None:
        self.machine = machine
        self._flight = Outbox(round(10 * SECOND / baud) if baud else 0)

    def send(self, data: bytes, now: int) -> None:
        """Send bytes at a time [ns]; without a baud rate they arrive at once."""
        if self._flight.byte_ns == 0:
            self.machine.receive(data, now)
        else:
            self._flight.put(data, now)

    def due(self) -> int | None:
        """When the next byte arrives."""
        return self._flight.ready()

    def advance(self, now: int) -> None:
        """Deliver the arrived bytes, each at its time."""
        while (at := self._flight.ready()) is not None and at <= now:
            self.machine.receive(self._flight.take(at), at)


class VirtualPort:
    """A port to a machine on a virtual clock: reading waits in virtual time; with ``baud`` 0, sending takes none."""

    def __init__(
        self, machine: LineDevice, clock: VirtualClock, timeout_s: float = 0.25, baud: int = 0,
        faults: Faults | None = None,
    ) -> None:  # fmt: skip
        self.machine = machine
        self.clock = clock
        self.faults: Faults = faults or Faults()
        self.timeout_ns: int = round(timeout_s * SECOND)
        self._cable = Cable(machine, baud)
        self._received = bytearray()
        self._unplugged = self._absent = False
        clock.attach(machine)
        clock.attach(self._cable)

    def unplug(self) -> None:
        """Pull the plug: every use fails."""
        self._unplugged = self._absent = True

    def replug(self) -> None:
        """Put the plug back; the port works once it is opened again."""
        self._absent = False

    def open(self) -> None:
        """Open it again after `close`."""
        self._unplugged = self._absent
        self._check()
        self._received.clear()
        self.clock.attach(self._cable)

    def _check(self) -> None:
        if self._unplugged:
            raise OSError(errno.EIO, "device disconnected")

    def _collect(self) -> None:
        with self.clock.lock:
            if data := self.machine.take(self.clock.now()):
                self._received += self.faults.spoiled(data, "out")

    def write(self, data: bytes, /) -> int:
        self._check()
        with self.clock.lock:
            self._cable.send(self.faults.spoiled(bytes(data), "in"), self.clock.now())
        return len(data)

    def read(self, size: int = 1, /) -> bytes:
        """Receive, or give up after the timeout."""
        with self.clock.lock:
            return self._read(size)

    def _read(self, size: int) -> bytes:
        self._check()
        deadline = self.clock.now() + self.timeout_ns
        self._collect()
        while len(self._received) < size and self.clock.now() < deadline:
            times = (self.machine.ready(), self.machine.due(), self._cable.due())
            ahead = [at for at in times if at is not None and at <= deadline]
            self.clock.sleep_until(min(ahead, default=deadline))
            self._check()
            self._collect()
        taken = bytes(self._received[:size])
        del self._received[:size]
        return taken

    @property
    def in_waiting(self) -> int:
        self._check()
        self._collect()
        return len(self._received)

    def reset_input_buffer(self) -> None:
        self._check()
        self._collect()
        self._received.clear()

    def close(self) -> None:
        """Disconnect the line; the machine keeps its state."""
        self.clock.detach(self._cable)
