"""Lines to emulated machines: a cable that takes time, and faults on it.

A machine on a line takes bytes with ``receive`` and gives bytes with ``take``. It is reached in three ways:
``ports.plug`` makes a port on a virtual clock, ``servers.PtyServer`` a pseudo terminal and ``servers.TcpServer`` a
socket, both in real time.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Protocol

SECOND = 1_000_000_000


class LineMachine(Protocol):
    """An emulated machine on a line; times in ns."""

    def receive(self, data: bytes, now: int) -> None:
        """Take bytes that have arrived."""
        ...

    def take(self, now: int) -> bytes:
        """Give the bytes that have left by now."""
        ...

    def ready(self) -> int | None:
        """When the next bytes will have left; None while there are none."""
        ...

    def due(self) -> int | None:
        """When the machine acts by itself next."""
        ...

    def advance(self, now: int) -> None:
        """Carry the state to ``now``."""
        ...


class Outbox:
    """Bytes on their way out, each with the time when it has left."""

    def __init__(self, byte_ns: int = 0, latency_ns: int = 0) -> None:
        self.byte_ns, self.latency_ns = byte_ns, latency_ns
        self._bytes: deque[tuple[int, int]] = deque()
        self._last = 0

    def put(self, data: bytes, now: int) -> None:
        """Queue bytes behind those that are still leaving."""
        start = max(now + self.latency_ns, self._last)
        for number, byte in enumerate(data, 1):
            self._last = start + number * self.byte_ns
            self._bytes.append((self._last, byte))

    def take(self, now: int) -> bytes:
        """The bytes that have left."""
        taken = bytearray()
        while self._bytes and self._bytes[0][0] <= now:
            taken.append(self._bytes.popleft()[1])
        return bytes(taken)

    def ready(self) -> int | None:
        """When the next byte will have left."""
        return self._bytes[0][0] if self._bytes else None


@dataclass
class Faults:
    """What goes wrong on a line: bytes dropped or with a bit flipped, by their number since the start; or all dead."""

    drop_in: frozenset[int] = frozenset()
    flip_in: frozenset[int] = frozenset()
    drop_out: frozenset[int] = frozenset()
    flip_out: frozenset[int] = frozenset()
    dead: bool = False
    _count: dict[str, int] = field(default_factory=lambda: {"in": 0, "out": 0})

    def to_machine(self, data: bytes) -> bytes:
        """What arrives of what the host sent."""
        return self._spoil(data, "in", self.drop_in, self.flip_in)

    def to_host(self, data: bytes) -> bytes:
        """What arrives of what the machine sent."""
        return self._spoil(data, "out", self.drop_out, self.flip_out)

    def _spoil(self, data: bytes, way: str, drop: frozenset[int], flip: frozenset[int]) -> bytes:
        first = self._count[way]
        self._count[way] += len(data)
        if self.dead:
            return b""
        kept = [(byte ^ 1 if first + i in flip else byte) for i, byte in enumerate(data) if first + i not in drop]
        return bytes(kept)


class Cable:
    """One way of a line: bytes arrive at a machine after the time they take."""

    def __init__(self, machine: LineMachine, baud: int = 0) -> None:
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
        """Deliver what has arrived, each byte at its time."""
        while (at := self._flight.ready()) is not None and at <= now:
            self.machine.receive(self._flight.take(at), at)
