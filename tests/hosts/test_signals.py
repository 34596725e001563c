"""Signals that come while a thread waits: for its turn at the mirrors, or for another one that stops the light."""

from __future__ import annotations

import signal
import sys
import threading
import time

import pytest

from vamgpu.hosts.drivers.memory import FairLock
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.safety.interlock import Lease
from vamgpu.hosts.safety.light import LightGuard

MAIN = threading.main_thread().ident or 0


def signalled(number: int, file: str) -> None:
    """Send the main thread a signal from another one, once it runs or waits in a file."""

    def send() -> None:
        while not sys._current_frames()[MAIN].f_code.co_filename.endswith(file):
            time.sleep(0.001)
        time.sleep(0.05)  # until it waits there, most often; earlier is as good a moment
        signal.pthread_kill(MAIN, number)

    threading.Thread(target=send, daemon=True).start()


class Alarm(Exception):
    pass


@pytest.fixture
def alarm(request: pytest.FixtureRequest) -> int:
    def rings(*_: object) -> None:
        raise Alarm

    before = signal.signal(signal.SIGUSR1, rings)
    request.addfinalizer(lambda: signal.signal(signal.SIGUSR1, before))
    return signal.SIGUSR1


@pytest.mark.parametrize("given", [False, True], ids=["while it waits", "when it was given"])
def test_a_signal_in_the_wait_for_a_turn_loses_no_turn(alarm: int, given: bool) -> None:
    turns, leave = FairLock(), threading.Event()
    holds = threading.Event()

    def hold() -> None:
        with turns:
            holds.set()
            leave.wait()

    holder = threading.Thread(target=hold, daemon=True)
    holder.start()
    holds.wait()
    if given:
        ticket = threading.Lock()
        ticket.acquire()
        turns._waiting.append(ticket)
        leave.set()
        holder.join()
        assert turns._held and not turns._waiting
        turns._leave(ticket)
    else:
        signalled(alarm, "memory.py")
        with pytest.raises(Alarm), turns:
            raise AssertionError("nobody gave a turn")
        leave.set()
        holder.join()
    with turns:
        assert turns._held
    assert not turns._held


def test_a_signal_before_a_thread_has_joined_gives_no_turn_away(alarm: int) -> None:
    """It waits for the lock inside, which another thread holds for a moment."""
    turns = FairLock()
    turns._held = True  # another thread's
    turns._lock.acquire()
    signalled(alarm, "memory.py")
    with pytest.raises(Alarm), turns:
        raise AssertionError("nobody gave a turn")
    turns._lock.release()
    assert turns._held and not turns._waiting


def test_a_signal_does_not_wait_for_who_waits_for_its_thread(request: pytest.FixtureRequest) -> None:
    """The main thread is in an exchange on the line; a page's stop waits for the line, and a signal comes."""
    request.addfinalizer(lambda: signal.signal(signal.SIGTERM, before))
    before = signal.signal(signal.SIGTERM, signal.SIG_DFL)
    line, dark = threading.RLock(), []

    class Lamp:
        def on(self, power: float) -> None:
            dark.clear()

        def off(self) -> None:
            with line:
                dark.append(threading.get_ident())

    guard = LightGuard(Lamp(), Lease(VirtualClock(), lambda length: None), tolerance=1.0)
    page = threading.Thread(target=lambda: guard.fail("stopped at the page"), daemon=True)
    with pytest.raises(SystemExit), guard:
        guard.observe(armed=True, motion=0.0, shown=0, scheduled=0)
        guard.on(1.0)
        with line:
            page.start()
            while guard._lock.acquire(blocking=False):  # until the page has it
                guard._lock.release()
            signalled(signal.SIGTERM, "test_signals.py")
            time.sleep(30)
            raise AssertionError("the signal never came")
    page.join()
    assert not page.is_alive() and len(dark) >= 2 and guard.fault == "stopped at the page" and not guard.lit


def test_a_handler_that_python_did_not_set_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    class Lamp:
        def on(self, power: float) -> None: ...

        def off(self) -> None: ...

    monkeypatch.setattr("vamgpu.hosts.safety.light.signal.getsignal", lambda number: None)
    with LightGuard(Lamp(), Lease(VirtualClock(), lambda length: None), tolerance=1.0):
        pass
