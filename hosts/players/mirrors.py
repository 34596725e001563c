"""Machines around triggered mirrors, schedules that they show, and what decides on late pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from vamgpu.errors import BadInput
from vamgpu.hosts.clock import Clock
from vamgpu.hosts.drivers.camera import Camera
from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.drivers.dmd import Dmd
from vamgpu.hosts.drivers.lens import TunableLens
from vamgpu.hosts.pictures.underrun import Underruns, VialUnderrun, WebUnderrun
from vamgpu.hosts.schedules.schedule import Schedule

REST = 20_000
"""Least time from a picture's last light to the next trigger [ns]."""


@dataclass
class Machines:
    """The machines of a rig, opened. microsteps: of the motion, in a unit of the schedule's positions.  camera: watches
    the resin."""

    clock: Clock
    controller: Controller
    mirrors: Sequence[Dmd]
    microsteps: float
    lens: TunableLens | None = None
    camera: Camera | None = None


def usual(schedule: Schedule) -> Underruns:
    """What decides on late pictures: of a web or of a vial."""
    return VialUnderrun(schedule.frames) if schedule.unit == "deg" else WebUnderrun()


def shows(schedule: Schedule) -> None:
    """Raise `BadInput` for slots that triggered mirrors do not show."""
    if len(set(schedule.on.tolist())) != 1 or (schedule.power != schedule.power[0]).any():
        raise BadInput("pictures differ in how long or how brightly they are lit; the mirrors take one time for all")
    gap = schedule.gap
    if gap - int(schedule.on[0]) < REST:
        raise BadInput(
            f"pictures are lit for {int(schedule.on[0]) / 1000:.6g} of the {gap / 1000:.6g} us that they have; mirrors "
            f"need {REST // 1000} us more for the next trigger: plan with MirrorTiming(dark=…)"
        )
