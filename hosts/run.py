"""Carry out a print: prime, light, watch, record, feed; and whatever happens, dark first."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from vamgpu.errors import BadInput, VamError
from vamgpu.geometry import positive
from vamgpu.hosts.board import Board
from vamgpu.hosts.insist import insist
from vamgpu.hosts.players.player import Look, Player
from vamgpu.hosts.record import RunFolder
from vamgpu.hosts.safety.interlock import Budget, InterlockOpen
from vamgpu.hosts.safety.lease import DEFAULT_LENGTH, Lease
from vamgpu.hosts.safety.light import LightGuard
from vamgpu.hosts.schedules.timing import SECOND, whole
from vamgpu.hosts.state import State, States, WrongState

log = logging.getLogger(__name__)
SIGN = SECOND // 2
"""A print leaves a sign of its time at least as often [ns]."""


@dataclass(frozen=True)
class Limits:
    """What holds the light of a print.

    lease: how long the controller keeps the light by itself [ns].  tolerance: of motion, in poses.  budget: light over
    the plan's.  resume: the longest rest after which a print goes on [ns]. Raises `BadInput`.
    """

    lease: int = DEFAULT_LENGTH
    tolerance: float = 0.5
    budget: float = 1.01
    resume: int = 30 * SECOND

    def __post_init__(self) -> None:
        whole("lease [ns]", self.lease)
        whole("resume [ns]", self.resume, 0)
        positive("tolerance [poses]", self.tolerance)
        positive("budget", self.budget)


class Print:
    """One print: a player's schedule under one holder of the light.

    player: machines that play the schedule.  folder: keeps what happens.  power: over the schedule's, 0 to 1.  enough:
    asked at every look whether the part has had its light, and says why; then it is dark at once and all is complete.
    short: what is said of a print that came to its end without that. Raises `BadInput`.
    """

    def __init__(
        self, player: Player, folder: RunFolder, *, limits: Limits = Limits(), board: Board | None = None,
        power: float = 1.0, enough: Callable[[], str | None] = lambda: None, short: Callable[[], str] = lambda: "",
    ) -> None:  # fmt: skip
        if (share := positive("power", power)) > 1:
            raise BadInput(f"power is {power!r}; wanted a share of the schedule's: 1 at most")
        self.player, self.folder, self.limits, self.power = player, folder, limits, share
        self._enough, self._short = enough, short
        self.board, self.states = board or Board(), States()
        self.lease = Lease(player.clock, player.renew, limits.lease)
        schedule = player.schedule
        total = float((schedule.on[:, None] * schedule.power).sum()) * 1e-9 * share
        self.guard = LightGuard(
            player.lamp, self.lease, tolerance=limits.tolerance, budget=Budget(total * limits.budget),
            others=player.switches, told=self._told,
        )  # fmt: skip
        self.next = 0
        self.dark_since: int | None = None
        self._cancelled = self._pausing = self._finishing = self._lit = False
        self._signed = 0
        self.states.listen(folder.state)
        self.states.listen(lambda change: self.board.show(state=change.after, message=change.message))
        self.board.on_stop(self.stop)
        self.board.show(slots=len(schedule), unit=schedule.unit)

    # ---- from any thread -------------------------------------------------------------------------------------
    @property
    def asked(self) -> State | None:
        """What somebody asked for: `State.CANCELLED`, or else `State.PAUSED`."""
        return State.CANCELLED if self._cancelled else State.PAUSED if self._pausing else None

    def stop(self, why: str = "emergency stop") -> None:
        """Light off now; the print is cancelled when its thread looks."""
        self._cancelled = True  # first: who sees the light fail shall know why
        self.guard.fail(why)

    def pause(self) -> None:
        """Dark after the picture that is shown, and the motion at rest, until `run` is called again."""
        self._pausing = True

    def recall(self, shown: np.ndarray, rest: int) -> None:
        """Count light that an earlier host gave, records of its folder, and how long it has been dark since [ns]."""
        self.dark_since = self.player.clock.now() - rest
        lit = shown[shown["dark"] == 0]
        power = self.player.schedule.power[0]
        for engine in range(self.player.schedule.engines):
            self.guard.spend(self.power * power[engine], int(lit["on_time"][lit["engine"] == engine].sum()))

    # ---- the printing thread ---------------------------------------------------------------------------------
    def run(self, first: int | None = None) -> State:
        """Print from a slot on (by default where it paused) until it is complete, paused, cancelled or failed.

        Raises what went wrong, after it is dark and written down; `WrongState` for a print that has ended.
        """
        if self.states.state.ended:
            raise WrongState(f"the print is {self.states.state.value}; begin another one, in a folder of its own")
        start = self.next if first is None else whole("slot", first, 0)
        if start >= len(self.player.schedule):
            raise BadInput(f"slot {start} is none of the {len(self.player.schedule)} slots")
        try:
            self._rested()
            self._pausing = False
            self._stopped()
            with self.guard:
                self.begin(start)
                while self.step():
                    self.player.wait()
        except BaseException as error:
            self.ended(error)
            if isinstance(error, InterlockOpen) and self.states.state is State.CANCELLED:
                return State.CANCELLED
            raise
        return self.states.state

    def begin(self, first: int) -> None:
        """Prime the machines and make light from a slot on; the guard is held already."""
        self.next, self._finishing, self._lit = first, False, False
        ahead = self.player.prime(first, self._alive)
        self.states.to(State.PRINTING, "" if first == 0 else f"from slot {first}")
        dark = 0 if self.dark_since is None else self.player.clock.now() - self.dark_since
        self._event("leg", first=first, dark=dark, **self.player.facts())
        self.guard.look(armed=True, motion=0.0, shown=0, scheduled=0, fault=None)
        self._stopped()
        self._rested(ahead)  # getting ready took its time too
        self._alive(force=True)  # who made it dark before ended the controller's lease too
        self.guard.on(self.power)
        self._lit, self.dark_since = True, None
        self.player.start()

    def step(self) -> bool:
        """One look at the machines; False once the print is over or at rest."""
        if self._cancelled:
            return self._rest(State.CANCELLED)
        if self._pausing and not self._finishing:
            self._finishing = True
            self.player.finish()
        seen = self.player.look()
        lit = self.guard.lit
        try:
            self.guard.look(motion=seen.motion, shown=seen.shown, scheduled=seen.scheduled, fault=seen.fault)
        finally:
            self._keep(seen, lit)
        if not self.guard.lit:
            raise InterlockOpen(f"the light is off: {self.guard.fault or 'somebody turned it off'}")
        self._show(seen)
        if (why := self._enough()) is not None:
            return self._rest(State.COMPLETE, why)
        if not seen.running:
            return self._over()
        self.player.feed()
        self._alive()
        return True

    def ended(self, error: BaseException) -> None:
        """Bring all to rest after an error; it is dark already. A second error is logged: the first is to be told."""
        wanted = self._cancelled or self.guard.signalled or isinstance(error, (KeyboardInterrupt, SystemExit))
        state = State.CANCELLED if wanted else State.ERROR
        why = self.guard.fault if wanted and self.guard.fault else str(error) or type(error).__name__
        told, end = lambda: self._event("ended", error=repr(error)), lambda: self.states.end(state, why)  # noqa: E731
        for second in insist(self._last_look, self.player.halt, told, end):
            log.error("after %r: %r", error, second)

    def _rested(self, ahead: int = 0) -> None:
        """Raise `BadInput` where it has been dark for too long. ahead: until there is light [ns]."""
        if self.dark_since is not None:
            may_resume(self.player.clock.now() + ahead - self.dark_since, self.limits)

    def _over(self) -> bool:
        """No light is to come: a rest, the end, or a turn more for what was missed."""
        if self._pausing and self.next < len(self.player.schedule):
            return self._rest(State.PAUSED)
        self.guard.off("complete")
        self._lit = False
        if self.next < len(self.player.schedule):
            raise InterlockOpen(
                f"the controller stopped after {self.next} of {len(self.player.schedule)} pictures; look at its events"
            )
        self.player.halt()
        if self.player.amends():
            self.board.show(slots=len(self.player.schedule))
            self.begin(self.next)
            return True
        self.states.to(State.COMPLETE, self._short())
        return False

    def _rest(self, state: State, why: str = "") -> bool:
        """Dark, then at rest; what was shown until then is kept."""
        self.guard.off(why or state.value)
        self.dark_since = self.player.clock.now()
        self._last_look()
        self.player.halt()
        self.states.to(state, self.guard.fault or why)
        return False

    def _alive(self, force: bool = False) -> None:
        self._stopped()
        self.lease.beat()
        self.lease.keep(force)

    def _stopped(self) -> None:
        """Raise `InterlockOpen` where somebody has stopped the print."""
        if self._cancelled:
            raise InterlockOpen(f"the print was stopped: {self.guard.fault or 'cancelled'}")

    def _last_look(self) -> None:
        """In the dark: keep what was shown since the last look; the last picture may have been cut."""
        if self._lit:
            self._lit = False
            self._keep(self.player.look())

    def _keep(self, seen: Look, lit: bool = True) -> None:
        """Write down what was shown, in the dark where the light had been put out, and count its light."""
        schedule = self.player.schedule
        for shown in seen.pictures:
            shown = shown if lit else replace(shown, dark=True)
            self.folder.shown(shown)
            self.next = shown.slot + 1
            if not shown.dark:
                self.guard.spend(self.power * float(schedule.power[shown.slot, shown.engine]), shown.on_time)
        # a look that writes nothing would not see a full disk
        if not seen.pictures or self.player.clock.now() >= self._signed + SIGN:
            self._event("look", shown=seen.scheduled)

    def _show(self, seen: Look) -> None:
        schedule, slot = self.player.schedule, max(self.next - 1, 0)
        frame, focus, budget = int(schedule.frame[slot]), float(schedule.focus[slot]), self.guard.budget
        self.board.show(
            slot=slot, frame=frame, position=seen.position, focus=None if np.isnan(focus) else focus, fill=seen.fill,
            margin=round(seen.margin * SECOND), light=self.guard.lit, power=self.power,
            spent=0.0 if budget is None else budget.spent / budget.limit,
            dark=self.board.now.dark + sum(shown.dark for shown in seen.pictures),
        )  # fmt: skip

    def _told(self, what: str, why: str) -> None:
        self.board.show(light=what == "on")
        try:
            self._event("light", to=what, why=why)
        except VamError as error:  # a full disk must not keep the light on
            log.error("the event could not be kept: %s", error)

    def _event(self, kind: str, **facts: object) -> None:
        self._signed = self.player.clock.now()
        self.folder.event(kind, self._signed, **facts)


def may_resume(rest: int, limits: Limits) -> None:
    """Raise `BadInput` for a rest [ns] that was too long."""
    if rest > limits.resume:
        raise BadInput(
            f"the print rested {rest / SECOND:.1f} s; after {limits.resume / SECOND:g} s resin has forgotten "
            "too much of its dose: begin anew with fresh resin"
        )
