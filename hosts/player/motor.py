"""Motion of a controller's own motor: run-up to its speed ahead of a slot, and monitoring from then on."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

from vamgpu.errors import BadInput
from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.drivers.controller_protocol import FASTEST, NUMBERS
from vamgpu.hosts.player.rows import RowTable
from vamgpu.hosts.safety.interlock import InterlockOpen
from vamgpu.hosts.schedules.clock import Clock
from vamgpu.hosts.schedules.schedule import Schedule
from vamgpu.hosts.schedules.timing import SECOND, fraction, whole

log: logging.Logger = logging.getLogger(__name__)
MILLI = 1_000_000
POLL = 20 * MILLI  # between two polls of the machines [ns]
PATIENCE = 3.0  # longest wait for the speed, in run-up times
AHEAD = 0.2  # time before its first row at which a motion must have its speed [s]
RUN_UPS = 4  # number of tries with longer run-ups
WINDOW = 1_000_000_000  # time over which the speed is measured [ns]


def own_number(clock: Clock, other: int) -> int:
    """A random number for a controller's zero or play, other than its present one."""
    number = clock.now() // MILLI % (NUMBERS - 1) + 1
    return number if number != other else number % (NUMBERS - 1) + 1


@dataclass(frozen=True)
class Origin:
    """Position of a print's pose 0 on the motor."""

    at: float  # distance in the schedule's unit from the controller's position 0
    zero: int  # its number in the controller

    def __post_init__(self) -> None:
        object.__setattr__(self, "at", float(fraction("origin", self.at)))
        if (number := whole("number of the zero", self.zero)) >= NUMBERS:
            raise BadInput(f"the number of a zero is {number}; expected 1 to {NUMBERS - 1}")
        object.__setattr__(self, "zero", number)


class SpeedMonitor:
    """A motion's error in poses over the last second. microsteps: microsteps per unit of the schedule's positions."""

    def __init__(self, schedule: Schedule, microsteps: float = 1.0) -> None:
        self._per_pose = float(schedule.advance) * microsteps
        self._period = float(schedule.cadence.period)
        self.restart()

    def restart(self) -> None:
        self._seen: deque[tuple[int, float]] = deque()
        self.last: float = 0.0
        self.span: int = 0

    def error(self, now: int, position: float) -> float:
        """The error [poses] at a position, kept in ``last``, with its measuring time [ns] in ``span``."""
        self._seen.append((now, position))
        while now - self._seen[0][0] > WINDOW:
            self._seen.popleft()
        began, start = self._seen[0]
        self.span, self.last = now - began, (position - start) / self._per_pose - (now - began) / self._period
        return self.last


