"""Run a print: the light goes off first in any event; if its cause may pass, the print is held and can continue."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import numpy as np

from vamgpu.errors import BadInput, OriginLost, Underrun, VamError
from vamgpu.geometry import positive
from vamgpu.hosts.drivers.cleanup import run_all
from vamgpu.hosts.player.machine_watch import MachineWatch
from vamgpu.hosts.player.mending import Mending
from vamgpu.hosts.player.player import Player, StatusPoll, no_lease
from vamgpu.hosts.records.account import account, wanted_light
from vamgpu.hosts.records.record import FrameRecord, RunFolder, read_run
from vamgpu.hosts.records.state import Board, PrintState, PrintStates, StateChange, WrongState
from vamgpu.hosts.safety.interlock import DEFAULT_LENGTH, Budget, InterlockOpen, Lease, OverDose
from vamgpu.hosts.safety.light import LightGuard
from vamgpu.hosts.schedules.schedule import NONE
from vamgpu.hosts.schedules.timing import SECOND, whole
from vamgpu.printing.given_dose import GivenDose

log: logging.Logger = logging.getLogger(__name__)
SIGN = SECOND // 2  # longest time between two records of a print [ns]
FINAL = (BadInput, OverDose, OriginLost)  # errors after which a print cannot continue


@dataclass(frozen=True)
class SafetyLimits:
    """Limits of the light of a print."""

    lease: int = DEFAULT_LENGTH  # time for which the controller keeps the light on without the host [ns]
    tolerance: float = 0.5  # error of motion [poses]
    budget: float = 1.01  # light relative to the plan's
    resume: int = 30 * SECOND  # longest pause [ns]

    def __post_init__(self) -> None:
        whole("lease [ns]", self.lease)
        whole("resume [ns]", self.resume, 0)
        positive("tolerance [poses]", self.tolerance)
        positive("budget", self.budget)


class PrintObserver(Protocol):
    """Observes a print: it is called in the printing thread, never waits, and never raises."""

    def saw(self, seen: StatusPoll) -> None: ...  # take the result of a poll
    def notices(self) -> list[tuple[str, dict[str, Any]]]: ...  # events since the last call, and their facts


class Print:
    """One print: a player's schedule with one holder of the light."""

    next: int
    holds: int

    def __init__(
        self, player: Player, folder: RunFolder, *, limits: SafetyLimits = SafetyLimits(), board: Board | None = None,
        power: float = 1.0, enough: Callable[[], str | None] = lambda: None, short: Callable[[], str] = lambda: "",
        recover: Callable[[], None] = lambda: None, senses: Callable[[], Mapping[str, object]] = dict,
        live: PrintObserver | None = None, watch: Callable[[], Mapping[str, object]] = dict,
        mend: bool = False, dose: GivenDose | None = None,
    ) -> None:  # fmt: skip
        if (share := positive("power", power)) > 1:
            raise BadInput(f"power is {power!r}; expected a share of the schedule's: at most 1")
        self.player = player
        self.folder = folder
        self.limits = limits
        self.power: float = share
        self._enough, self._short, self._recover, self._live = enough, short, recover, live
        self._senses, self._sensed, self._watch = senses, -SIGN, MachineWatch(watch, player.clock)
        self.board: Board = board or Board()
        self.states: PrintStates = PrintStates()
        self._leased = player.renew is not no_lease
        self.lease: Lease = Lease(player.clock, player.renew, limits.lease)
        schedule = player.schedule
        self._wanted = wanted_light(schedule)
        total = float((schedule.on[:, None] * schedule.power).sum()) * 1e-9 * share
        self._mending = Mending(dose, total * (limits.budget - 1.0)) if mend else None
        self.guard: LightGuard = LightGuard(
            player.lamp, self.lease, tolerance=limits.tolerance, budget=Budget(total * limits.budget),
            others=player.switches, notify=self._notified,
        )  # fmt: skip
        self.next = self.holds = 0
        self.dark_since: int | None = None
        self._cancelled = self._pausing = self._finishing = self._lit = self._begun = self._final = False
        self._signed = self._seen = 0
        self._why = ""  # why the part has enough light
        self._unwritten: deque[Callable[[], None]] = deque()
        self.states.listen(folder.state)
        self.states.listen(self._told)
        self.board.on_stop(self.stop)
        period = len(schedule) // schedule.turns if schedule.turns else 0
        self.board.show(slots=len(schedule), unit=schedule.unit, period=period)
        self._arm()  # for a print that continues with a version

    @property
    def asked(self) -> PrintState | None:
        """The requested state: `PrintState.CANCELLED`, or else `PrintState.PAUSED`."""
        return PrintState.CANCELLED if self._cancelled else PrintState.PAUSED if self._pausing else None

    def stop(self, why: str = "emergency stop") -> None:
        """Turn the light off now; the print is cancelled at the next poll of its thread."""
        self._cancelled = True  # set first, so that the failure of the light has its reason
        self.guard.fail(why)

    def pause(self) -> None:
        """Go dark after the present frame, and stop the motion, until `run` is called again."""
        self._pausing = True

    def restore(self, shown: np.ndarray, pause: int) -> None:
        """Count the light of an earlier host, the records of its folder, and its time in the dark [ns]."""
        self._begun = True
        self.dark_since = self.player.clock.now() - pause
        lit = shown[shown["dark"] == 0]
        power = self.player.schedule.power[0]
        for engine in range(self.player.schedule.engines):
            self.guard.spend(self.power * power[engine], int(lit["on_time"][lit["engine"] == engine].sum()))

    def sense(self) -> None:
        """In the dark: show the status of the machines, at most twice per second."""
        if (now := self.player.clock.now()) >= self._sensed + SIGN:
            self._sensed = now
            self.board.show(**self._senses())

    def run(self, first: int | None = None) -> PrintState:
        """Print from a slot on (None: where it stopped) until it ends, pauses or is held. Raises its error."""
        if self.states.state.ended:
            raise WrongState(f"the print is {self.states.state.value}; start another one, in a new folder")
        start = self.next if first is None else whole("slot", first, 0)
        if self.states.state is PrintState.HELD and start >= self._end_slot:
            self._account()  # only the disk was the problem
            return self.states.state
        if start >= self._end_slot:
            raise BadInput(f"slot {start} is not one of the {len(self.player.schedule)} slots")
        try:
            self._check_pause()
            self._pausing = self._final = False
            self.board.show(resuming=self.states.state.waits)
            self._stopped()
            if self.states.state is PrintState.HELD:
                self._write()
                self._recover()
                self.player.recover()
                self._watch.silent = False
            self.sense()
            with self.guard:
                going = self.begin(start)
                while going and self.step():
                    self.player.wait()
        except BaseException as error:
            self.ended(error)
            state = self.states.state
            if state in (PrintState.COMPLETE, PrintState.INCOMPLETE) or (
                isinstance(error, InterlockOpen) and state is PrintState.CANCELLED
            ):
                return state
            raise
        return self.states.state

    def begin(self, first: int) -> bool:
        """Prime the machines and turn the light on from a slot on; False if a pause was requested meanwhile."""
        self.next, self._finishing, self._lit = first, False, False
        self._swap()
        self.board.show(**self._watch.begin(first))
        ahead = self.player.prime(first, self._alive)
        self.states.to(PrintState.PRINTING, "" if first == 0 else f"from slot {first}")
        dark = 0 if self.dark_since is None else self.player.clock.now() - self.dark_since
        self._event("segment", first=first, dark=dark, **self.player.facts())
        self.guard.observe(armed=True, motion=0.0, shown=0, scheduled=0, fault=None)
        self._stopped()
        self._check_pause(ahead)  # the preparation also took time
        if self._pausing:
            return self._rest(PrintState.PAUSED)
        self._alive(force=True)  # an earlier stop also ended the controller's lease
        self.guard.on(self.power)
        self._lit, self._begun, self.dark_since, self._seen = True, True, None, self.player.clock.now()
        self.player.start()
        return True

    def step(self) -> bool:
        """Poll the machines once; False if the print is over or paused."""
        if self._cancelled:
            return self._rest(PrintState.CANCELLED)
        if (self._pausing or self._why) and not self._finishing:
            self._finishing = True
            self.player.finish()  # no frame is cut
        seen = self.player.poll()
        self._final = seen.final or seen.shown != seen.scheduled
        try:
            self.guard.observe(motion=seen.motion, shown=seen.shown, scheduled=seen.scheduled, fault=seen.fault)
        finally:
            self._keep(seen)
        if not self.guard.lit:
            raise InterlockOpen(f"the light is off: {self.guard.fault or 'it was turned off'}")
        self._seen = self.player.clock.now()
        self._show(seen)
        self._swap()
        self._why = self._why or self._enough() or ""
        if not seen.running or (self._sooner and self.next > self._end_slot):  # at a black slot: no light is cut
            return self._over()
        end = self.next if self._finishing else self._end_slot
        if self._watch.due(self.next, self.player.schedule, self._seen, end):
            self.board.show(**self._watch.ask(self.next, self.player.schedule))
        self.player.feed()
        self._alive()
        return True

    def ended(self, error: BaseException) -> None:
        """Stop everything after an error, in the dark. The first error is raised, a second one is logged."""
        wanted = self._cancelled or self.guard.signalled or isinstance(error, (KeyboardInterrupt, SystemExit))
        why = self.guard.fault if wanted and self.guard.fault else str(error) or type(error).__name__
        self.board.show(resuming=False)
        if self.dark_since is None:
            self.dark_since = self._seen
        self.holds += self._lit
        doubt = self._doubt if self._lit else lambda: None
        told, end = partial(self._event, "ended", error=repr(error)), partial(self._end, error, wanted, why)
        for second in run_all(self._last_poll, doubt, self.player.halt, self._write, told, end):
            log.error("after %r: %r", error, second)

    def _end(self, error: BaseException, wanted: bool, why: str) -> None:
        """The state after an error."""
        excess = self.guard.budget.excess if self.guard.budget is not None else ""
        final = FINAL if self.limits.resume else (VamError, OSError)
        if wanted:
            self.states.end(PrintState.CANCELLED, why)
        elif excess:  # perhaps of frames that were counted after the error
            self.states.end(PrintState.ERROR, excess if why == excess else f"{why}; {excess}")
        elif self._final or not self._begun or isinstance(error, final) or not isinstance(error, (VamError, OSError)):
            self.states.end(PrintState.ERROR, why)
        elif not self._ended_short(why):
            left = self._end_slot - self.next
            self.states.to(PrintState.HELD, f"{why}; {left} of {len(self.player.schedule)} slots remain, and resin "
                           f"waits for at most {self.limits.resume / SECOND:g} s")  # fmt: skip

    def _ended_short(self, why: str) -> bool:
        """After an error: end a print that has shown all its slots and cannot add any."""
        try:
            if self.next < self._end_slot or (not self._sooner and self.player.add_repeats()):
                return False
        except Underrun as error:
            why = str(error)
        try:
            self._account(why)
        except VamError as error:
            log.error("the record cannot be read or written: %s", error)
        return self.states.state.ended

    def _account(self, why: str = "") -> None:
        """The state of a finished print, from the record of its light."""
        self._write()
        found = account(read_run(self.folder.path), self._wanted, ended=True)
        assert found is not None
        if found.complete:
            self.states.to(PrintState.COMPLETE, why)
        else:
            self.states.to(PrintState.INCOMPLETE, str(found) + (f" ({why})" if why else ""))

    def _doubt(self) -> None:
        """Record the frames that were cut, and those since the last answer of a silent machine."""
        failed: VamError | None = None
        try:
            doubtful = self.player.doubtful()
        except VamError as error:  # more may have been shown than is known
            self._final, failed = True, error
            since = (self.player.clock.now() - self._seen) // self.player.schedule.gap
            doubtful = range(max(self.next - 1, 0), min(self.next + since + 1, self._end_slot))
        if self._watch.silent:
            doubtful = range(min(self._watch.vouched, doubtful.start), max(self.next, doubtful.stop))
        if not len(doubtful):
            return
        schedule, given = self.player.schedule, []
        for slot in range(max(self.next, doubtful.start), min(doubtful.stop, self._end_slot)):
            version = 0 if self.player.versions is None else self.player.versions.at(slot)
            for engine in range(schedule.engines):
                shown = FrameRecord.of(schedule, slot, engine, version)
                self._unwritten.append(partial(self.folder.shown, shown))
                given.append((float(schedule.power[slot, engine]), shown.on_time))
        self.next = max(self.next, doubtful.stop)
        self._unwritten.append(partial(self._event, "unseen", first=doubtful.start, stop=doubtful.stop))
        self._repeat(range(doubtful.start, min(doubtful.stop, self._end_slot)))
        for power, on in given:  # after all records are queued, because it raises if the budget is used up
            self.guard.spend(self.power * power, on)
        self._write()
        if failed is not None:
            raise failed

    def _repeat(self, slots: range) -> None:
        """Show frames in doubt again in an added turn of a vial, if neither dose nor budget forbid it."""
        schedule = self.player.schedule
        if self._mending is None or not schedule.repeats or self._cancelled or self.guard.signalled:
            return
        lit = np.array(slots)[schedule.frame[slots] != NONE]
        light = float((schedule.on[:, None] * schedule.power)[lit].sum()) * 1e-9 * self.power
        why, facts = self._mending.refused(schedule.frame[lit].tolist(), light), {"first": slots.start}
        if why is None:
            self.player.repeat(slots)
        told = ("mended", {}) if why is None else ("not mended", {"why": why})
        self._unwritten.append(partial(self._event, told[0], **facts, stop=slots.stop, **told[1]))

    def _check_pause(self, ahead: int = 0) -> None:
        """Raise `BadInput` if it was dark for too long. ahead: time until light [ns]."""
        if self.dark_since is not None:
            may_resume(self.player.clock.now() + ahead - self.dark_since, self.limits)

    @property
    def _end_slot(self) -> int:
        """The slot before which the light ends; a version of the frames may end sooner than the plan."""
        versions = self.player.versions
        return len(self.player.schedule) if versions is None or versions.stop is None else versions.end

    @property
    def _sooner(self) -> bool:
        """Whether the last slots of the plan are black."""
        return self._end_slot < len(self.player.schedule)

    def _swap(self) -> None:
        """Commit or drop the offered version, and set the budget for its light."""
        if (versions := self.player.versions) is None:
            return
        if (version := versions.take()) is not None:
            if self.player.swap(version):
                self._arm()
                self.board.show(plan=version.number, stop=version.stop)
                # kept until it is written, even if the disk is full now: a resume depends on it
                self._unwritten.append(partial(self._event, "swap", **version.facts(), **versions.facts()))
                self._write()
            else:
                versions.drop(version, f"frames of {versions.unit} {version.turn} were already queued")
        for number, why in versions.refused():
            log.warning("version %d of the frames is not shown: %s", number, why)
            self._event("swap dropped", version=number, why=why)
        versions.forget(self.next, self.player.pending_versions)

    def _arm(self) -> None:
        """The light of all lit slots, at most that of the first plan."""
        schedule, versions, budget = self.player.schedule, self.player.versions, self.guard.budget
        if versions is not None and budget is not None:
            lit = (schedule.on[:, None] * schedule.power)[: versions.end]
            budget.arm(float(lit.sum()) * 1e-9 * self.power * self.limits.budget)

    def _over(self) -> bool:
        """Handle the end of the light: a pause, the end, or another turn for missed frames."""
        paused = self._pausing and not self._why and self.next < self._end_slot
        self.guard.off(PrintState.PAUSED.value if paused else "complete")
        if paused:
            self.dark_since = self.player.clock.now()
        self.board.show(**self._watch.ask(self.next, self.player.schedule, over=True))
        if paused:
            return self._rest(PrintState.PAUSED)
        self._lit = False
        if self._why:
            return self._rest(PrintState.COMPLETE, self._why)
        if self._sooner and self.next >= self._end_slot:
            assert self.player.versions is not None
            self.player.halt()
            self._account(
                f"it ended after {self.player.versions.stop} {self.player.versions.unit}s, set by its last version"
            )
            return False
        if self.next < len(self.player.schedule):
            raise InterlockOpen(
                f"the controller stopped after {self.next} of {len(self.player.schedule)} frames; check its events"
            )
        self.player.halt()
        if self.player.add_repeats():
            self.board.show(slots=len(self.player.schedule))
            if self._pausing:
                return self._rest(PrintState.PAUSED)
            return self.begin(self.next)
        self._account(self._short())
        return False

    def _rest(self, state: PrintState, why: str = "") -> bool:
        """Go dark, then stop; the frames shown until then are recorded, and one that was cut is in doubt."""
        self.guard.off(why or state.value)
        if self.dark_since is None:
            self.dark_since = self.player.clock.now()
        lit = self._lit
        self._last_poll()
        if lit and state is PrintState.CANCELLED:
            self._doubt()
        self.player.halt()
        self.states.to(state, self.guard.fault or why)
        return False

    def _told(self, change: StateChange) -> None:
        """Show a state, which changes only in the dark, and the time until which a waiting print can continue."""
        deadline = None
        if change.after.waits and self.dark_since is not None:
            left = self.limits.resume - (self.player.clock.now() - self.dark_since)
            deadline = time.monotonic() + left / SECOND
        self.board.show(state=change.after, message=change.message, deadline=deadline, light=False, resuming=False)

    def _alive(self, force: bool = False) -> None:
        self._stopped()
        self.lease.beat()
        self.lease.keep(force)

    def _stopped(self) -> None:
        """Raise `InterlockOpen` if the print was stopped."""
        if self._cancelled:
            raise InterlockOpen(f"the print was stopped: {self.guard.fault or 'cancelled'}")

    def _last_poll(self) -> None:
        """In the dark: record the frames since the last poll; the last one may have been cut."""
        if self._lit:
            self._lit = False
            self._keep(self.player.poll())

    def _keep(self, seen: StatusPoll) -> None:
        """Record shown frames, and count their light."""
        schedule = self.player.schedule
        for shown in seen.frames:
            self._unwritten.append(partial(self.folder.shown, shown))
            self.next = shown.slot + 1
        self._write()
        for shown in seen.frames:
            if not shown.dark:
                self.guard.spend(self.power * float(schedule.power[shown.slot, shown.engine]), shown.on_time)
        if self._live is not None:
            self._live.saw(seen)
            for kind, facts in self._live.notices():
                self._event(kind, **facts)
        if self.player.clock.now() >= self._signed + SIGN:
            self._event("poll", shown=seen.scheduled)

    def _write(self) -> None:
        """Write queued records; with a full disk they stay queued."""
        while self._unwritten:
            self._unwritten[0]()
            self._unwritten.popleft()
        self.folder.failed = False

    def _show(self, seen: StatusPoll) -> None:
        schedule, slot = self.player.schedule, max(self.next - 1, 0)
        frame, budget = int(schedule.frame[slot]), self.guard.budget
        last = max(self._end_slot - 1, slot)
        self.board.show(
            slot=slot, frame=frame, position=seen.position, fill=seen.fill, margin=round(seen.margin * SECOND),
            spent=0.0 if budget is None else budget.spent / budget.limit,
            dark=self.board.now.dark + sum(shown.dark for shown in seen.frames),
            left=float(schedule.light[last] + schedule.on[last] - schedule.light[slot]) / SECOND,
            lease=self.limits.lease / SECOND if self._leased else None,
            renewed=None if (age := self.lease.age()) is None else age / SECOND, polled=time.monotonic(),
        )  # fmt: skip

    def _notified(self, what: str, why: str) -> None:
        self.board.show(light=what == "on", power=self.power)  # under the guard's lock: a poll would be outdated
        try:
            self._event("light", to=what, why=why)
        except VamError as error:  # a full disk must not keep the light on
            log.error("the event could not be recorded: %s", error)

    def _event(self, kind: str, **facts: object) -> None:
        self._signed = self.player.clock.now()
        self.folder.event(kind, self._signed, **facts)
        if kind == "unseen":
            self.board.show(doubt=(*self.board.now.doubt, (facts["first"], facts["stop"])))


def may_resume(pause: int, limits: SafetyLimits) -> None:
    """Raise `BadInput` if a pause [ns] was too long."""
    if pause > limits.resume:
        raise BadInput(
            f"the print paused for {pause / SECOND:.1f} s; after {limits.resume / SECOND:g} s too much "
            "of its dose has decayed, or its part has moved: start again with fresh resin"
        )
