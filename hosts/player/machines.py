"""The opened machines of a rig with triggered mirrors or a projector on a video cable."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np

from vamgpu.errors import BadInput, DeviceError, WrongDevice
from vamgpu.hosts.drivers.camera import CameraDriver
from vamgpu.hosts.drivers.cleanup import close_all
from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.drivers.dmd import Dmd
from vamgpu.hosts.drivers.lens import Lens
from vamgpu.hosts.drivers.projector import HdmiProjector
from vamgpu.hosts.drivers.stages import Stage
from vamgpu.hosts.frames.lateness import LatePolicy, VialLatePolicy, WebLatePolicy
from vamgpu.hosts.frames.sources import FrameSource, MirrorArray
from vamgpu.hosts.player.player import Renew, no_lease
from vamgpu.hosts.safety.light import Lamp, LampGate
from vamgpu.hosts.schedules.clock import Clock
from vamgpu.hosts.schedules.limits import HdmiTiming
from vamgpu.hosts.schedules.schedule import Schedule

REST = 20_000  # least time from a frame's last light to the next trigger [ns]


@dataclass
class MirrorMachines:
    """The opened machines of a rig whose controller triggers the mirrors."""

    clock: Clock
    controller: Controller
    mirrors: Sequence[Dmd]
    microsteps: float  # microsteps of the motion per unit of the schedule
    lens: Lens | None = None
    camera: CameraDriver | None = None  # camera that watches the resin
    lift: Stage | None = None  # stage that raises the vial


class TriggeringStage(Stage, Protocol):
    """A stage with a trigger output."""

    # from rest, fire at equal distances in units; 0 stops it
    def trigger_every(self, distance: float) -> None: ...


@dataclass
class StageMachines:
    """The opened machines of a rig whose stage triggers the mirrors."""

    run_up: ClassVar[float] = 2.0  # time before its first slot at which the stage starts moving [s]
    clock: Clock
    stage: TriggeringStage
    mirrors: Sequence[Dmd]
    microsteps: float  # microsteps of the stage per unit of the schedule
    controller: Controller | None = None  # gates the light; None: there is none
    lamp: Lamp | None = None  # lamp that the host switches; None: dark mirrors switch it off
    lens: Lens | None = None
    camera: CameraDriver | None = None
    lift: Stage | None = None  # stage that raises the vial


class Lamps:
    """A light with several lamps in series, each of which can turn it off; without lamps, only the mirrors can."""

    def __init__(self, *lamps: Lamp) -> None:
        self._lamps = lamps

    def on(self, power: float) -> None:
        """Turn the light on, one lamp after another."""
        for lamp in self._lamps:
            lamp.on(power)

    def off(self) -> None:
        """Turn all lamps off, the last first, even if one fails."""
        close_all([lamp.off for lamp in self._lamps])


def gate(
    controller: Controller | None, lamp: Lamp | None, channels: Sequence[int], shares: Sequence[float] | None = None
) -> tuple[Lamp, Renew]:  # fmt: skip
    """A steady light, and the renewal of the controller's lease, if any. lamp: lamp that the host switches."""
    own = () if lamp is None else (lamp,)
    if controller is None:
        return Lamps(*own), no_lease
    found = LampGate(controller, channels, steady=True, shares=shares)
    return Lamps(found, *own) if own else found, found.renew


def late_policy(schedule: Schedule) -> LatePolicy:
    return VialLatePolicy(schedule.frames) if schedule.repeats else WebLatePolicy()


def shows(schedule: Schedule) -> None:
    """Raise `BadInput` for slots that triggered mirrors cannot show."""
    if len(set(schedule.on.tolist())) != 1 or (schedule.power != schedule.power[0]).any():
        raise BadInput("frames differ in time or brightness; the mirrors use the same for all")
    gap = schedule.gap
    if gap - int(schedule.on[0]) < REST:
        raise BadInput(
            f"frames are lit for {int(schedule.on[0]) / 1000:.6g} of {gap / 1000:.6g} us; mirrors need {REST // 1000} "
            "us more for the next trigger: plan with MirrorTiming(dark=…)"
        )


RATES = 0.01  # greatest difference between the expected refresh and that of the screen


@runtime_checkable
class Limited(Protocol):
    """A stage that reports its travel."""

    def travel(self) -> tuple[float, float]: ...  # least and greatest position


@runtime_checkable
class Inspected(Protocol):
    """A lamp that reports whether it works."""

    def inspect(self) -> None: ...  # raises `DeviceError` if not


