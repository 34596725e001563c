"""Ports to emulated machines on a virtual clock."""

from __future__ import annotations

import errno

from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.line import SECOND, Cable, Faults, LineMachine


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
        with self.clock.lock:
            self._received += self.faults.to_host(self.machine.take(self.clock.now()))

    def write(self, data: bytes, /) -> int:
        """Send."""
        self._check()
        with self.clock.lock:
            self._cable.send(self.faults.to_machine(bytes(data)), self.clock.now())
        return len(data)

    def read(self, size: int = 1, /) -> bytes:
        """Receive, or give up when the timeout is over."""
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
