"""The machines of a calibration, opened from the file of a rig, and what is read with them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol, TypeVar

import numpy as np

from vamgpu.errors import BadInput, JobError
from vamgpu.hosts.calibrating.screen import Screen
from vamgpu.hosts.clock import Clock
from vamgpu.hosts.drivers.camera import Camera
from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.drivers.lens import TunableLens
from vamgpu.hosts.drivers.scpi import PowerMeter
from vamgpu.hosts.drivers.stage import Stage
from vamgpu.hosts.rigs.closing import let_go
from vamgpu.hosts.rigs.config import RigFile

T = TypeVar("T")
SATURATED = 1e-3
"""Share of pixels at the camera's top from which a picture is overexposed."""
SETTLINGS = 4.0
"""Times of settling that a calibration waits for the lens."""
ARRIVED = 0.005
"""How near the camera's stage must come to where it was sent [mm]."""


class Waits(Protocol):
    """What keeps light while a reading is waited for."""

    def wait(self, seconds: float) -> None:
        """Let time pass."""
        ...

    def alive(self) -> None:
        """A sign of work."""
        ...


@dataclass
class Stand:
    """Opened machines. screens, channels: of each projector.  lens, camera, stage, meter: None where there is none."""

    rig: RigFile
    clock: Clock
    controller: Controller
    screens: tuple[Screen, ...]
    channels: tuple[int, ...]
    lens: TunableLens | None = None
    camera: Camera | None = None
    stage: Stage | None = None
    meter: PowerMeter | None = None
    closers: list[Callable[[], None]] = field(default_factory=list)

    def screen(self, projector: int) -> Screen:
        """The mirrors of a projector, counted from 0."""
        if not 0 <= projector < len(self.screens):
            raise BadInput(f"projector {projector}; wanted one of the rig's {len(self.screens)}, counted from 0")
        return self.screens[projector]

    def move(self, position: float) -> float:
        """Bring the camera to a position [mm] from the middle, in the dark; where it says it is."""
        section, stage = need(self.rig.camera_stage, "camera_stage"), need(self.stage, "camera_stage")
        stage.move(section.middle + position, section.speed)
        stage.wait()
        found = stage.position() - section.middle
        if abs(found - position) > ARRIVED:
            raise BadInput(f"the camera's stage went to {found:g} mm, {position:g} mm was asked; check its travel")
        return found

    def focus(self, power: float, light: Waits) -> float:
        """Set the lens's power [dpt] and wait for it; the power it has, which is a whole number of its steps."""
        section, lens = need(self.rig.lens, "lens"), need(self.lens, "lens")
        if not section.lowest <= power <= section.highest:
            raise BadInput(
                f"a lens power of {power:g} dpt; wanted {section.lowest:g} to {section.highest:g} dpt, as the rig says"
            )
        lens.set_power(power)
        light.wait(SETTLINGS * section.settle)
        return lens.power()

    def picture(self, light: Waits) -> np.ndarray:
        """A picture of the camera that began after now. Raises `BadInput` where it is overexposed."""
        section, camera = need(self.rig.camera, "camera"), need(self.camera, "camera")
        for _ in range(section.discard):
            camera.grab()
            light.alive()
        picture = camera.grab()
        light.alive()
        over = float((picture >= 2**section.bits - 1).mean())
        if over > SATURATED:
            raise BadInput(
                f"{100 * over:.1f} % of the camera's pixels are saturated; wanted {100 * SATURATED:g} % at most: lower "
                "camera.exposure or light.power of the rig"
            )
        return picture

    def read(self, light: Waits, repeats: int) -> np.ndarray:
        """Readings of the photodiode [mW] after it has followed the light; shape (repeats,)."""
        section, meter = need(self.rig.photodiode, "photodiode"), need(self.meter, "photodiode")
        light.wait(section.settle)
        found = np.empty(repeats)
        for number in range(repeats):
            found[number] = meter.power_mw()
            light.alive()
        return found

    def close(self) -> None:
        """Let go of all machines, the last opened first; raises what went wrong first."""
        closers, self.closers = self.closers, []
        let_go(closers)


def need(part: T | None, table: str) -> T:
    """A machine that a run cannot do without. Raises `JobError` naming the table of the rig's file."""
    if part is None:
        raise JobError(f"the rig has no table [{table}], which this calibration wanted; add it to the rig's file")
    return part
