"""The opened machines of a rig, around triggered mirrors or around a projector on a video cable."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from vamgpu.errors import BadInput, DeviceError, WrongDevice
from vamgpu.hosts.clock import Clock
from vamgpu.hosts.drivers.camera import CameraDriver
from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.drivers.dmd import Dmd
from vamgpu.hosts.drivers.lens import LensDriver
from vamgpu.hosts.drivers.projector import HdmiProjector
from vamgpu.hosts.drivers.stages import Stage
from vamgpu.hosts.frames.late import LatePolicy, VialLatePolicy, WebLatePolicy
from vamgpu.hosts.frames.sources import FrameSource, MirrorArray
from vamgpu.hosts.players.player import Renew
from vamgpu.hosts.run_all import run_all
from vamgpu.hosts.safety.light import Lamp, LampGate
from vamgpu.hosts.schedules.limits import HdmiTiming
from vamgpu.hosts.schedules.schedule import Schedule

REST = 20_000  # least time from a frame's last light to the next trigger [ns]


@dataclass
class MirrorMachines:
    """The machines of a rig, opened. microsteps: of the motion, in a unit of the schedule's positions.  camera: watches
    the resin."""

    clock: Clock
    controller: Controller
    mirrors: Sequence[Dmd]
    microsteps: float
    lens: LensDriver | None = None
    camera: CameraDriver | None = None


class TriggeringStage(Stage, Protocol):
    """A stage with a trigger output."""

    # from where it rests on, fire at every so many units on the way; 0 for no more
    def trigger_every(self, distance: float) -> None: ...


@dataclass
class StageMachines:
    """The machines of a rig, opened. stage: of the vial or web; its output triggers the mirrors.  microsteps: of it, in
    a unit of the schedule's positions.  controller: that gates the light; None where none is there.  lamp: that the
    host switches; None where the mirrors alone make the dark.  camera: watches the resin."""

    clock: Clock
    stage: TriggeringStage
    mirrors: Sequence[Dmd]
    microsteps: float
    controller: Controller | None = None
    lamp: Lamp | None = None
    lens: LensDriver | None = None
    camera: CameraDriver | None = None


class HostLamp:
    """A light that the host alone switches: nobody closes it for a host that has died. lamp: None for one that shines,
    and is dark where mirrors are."""

    def __init__(self, lamp: Lamp | None) -> None:
        self._lamp = lamp

    def on(self, power: float) -> None:
        """Light."""
        if self._lamp is not None:
            self._lamp.on(power)

    def off(self) -> None:
        """Dark, as far as it is the lamp's to say."""
        if self._lamp is not None:
            self._lamp.off()


class GatedLamp:
    """A lamp that the host switches, on a rig whose controller has a gate: light wants both, each alone makes dark."""

    def __init__(self, lamp: Lamp, gate: Lamp) -> None:
        self._lamp, self._gate = lamp, gate

    def on(self, power: float) -> None:
        """Light, once the controller allows it."""
        self._gate.on(power)
        self._lamp.on(power)

    def off(self) -> None:
        """Dark by both, whatever becomes of one."""
        if failed := run_all(self._lamp.off, self._gate.off):
            raise failed[0]


def gate(controller: Controller | None, lamp: Lamp | None, schedule: Schedule) -> tuple[Lamp, Renew]:
    """A steady light, and what renews its lease: the controller's, or none."""
    if controller is None:
        return HostLamp(lamp), lambda length: None
    found = LampGate(controller, range(schedule.engines), steady=True, shares=schedule.power[0])
    return found if lamp is None else GatedLamp(lamp, found), found.renew


def late_policy(schedule: Schedule) -> LatePolicy:
    """What decides on late frames: of a web or of a vial."""
    return VialLatePolicy(schedule.frames) if schedule.unit == "deg" else WebLatePolicy()


def shows(schedule: Schedule) -> None:
    """Raise `BadInput` for slots that triggered mirrors do not show."""
    if len(set(schedule.on.tolist())) != 1 or (schedule.power != schedule.power[0]).any():
        raise BadInput("frames differ in how long or how brightly they are lit; the mirrors take one time for all")
    gap = schedule.gap
    if gap - int(schedule.on[0]) < REST:
        raise BadInput(
            f"frames are lit for {int(schedule.on[0]) / 1000:.6g} of the {gap / 1000:.6g} us that they have; mirrors "
            f"need {REST // 1000} us more for the next trigger: plan with MirrorTiming(dark=…)"
        )


