"""Plays a schedule on mirrors that a stage triggers: its output fires at every pose, without the host.

Mirrors count frames, the stage's position counts triggers, and both must agree; a vial's pose 0 is at its zero.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import ceil, floor
from typing import Any

from vamgpu.hosts.drivers.cleanup import all_of
from vamgpu.hosts.frames.sources import FrameSource
from vamgpu.hosts.player.machines import StageMachines, gate
from vamgpu.hosts.player.mirrors import PRIMING, MirrorPlayer
from vamgpu.hosts.player.motor import POLL, SpeedMonitor
from vamgpu.hosts.player.player import Renew, StatusPoll
from vamgpu.hosts.safety.interlock import InterlockOpen
from vamgpu.hosts.safety.light import Lamp
from vamgpu.hosts.schedules.clock import TimedQuery
from vamgpu.hosts.schedules.schedule import Schedule
from vamgpu.hosts.schedules.timing import SECOND

LEAD = 0.25  # time before that slot at which it must have its speed [s]
EVEN = 0.05  # greatest error of that speed, over a status poll [poses]
STEP = 1.0  # allowed error of a stage's reported position [microsteps]


class StageClockedPlayer(MirrorPlayer[StageMachines]):
    """Plays a schedule on mirrors that a stage's output triggers; a pose has whole microsteps."""

    def __init__(
        self, schedule: Schedule, machines: StageMachines, sources: Sequence[FrameSource], **options: Any
    ) -> None:
        self._stage = machines.stage
        super().__init__(schedule, machines, sources, **options)
        self._pose = float(schedule.advance)
        self._zero = 0.0 if schedule.unit == "deg" else None
        self._fired_at = self._turned = 0.0
        self._ended: int | None = None

    def _gate(self) -> tuple[Lamp, Renew]:
        return gate(self.machines.controller, self.machines.lamp, range(self.schedule.engines), self.schedule.power[0])

    def prime(self, first: int, alive: Callable[[], None]) -> int:
        """Fill the mirrors, arm the output at rest, and bring the motion to its speed ahead of the slot."""
        self._first = self._kept = first
        self._ended = None
        self._rest(alive)
        self._preroll = self._ahead(first)
        self._fill(first, alive)
        self._ask = TimedQuery(self.clock, self._stage.position, float(self.schedule.cadence.period) / 8)
        self._motion = SpeedMonitor(self.schedule)
        self._fired_at = self._stage.position() - 0.5 * self._pose  # the first edge comes after half a distance
        self._turned = self._fired_at + (self._preroll + 1 - first) * self._pose  # of a vial, in whole turns
        self._stage.trigger_every(self._pose)
        self._stage.run(float(self.schedule.speed))
        return self._at_speed(alive)

    def _rest(self, alive: Callable[[], None]) -> None:
        """Stop half a pose before one: a vial at the next such position, a web back with room for its run-up."""
        self._stage.trigger_every(0.0)
        self._stage.run(0.0)
        self._stage.wait()
        alive()
        here, speed = self._stage.position(), float(self.schedule.speed)
        if self.schedule.unit == "deg":
            goal = (ceil(here / self._pose - 0.5 - 1e-6) + 0.5) * self._pose
        else:
            self._zero = here if self._zero is None else self._zero
            goal = self._zero + (self._first - self._run_up() + 0.5) * self._pose
        if abs(goal - here) > 1e-9:
            self._stage.move(goal, speed)
            self._stage.wait()
            alive()

    def _run_up(self) -> int:
        """Poses until the motion surely has its speed."""
        return ceil(self.machines.run_up * float(self.schedule.speed) / self._pose) + 1

    def _ahead(self, first: int) -> int:
        """Black frames until a slot, for triggers of earlier poses."""
        if self.schedule.unit != "deg":
            return self._run_up() - 1
        run_up, turn = self._run_up(), round(360.0 / self._pose)
        resting = floor(self._stage.position() / self._pose)
        return run_up + (first - resting - 1 - run_up) % turn

    def _at_speed(self, alive: Callable[[], None]) -> int:
        """Wait until the slot is near. Returns the time to its light [ns]."""
        speed, goal = float(self.schedule.speed), self._fired_at + (self._preroll + 1) * self._pose
        end = self.clock.now() + round((goal - self._fired_at) / speed * SECOND) + PRIMING // 12
        while True:
            self.wait()
            alive()
            for queue in self._queues:
                queue.prime()
            now, here = self._ask()
            error = self._motion.error(now, here)
            if goal - here <= LEAD * speed + 2 * POLL * speed / SECOND:
                break
            if now > end:
                raise InterlockOpen(
                    f"the stage does not turn at {speed:.4g} {self.schedule.unit}/s; check motor and load"
                )
            self._motion = SpeedMonitor(self.schedule) if abs(error) > EVEN else self._motion
        low, high = self._triggers(here)
        shown = self._counted()
        if abs(error) > EVEN or not all(low <= each <= high + 1 for each in shown):
            raise InterlockOpen(
                f"the stage is {error:+.2g} angles off its speed and fired {low} triggers, of which the mirrors "
                f"counted {', '.join(map(str, shown))}; check motor, load and the trigger's wire"
            )
        return round((goal - here) / speed * SECOND)

    def facts(self) -> dict[str, Any]:
        """Position of pose 0 on the stage."""
        return {"origin": self._zero}

    def start(self) -> None:
        """Nothing to start: frames already follow the stage."""
        self._polled = self.clock.now()

    def _triggers(self, position: float) -> tuple[int, int]:
        """Least and greatest number of triggers that the stage has fired at a position."""
        whole = self.machines.microsteps * self._pose
        fired = (position - self._fired_at) * self.machines.microsteps / whole
        low, high = (floor(fired + sign * STEP / whole) for sign in (-1, 1))
        return max(0, min(low, self._total)), max(0, min(high, self._total))

    @property
    def _total(self) -> int:
        """Triggers of this run segment."""
        return self._preroll + len(self.schedule) - self._first if self._ended is None else self._ended

    def poll(self) -> StatusPoll:
        """Compare the stage's position with the mirrors' count."""
        before = self._counted()
        now, here = self._ask()
        after = self._counted()
        low, high = self._triggers(here)
        counted = min(high, *before)  # halted mirrors count all their frames
        agreed = all(one <= high and low <= two for one, two in zip(before, after, strict=True))
        scheduled = max(low, min(high, counted)) if agreed else low
        error, frames = self._motion.error(now, here), self._since(counted)
        self._polled, closed = now, self._closed()
        if agreed and closed is None:
            self._punctual = self._kept
        return StatusPoll(
            not self._over(here, counted), error, scheduled if agreed else counted, scheduled, frames,
            here - self._turned, *self._supply(), closed,
        )  # fmt: skip

    def _over(self, here: float, counted: int) -> bool:
        """Whether the light of the last frame is over: the mirrors are then dark, because none is queued."""
        total = self._total
        lit = float(self.schedule.speed) * float(self.schedule.on[0]) / SECOND
        return counted >= total and here - self._fired_at >= total * self._pose + lit

    def _closed(self) -> str | None:
        """Why the controller switched the light off."""
        if self.machines.controller is None:
            return None
        status = self.machines.controller.status()
        return None if status.light else f"the controller switched the light off: {status.fault}"

    def finish(self) -> None:
        """Stop triggers after the present frame, so that none is cut."""
        self._stage.trigger_every(0.0)
        self._ended = min(self._counted())

    def _triggered(self) -> int:
        """Frames of this run segment that the stage may have triggered."""
        return self._triggers(self._stage.position())[1]

    def halt(self) -> None:
        """Stop triggers and the stage, turn the mirrors dark; each even if the one before fails."""
        all_of(lambda: self._stage.trigger_every(0.0), self._stage.stop, self._close, self._stage.wait)
