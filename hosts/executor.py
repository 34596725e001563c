"""Runs a schedule: primes the mirrors, opens the light, and watches what the trigger counter says. Never a host's time.

The mirrors show the next picture at each trigger, so what is shown follows from how many triggers were counted; this
loop only keeps enough pictures ahead of the counter and puts the light out when it cannot.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from vamgpu.errors import BadInput, DeviceError, Underrun
from vamgpu.hosts.clock import Clock
from vamgpu.hosts.feed import Feed, Late, Sink
from vamgpu.hosts.schedule import NONE, Schedule
from vamgpu.hosts.timing import SECOND
from vamgpu.hosts.underrun import Action, WebUnderrun

log = logging.getLogger(__name__)


class Light(Protocol):
    """The light as this loop may use it; who holds it decides whether it may be on."""

    def on(self, power: float) -> None:
        """Allow light of a power."""
        ...

    def off(self, why: str) -> None:
        """Make it dark; never raises."""
        ...


class Motion(Protocol):
    """What moves, and triggers the mirrors as it goes."""

    def start(self) -> None:
        """Begin to move, and with it to trigger."""
        ...

    def stop(self) -> None:
        """Come to rest."""
        ...


@dataclass(frozen=True, eq=False)
class Ran:
    """How a run went.

    shown: pictures that were triggered.  lost: those that were black instead.  late: of every other picture, how much
    later than its trigger it was at the mirrors [ns], int64; negative: so much earlier.  duration: [ns].
    """

    shown: int
    lost: tuple[Late, ...]
    late: np.ndarray
    duration: int

    def __str__(self) -> str:
        if not self.late.size:
            return f"{self.shown} pictures, {len(self.lost)} lost"
        p50, p99, most = 1e-6 * np.percentile(self.late, [50, 99, 100])
        return f"{self.shown} pictures, {len(self.lost)} lost, late by p50 {p50:.3g}, p99 {p99:.3g}, max {most:.3g} ms"


class Executor:
    """One print on triggered mirrors.

    guard: pictures that must be at the mirrors ahead of the counter; where one is not made in time, black goes in its
    place and ``policy`` is asked.  poll: between looks at the counter [ns]; by default a quarter of the guard's time.
    patience: longest without a trigger [ns].  preroll, pulse: black pictures shown before the light opens, by calling
    ``pulse`` once for each, after which the counter must agree: some mirrors show an unpredictable first picture.
    triggers: how many triggers the controller has sent, where it counts them: mirrors that count fewer have missed one,
    and every later picture would be at a wrong pose, so that ends the print.  watch: called at every
    look with the slot that is shown, to renew leases and compare positions; what it raises ends the print.
    """

    def __init__(
        self, schedule: Schedule, feed: Feed, sink: Sink, light: Light, motion: Motion, clock: Clock, *,
        policy: WebUnderrun | None = None, guard: int = 2, poll: int | None = None, patience: int | None = None,
        preroll: int = 0, pulse: Callable[[], None] | None = None, triggers: Callable[[], int] | None = None,
        watch: Callable[[int], None] | None = None,
    ) -> None:  # fmt: skip
        if len(feed) != len(schedule):
            raise BadInput(f"the feed has {len(feed)} pictures, the schedule {len(schedule)} slots; use one job")
        if guard < 1 or preroll < 0 or (preroll and pulse is None):
            raise BadInput(f"guard is {guard} and preroll {preroll}; wanted 1 or more, and a pulse for any preroll")
        self._schedule, self._feed, self._sink, self._clock = schedule, feed, sink, clock
        self._light, self._motion, self._watch = light, motion, watch or (lambda slot: None)
        self._policy = WebUnderrun() if policy is None else policy
        slot = int(np.diff(schedule.light).min()) if len(schedule) > 1 else max(schedule.duration, 1)
        longest = int(np.diff(schedule.light, prepend=0).max()) if len(schedule) else 0
        self._guard, self._preroll, self._pulse, self._triggers = guard, preroll, pulse, triggers
        self._poll = max(guard * slot // 4, 1) if poll is None else poll
        self._patience = max(3 * longest, SECOND // 4) if patience is None else patience
        self.began = NONE

    def run(self) -> Ran:
        """Print from the first slot to the last. Raises `Underrun`, `DeviceError` and what the machines raise.

        However it ends, the light goes off first, then the motion stops.
        """
        try:
            self.prime()
            self._align()
            self._light.on(float(self._schedule.power.max()))
            self.began = self._clock.now()
            self._motion.start()
            self._follow()
        except BaseException as error:
            self._light.off(f"{type(error).__name__}: {error}")
            raise
        finally:
            self._light.off("the end")
            try:
                self._motion.stop()
            finally:
                self._feed.stop()
        return self.ran()

    def ran(self) -> Ran:
        """How it went, or goes."""
        arrived = self._feed.arrived[: self._feed.uploaded]
        due = max(self.began, 0) + self._schedule.trigger[: len(arrived)]
        kept = np.ones(len(arrived), bool)
        kept[[slot for slot in self._feed.late if slot < len(arrived)]] = False
        lost = tuple(self._feed.late[slot] for slot in sorted(self._feed.late))
        took = self._clock.now() - max(self.began, 0)
        return Ran(max(self._count(), 0), lost, (arrived - due)[kept], took)

    def prime(self, timeout: int = 60 * SECOND) -> None:
        """Fill mirrors and ring. Raises `DeviceError` where that takes longer than ``timeout`` [ns]."""
        if self._preroll:
            self._feed.blank(self._preroll)
        end = self._clock.now() + timeout
        while not self._feed.primed:
            self._work()
            if self._clock.now() > end:
                raise DeviceError(
                    f"mirrors and ring are not full after {timeout / SECOND:g} s: {self._feed.uploaded} pictures are "
                    f"at the mirrors, {self._feed.made} were made; check the device that makes them, and the upload"
                )
            if not self._feed.primed:
                self._clock.sleep_until(self._clock.now() + self._poll)

    def _align(self) -> None:
        for _ in range(self._preroll):
            assert self._pulse is not None
            self._pulse()
        if self._count() != 0:
            raise DeviceError(
                f"the mirrors counted {self._sink.shown()} triggers after {self._preroll} pulses: picture 0 would not "
                "meet the first focus; check the trigger line"
            )

    def _count(self) -> int:
        return self._sink.shown() - self._preroll

    def _follow(self) -> None:
        shown, seen = 0, self._clock.now()
        while shown < len(self._schedule):
            self._work()
            self._keep_ahead(shown)
            self._watch(shown)
            self._clock.sleep_until(self._clock.now() + self._poll)
            sent = self._triggers() if self._triggers is not None else 0  # before the mirrors are asked
            count = self._count()
            if sent > count + self._preroll:
                raise Underrun(
                    f"the controller sent {sent} triggers, the mirrors counted {count + self._preroll}: pictures are "
                    "no longer where they belong; check the trigger line, and whether the host stood still"
                )
            if count != shown:
                shown, seen = count, self._clock.now()
            elif self._clock.now() - seen > self._patience:
                raise DeviceError(
                    f"no trigger for {1e-6 * self._patience:.4g} ms after picture {shown}: the web or its controller "
                    "stands still; check both before printing again"
                )

    def _work(self) -> None:
        self._feed.check()
        if not self._feed.threaded:
            self._feed.pump()

    def _keep_ahead(self, shown: int) -> None:
        while not self._feed.done and self._feed.uploaded - shown < self._guard:
            if self._feed.upload():
                continue
            if not self._sink.room():
                return
            slot = self._feed.black()
            pose = int(self._schedule.pose[slot])
            log.warning("slot %d (pose %d) is black: its picture is not there", slot, pose)
            if self._policy.lost(pose) is Action.STOP:
                raise Underrun(
                    f"more than {self._policy.allowed} of {self._policy.window} poses were lost, the last at slot "
                    f"{slot} (pose {pose}): the light is off and the web stops; print slower, or make pictures faster"
                )
