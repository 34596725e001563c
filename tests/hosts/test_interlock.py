"""Light on ⇒ armed, lease fresh, motion in tolerance, frame = scheduled: proven on the emulated rig under faults.

The truth is read from the emulated machines, not from the host. What the controller guards by itself (arming, lease,
interlock) must hold at every moment. What only the host can see (motion, frames, its own disk) must hold after each of
its looks, and never be broken in the light for longer than a lease, whatever the host does or no longer does.
"""

from __future__ import annotations

import errno
import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from vamgpu.hosts.emulators.array import ArrayModel
from vamgpu.hosts.emulators.rigs import EmulatedMirrorRig
from vamgpu.hosts.frames.sources import MirrorArray, VialFrames
from vamgpu.hosts.player.controller_mirrors import TriggeredPlayer
from vamgpu.hosts.player.motor import POLL
from vamgpu.hosts.player.run import SIGN, Print
from vamgpu.hosts.records.record import RunFolder, read_run
from vamgpu.hosts.records.state import PrintState
from vamgpu.hosts.schedules.limits import MirrorTiming
from vamgpu.hosts.schedules.mirrors import turned
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve

MODEL = ArrayModel(height=4, width=16)
FRAMES = Frames.from_bytes(
    np.full((360, 4, 16), 200, np.uint8), "numpy", bits=8, gray=GrayCurve.linear(), scale=1.0, columns=16
)
SCHEDULE = turned(360, speed=40, engines=MirrorTiming(pixels=(16, 4), row_bytes=2, dark=2e-3), turns=2)
STEPS = 1000
TOLERANCE = 0.5
LOOKS = st.integers(0, 5)
"""How often the host looks after a fault, before anything else happens."""


