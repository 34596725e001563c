"""An emulated laboratory for calibrations: mirrors, lens, lamp, a camera on a stage, and a photodiode, on one clock."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

import numpy as np

from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.drivers.dmd import Dmd
from vamgpu.hosts.drivers.lens import TunableLens
from vamgpu.hosts.drivers.scpi import PowerMeter
from vamgpu.hosts.drivers.wire import Wire
from vamgpu.hosts.drivers.zaber import ZaberStage
from vamgpu.hosts.emulators.array import ArrayModel, Shown
from vamgpu.hosts.emulators.camera import EmulatedCamera, Sensor
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.controller import EmulatedController
from vamgpu.hosts.emulators.dmd import FakeAlp
from vamgpu.hosts.emulators.instruments import EmulatedMeter
from vamgpu.hosts.emulators.lens import EmulatedLens
from vamgpu.hosts.emulators.optics import MICRO, Optics, box, smooth
from vamgpu.hosts.emulators.ports import plug
from vamgpu.hosts.emulators.stage import EmulatedStage

if TYPE_CHECKING:
    from vamgpu.hosts.rigs.config import RigFile

MEMORY = 100_000_000
"""How far back the photodiode's reading reaches [ns]."""
TRAVEL = 60.0
"""Of the camera's stage [mm]."""


class SeenAlp(FakeAlp):
    """Mirrors that remember when which picture stood, also the one that stands."""

    def __init__(self, clock: VirtualClock, model: ArrayModel) -> None:
        super().__init__(clock, model)
        self.seen: deque[Shown] = deque(maxlen=512)
        self.on_shown = self._over

    def _show(self, start: int) -> None:
        super()._show(start)
        if self._current is not None:
            self.seen.append(self._current[0])

    def _over(self, shown: Shown) -> None:
        """A picture is over, perhaps before its time."""
        if self.seen and self.seen[-1].number == shown.number:
            self.seen[-1] = shown


