"""Lines to emulated machines: a cable that takes time, faults on it, and ports that drivers can open.

A machine on a line takes bytes with ``receive`` and gives bytes with ``take``. It is reached in three ways: ``plug``
makes a port on a virtual clock, ``PtyServer`` a pseudo terminal and ``TcpServer`` a socket, both in real time.
"""

from __future__ import annotations

import errno
import logging
import os
import select
import socket
import threading
import time
from collections import deque
from dataclasses import dataclass, field
from typing import Protocol, Self

from vamgpu.hosts.emulators.clock import VirtualClock

log = logging.getLogger(__name__)
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


class VirtualPort:
    """A port on a virtual clock: reading waits in virtual time."""

    def __init__(self, machine: LineMachine, clock: VirtualClock, timeout_s: float, baud: int, faults: Faults) -> None:
        self.machine, self.clock, self.faults = machine, clock, faults
        self.timeout_ns = round(timeout_s * SECOND)
        self._cable = Cable(machine, baud)
        self._received = bytearray()
        self._unplugged = False
        clock.attach(machine)
        clock.attach(self._cable)

    def unplug(self) -> None:
        """From now on every use fails as when a plug is pulled."""
        self._unplugged = True

    def _check(self) -> None:
        if self._unplugged:
            raise OSError(errno.EIO, "device disconnected")

    def _collect(self) -> None:
        self._received += self.faults.to_host(self.machine.take(self.clock.now()))

    def write(self, data: bytes, /) -> int:
        """Send."""
        self._check()
        self._cable.send(self.faults.to_machine(bytes(data)), self.clock.now())
        return len(data)

    def read(self, size: int = 1, /) -> bytes:
        """Receive, or give up when the timeout is over."""
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
        """How many bytes have come in."""
        self._check()
        self._collect()
        return len(self._received)

    def reset_input_buffer(self) -> None:
        """Forget what has come in."""
        self._check()
        self._collect()
        self._received.clear()

    def close(self) -> None:
        """Pull the line out; the machine stays as it is."""
        self.clock.detach(self._cable)


def plug(
    machine: LineMachine,
    clock: VirtualClock,
    timeout_s: float = 0.25,
    baud: int = 0,
    faults: Faults | None = None,
) -> VirtualPort:
    """A port to a machine on a virtual clock; ``baud`` 0 means that sending takes no time."""
    return VirtualPort(machine, clock, timeout_s, baud, faults or Faults())


class _Server:
    """A thread that carries bytes between a file descriptor and a machine, in real time."""

    def __init__(self, machine: LineMachine, faults: Faults | None = None) -> None:
        self.machine = machine
        self.faults = faults or Faults()
        self.lock = threading.RLock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def _read(self) -> bytes:
        raise NotImplementedError

    def _write(self, data: bytes) -> None:
        raise NotImplementedError

    def _descriptors(self) -> list[int]:
        raise NotImplementedError

    def step(self, longest_s: float) -> None:
        """Wait for bytes or for the machine, and act."""
        with self.lock:
            times = [at for at in (self.machine.due(), self.machine.ready()) if at is not None]
        wait = min([longest_s, *(max(at - time.monotonic_ns(), 0) / SECOND for at in times)])
        readable = select.select(self._descriptors(), [], [], wait)[0]
        with self.lock:
            now = time.monotonic_ns()
            self.machine.advance(now)
            if readable and (data := self._read()):
                self.machine.receive(self.faults.to_machine(data), now)
            out = self.faults.to_host(self.machine.take(time.monotonic_ns()))
        if out:
            self._write(out)

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                self.step(0.02)
            except OSError as error:
                if not self._stop.is_set():
                    log.warning("emulated line: %s", error)
                break

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop serving."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(2.0)


class PtyServer(_Server):
    """A machine on a pseudo terminal; ``url`` is what a driver opens."""

    def __init__(self, machine: LineMachine, faults: Faults | None = None) -> None:
        super().__init__(machine, faults)
        import tty

        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.url = os.ttyname(self._slave)

    def _descriptors(self) -> list[int]:
        return [self._master]

    def _read(self) -> bytes:
        return os.read(self._master, 4096)

    def _write(self, data: bytes) -> None:
        try:
            os.write(self._master, data)
        except BlockingIOError:
            log.warning("nobody reads %s: %d bytes lost", self.url, len(data))

    def close(self) -> None:
        """Stop serving, and hang up."""
        super().close()
        for descriptor in (self._master, self._slave):
            if descriptor >= 0:
                os.close(descriptor)
        self._master = self._slave = -1


class TcpServer(_Server):
    """A machine on a socket of this computer; ``url`` is what a driver opens. One caller at a time."""

    def __init__(self, machine: LineMachine, faults: Faults | None = None) -> None:
        super().__init__(machine, faults)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._caller: socket.socket | None = None
        self.url = f"socket://127.0.0.1:{self._listener.getsockname()[1]}"

    def _descriptors(self) -> list[int]:
        return [(self._caller or self._listener).fileno()]

    def _read(self) -> bytes:
        if self._caller is None:
            self._caller = self._listener.accept()[0]
            self._caller.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            return b""
        try:
            data = self._caller.recv(4096)
        except ConnectionError:
            data = b""
        if not data:
            self._caller.close()
            self._caller = None
        return data

    def _write(self, data: bytes) -> None:
        if self._caller is not None:
            try:
                self._caller.sendall(data)
            except ConnectionError:
                self._caller.close()
                self._caller = None

    def close(self) -> None:
        """Stop serving, and hang up."""
        super().close()
        if self._caller is not None:
            self._caller.close()
        self._listener.close()