RATES = 0.01  # greatest difference between the refresh that a display should have and that of the screen


@dataclass
class VideoMachines:
    """The machines of a rig, opened. controller: gates the light and holds its lease; None where none is there.

    stage: of the vial, in deg.  camera: watches the resin.  lamp: that the host switches where no controller does;
    None where black frames alone make the dark.
    """

    clock: Clock
    controller: Controller | None
    stage: Stage
    projector: HdmiProjector
    camera: CameraDriver | None = None
    lamp: Lamp | None = None

    def check(self, schedule: Schedule, display: HdmiTiming) -> None:
        """Raise `BadInput` for a schedule of no vial, `WrongDevice` for one that was made for another projector."""
        if schedule.engines != 1 or len(schedule) % schedule.frames:
            raise BadInput(
                f"the schedule has {len(schedule)} slots of {schedule.engines} engines in {schedule.unit}; expected "
                "whole turns of a vial, or a web, before one projector"
            )
        if self.stage.unit != schedule.unit:
            raise BadInput(
                f"the stage moves in {self.stage.unit}; the schedule needs one that moves in {schedule.unit}"
            )
        projector, layout, rate = self.projector, self.projector.layout, float(display.slot_rate)
        has = (*projector.size, layout.slots, layout.bits, projector.latency)
        wanted = (*reversed(display.pixels), display.patterns, display.bits, display.latency)
        if has != wanted or abs(projector.slots_per_s / rate - 1) > RATES:
            names = "rows, columns, frames a video frame, their bits, frames of delay"
            raise WrongDevice(
                f"the projector has {has} {names}, and {projector.slots_per_s:.6g} frames a second; the schedule was "
                f"made for {wanted} and {rate:.6g}: check the rig's file, or make the job for this projector"
            )


Machines = MirrorMachines | StageMachines | VideoMachines
"""The opened machines of any rig."""


def senses(machines: Machines) -> dict[str, bool | float | None]:
    """What machines say in the dark, as a `Snapshot` names it; None for what is not told."""
    told: dict[str, bool | float | None] = {"interlock_closed": None, "lens_temperature": None}
    with suppress(DeviceError):
        if machines.controller is not None:
            told["interlock_closed"] = machines.controller.status().interlock_closed
    with suppress(DeviceError):
        if not isinstance(machines, VideoMachines) and machines.lens is not None:
            told["lens_temperature"] = machines.lens.temperature()
    return told


class VideoFrames(Protocol):
    """Numbered frames for a video cable."""

    # one frame, uint8 [row, column], full on at 255; None where it is not there yet
    def frame(self, number: int) -> np.ndarray | None: ...


class SourceFrames:
    """The frames of a source in the middle of a projector's frame of (rows, columns); each is made when it is shown.

    Raises `BadInput` as it shows a frame that is larger.
    """

    def __init__(self, source: FrameSource, size: tuple[int, int]) -> None:
        self._source, self._size = source, size

    def frame(self, number: int) -> np.ndarray:
        """See `VideoFrames`."""
        full, frame = np.zeros(self._size, np.uint8), self._source.frame(number)
        full[MirrorArray(*self._size, -(-self._size[1] // 8)).place(*frame.shape)] = frame
        return full


class ScreenBlackout:
    """A projector that shows black from the next video frame on; in the thread that prints at once."""

    def __init__(self, projector: HdmiProjector) -> None:
        self._projector, self._owner = projector, threading.get_ident()
        self.dark: bool = False

    def own(self) -> None:
        """This thread prints, and frames may be shown again."""
        self._owner, self.dark = threading.get_ident(), False

    def off(self) -> None:
        """Black; a window belongs to one thread, others leave word."""
        self.dark = True
        if threading.get_ident() == self._owner:
            self._projector.black()


class MirrorBlackout:
    """Mirrors as a way to make it dark."""

    def __init__(self, dmd: Dmd) -> None:
        self._dmd = dmd

    def off(self) -> None:
        """Halt: the mirrors turn away."""
        self._dmd.halt()
