"""A vial before a projector on a video cable: its machines, its pictures, and black as a way to make it dark."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from vamgpu.errors import BadInput, WrongDevice
from vamgpu.hosts.clock import Clock
from vamgpu.hosts.drivers.camera import Camera
from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.drivers.projector import HdmiProjector
from vamgpu.hosts.drivers.stage import Stage
from vamgpu.hosts.pictures.stream import Mirrors
from vamgpu.hosts.schedules.limits import HdmiTiming
from vamgpu.hosts.schedules.schedule import Schedule
from vamgpu.printing.frames import Frames

RATES = 0.01
"""Greatest difference between the refresh that a display should have and that of the screen."""


@dataclass
class VideoMachines:
    """The machines of a rig, opened. controller: gates the light and holds its lease.  stage: of the vial, in deg.

    camera: watches the resin.
    """

    clock: Clock
    controller: Controller
    stage: Stage
    projector: HdmiProjector
    camera: Camera | None = None

    def check(self, schedule: Schedule, display: HdmiTiming) -> None:
        """Raise `BadInput` for a schedule of no vial, `WrongDevice` for one that was made for another projector."""
        if schedule.unit != "deg" or schedule.engines != 1 or len(schedule) % schedule.frames:
            raise BadInput(
                f"the schedule has {len(schedule)} slots of {schedule.engines} engines in {schedule.unit}; wanted "
                "whole turns of a vial before one projector"
            )
        if self.stage.unit != "deg":
            raise BadInput(f"the stage moves in {self.stage.unit}; a vial needs one that turns")
        projector, layout, rate = self.projector, self.projector.layout, float(display.slot_rate)
        has = (*projector.size, layout.slots, layout.bits, projector.latency)
        wanted = (*reversed(display.pixels), display.patterns, display.bits, display.latency)
        if has != wanted or abs(projector.slots_per_s / rate - 1) > RATES:
            names = "rows, columns, pictures a video frame, their bits, frames of delay"
            raise WrongDevice(
                f"the projector has {has} {names}, and {projector.slots_per_s:.6g} pictures a second; the schedule was "
                f"made for {wanted} and {rate:.6g}: check the rig's file, or make the job for this projector"
            )


class VideoPictures(Protocol):
    """Numbered pictures for a video cable."""

    def picture(self, number: int) -> np.ndarray | None:
        """One picture, uint8 [row, column], full on at 255; None where it is not there yet."""
        ...


class CablePictures:
    """The frames of a job in the middle of a projector's picture of (rows, columns); all in the host's memory.

    Raises `BadInput` for a job whose frames are larger.
    """

    def __init__(self, frames: Frames, size: tuple[int, int]) -> None:
        rows, columns = size
        self._place = Mirrors(rows, columns, -(-columns // 8)).place(*frames.shape[1:])
        self._levels, self._size = frames.pictures(), size

    def picture(self, number: int) -> np.ndarray:
        """See `VideoPictures`."""
        full = np.zeros(self._size, np.uint8)
        full[self._place] = self._levels[number]
        return full


class Blackout:
    """A projector that shows black from the next video frame on; in the thread that prints at once."""

    def __init__(self, projector: HdmiProjector) -> None:
        self._projector, self._owner = projector, threading.get_ident()
        self.dark = False

    def own(self) -> None:
        """This thread prints, and pictures may be shown again."""
        self._owner, self.dark = threading.get_ident(), False

    def off(self) -> None:
        """Black; a window belongs to one thread, others leave word."""
        self.dark = True
        if threading.get_ident() == self._owner:
            self._projector.black()
