"""Carry out a print: prime, light, watch, feed, record; and whatever happens, dark first."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from vamgpu.errors import BadInput, DeviceError, VamError
from vamgpu.hosts.board import Board
from vamgpu.hosts.clock import Clock, RealClock
from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.drivers.dmd import Dmd, PlaneStream, SlotTiming
from vamgpu.hosts.drivers.lens import TunableLens
from vamgpu.hosts.interlock import Budget, InterlockOpen
from vamgpu.hosts.lamp import ControllerLamp, Renewal
from vamgpu.hosts.lease import DEFAULT_LENGTH, Lease
from vamgpu.hosts.light import LightGuard
from vamgpu.hosts.record import RunFolder, Shown
from vamgpu.hosts.rows import Rows
from vamgpu.hosts.schedule import Schedule
from vamgpu.hosts.state import State, States
from vamgpu.hosts.stream import Pictures
from vamgpu.hosts.supply import Dark, Motion, Supply
from vamgpu.hosts.underrun import WebUnderrun

log = logging.getLogger(__name__)
SECOND = 1_000_000_000
LOOK = 20_000_000
"""Between two looks at the machines [ns]."""
TRIES = 200
"""Looks for the motion to come to its speed, or to rest."""
PRIMING = 60 * SECOND
"""Longest wait for mirrors and buffers to be full before the light opens [ns]."""


@dataclass
class Machines:
    """The machines of a rig, opened. microsteps: of the motion, in a unit of the schedule's positions."""

    clock: Clock
    controller: Controller
    mirrors: Sequence[Dmd]
    microsteps: float
    lens: TunableLens | None = None


@dataclass(frozen=True)
class Limits:
    """What holds the light of a print. lease: [ns].  tolerance: of motion, in poses.  budget: light over the plan's."""

    lease: int = DEFAULT_LENGTH
    tolerance: float = 0.5
    budget: float = 1.01
    resume: int = 30 * SECOND