class Sight:
    """The light of mirrors over a time: of one projector, behind one channel of the lamp."""

    def __init__(self, alp: SeenAlp, channel: int, optics: Optics) -> None:
        self.alp, self.channel, self.optics = alp, channel, optics
        self._lamp: deque[tuple[int, float]] = deque([(0, 0.0)], maxlen=4096)

    def lamp(self, channels: int, powers: Iterable[int], now: int) -> None:
        """The lamp changes."""
        drive = list(powers)[self.channel] / 65535.0
        self._lamp.append((now, drive if channels >> self.channel & 1 else 0.0))

    def light(self, start: int, end: int, weight: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Mean light of each mirror [row, column] over a time [ns], 1 for one that is on; ``weight`` cumulates to 1."""
        optics = self.optics
        held: dict[tuple[int, int, int], tuple[Shown, float]] = {}
        for shown in reversed(self.alp.seen):
            if shown.ends[-1] < start:
                break
            for plane, (begin, stop) in enumerate(zip(shown.starts, shown.ends, strict=True)):
                lit = self._lit(begin + round(optics.turn * MICRO), stop, start, end, weight)
                key = (shown.sequence, shown.picture, plane)
                held[key] = (shown, held.get(key, (shown, 0.0))[1] + lit)
        total = np.zeros(optics.mirrors)
        for (_, _, plane), (shown, lit) in held.items():
            if lit:
                total += lit * shown.mirrors(plane, optics.mirrors[1])
        return optics.leak * self._lit(start, end, start, end, weight) + (1.0 - optics.leak) * total

    def _lit(self, begin: int, stop: int, start: int, end: int, weight: Callable[[np.ndarray], np.ndarray]) -> float:
        """Drive of the lamp from ``begin`` to ``stop``, weighted within start..end."""
        low, high = max(begin, start), min(stop, end)
        if high <= low:
            return 0.0
        times = [at for at, _ in self._lamp]
        total = 0.0
        for number, (at, drive) in enumerate(self._lamp):
            after = times[number + 1] if number + 1 < len(times) else high
            first, last = max(low, at), min(high, after)
            if drive and last > first:
                ends = weight((np.array([first, last]) - start) / (end - start))
                total += drive * float(ends[1] - ends[0])
        return total


class StandCamera(EmulatedCamera):
    """A camera on a stage, that looks into the projector's light."""

    def __init__(self, laboratory: Laboratory, sensor: Sensor, pixel: float) -> None:
        super().__init__(laboratory.clock, lambda now: np.zeros(laboratory.optics.view), sensor,
                         seed=laboratory.optics.seed)  # fmt: skip
        self.laboratory, self.pixel = laboratory, pixel

    def grab(self) -> np.ndarray:
        """Take a picture [row, column]; the clock passes the exposure."""
        start = self.clock.now()
        end = start + round(self.exposure_us * MICRO)
        self.clock.sleep_until(end)
        light = sum(sight.light(start, end, box) for sight in self.laboratory.sights)
        blur = self.laboratory.blur((start + end) // 2)
        self.grabbed += 1
        return self._digitize(self.laboratory.optics.image(np.asarray(light), self.pixel, blur) * (end - start) * 1e-9)


class Laboratory:
    """All machines, and the optics between them; each method opens the driver of one. numbers: lamps of projectors."""

    def __init__(self, optics: Optics, rig: RigFile, numbers: tuple[int, ...] = (0,)) -> None:
        self.optics, self.rig, self.clock = optics, rig, VirtualClock()
        rows, columns = optics.mirrors
        model = ArrayModel(height=rows, width=columns)
        self.box = EmulatedController(channels=max(2, *(number + 1 for number in numbers)))
        self.alps = [SeenAlp(self.clock, model) for _ in numbers]
        self.sights = [Sight(alp, number, optics) for alp, number in zip(self.alps, numbers, strict=True)]
        self.glass = EmulatedLens()
        self.axis = EmulatedStage(limit=round(TRAVEL * self._microsteps()))
        self.box.on_light = self._lamp

    def _microsteps(self) -> float:
        section = self.rig.camera_stage
        return 1000.0 if section is None else section.microsteps

    def _lamp(self, channels: int, now: int) -> None:
        for sight in self.sights:
            sight.lamp(channels, self.box.powers, now)

    def blur(self, now: int) -> float:
        """Of what the camera sees at a time [mm]."""
        section = self.rig.camera_stage
        middle = 0.0 if section is None else section.middle
        position = self.axis.true_position(now) / self._microsteps() - middle
        return self.optics.blur(position, self.glass.power(now))

    def controller(self) -> Controller:
        """The controller."""
        return Controller(Wire(plug(self.box, self.clock, 0.02), "the controller"))

    def mirrors(self) -> list[Dmd]:
        """The mirrors of each projector."""
        return [Dmd(alp.library) for alp in self.alps]

    def lens(self) -> TunableLens:
        """The lens, in focal power mode."""
        lens = TunableLens(Wire(plug(self.glass, self.clock, 0.25, 115200), "the lens driver"))
        lens.focal_power_mode()
        return lens

    def stage(self) -> ZaberStage:
        """The camera's stage."""
        wire = Wire(plug(self.axis, self.clock, 0.5), "the camera's stage")
        return ZaberStage(wire, self._microsteps(), "mm", pause=lambda seconds: self.clock.sleep(round(seconds * 1e9)))

    def camera(self) -> StandCamera:
        """The camera; without a size of its pixels that is the optics' mirrors' half."""
        section = self.rig.camera
        bits, pixel = (8, None) if section is None else (section.bits, section.pixel)
        camera = StandCamera(self, Sensor(bits=bits), pixel or 0.5 * self.optics.pitch)
        camera.expose(1e4 if section is None else 1e6 * section.exposure)
        return camera

    def meter(self) -> PowerMeter:
        """The photodiode."""
        optics = self.optics
        passes = optics.passes()

        def light(now: int) -> float:
            seen = sum(sight.light(max(now - MEMORY, 0), max(now, 1), smooth) for sight in self.sights)
            return optics.ambient + optics.full * float((np.asarray(seen).mean(axis=0) * passes).mean())

        meter = EmulatedMeter(light, optics.noise, seed=optics.seed)
        return PowerMeter(Wire(plug(meter, self.clock, 1.0), "the photodiode"))
