"""The opened machines of a calibration, their light, and scans over patterns or positions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from math import ceil
from typing import Self, TypeVar

import numpy as np

from vamgpu.errors import BadInput, DeviceError, JobError
from vamgpu.hosts.calibrate.patterns import PatternScreen, VideoScreen
from vamgpu.hosts.drivers.camera import Buffered, CameraDriver
from vamgpu.hosts.drivers.cleanup import close_all
from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.drivers.lens import Lens
from vamgpu.hosts.drivers.scpi import PowerMeter
from vamgpu.hosts.drivers.stages import Stage
from vamgpu.hosts.player.machines import gate
from vamgpu.hosts.rigs.config import RigFile
from vamgpu.hosts.safety.interlock import Lease
from vamgpu.hosts.safety.light import Lamp, LightGuard
from vamgpu.hosts.schedules.clock import Clock

T = TypeVar("T")
SATURATED = 1e-3  # share of saturated pixels above which an image is overexposed
SETTLINGS = 4.0  # settling times that a calibration waits for the lens
POLL = 5_000_000  # time between two queries to the turntable [ns]
PATIENCE = 30.0  # time for it to change its speed [s]
STEPS = 8  # signs of life per lease
ARRIVED = 0.005  # allowed position error of the camera's stage [mm]


class SteppedTurntable:
    """The turntable that the controller steps. Its ramp takes it slightly past each angle."""

    def __init__(self, controller: Controller, clock: Clock) -> None:
        self._controller, self._clock = controller, clock

    def move(self, position: float, speed: float) -> None:
        """Turn forwards to an angle, or just past it."""
        self._controller.move(speed)
        end = self._clock.now() + round(1e9 * (PATIENCE + (position - self.position()) / speed))
        try:
            while self.position() < position:
                self._pause(end)
        finally:
            self._controller.move(0.0)

    def wait(self) -> None:
        """Return when it is at rest."""
        end = self._clock.now() + round(1e9 * PATIENCE)
        while self._controller.status().speed:
            self._pause(end)

    def position(self) -> float:
        """Its angle, from its steps."""
        return self._controller.position_mm()

    def _pause(self, end: int) -> None:
        if self._clock.now() > end:
            raise DeviceError("the turntable does not reach its target; check its motor, power and ramp")
        self._clock.sleep_until(self._clock.now() + POLL)


@dataclass
class CalibrationMachines:
    """Opened machines of a calibration, with a screen for each projector; its number is the channel of its light."""

    rig: RigFile
    clock: Clock
    controller: Controller | None
    screens: tuple[PatternScreen | VideoScreen, ...]
    lens: Lens | None = None
    camera: CameraDriver | None = None
    stage: Stage | None = None
    meter: PowerMeter | None = None
    turntable: SteppedTurntable | Stage | None = None
    lamp: Lamp | None = None
    closers: list[Callable[[], None]] = field(default_factory=list)

    def screen(self, projector: int) -> PatternScreen | VideoScreen:
        """The screen of a projector, counted from 0."""
        if not 0 <= projector < len(self.screens):
            raise BadInput(f"projector {projector}; expected one of the rig's {len(self.screens)}, counted from 0")
        return self.screens[projector]

    def move(self, position: float) -> float:
        """Move the camera to a position [mm] from the middle, in the dark; returns the reported position."""
        section, stage = need(self.rig.camera_stage, "camera_stage"), need(self.stage, "camera_stage")
        stage.move(section.middle + position, section.speed)
        stage.wait()
        found = stage.position() - section.middle
        if abs(found - position) > ARRIVED:
            raise BadInput(f"the camera's stage went to {found:g} mm instead of {position:g} mm; check its travel")
        return found

    def turn(self, angle: float, speed: float) -> float:
        """Turn forwards to an angle [deg] or past it, in the dark; returns the reported angle."""
        table = need(self.turntable, "motion")
        table.move(angle, speed)
        table.wait()
        return table.position()

    def focus(self, power: float, light: CalibrationLight) -> float:
        """Set the lens's power [dpt] and wait for it; returns the actual power, a whole number of steps of the lens."""
        section, lens = need(self.rig.lens, "lens"), need(self.lens, "lens")
        if not section.lowest <= power <= section.highest:
            raise BadInput(
                f"a lens power of {power:g} dpt; expected {section.lowest:g} to {section.highest:g} dpt, the "
                "limits of the rig"
            )
        lens.set_power(power)
        light.wait(SETTLINGS * section.settle)
        return lens.power()

    def image(self, light: CalibrationLight) -> np.ndarray:
        """An image of the camera that starts after now. Raises `BadInput` if it is overexposed."""
        section, camera = need(self.rig.camera, "camera"), need(self.camera, "camera")
        if isinstance(camera, Buffered):
            camera.flush()
        for _ in range(section.discard):
            camera.grab()
            light.alive()
        image = camera.grab()
        light.alive()
        over = float((image >= 2**section.bits - 1).mean())
        if over > SATURATED:
            raise BadInput(
                f"{100 * over:.1f} % of the camera's pixels are saturated; expected at most {100 * SATURATED:g} %: "
                "lower the camera's exposure in [[feedback]] or power in [light]"
            )
        return image

    def shown(self, light: CalibrationLight) -> np.ndarray:
        """An image of what a projector shows; on a video cable, the mean of exposures that fill a video frame."""
        if not self.rig.video:
            return self.image(light)
        frame, exposure = self.screens[0].period, need(self.rig.camera, "camera").exposure
        images = []
        for part in range(ceil(frame / exposure)):  # lamps and colors change within a video frame
            light.wait((part * exposure - self.clock.now() * 1e-9) % frame)
            images.append(self.image(light))
        return np.mean(images, axis=0)

    def read(self, light: CalibrationLight, repeats: int) -> np.ndarray:
        """Readings of the photodiode [mW] after it has settled; shape (repeats,)."""
        section, meter = need(self.rig.photodiode, "photodiode"), need(self.meter, "photodiode")
        light.wait(section.settle)
        found = np.empty(repeats)
        for number in range(repeats):
            found[number] = meter.power_mw()
            light.alive()
        return found

    def close(self) -> None:
        """Release all machines, the last opened first; raises the first error."""
        closers, self.closers = self.closers, []
        close_all(closers)