class Print:
    """One print on one rig.

    schedule: see `vamgpu.hosts.schedule`.  pictures: of each projector.  folder: keeps what happens.  depth: pictures
    in each of the two sequences of the mirrors; by default a second's.  policy: of each projector, decides on pictures
    that are late. Raises `BadInput`.
    """

    def __init__(
        self,
        schedule: Schedule,
        machines: Machines,
        pictures: Sequence[Pictures],
        folder: RunFolder,
        *,
        limits: Limits = Limits(),
        board: Board | None = None,
        depth: int | None = None,
        power: float = 1.0,
        policy: Callable[[], WebUnderrun] = WebUnderrun,
    ) -> None:
        if len(pictures) != schedule.engines or len(machines.mirrors) != schedule.engines:
            raise BadInput(
                f"the schedule is for {schedule.engines} projectors, the rig has {len(machines.mirrors)} and pictures "
                f"are for {len(pictures)}; choose the rig that the job was made for"
            )
        if len(set(schedule.on.tolist())) != 1:
            raise BadInput("pictures differ in how long they are lit; the mirrors take one time for all")
        self.schedule, self.machines, self.pictures, self.folder, self.power = (
            schedule, machines, tuple(pictures), folder, power,
        )  # fmt: skip
        self.limits, self.board, self.states = limits, board or Board(), States()
        self.depth = depth or max(2, round(schedule.rate))
        self.lease = Lease(machines.clock, Renewal(machines.controller), limits.lease)
        lamp = ControllerLamp(machines.controller, tuple(range(schedule.engines)))
        total = float(schedule.on.sum()) * 1e-9 * power
        self.guard = LightGuard(
            lamp, self.lease, tolerance=limits.tolerance, budget=Budget(total * limits.budget),
            others={f"mirrors {number}": Dark(dmd) for number, dmd in enumerate(machines.mirrors)}, told=self._told,
        )  # fmt: skip
        self.policies = tuple(policy() for _ in pictures)
        self.streams: list[Supply] = []
        self.next = 0
        self.asked: State | None = None
        self.paused_at: int | None = None
        self.states.listen(folder.state)
        self.states.listen(lambda change: self.board.show(state=change.after, message=change.message))
        self.board.on_stop(self.stop)
        self.board.show(slots=len(schedule), unit=schedule.unit)

    # ---- from any thread -------------------------------------------------------------------------------------
    def stop(self, why: str = "emergency stop") -> None:
        """Light off now; the print is cancelled when its thread looks."""
        self.guard.fail(why)
        self.asked = State.CANCELLED

    def pause(self) -> None:
        """Dark, and the motion at rest, until `run` is called again."""
        self.asked = State.PAUSED

    # ---- the printing thread ---------------------------------------------------------------------------------
    def run(self, first: int | None = None) -> State:
        """Print from a slot on (by default where it paused) until it is complete, paused, cancelled or failed.

        Raises what went wrong, after it is dark and written down.
        """
        try:
            self._may_resume()
            self.next = self.next if first is None else first
            with self.guard:
                self._leg()
        except BaseException as error:
            self._ended(error)
            if isinstance(error, InterlockOpen) and self.states.state is State.CANCELLED:
                return State.CANCELLED
            raise
        return self.states.state

    def _may_resume(self) -> None:
        if self.paused_at is None:
            return
        rest = self.machines.clock.now() - self.paused_at
        if rest > self.limits.resume:
            raise BadInput(
                f"the print rested {rest / SECOND:.1f} s; after {self.limits.resume / SECOND:g} s resin has forgotten "
                "too much of its dose: begin anew with fresh resin"
            )

    def _ended(self, error: BaseException) -> None:
        wanted = self.asked is State.CANCELLED or isinstance(error, KeyboardInterrupt)
        state = State.CANCELLED if wanted else State.ERROR
        stops = (stream.stop for stream in self.streams)
        told = lambda: self._event("ended", error=repr(error))  # noqa: E731
        for act in (self.machines.controller.stop, told, *stops):
            try:
                act()
            except Exception as second:  # the first error is the one to tell
                log.warning("while stopping: %s", second)
        try:
            self.states.end(state, str(error) or type(error).__name__)
        except VamError as second:
            log.error("the state could not be kept: %s", second)

    def _leg(self) -> None:
        """From ``next`` to the end or a pause."""
        leg = self.begin(self.next)
        while leg.step():
            self.machines.clock.sleep_until(self.machines.clock.now() + LOOK)

    def begin(self, first: int) -> Leg:
        """Prime the mirrors, bring the motion to its speed, make light; the guard is held already."""
        machines = self.machines
        streams = self._primed(first)
        rows = self._approach(first)
        self.states.to(State.PRINTING, "" if first == 0 else f"from slot {first}")
        sent = self._rows(rows, first, first, machines.controller.capacity)
        machines.controller.end(len(self.schedule) - first)
        self.guard.look(armed=True, motion=0.0, shown=0, scheduled=0, fault=None)
        self.guard.on(self.power)
        machines.controller.go()
        return Leg(self, first, streams, Motion(self.schedule, machines.microsteps), rows, sent, machines.clock.now())

    def look(self, leg: Leg) -> bool:
        """See what the machines did, keep it, feed them; whether the light's last row is still to end."""
        clock, controller = self.machines.clock, self.machines.controller
        before = [stream.shown() for stream in leg.streams]
        status = controller.status()
        after = [stream.shown() for stream in leg.streams]
        if status.state == "fault":
            self.guard.look(fault=f"the controller closed the light: {status.fault}")
        shown = next((each for low, each in zip(before, after, strict=True) if not low <= status.shown <= each), None)
        error = leg.motion.error(clock.now(), status.position)
        self.guard.look(motion=error, shown=status.shown if shown is None else shown, scheduled=status.shown)
        kept = self.next
        self._keep(leg, status.shown, status.late)
        if self.next == kept:  # a look that writes nothing would not see a full disk
            self._event("look", shown=status.shown)
        leg.looked = clock.now()
        for stream in leg.streams:
            stream.fill()
        leg.sent = self._rows(leg.rows, leg.first, leg.sent, status.free)
        self.lease.beat()
        self.lease.keep()
        self._show(status.position, leg.streams)
        return status.state == "running"

    def complete(self, leg: Leg) -> None:
        """Dark, at rest, and everything was shown. Raises `InterlockOpen` where it was not."""
        self.guard.off("complete")
        if self.next < len(self.schedule):
            raise InterlockOpen(f"the controller stopped after {self.next} of {len(self.schedule)} pictures")
        self.machines.controller.stop()
        for stream in leg.streams:
            stream.close()
        self.states.to(State.COMPLETE)

    def _keep(self, leg: Leg, shown: int, late: int) -> None:
        """Write down the pictures shown since the last look.

        How late one was, is told as at most: from the last look before its trigger to when it was at the mirrors.
        """
        first, table = leg.first, self.schedule
        for slot in range(self.next, min(first + shown, len(table))):
            on = int(table.on[slot])
            for engine, stream in enumerate(leg.streams):
                behind = stream.arrived(slot) - leg.looked
                self.folder.shown(
                    Shown(slot, int(table.frame[slot]), int(table.pose[slot]), int(table.light[slot]), on,
                          late=behind, engine=engine, dark=slot - first < late or stream.black(slot))
                )  # fmt: skip
            self.next = slot + 1
            self.guard.spend(self.power, on)

    def _rows(self, rows: Rows, first: int, sent: int, free: int) -> int:
        stop = min(sent + free, len(self.schedule))
        for slot in range(sent, stop):
            self.machines.controller.row(rows.row(slot, slot - first))
        return max(sent, stop)

    def _primed(self, first: int) -> list[Supply]:
        """Mirrors with both their sequences full, and buffers with the pictures after those."""
        machines, on = self.machines, int(self.schedule.on[0]) // 1000
        threaded, self.streams = isinstance(machines.clock, RealClock), []
        for dmd, pictures, policy in zip(machines.mirrors, self.pictures, self.policies, strict=True):
            dmd.halt()
            dmd.slave()
            stream = PlaneStream(dmd, self.depth, pictures.bits, SlotTiming(on, on))
            self.streams.append(
                Supply(stream, pictures, self.schedule, machines.clock, first, policy=policy, threaded=threaded)
            )
        end = machines.clock.now() + PRIMING
        while not all(stream.primed for stream in self.streams):
            for stream in self.streams:
                stream.prime()
                self._alive()
            if machines.clock.now() > end:
                raise DeviceError(f"mirrors and buffers are not full after {PRIMING // SECOND} s; check their source")
            if threaded:
                machines.clock.sleep_until(machines.clock.now() + LOOK)
        return self.streams

    def _approach(self, first: int) -> Rows:
        """Bring the motion to its speed ahead of the first slot, and say where pose 0 is."""
        machines, speed = self.machines, float(self.schedule.speed)
        lens = machines.lens
        channels = (1 << self.schedule.engines) - 1
        code = None if lens is None else lens.code
        run_up = 4 * float(self.schedule.advance) + speed * 0.6
        controller = machines.controller
        controller.mode("steps")
        if first == 0 and self.states.state is State.STANDBY:
            controller.zero()
            self.origin = run_up + speed * 0.4
        rows = Rows(self.schedule, machines.microsteps, self.origin, code, channels)
        wanted = rows.at(rows.acts(first)) - round((run_up + speed * 0.4) * machines.microsteps)
        per_mm = controller.microsteps_per_mm / machines.microsteps
        while controller.status().position > wanted:
            controller.move(-max(speed, 1e-3) * 4 / per_mm)
            machines.clock.sleep_until(machines.clock.now() + LOOK)
            self._alive()
        controller.move(0.0)
        controller.move(speed / per_mm)
        goal = round(speed * machines.microsteps * 1000)
        for _ in range(TRIES):
            if abs(controller.status().speed - goal) <= 1 + 1e-3 * abs(goal):
                return rows
            machines.clock.sleep_until(machines.clock.now() + LOOK // 10)
            self._alive()
        raise InterlockOpen(f"the motion did not reach {speed:.4g} {self.schedule.unit}/s; check motor and load")

    def _alive(self) -> None:
        self.lease.beat()
        self.lease.keep()

    def halt(self, streams: list[Supply]) -> None:
        """Dark, then at rest; what was shown until then is kept."""
        asked, self.asked = self.asked or State.PAUSED, None
        self.guard.off(asked.value)
        self.machines.controller.move(0.0)
        self.machines.controller.stop()
        for stream in streams:
            stream.close()
        self.paused_at = self.machines.clock.now()
        self.states.to(asked, self.guard.fault or "")

    def _show(self, position: int, streams: list[Supply]) -> None:
        slot = max(self.next - 1, 0)
        frame, focus = int(self.schedule.frame[slot]), float(self.schedule.focus[slot])
        budget = self.guard.budget
        self.board.show(
            slot=slot, frame=frame, position=position / self.machines.microsteps - self.origin,
            focus=None if np.isnan(focus) else focus, fill=min(stream.share for stream in streams),
            margin=round(min(stream.ahead for stream in streams) * SECOND / max(self.schedule.rate, 1e-9)),
            light=self.guard.lit, power=self.power, spent=0.0 if budget is None else budget.spent / budget.limit,
            picture=self.pictures[0].picture(frame),
        )  # fmt: skip

    def _told(self, what: str, why: str) -> None:
        self.board.show(light=what == "on")
        try:
            self._event("light", to=what, why=why)
        except VamError as error:  # a full disk must not keep the light on
            log.error("the event could not be kept: %s", error)

    def _event(self, kind: str, **facts: object) -> None:
        self.folder.event(kind, self.machines.clock.now(), **facts)


@dataclass
class Leg:
    """A stretch of a print without a rest.

    first: its first slot.  sent: slots whose rows the controller has.  looked: when the last look was [ns].
    """

    run: Print
    first: int
    streams: list[Supply]
    motion: Motion
    rows: Rows
    sent: int
    looked: int

    def step(self) -> bool:
        """One look at the machines; False once the leg is over."""
        if self.run.asked is not None:
            self.run.halt(self.streams)
            return False
        if self.run.look(self):
            return True
        self.run.complete(self)
        return False