class Printing(RuleBasedStateMachine):
    """A print to which things happen."""

    begun = False

    @initialize()
    def begin(self) -> None:
        self.place = tempfile.TemporaryDirectory()
        self.emulated = EmulatedMirrorRig(STEPS, MODEL)
        machines = self.emulated.machines(STEPS / float(SCHEDULE.advance))
        self.folder = RunFolder.begin(Path(self.place.name) / "run", {}, "")
        player = TriggeredPlayer(SCHEDULE, machines, [VialFrames(FRAMES, MirrorArray(4, 16, 2))])
        self.print = Print(player, self.folder)
        self.print.guard.__enter__()
        self.ended: int | None = None
        self.wrong: int | None = None
        self.looked = True
        self.faults = 0
        self.print.begin(0)
        self.anchor = (self.now, self.web.position(self.now))
        self.begun = True
        while not self.emulated.controller.light:  # the run-up is dark
            self.look(1)

    # ---- the truth -------------------------------------------------------------------------------------------
    @property
    def now(self) -> int:
        return self.emulated.clock.now()

    @property
    def web(self):  # noqa: ANN202
        return self.emulated.controller.web

    def motion_error(self) -> float:
        began, start = self.anchor
        should = start + (self.now - began) * STEPS / float(SCHEDULE.cadence.period)
        return abs(self.web.position(self.now) - should) / STEPS

    def is_wrong(self) -> bool:
        frames = self.emulated.alps[0].counts["shown"] != self.emulated.controller.shown
        full = self.folder._write is not WRITE and self.now > self.print._signed + SIGN  # then something is written
        return frames or full or self.motion_error() > TOLERANCE + 0.01

    # ---- what the host does ----------------------------------------------------------------------------------
    def host(self, act: Callable[[], object]) -> None:
        """The host acts; what it does about errors is what `Print.run` does."""
        try:
            act()
        except Exception as error:
            self.print.guard.__exit__(type(error), error, None)
            self.print.ended(error)
            self.ended = self.now

    def pass_time(self, duration: int) -> None:
        """Time passes in pieces, with the truth looked at in between."""
        end = self.now + duration
        while self.now < end:
            self.emulated.clock.sleep_until(min(end, self.now + POLL // 4))
            self.check()

    @precondition(lambda self: self.ended is None)
    @rule(looks=st.integers(1, 12))
    def look(self, looks: int) -> None:
        for _ in range(looks):
            if self.ended is None:
                self.pass_time(POLL)
                self.host(self.print.step)
                self.looked = True
                self.check()
                self.looked = False

    @rule(milliseconds=st.integers(1, 600))
    def stalled_gpu(self, milliseconds: int) -> None:
        self.pass_time(milliseconds * 1_000_000)

    def after(self, looks: int) -> None:
        """The host goes on for so many looks, or has already given up."""
        if self.ended is None and looks:
            self.look(looks)

    # ---- what happens ----------------------------------------------------------------------------------------
    @rule(ahead=st.integers(0, 60), way=st.sampled_from(("drop_in", "drop_out", "flip_in", "flip_out")))
    def spoiled_byte(self, ahead: int, way: str) -> None:
        faults = self.emulated.faults
        number = faults._count[way.partition("_")[2]] + ahead
        setattr(faults, way, getattr(faults, way) | {number})

    @rule(looks=LOOKS)
    def unplugged_port(self, looks: int) -> None:
        self.emulated.port.unplug()
        self.after(looks)

    @rule(looks=LOOKS)
    def lost_trigger(self, looks: int) -> None:
        self.emulated.lose_triggers += 1
        self.after(looks)

    @rule(looks=LOOKS)
    def stray_trigger(self, looks: int) -> None:
        self.emulated.alps[0].trigger(self.now)
        self.after(looks)

    @rule(poses=st.sampled_from((-3.0, -1.0)), looks=LOOKS)
    def slipping_stage(self, poses: float, looks: int) -> None:
        self.web.set_position(self.now, self.web.position(self.now) + poses * STEPS)
        self.after(2 * looks)

    @rule(share=st.sampled_from((0.0, 0.6, 1.4)), looks=LOOKS)
    def stage_at_a_wrong_speed(self, share: float, looks: int) -> None:
        self.web.run(self.now, self.web.velocity(self.now) * share)
        self.after(2 * looks)

    @rule(looks=LOOKS)
    def opened_door(self, looks: int) -> None:
        self.emulated.controller.open_interlock(self.now)
        self.after(looks)

    @rule(looks=LOOKS)
    def full_disk(self, looks: int) -> None:
        def full(file: int, data: bytes) -> int:
            raise OSError(errno.ENOSPC, "No space left on device")

        self.folder._write = full
        self.after(looks)

    @precondition(lambda self: self.ended is None)
    @rule()
    def emergency_stop(self) -> None:
        self.host(self.print.stop)
        self.ended = self.ended or self.now
        self.print.guard.__exit__(None, None, None)

    # ---- what must hold --------------------------------------------------------------------------------------
    @invariant()
    def check(self) -> None:
        controller, lease = self.emulated.controller, self.print.limits.lease
        self.wrong = (self.wrong or self.now) if self.is_wrong() else None
        if not controller.light:
            return
        assert controller.armed and controller.interlock_closed, "light is armed for"
        assert controller.lease_end is not None and self.now < controller.lease_end, "the lease is fresh"
        assert self.now < controller.lease_end <= self.now + lease
        assert self.ended is None or self.now - self.ended < lease, "a host that gave up leaves no light"
        if self.wrong is not None:
            assert not self.looked or self.emulated.port._unplugged, "a host that looks, and has a line, sees it"
            assert self.now - self.wrong <= lease, "a host that does not look lets the lease run out"

    def teardown(self) -> None:
        if not self.begun:
            return
        if self.ended is None:
            self.print.guard.__exit__(None, None, None)
            self.ended = self.now
        self.pass_time(self.print.limits.lease)
        assert not self.emulated.controller.light
        self.folder._write = WRITE
        self.folder.close()
        shown = read_run(self.folder.path).shown["slot"]
        assert shown.tolist() == list(range(len(shown))), "the record has every frame once, in order"
        self.place.cleanup()


WRITE = os.write
FEW = settings(
    max_examples=20, stateful_step_count=10, deadline=None,
    suppress_health_check=(HealthCheck.too_slow, HealthCheck.filter_too_much),
)  # fmt: skip
TestPrinting = Printing.TestCase
TestPrinting.settings = FEW


@pytest.mark.slow
def test_many_more_prints_to_which_things_happen() -> None:
    run_state_machine_as_test(Printing, settings=settings(FEW, max_examples=80))


def test_a_print_that_nothing_happens_to_is_completed() -> None:
    """The state machine's host does print: no proof of darkness by standing still."""
    machine = Printing()
    machine.begin()
    lit = 0
    while machine.ended is None and machine.print.states.state is PrintState.PRINTING:
        machine.look(1)
        lit += bool(machine.emulated.controller.light)
    assert machine.print.states.state is PrintState.COMPLETE and lit > 100
    machine.print.guard.__exit__(None, None, None)
    machine.ended = machine.now
    machine.teardown()
