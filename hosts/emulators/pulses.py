"""A stepper behind an output of pulses, whose clock is off, with an index that passes once a turn."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, floor

from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.schedules.timing import SECOND


@dataclass(eq=False)
class EmulatedStepper:
    """A pulse output and its motor, which stands once it is stalled."""

    clock: VirtualClock
    turn: float  # pulses
    off: float = 0.0  # how much quicker its clock is than the host's [ppm]

    def __post_init__(self) -> None:
        self.stalled: bool = False
        self._pieces: list[tuple[int, float, float]] = [(0, 0.0, 0.0)]
        self._asked = 0

    def position(self, now: int) -> float:
        """Where the motor truly was at a time [pulses]."""
        at, place, speed = next(piece for piece in reversed(self._pieces) if piece[0] <= now)
        return place + speed * (now - at) / SECOND

    def rate(self, hz: float) -> float:
        now = self.clock.now()
        true = 0.0 if self.stalled else hz * (1 + 1e-6 * self.off)
        self._pieces.append((now, self.position(now), true))
        return hz

    def stall(self) -> None:
        """The motor stands, and pulses go on."""
        self.rate(0.0)
        self.stalled = True

    def edges(self) -> tuple[int, ...]:
        """When the index passed since it was asked last [ns]."""
        found, now = [], self.clock.now()
        for piece, (at, place, speed) in enumerate(self._pieces):
            end = self._pieces[piece + 1][0] if piece + 1 < len(self._pieces) else now
            last = place + speed * (end - at) / SECOND
            marks = range(ceil(place / self.turn), floor(last / self.turn) + 1) if speed else ()
            found += [at + round((mark * self.turn - place) / speed * SECOND) for mark in marks]
        asked, self._asked = self._asked, now
        return tuple(at for at in dict.fromkeys(found) if asked < at <= now)

    def close(self) -> None:
        """No pulses."""
        self.rate(0.0)
