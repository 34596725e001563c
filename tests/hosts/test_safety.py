"""Light is on only while everything that must hold does; off comes first, always, and by more than one way."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap

import pytest

from vamgpu.errors import BadInput, DeviceBusy
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.records.state import NEXT, PrintState, PrintStates, WrongState
from vamgpu.hosts.safety.interlock import Budget, InterlockOpen, Lease, OverDose
from vamgpu.hosts.safety.light import LightGuard

MS = 1_000_000
GOOD = {"armed": True, "motion": 0.0, "shown": 3, "scheduled": 3}


class Bulb:
    """A lamp that can be unplugged."""

    def __init__(self) -> None:
        self.power, self.unplugged, self.calls = 0.0, False, 0

    def on(self, power: float) -> None:
        self._line()
        self.power = power

    def off(self) -> None:
        self.calls += 1
        self._line()
        self.power = 0.0

    def _line(self) -> None:
        if self.unplugged:
            raise OSError("unplugged")


class Held:
    """A guard with a lamp and a second switch, on virtual time."""

    def __init__(self, **fields: object) -> None:
        self.clock, self.bulb, self.black = VirtualClock(), Bulb(), Bulb()
        self.renewed: list[int] = []
        self.lease = Lease(self.clock, self.renewed.append, 250 * MS)
        options = {"tolerance": 0.5, "others": {"projector": self.black}} | fields
        self.guard = LightGuard(self.bulb, self.lease, **options)  # type: ignore[arg-type]

    def light(self) -> LightGuard:
        self.guard.observe(**GOOD)
        self.guard.on(0.8)
        assert self.guard.lit and self.bulb.power == 0.8
        return self.guard


def test_light_needs_everything_and_says_what_is_missing() -> None:
    held = Held()
    with pytest.raises(InterlockOpen, match="no holder"):
        held.guard.on(1.0)
    with held.guard as light:
        for change, why in (
            ({"armed": False}, "not armed"),
            ({"motion": None}, "has not been read"),
            ({"motion": 0.6}, "0.5 is allowed"),
            ({"motion": float("nan")}, "nan"),
            ({"shown": 2}, "frame 2 is shown; expected frame 3"),
            ({"scheduled": None, "shown": None}, "expected frame None"),
            ({"fault": "the lens is silent"}, "lens is silent"),
        ):
            light.observe(**(GOOD | change))
            with pytest.raises(InterlockOpen, match=why):
                light.on(1.0)
            light.observe(fault=None)
        held.light()
    assert held.bulb.power == 0.0 and not held.guard.lit


@pytest.mark.parametrize(
    "change", [{"armed": False}, {"motion": -0.51}, {"shown": 4}, {"scheduled": 4}, {"fault": "trigger late"}]
)
def test_what_stops_holding_puts_the_light_out_for_good(change: dict[str, object]) -> None:
    held = Held()
    with held.guard as light:
        held.light()
        with pytest.raises(InterlockOpen, match="went off"):
            light.observe(**change)
        assert held.bulb.power == 0.0 and not held.lease.fresh()
        light.observe(**(GOOD | {"fault": None}))
        with pytest.raises(InterlockOpen):
            light.on(0.8)


def test_off_is_idempotent_and_needs_no_failed_device() -> None:
    held = Held()
    with held.guard as light:
        held.light()
        held.bulb.unplugged = True
        light.off()
        light.off()
        assert held.black.calls >= 3, "the projector was told although the lamp is unplugged"
        assert not held.lease.fresh(), "the controller closes what the lamp's line cannot"
        with pytest.raises(InterlockOpen, match="did not go off"):
            light.on(0.8)


def test_any_exception_is_dark_first() -> None:
    for kind in (ValueError, KeyboardInterrupt, SystemExit, MemoryError):
        held = Held()
        with pytest.raises(kind), held.guard:
            held.light()
            raise kind("x")
        assert held.bulb.power == 0.0
        assert not held.lease.keep(force=True), "nobody renews a lease that was left"


def test_a_lamp_that_fails_on_is_put_out() -> None:
    held = Held()
    with held.guard as light:
        light.observe(**GOOD)
        held.bulb.unplugged = True
        with pytest.raises(OSError, match="unplugged"):
            light.on(0.5)
        assert not light.lit and light.fault is not None


def test_one_holder() -> None:
    held = Held()
    with held.guard, pytest.raises(DeviceBusy), held.guard:
        pass
    with held.guard:
        held.light()


def test_a_stale_lease_is_dark() -> None:
    held = Held()
    with held.guard as light:
        held.light()
        held.clock.sleep(249 * MS)
        light.check()
        held.clock.sleep(2 * MS)
        with pytest.raises(InterlockOpen, match="stale"):
            light.check()
    assert held.bulb.power == 0.0


def test_a_lease_is_renewed_for_work_only() -> None:
    held = Held()
    held.lease.begin()
    for _ in range(20):
        held.clock.sleep(70 * MS)
        held.lease.beat()
        assert held.lease.keep()
    assert held.renewed == [250 * MS] * 21
    assert not held.lease.keep(), "no more often than every quarter"
    held.clock.sleep(251 * MS)
    assert not held.lease.keep(), "a thread that lives renews nothing for work that has stalled"
    assert not held.lease.fresh()


def test_a_budget_counts_light_that_was_on() -> None:
    held = Held(budget=Budget(0.8 * 0.1))
    with held.guard as light:
        held.light()
        for _ in range(10):
            light.spend(0.8, 10 * MS)
        with pytest.raises(OverDose, match="no more than the plan"):
            light.spend(0.8, 10 * MS)
        assert held.bulb.power == 0.0 and light.budget is not None and light.budget.spent >= light.budget.limit
    with pytest.raises(BadInput):
        Budget(0.0)
    with pytest.raises(BadInput):
        Lease(VirtualClock(), print, MS)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_are_dark_first(number: signal.Signals) -> None:
    """The process says when the lamp went off and when the signal's own effect came."""
    script = """
        import os, signal, sys, time
        signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell may have told its children to ignore it
        from vamgpu.hosts.emulators.clock import VirtualClock
        from vamgpu.hosts.safety.interlock import Lease
        from vamgpu.hosts.safety.light import LightGuard
        class Lamp:
            def on(self, power): os.write(1, b"on ")
            def off(self): os.write(1, b"off ")
        guard = LightGuard(Lamp(), Lease(VirtualClock(), lambda length: None), tolerance=1.0)
        try:
            with guard as light:
                light.observe(armed=True, motion=0.0, shown=0, scheduled=0)
                light.on(1.0)
                signal.raise_signal(int(sys.argv[1]))
        except BaseException as error:
            os.write(1, type(error).__name__.encode())
    """
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    command = [sys.executable, "-c", textwrap.dedent(script), str(int(number))]
    said = subprocess.run(command, capture_output=True, text=True, timeout=60, env=environment, check=False).stdout
    assert said.startswith("off on off ")
    assert said.split()[-1] == {signal.SIGINT: "KeyboardInterrupt", signal.SIGTERM: "SystemExit"}[number]


def test_states_go_only_where_they_may() -> None:
    states, heard = PrintStates(), []
    states.listen(heard.append)
    with pytest.raises(WrongState, match="standby and cannot become paused"):
        states.to(PrintState.PAUSED)
    assert states.to(PrintState.PRINTING, "go") and not states.to(PrintState.PRINTING)
    states.to(PrintState.PAUSED)
    states.to(PrintState.PRINTING)
    assert states.end(PrintState.ERROR, "lens")
    assert not states.end(PrintState.CANCELLED, "later"), "the first reason stays"
    assert (states.state, states.message) == (PrintState.ERROR, "lens")
    assert [change.after for change in heard] == [
        PrintState.PRINTING,
        PrintState.PAUSED,
        PrintState.PRINTING,
        PrintState.ERROR,
    ]
    assert all(not NEXT[state] for state in PrintState if state.ended)