@dataclass
class VideoMachines:
    """The opened machines of a rig with a projector on a video cable."""

    run_up: ClassVar[float] = 12.0  # of a web, until it is in step with the cable [s]
    clock: Clock
    controller: Controller | None  # gates the light and holds its lease; None: there is none
    stage: Stage  # stage of the vial [deg] or web [mm]
    projector: HdmiProjector
    camera: CameraDriver | None = None
    lamp: Lamp | None = None  # lamp that the host switches; None: black frames turn it off
    lens: Lens | None = None
    lift: Stage | None = None  # stage that raises the vial

    def check(self, schedule: Schedule, display: HdmiTiming) -> None:
        """Raise `BadInput` for a schedule without whole turns or a web, `WrongDevice` for one of another projector."""
        if schedule.engines != 1 or len(schedule) % schedule.frames:
            raise BadInput(
                f"the schedule has {len(schedule)} slots of {schedule.engines} engines in {schedule.unit}; expected "
                "whole turns of a vial, or a web, for one projector"
            )
        if self.stage.unit != schedule.unit:
            raise BadInput(
                f"the stage moves in {self.stage.unit}; the schedule needs one that moves in {schedule.unit}"
            )
        projector, layout, rate = self.projector, self.projector.layout, float(display.slot_rate)
        has = (*projector.size, layout.slots, layout.bits, projector.latency)
        wanted = (*reversed(display.pixels), display.patterns, display.bits, display.latency)
        if has != wanted or abs(projector.slots_per_s / rate - 1) > RATES:
            names = "rows, columns, frames per video frame, their bits, frames of delay"
            raise WrongDevice(
                f"the projector has {has} {names}, and {projector.slots_per_s:.6g} frames per second; the schedule was "
                f"made for {wanted} and {rate:.6g}: check the rig's file, or make the job for this projector"
            )


Machines = MirrorMachines | StageMachines | VideoMachines  # The opened machines of any rig


def senses(machines: Machines) -> dict[str, bool | float | None]:
    """Sensor values in the dark, as a `Snapshot` names them; None for unknown ones."""
    told: dict[str, bool | float | None] = {"interlock_closed": None, "lens_temperature": None}
    with suppress(DeviceError):
        if machines.controller is not None:
            told["interlock_closed"] = machines.controller.status().interlock_closed
    with suppress(DeviceError):
        if machines.lens is not None:
            told["lens_temperature"] = machines.lens.temperature()
    return told


def within_travel(schedule: Schedule, machines: Machines) -> None:
    """Raise `BadInput` for a web that leaves the travel of its stage, if the stage reports it."""
    if schedule.unit == "mm" and not isinstance(machines, MirrorMachines):
        here, speed = machines.stage.position(), float(schedule.speed)
        end = here + float(schedule.advance) * len(schedule)
        reaches(machines.stage, here - machines.run_up * speed, end, "the web", "motion")


def reaches(stage: Stage, begin: float, end: float, what: str, table: str) -> None:
    """Raise `BadInput` if a stage reports that it does not go from one position to another [mm]."""
    low, high = stage.travel() if isinstance(stage, Limited) else (begin, end)
    if begin < low or end > high:
        raise BadInput(f"{what} moves from {begin:.4g} to {end:.4g} mm, with its run-up, and the stage reports that it "
                       f"goes from {low:.4g} to {high:.4g} mm: move it, or check microsteps in [{table}]")  # fmt: skip


def inspect(machines: Machines) -> dict[str, float]:
    """Ask the machines that no status poll reads; their answers, as a `Snapshot` names them. Raises `DeviceError`."""
    if isinstance(lamp := getattr(machines, "lamp", None), Inspected):
        lamp.inspect()
    return {} if machines.lens is None else {"focus": machines.lens.inspect()}


def recover(machines: Machines) -> None:
    """Reconnect to the controller and the lens of a held print. Raises `DeviceError`."""
    for machine in (machines.controller, getattr(machines, "lens", None)):
        if machine is not None:
            machine.revive()


class VideoFrames(Protocol):
    """Numbered frames for a video cable."""

    # one frame, uint8 [row, column], full on at 255; None if it is not ready
    def frame(self, number: int) -> np.ndarray | None: ...


class SourceFrames:
    """Frames of a source in the middle of a projector's (rows, columns). Raises `BadInput` for larger ones."""

    def __init__(self, source: FrameSource, size: tuple[int, int]) -> None:
        self._source, self._size = source, size

    def frame(self, number: int) -> np.ndarray:
        full, frame = np.zeros(self._size, np.uint8), self._source.frame(number)
        full[MirrorArray(*self._size, -(-self._size[1] // 8)).place(*frame.shape)] = frame
        return full


class ScreenBlackout:
    """A projector that shows black from the next video frame on, or at once in the printing thread."""

    def __init__(self, projector: HdmiProjector) -> None:
        self._projector, self._owner = projector, threading.get_ident()
        self.dark: bool = False

    def own(self) -> None:
        """Mark this thread as printing, and allow frames again."""
        self._owner, self.dark = threading.get_ident(), False

    def off(self) -> None:
        """Show black; a window belongs to one thread, so others leave a request."""
        self.dark = True
        if threading.get_ident() == self._owner:
            self._projector.black()
