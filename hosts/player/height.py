"""Height of a part that moves during its print: the stage that lifts its vial, and whether its frames follow it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from vamgpu.errors import BadInput, WrongDevice
from vamgpu.hosts.drivers.cleanup import all_of
from vamgpu.hosts.player.machines import Machines, VideoMachines, reaches
from vamgpu.hosts.player.motor import POLL
from vamgpu.hosts.player.player import Player, StatusPoll
from vamgpu.hosts.schedules.timing import SECOND
from vamgpu.travel import Travel

LEAD = SECOND // 10  # time before the first light at which a lift starts [ns]
LEAST = 2.0  # slowest way to the start and back [mm/s]
NEAR = 0.5  # rows by which a part may be away from its frames


class MovingPlayer:
    """A player that raises the vial, in steps of rows [mm], and compares the height of the part with its frames'."""

    def __init__(self, player: Player, machines: Machines, travel: Travel, row: float) -> None:
        self._player, schedule = player, player.schedule
        self._clock, self._lift, self._near = machines.clock, machines.lift if travel.rows else None, NEAR * row
        self._begin, self._turning = schedule.position, float(schedule.speed)  # of slots [deg]; [deg/s]
        self._at = schedule.position + 0.5 * float(schedule.advance)  # their middles
        self._up = np.broadcast_to(travel.up, (schedule.turns, len(schedule) // schedule.turns)).ravel()
        self._rise = float((self._up[-1] - self._up[0]) / (np.ptp(self._at) or 1.0))  # [mm/deg]
        self._first = self._light = 0  # the first slot, and its time [ns]
        self._runs, self._origin = False, 0.0
        self._sleeps = not isinstance(machines, VideoMachines)  # whether a poll is waited for
        if travel.rows and self._lift is None:
            raise WrongDevice("the plan raises its vial, but no lift was opened; open the rig of the plan")
        if self._lift is not None:
            if np.abs(self._up - self._up[0] - self._rise * (self._at - self._at[0])).max() > 0.1 * self._near:
                raise BadInput("the part rises unevenly; expected a steady rise, because a lift keeps its speed: use "
                               "Travel.helix")  # fmt: skip
            self._origin, ends = self._lift.position(), sorted((self._start(0), float(self._up[-1])))
            reaches(self._lift, self._origin + ends[0], self._origin + ends[1], "the vial", "lift")

    def __getattr__(self, name: str) -> Any:
        return getattr(self._player, name)

    def prime(self, first: int, alive: Callable[[], None]) -> int:
        """Put the lift where it reaches the height of the slot in time, and prime the player."""
        self._first, self._runs = first, False
        self._go(self._start(first))
        alive()
        ahead = self._player.prime(first, alive)
        self._light = self._clock.now() + ahead
        return ahead

    def _start(self, first: int) -> float:
        """Height from which the lift reaches that of a slot in time [mm]."""
        return float(self._up[0] + self._rise * (self._begin[first] - self._at[0] - self._turning * LEAD / SECOND))

    def wait(self) -> None:
        """Start the lift when it is due: at once within half a poll where the player itself does not sleep."""
        due, early = self._light - LEAD, POLL if self._sleeps else POLL // 2
        if self._lift is not None and not self._runs and self._clock.now() >= due - early:
            if self._sleeps:
                self._clock.sleep_until(due)
            self._lift.run(self._rise * self._turning)
            self._runs = True
        self._player.wait()

    def poll(self) -> StatusPoll:
        """Compare the heights as well."""
        seen = self._player.poll()
        return replace(seen, fault=self._fault(seen.position)) if seen.running and seen.fault is None else seen

    def _fault(self, position: float) -> str | None:
        """Why the part is not where its frames are, at a position of the vial [deg]."""
        now, begin = self._clock.now(), float(self._begin[self._first])
        if position < begin:
            return None
        if self._lift is None:
            here = float(np.interp(begin + (now - self._light) / SECOND * self._turning, self._at, self._up))
        else:
            here = self._lift.position() - self._origin
        wanted = float(np.interp(position, self._at, self._up))
        if abs(here - wanted) <= self._near:
            return None
        what = "vial" if self._lift is None else "lift"
        return f"the part is at {here:.4g} mm, and its frames follow one at {wanted:.4g} mm: check the {what}"

    def halt(self) -> None:
        """Stop the lift as well."""
        all_of(self._player.halt, *(() if self._lift is None else (self._lift.stop,)))

    def add_repeats(self) -> bool:
        """At the end, return the lift to where it was."""
        self._go(0.0)
        return self._player.add_repeats()

    def _go(self, height: float) -> None:
        if self._lift is not None:
            self._lift.run(0.0)
            self._lift.wait()
            self._lift.move(self._origin + height, max(LEAST, 4.0 * abs(self._rise) * self._turning))
            self._lift.wait()
