"""Machines of a rig opened over real lines: what the file says is checked, and what fails leaves nothing open."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from servers import PtyServer

from vamgpu.errors import DeviceLost, DeviceNotFound, WrongDevice
from vamgpu.hosts.calibrate.machines import CalibrationMachines
from vamgpu.hosts.drivers import alp, projector
from vamgpu.hosts.emulators.alp import EmulatedAlp
from vamgpu.hosts.emulators.array import ArrayModel
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.controller import EmulatedController
from vamgpu.hosts.emulators.lens import EmulatedLens
from vamgpu.hosts.emulators.stage import EmulatedStage
from vamgpu.hosts.player.machines import MirrorMachines, VideoMachines
from vamgpu.hosts.rigs.config import RigConfig, parse_rig
from vamgpu.hosts.rigs.connection import close, opened
from vamgpu.hosts.rigs.preflight import judged
from vamgpu.hosts.schedules.limits import MirrorTiming
from vamgpu.hosts.schedules.mirrors import turned


@dataclass
class Lab:
    """Emulated machines on lines of this computer, and the addresses of them."""

    controller: str
    lens: str
    stage: str
    alps: list[EmulatedAlp]
    box: EmulatedController

    @property
    def head(self) -> str:
        rig = '[rig]\nname = "lab"\nmachine = "vial"\n'
        return f'{rig}[controller]\nport = "{self.controller}"\n'

    def rig(self, **lens: Any) -> RigConfig:
        wanted = "".join(f"{name} = {value!r}\n".replace("'", '"') for name, value in lens.items())
        mirrors = '[[display]]\ndriver = "alp"\nlibrary = "{}"\nsize = [12, 64]\n'
        return parse_rig(
            self.head + '[motion]\ndriver = "controller"\nmicrosteps = 3200\n'
            f'[lens]\ndriver = "optotune"\nport = "{self.lens}"\n{wanted}'
            + mirrors.format(0) + mirrors.format(1)
        )  # fmt: skip

    def cable(self) -> RigConfig:
        return parse_rig(
            self.head + '[display]\ndriver = "video"\nsize = [8, 12]\norder = ["red", "green"]\n'
            f'[motion]\ndriver = "zaber"\nport = "{self.stage}"\nmicrosteps = 1000\n'
        )


@pytest.fixture
def lab(monkeypatch: pytest.MonkeyPatch) -> Iterator[Lab]:
    with ExitStack() as stack:
        box = EmulatedController()
        lines: list[str] = [
            stack.enter_context(PtyServer(machine)).url for machine in (box, EmulatedLens(), EmulatedStage(rotary=True))
        ]
        alps = [EmulatedAlp(VirtualClock(), ArrayModel(height=12, width=64)) for _ in range(2)]
        monkeypatch.setattr(alp, "load", lambda path: alps[int(path)].library)
        controller, lens, stage = lines
        yield Lab(controller, lens, stage, alps, box)


class Screen:
    """A window that keeps what it was shown."""

    size, rate_hz, closed = (8, 12), 60.0, False

    def __init__(self, screen: int, size: tuple[int, int], rate_hz: float) -> None:
        assert (screen, size, rate_hz) == (0, self.size, 60.0)
        self.frames: list[np.ndarray] = []

    def show(self, frame: np.ndarray) -> int:
        self.frames.append(frame)
        return len(self.frames)

    def close(self) -> None:
        self.closed = True


def test_a_rig_is_opened_measured_and_let_go_of(lab: Lab) -> None:
    machines = opened(lab.rig(firmware="A"))
    assert isinstance(machines, MirrorMachines) and len(machines.mirrors) == 2 and machines.lens is not None
    lens: Any = machines.lens
    assert lens.firmware == "A" and all(each.allocated for each in lab.alps)
    table = turned(40, speed=40, engines=(MirrorTiming(pixels=(64, 12), row_bytes=8, dark=3e-3),) * 2)
    found = judged(table, machines.mirrors, machines.clock, seconds=0.05)
    assert len(found.found) == 2 and np.isfinite(found.found[0].measured), "both wires at once"
    close(machines)
    assert not any(each.allocated for each in lab.alps)
    ramping = parse_rig(lab.rig().text.replace("microsteps = 3200", "microsteps = 100.0\nramp = 30.0"))
    close(opened(ramping))
    assert lab.box.web.acceleration == 3000.0, "30 deg/s2 of 100 microsteps a degree"


def test_what_fails_leaves_nothing_open(lab: Lab) -> None:
    for rig, why in (
        (lab.rig(firmware="B"), "firmware type A; expected B"),
        (lab.rig(lowest=-4.0), "guarantees -1.5 to 3.5 dpt; expected -4"),
        (parse_rig(lab.rig().text.replace("size = [12, 64]", "size = [24, 64]")), "12 x 64 mirrors"),
        (parse_rig(lab.rig().text.replace(lab.lens, lab.stage)), "check that the port is the lens driver's"),
    ):
        with pytest.raises(WrongDevice, match=why):
            opened(rig)
        assert not any(each.allocated for each in lab.alps)
    close(opened(lab.rig()))


def test_a_video_projector_and_its_stage(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(*_: object) -> None:
        raise DeviceNotFound("there is no display to open a window on")

    monkeypatch.setattr(projector, "PygletWindow", absent)
    with pytest.raises(DeviceNotFound, match="no display"):
        opened(lab.cable())
    monkeypatch.setattr(projector, "PygletWindow", Screen)
    machines = opened(lab.cable())
    assert isinstance(machines, VideoMachines) and machines.stage.unit == "deg" and machines.stage.position() == 0.0
    machines.projector.show([np.full((8, 12), 7, np.uint8), np.full((8, 12), 9, np.uint8)])
    screen: Any = machines.projector.window
    assert screen.frames[-1][0, 0].tolist() == [7, 9, 0], "red first, as the file says"
    close(machines)
    assert screen.closed


def test_one_that_does_not_close_keeps_none_open() -> None:
    closed: list[str] = []

    def fail() -> None:
        raise DeviceLost("its plug is out")

    nothing: Any = None
    stand = CalibrationMachines(nothing, nothing, nothing, (), nothing)
    stand.closers += [lambda: closed.append("controller"), fail, lambda: closed.append("lens")]
    with pytest.raises(DeviceLost, match="plug"):
        stand.close()
    assert closed == ["lens", "controller"]
    stand.close()
    assert closed == ["lens", "controller"]


def test_a_lens_that_the_host_controls_is_set_before_the_print(lab: Lab) -> None:
    for focus, power in (((1.25,), 1.25), ((), 0.5)):
        machines = opened(lab.rig(controlled_by="host", axis=0.5), focus=focus)
        assert isinstance(machines, MirrorMachines) and machines.lens is not None
        assert machines.lens.power() == pytest.approx(power, abs=0.01)
        close(machines)
