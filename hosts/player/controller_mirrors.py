"""Plays a schedule on mirrors with a controller, which moves, triggers and gates the light, row by row."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from vamgpu.errors import DeviceError, OriginLost
from vamgpu.hosts.drivers.cleanup import all_of
from vamgpu.hosts.drivers.controller_protocol import ControllerRow, Status
from vamgpu.hosts.frames.sources import FrameSource
from vamgpu.hosts.player.machines import MirrorMachines
from vamgpu.hosts.player.mirrors import MirrorPlayer
from vamgpu.hosts.player.motor import Approach, Origin, SpeedMonitor, own_number
from vamgpu.hosts.player.player import Renew, StatusPoll
from vamgpu.hosts.player.rows import RowTable
from vamgpu.hosts.safety.light import Lamp, LampGate
from vamgpu.hosts.schedules.clock import TimedQuery
from vamgpu.hosts.schedules.schedule import NONE, Schedule
from vamgpu.hosts.schedules.timing import SECOND

PREROLL = 2
"""Black frames triggered before the first slot: some mirrors show an unpredictable first frame, and both counts must
agree before the light."""
APART = SECOND // 7  # least time between them, and to the first slot [ns]: some polls
PATIENCE = 0.25  # longest delay of a trigger by the position of the motion [s]
FORGOTTEN = (
    "the controller has another zero or play than this print: it lost its power, was reset, or served another program, "
    "so the position of the motor and the dose of the resin are not known; start again with fresh resin"
)
CLOSED = {
    "stall": "stall, the encoder differs from the motor's steps; check motor and load",
    "index": "index, its mark was off position: the motor lost steps, or the belt slipped",
}


def triggers(schedule: Schedule, first: int = 0) -> int:
    """Frames at the mirrors, and rows at the controller, from a slot on, with the black ones before it."""
    return len(schedule) - first + PREROLL


class TriggeredPlayer(MirrorPlayer[MirrorMachines]):
    """Plays a schedule on mirrors with a controller. origin: place of pose 0 in a print that an earlier host began."""

    def __init__(
        self, schedule: Schedule, machines: MirrorMachines, sources: Sequence[FrameSource], *,
        origin: Origin | None = None, **options: Any,
    ) -> None:  # fmt: skip
        super().__init__(schedule, machines, sources, preroll=PREROLL, **options)
        self._apart = APART + int(schedule.on[0])
        self._longest = int((schedule.dark - schedule.command).max(where=schedule.command != NONE, initial=0))
        self._origin = origin
        self._play: int | None = None
        self._lost: float | None = None
        self._sent = self._before = 0
        self._going = False
        self._blind: tuple[int, int] | None = None  # frames counted by the mirrors, and then silence of the line [ns]

    def _gate(self) -> tuple[Lamp, Renew]:
        gate = LampGate(self.machines.controller, range(self.schedule.engines), shares=self.schedule.power[0])
        return gate, gate.renew

    def prime(self, first: int, alive: Callable[[], None]) -> int:
        """Fill mirrors and buffers, bring the motion to its speed, queue black frames and first rows."""
        controller = self.machines.controller
        self._first = self._kept = self._punctual = first
        self._blind = None
        self._still_own(controller.status())
        controller.move(0.0)  # a dead host may have left it running
        self._fill(first, alive)
        controller.mode("steps")
        start = RowTable(self.schedule, self.machines.microsteps).acts(first) - PREROLL * self._apart
        approach = Approach(self.schedule, controller, self.clock, self.machines.microsteps)
        self._origin = (
            approach.fresh(start, alive) if self._origin is None else approach.again(start, self._origin, alive)
        )
        self._lost = approach.lost
        self._origin = approach.to(start, self._origin, alive)
        code = getattr(self.machines.lens, "code", None)  # only a lens driver on the controller's line has one
        channels = (1 << self.schedule.engines) - 1
        self._rows = RowTable(self.schedule, self.machines.microsteps, self._origin.at, code, channels)
        self._motion = SpeedMonitor(self.schedule, self.machines.microsteps)
        self._ask = TimedQuery(self.clock, controller.status, float(self.schedule.cadence.period) / 8)
        self._sent, self._alive = 0, alive
        self._send(controller.capacity)
        controller.end(triggers(self.schedule, first))
        status = controller.status()
        self._still_own(status)  # the steps above took time
        self._before, self._play, self._going = status.play, own_number(self.clock, status.play), False
        return round(approach.ahead(start, self._origin.at) * SECOND) + PREROLL * self._apart

    def _still_own(self, status: Status) -> None:
        """Raise `OriginLost` if the controller lost this print, or played something else."""
        if why := self._forgotten(status):
            raise OriginLost(why)

    def _forgotten(self, status: Status) -> str | None:
        zero = self._origin is None or status.zero == self._origin.zero
        plays = (self._play,) if self._going else (self._play, self._before)  # a primed one may never begin
        return None if zero and (self._play is None or status.play in plays) else FORGOTTEN

    def facts(self) -> dict[str, Any]:
        """Position of pose 0 on the motor, and the number of the run segment's play."""
        assert self._origin is not None, "primed"
        own = {"zero": self._origin.zero, "play": self._play, "before": self._before}
        lost = {} if self._lost is None else {"lost": self._lost}
        return {"origin": self._origin.at, "preroll": PREROLL} | own | lost

    def start(self) -> None:
        """Let the controller play its rows."""
        self._polled = self.clock.now()
        assert self._play is not None, "primed"
        self.machines.controller.go(self._play)
        self._going = True

    def poll(self) -> StatusPoll:
        """Compare the controller's triggers with the mirrors' count."""
        before = self._counted()
        began = self.clock.now()
        try:
            now, status = self._ask()
        except DeviceError:
            self._blind = self._blind or (max(before), self.clock.now() - began)
            raise
        after = self._counted()
        count = status.shown if status.play == self._play else 0  # of an earlier play
        counts = (each for low, each in zip(before, after, strict=True) if not low <= count <= each)
        error, frames = self._motion.error(now, status.at), self._since(count)
        if not status.late:
            self._punctual = self._kept
        self._polled, self._free = now, status.free
        return StatusPoll(
            status.state == "running", error, next(counts, count), count, frames,
            status.at / self.machines.microsteps - self._rows.origin, *self._supply(), self._fault(status),
            self._forgotten(status) is not None,
        )  # fmt: skip

    def _fault(self, status: Status) -> str | None:
        """Why the controller is not reliable."""
        if status.state == "fault":
            return f"the controller switched the light off: {CLOSED.get(status.fault, status.fault)}"
        if why := self._forgotten(status):
            return why
        if status.late:
            return f"{status.late} rows reached the controller late; check what delays the host"
        if status.state == "running" and status.shown < triggers(self.schedule, self._first):
            speed = float(self.schedule.speed) * self.machines.microsteps
            overdue = (status.position - self._row(status.shown).at) / speed - self._longest * 1e-9
            if overdue > PATIENCE:
                return f"no trigger for {1e3 * overdue:.0f} ms after frame {status.shown}, although the axis turns"
        return None

    def feed(self) -> None:
        """Replace late frames by black, and send rows."""
        super().feed()
        self._send(self._free)

    def _send(self, free: int) -> None:
        """Send rows while there is room: first those of the black frames, then slots."""
        stop = min(self._sent + free, triggers(self.schedule, self._first))
        for number in range(self._sent, stop):
            self.machines.controller.row(self._row(number))
            if number % 16 == 15:  # a slow line takes a while
                self._alive()
        self._sent = max(self._sent, stop)

    def _row(self, number: int) -> ControllerRow:
        if number < PREROLL:
            return self._rows.dark(self._first, (PREROLL - number) * self._apart, number)
        return self._rows.row(self._first + number - PREROLL, number)

    def finish(self) -> None:
        """End after the present frame, so that none is cut."""
        controller = self.machines.controller
        controller.end(min(controller.status().shown + 1, triggers(self.schedule, self._first)))

    def _triggered(self) -> int:
        """Frames of this run segment, in the dark; an upper bound if the controller does not answer."""
        try:
            status = self.machines.controller.status()
        except DeviceError:
            if self._blind is None:
                raise
            counted, time = self._blind
            return counted + 1 + time // self.schedule.gap
        return status.shown if status.play == self._play else 0

    def recover(self) -> None:
        """Reconnect, and drop remaining rows."""
        super().recover()
        self.machines.controller.stop()

    def halt(self) -> None:
        """Stop the motion, drop rows, turn the mirrors dark; each even if the one before fails."""
        all_of(self.machines.controller.stop, self._close)
