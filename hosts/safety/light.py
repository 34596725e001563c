"""The one holder of the light: it turns on only if all conditions hold, and off first in any event."""

from __future__ import annotations

import atexit
import logging
import signal
import threading
import weakref
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import FrameType
from typing import Any, Protocol

from vamgpu.errors import DeviceBusy, DeviceError, ProtocolError, VamError
from vamgpu.geometry import positive
from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.safety.interlock import Budget, InterlockOpen, Lease, Observation, reason_dark

log: logging.Logger = logging.getLogger(__name__)
SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Signals that end a process with the light: from keys, the system, and closed terminals."""

HELD_UP = 0.1  # time for which a signal waits for another thread that is turning the light off [s]


class Switch(Protocol):
    """A switch that can turn the light off: a controller's gate, a lamp's driver, a projector that shows black."""

    def off(self) -> None: ...  # turn the light off; harmless if it is off


class Lamp(Switch, Protocol):
    """The switch that can also turn the light on."""

    def on(self, power: float) -> None: ...  # turn the light on at a power


class LightGuard:
    """Controls the light of one rig, entered last and left first; a fault latches until it is left."""

    # ``others`` are named switches, always tried after the lamp. SIGINT, SIGTERM and SIGHUP turn the light off before
    # their usual effect, in the main thread; an ignored signal, as under nohup, stays ignored.

    def __init__(
        self, lamp: Lamp, lease: Lease, *, tolerance: float, budget: Budget | None = None,
        others: Mapping[str, Switch] | None = None,
        notify: Callable[[str, str], None] | None = None,
    ) -> None:  # fmt: skip
        self.lease = lease
        self.budget = budget
        self.tolerance: float = positive("tolerance of motion", tolerance)
        self._lamp, self._others = lamp, dict(others or {})
        self._notify = notify or (lambda what, why: None)
        self._lock = threading.RLock()
        self._seen = Observation()
        self._lit = False
        self._entered = False
        self._fault: str | None = None
        self._outside = False
        self._before: dict[int, Any] = {}
        self.signalled: bool = False

    def __enter__(self) -> LightGuard:
        with self._lock:
            if self._entered:
                raise DeviceBusy("the light already has a holder; expected one at a time")
            self._seen, self._entered = Observation(), True
            self._fault = self._fault if self._outside else None  # it may have been stopped before
        self._guard_process()
        try:
            self._dark("begin")  # for any state that a crashed host left
            self.lease.begin()
        except BaseException:
            self.__exit__(None, None, None)
            raise
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        try:
            self.off("left" if error is None else f"{type(error).__name__}: {error}")
        finally:
            self.lease.revoke()
            self._entered = False
            self._release_process()

    @property
    def lit(self) -> bool:
        """Whether the light was turned on and not off since."""
        return self._lit

    @property
    def fault(self) -> str | None:
        """Why the light went off for good; None if it may go on again."""
        return self._fault

    def reason(self) -> str | None:
        """Why the light must be off now; None if it may be on."""
        if not self._entered:
            return "the light has no holder"
        if self._fault is not None:
            return self._fault
        return reason_dark(replace(self._seen, lease=self.lease.fresh()), self.tolerance)

    def observe(self, **seen: Any) -> None:
        """Take an observation of the machines (fields of `Observation`); InterlockOpen if the light had to go off."""
        with self._lock:
            self._seen = replace(self._seen, **seen)
        self.check()

    def check(self) -> None:
        """Turn the light off if it may not be on, and then raise `InterlockOpen`."""
        with self._lock:
            why = self.reason() if self._lit else None
            if why is not None:
                self.fail(why)
                raise InterlockOpen(f"the light went off: {why}")

    def on(self, power: float) -> None:
        """Turn the light on. Raises `InterlockOpen` with the reason if it must stay off."""
        with self._lock:
            why = self.reason()
            if why is not None:
                self.off(why)
                raise InterlockOpen(f"no light: {why}")
            power = positive("power", power)
            self._lit = True  # set first: a lamp that fails half-way may be on
            try:
                self._lamp.on(power)
            except BaseException as error:
                self.fail(f"the lamp failed: {error}")
                raise
            self._notify("on", f"{power:.6g}")

    def spend(self, power: float, on_time: int) -> None:
        """Count light of ``on_time`` [ns]; beyond the budget it goes off for good. Raises `OverDose`."""
        if self.budget is None:
            return
        try:
            self.budget.spend(power, on_time)
        except VamError as error:
            self.fail(str(error))
            raise

    def off(self, why: str = "asked") -> None:
        """Turn the light off; any number of times, from any thread, after any failure. Never raises."""
        with self._lock:
            was = self._lit
            self._dark(why)
            if was:
                self._notify("off", why)

    def fail(self, why: str) -> None:
        """Turn the light off for good: no light and no lease until the guard is left."""
        self.lease.revoke()  # first, because it does not wait: the controller switches off even if every line is dead
        with self._lock:
            self._fault, self._outside = self._fault or why, self._outside or not self._entered
            self.off(why)

    def _signalled(self, why: str) -> None:
        """Turn the light off from a signal; another thread that turns it off may wait for this thread's lock."""
        self.lease.revoke()
        self.signalled = True
        if self._lock.acquire(timeout=HELD_UP):
            try:
                self.fail(why)
            finally:
                self._lock.release()

    def _dark(self, why: str) -> None:
        """Try every switch, even if one fails. If all fail, the lease runs out."""
        worked = 0
        for name, switch in (("lamp", self._lamp), *self._others.items()):
            try:
                switch.off()
                worked += 1
            except Exception as error:
                log.error("off by the %s failed (%s): %s", name, why, error)
                self.lease.revoke()
                self._fault = self._fault or f"the {name} did not go off: {error}"
        self._lit = False
        if not worked:
            log.critical("no switch answered; the controller's lease will switch the light off (%s)", why)

    def _guard_process(self) -> None:
        """Signals and the interpreter's end also turn the light off."""
        atexit.register(self._at_exit)
        if threading.current_thread() is not threading.main_thread():
            return
        mine = weakref.ref(self)
        for number in SIGNALS:
            before = signal.getsignal(number)
            if before in (signal.SIG_IGN, None):  # the print continues after it, or a maker's library handles it
                continue

            def dark_first(number: int, frame: FrameType | None, before: Any = before) -> None:
                guard = mine()
                if guard is not None:
                    guard._signalled(signal.Signals(number).name)
                if not callable(before):
                    raise SystemExit(128 + number)
                before(number, frame)

            self._before[number] = before
            signal.signal(number, dark_first)

    def _release_process(self) -> None:
        atexit.unregister(self._at_exit)
        for number, before in self._before.items():
            signal.signal(number, before)
        self._before = {}

    def _at_exit(self) -> None:
        self.fail("the interpreter ends")


class LampGate:
    """The light behind a controller's gate: with ``steady`` it is on at once, otherwise row by row."""

    def __init__(
        self, controller: Controller, channels: Sequence[int] = (0,), steady: bool = False,
        shares: Sequence[float] | None = None,
    ) -> None:  # fmt: skip
        self._controller, self._channels, self._steady = controller, tuple(channels), steady
        self._shares = (1.0,) * len(channels) if shares is None else tuple(shares)

    def on(self, power: float) -> None:
        """Drive the channels at a share of full, and allow the light."""
        for channel, share in zip(self._channels, self._shares, strict=True):
            self._controller.power(channel, power * share)
        self._controller.arm()
        if self._steady:
            self._controller.light(sum(1 << channel for channel in self._channels))

    def off(self) -> None:
        """Turn the light off and disallow it; if that fails, everything stops."""
        try:
            self._controller.disarm()
        except (DeviceError, ProtocolError):
            self._controller.stop()

    def renew(self, length: int) -> None:
        """Let the controller keep the light on for ``length`` [ns] more."""
        self._controller.lease(length // 1_000_000)