class Approach:
    """Brings a motor to its speed `AHEAD` seconds before a slot's row; a vial never turns back and stirs its resin."""

    def __init__(self, schedule: Schedule, controller: Controller, clock: Clock, microsteps: float) -> None:
        self._schedule, self._controller, self._clock = schedule, controller, clock
        self._microsteps, self._speed = microsteps, float(schedule.speed)
        self._per_mm = controller.microsteps_per_mm / microsteps
        self._run_up = 4 * float(schedule.advance) + 1.6 * self._speed
        self.lost: float | None = None

    def fresh(self, time: int, alive: Callable[[], None]) -> Origin:
        """Set a zero with room for a run-up to a time [ns]; pose 0 of a vial is at the index mark if there is one."""
        zero = own_number(self._clock, self._controller.status().zero)
        if self._controller.index is None:
            self._controller.zero(zero)
        else:
            self._mark(zero, alive)
            if self._schedule.unit == "deg":
                return Origin(0.0, zero)
        return Origin(self._run_up + 1 / self._microsteps - float(self._schedule.position_at(time)), zero)

    def again(self, time: int, origin: Origin, alive: Callable[[], None]) -> Origin:
        """Position of a resumed print's pose 0 by the index mark; ``lost`` is the error of the mark."""
        if (index := self._controller.index) is None:
            return origin
        distance = index.distance * self._controller.microsteps_per_mm / self._microsteps
        if self._schedule.unit == "mm":  # rows count from the mark, which must come first
            self._back(time, origin.at, self._run_up + distance, alive)
        zero = own_number(self._clock, self._controller.status().zero)
        mark = self._mark(zero, alive) / self._microsteps
        passed = distance * round(mark / distance)
        self.lost = mark - passed
        if abs(self.lost) > index.tolerance + self._speed * POLL / 5 / SECOND:
            log.warning("the motor was %.3g %s off its index mark; its position is corrected by the mark",
                        self.lost, self._schedule.unit)  # fmt: skip
        return Origin(origin.at - passed, zero)

    def _mark(self, zero: int, alive: Callable[[], None]) -> int:
        """Run to the index mark and set 0 there; returns its earlier position [microsteps]."""
        controller, index = self._controller, self._controller.index
        assert index is not None
        way = PATIENCE * (index.distance * controller.microsteps_per_mm / self._microsteps + self._run_up)
        end = self._clock.now() + round(way / self._speed * SECOND)
        mark = controller.status().position
        controller.home(zero, self._speed / self._per_mm)
        while (status := controller.status()).homing:
            mark = status.position
            if self._clock.now() > end:
                raise InterlockOpen(
                    f"no index mark in {way:.4g} {self._schedule.unit} of motion; check motor, mark and its sensor, or "
                    "correct distance in [[feedback]]"
                )
            self._pause(POLL // 10, alive)
        return mark

    def to(self, time: int, origin: Origin, alive: Callable[[], None]) -> Origin:
        """Reach the speed before a time [ns]; returns the position of pose 0. Raises `InterlockOpen`."""
        run_up = self._run_up
        for _ in range(RUN_UPS):
            origin = replace(origin, at=self._back(time, origin.at, run_up, alive))
            self._controller.move(self._speed / self._per_mm)
            self._at_speed(run_up, alive)
            if self.ahead(time, origin.at) >= AHEAD:
                return origin
            run_up *= 2
        raise InterlockOpen(
            f"the motion reached its speed of {self._speed:.4g} {self._schedule.unit}/s too late, after a run-up of "
            f"{run_up / 2:.4g} {self._schedule.unit}: let the controller ramp faster"
        )

    def _row(self, time: int, origin: float) -> int:
        return RowTable(self._schedule, self._microsteps, origin).at(time)

    def ahead(self, time: int, origin: float) -> float:
        """Time until a time of the schedule, at the speed [s]."""
        return self._before(time, origin) / self._speed

    def _before(self, time: int, origin: float) -> float:
        """Distance to a time of the schedule, in its unit."""
        return (self._row(time, origin) - self._controller.status().position) / self._microsteps

    def _back(self, time: int, origin: float, run_up: float, alive: Callable[[], None]) -> float:
        """Stop with room for a run-up."""
        if self._schedule.unit == "deg":
            short = run_up - self._before(time, origin)
            return origin + 360.0 * max(0, -int(-short // 360))
        while self._before(time, origin) < run_up:
            fastest = FASTEST / self._microsteps
            self._controller.move(-min(max(self._speed, 1e-3) * 4, fastest) / self._per_mm)
            self._pause(POLL, alive)
        self._controller.move(0.0)
        return origin

    def _at_speed(self, run_up: float, alive: Callable[[], None]) -> None:
        goal, most = round(self._speed * self._microsteps * 1000), PATIENCE * run_up / self._speed
        end = self._clock.now() + round(most * SECOND)
        while abs(self._controller.status().speed - goal) > 1 + 1e-3 * abs(goal):
            if self._clock.now() > end:
                raise InterlockOpen(
                    f"the motion did not reach {self._speed:.4g} {self._schedule.unit}/s in {most:.3g} s; check motor "
                    "and load"
                )
            self._pause(POLL // 10, alive)

    def _pause(self, pause: int, alive: Callable[[], None]) -> None:
        self._clock.sleep_until(self._clock.now() + pause)
        alive()