def need(part: T | None, table: str) -> T:
    """A machine that a run needs. Raises `JobError`, which names the table of the rig's file."""
    if part is None:
        driver = {"photodiode": "power meter", "camera": "camera"}.get(table)
        entry = f"[{table}]" if driver is None else f'[[feedback]] with driver = "{driver}"'
        raise JobError(
            f"the rig has no {table.replace('_', ' ')}, which this calibration needs; add {entry} to the rig's file"
        )
    return part


class CalibrationLight:
    """The light of one projector, off while a stage moves; waiting renews its lease."""

    def __init__(self, machines: CalibrationMachines, projector: int = 0) -> None:
        safety = machines.rig.safety
        self.clock: Clock = machines.clock
        self.controller: Controller | None = machines.controller
        self._power = machines.rig.light.power
        lamp, renew = gate(machines.controller, machines.lamp, (projector,))
        self.lease: Lease = Lease(machines.clock, renew, round(safety.lease * 1e9))
        others = {"mirrors": machines.screen(projector)}
        self.guard: LightGuard = LightGuard(lamp, self.lease, tolerance=1.0, others=others)
        camera = machines.rig.camera
        if self.controller is not None and camera is not None and camera.exposure > 0.5 * safety.lease:
            raise BadInput(
                f"the camera exposes {1e3 * camera.exposure:g} ms, and a lease of the light is "
                f"{1e3 * safety.lease:g} ms; expected at most half of it: expose shorter"
            )

    def __enter__(self) -> Self:
        self.guard.__enter__()
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        self.guard.__exit__(kind, error, trace)

    def on(self) -> None:
        self.lease.beat()
        self.lease.keep(force=True)
        self.guard.observe(armed=True, motion=0.0, shown=0, scheduled=0, fault=None)
        self.guard.on(self._power)

    def off(self) -> None:
        self.guard.off("between readings")

    def wait(self, seconds: float) -> None:
        """Wait, and check that the light may still be on. Raises `InterlockOpen`."""
        end, step = self.clock.now() + round(seconds * 1e9), self.lease.length // STEPS
        self.alive()
        while (now := self.clock.now()) < end:
            self.clock.sleep_until(min(end, now + step))
            self.alive()

    def alive(self) -> None:
        """Renew the lease. Raises `InterlockOpen` if the controller has switched the light off."""
        if self.guard.lit and self.controller is not None:
            status = self.controller.status()
            if status.state == "fault":
                self.guard.observe(fault=f"the controller switched the light off: {status.fault}")
        self.lease.beat()
        self.guard.check()
        self.lease.keep()


Progress = Callable[[float], None]
Read = Callable[[CalibrationLight, int], np.ndarray]  # takes a number of readings under a light


def silent(share: float) -> None:
    """Progress without a display."""


def part_of(progress: Progress, number: int, count: int) -> Progress:
    """The progress of one of several successive measurements."""
    return lambda share: progress((number + share) / count)


def over_patterns(
    machines: CalibrationMachines, projector: int, patterns: Iterable[np.ndarray], count: int, read: Read,
    repeats: int, progress: Progress, *, darks: int | None = None, black: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Readings in the dark, or under a black pattern, and those of each pattern [pattern, repeat]."""
    screen, found = machines.screen(projector), []
    with CalibrationLight(machines, projector) as light:
        if black is None:
            dark = read(light, darks or repeats)
            light.on()
        else:
            light.on()
            screen.show(black)
            dark = read(light, repeats)
        for number, pattern in enumerate(patterns):
            screen.show(pattern)
            found.append(read(light, repeats))
            progress((number + 1) / count)
    return dark, np.array(found)


def over_positions(
    machines: CalibrationMachines, projector: int, positions: Sequence[float], pattern: np.ndarray,
    act: Callable[[CalibrationLight, float], T], progress: Progress,
) -> list[T]:  # fmt: skip
    """Results of ``act`` under a lit pattern at each camera position [mm], reached in the dark."""
    screen, found = machines.screen(projector), []
    with CalibrationLight(machines, projector) as light:
        for number, position in enumerate(positions):
            light.off()
            place = machines.move(position)
            light.on()
            screen.show(pattern)
            try:
                found.append(act(light, place))
            except BadInput as error:
                raise BadInput(f"position {place:g} mm: {error}") from error
            progress((number + 1) / len(positions))
    return found
