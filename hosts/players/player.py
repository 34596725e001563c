"""What plays a schedule on machines, whatever they are, under a print that holds the light."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from vamgpu.hosts.clock import Clock
from vamgpu.hosts.record import Shown
from vamgpu.hosts.safety.light import Lamp, Switch
from vamgpu.hosts.schedules.schedule import Schedule


@dataclass(frozen=True)
class Look:
    """What the machines did up to a look.

    running: False once the light of the last picture, or of the last that `Player.finish` lets through, is over.
    motion: its error, in poses.  shown, scheduled: pictures that the mirrors showed, and that they should have.
    pictures: those since the last look, slots rising.  position: of the motion, in the schedule's unit, pose 0 at 0.
    fill: of the buffers, 0..1.  margin: how long the pictures at the mirrors last [s].  fault: why a machine cannot be
    trusted; None where all can.
    """

    running: bool
    motion: float
    shown: int
    scheduled: int
    pictures: tuple[Shown, ...]
    position: float
    fill: float
    margin: float
    fault: str | None = None


class Player(Protocol):
    """Machines that play one schedule.

    schedule: may grow at its end, see `amends`.  lamp: the light.  switches: further ways to make it dark, by name.
    """

    clock: Clock

    @property
    def schedule(self) -> Schedule:
        """What is played."""
        ...

    @property
    def lamp(self) -> Lamp:
        """The light."""
        ...

    @property
    def switches(self) -> Mapping[str, Switch]:
        """Further ways to make it dark."""
        ...

    def renew(self, length: int) -> None:
        """Let the controller keep the light for ``length`` [ns] more."""
        ...

    def prime(self, first: int, alive: Callable[[], None]) -> int:
        """In the dark: fill buffers, bring the motion to its speed ahead of a slot; ``alive`` is called meanwhile.

        Returns how long it is from then to the slot's light [ns].
        """
        ...

    def facts(self) -> dict[str, Any]:
        """What a run's folder keeps of a leg, so that another host can go on with it."""
        ...

    def start(self) -> None:
        """Light is allowed: begin."""
        ...

    def look(self) -> Look:
        """See what the machines did."""
        ...

    def feed(self) -> None:
        """After a look: hand pictures on to the machines. Raises `Underrun`."""
        ...

    def wait(self) -> None:
        """Return when the next look is due."""
        ...

    def finish(self) -> None:
        """End after the picture that is on its way."""
        ...

    def halt(self) -> None:
        """Bring all to rest, come what may; raises the first failure afterwards."""
        ...

    def amends(self) -> bool:
        """At the end: whether slots were added for pictures that were missed. Raises `Underrun` for too many."""
        ...

    def picture(self, number: int) -> np.ndarray:
        """A frame for people, uint8 [row, column]."""
        ...
