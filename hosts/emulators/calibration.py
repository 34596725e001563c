"""An emulated rig for calibrations: mirrors, lens, lamp, a camera on a stage, and a photodiode, on one clock."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from math import ceil
from typing import Any

import numpy as np

from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.drivers.dmd import Dmd
from vamgpu.hosts.drivers.lamp import TtlLamp
from vamgpu.hosts.drivers.lens import LensDriver
from vamgpu.hosts.drivers.projector import HdmiProjector
from vamgpu.hosts.drivers.scpi import PowerMeter
from vamgpu.hosts.drivers.stages import ZaberStage
from vamgpu.hosts.drivers.wire import Wire
from vamgpu.hosts.emulators.alp import EmulatedAlp
from vamgpu.hosts.emulators.array import ArrayModel, DisplayedFrame
from vamgpu.hosts.emulators.camera import EmulatedCamera, Sensor
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.controller import EmulatedController
from vamgpu.hosts.emulators.lens import EmulatedLens
from vamgpu.hosts.emulators.line import LineDevice, VirtualPort
from vamgpu.hosts.emulators.rigs import EmulatedLine
from vamgpu.hosts.emulators.screen import EmulatedScreen, LitSlot
from vamgpu.hosts.emulators.stage import EmulatedStage

GREATEST = 500.0  # range of the meter [mW]


class EmulatedMeter(LineDevice):
    """A photodiode's meter that reads ``light(now)`` [mW], with noise [mW]; beyond its range it has no value."""

    def __init__(self, light: Callable[[int], float], noise_mw: float = 0.0, seed: int = 0) -> None:
        super().__init__(5000.0)
        self.errors: deque[str] = deque()
        self._light, self._noise = light, noise_mw
        self._random = np.random.default_rng(seed)
        self.wavelength: float = 405.0
        self.count: int = 1

    def receive(self, data: bytes, now: int) -> None:
        for line in self.lines(data):
            if words := line.decode("ascii", "replace").upper().split():
                answer = self._answer(words, now)
                if answer is None:
                    self.errors.append('-113,"Undefined header"')
                elif answer:
                    self._out.put(answer.encode("ascii") + b"\n", now)

    def _answer(self, words: list[str], now: int) -> str | None:
        """The answer to a command ('' if it has none), or None if there is no such command."""
        match words:
            case ["*IDN?"]:
                return "Emulated,PM400,1001,1.0"
            case ["*CLS"]:
                self.errors.clear()
            case ["SYST:ERR?"]:
                return self.errors.popleft() if self.errors else '+0,"No error"'
            case ["MEAS:POW?"]:
                reading = self._light(now) + self._noise / self.count**0.5 * self._random.standard_normal()
                return "9.91E+37" if reading > GREATEST else f"{reading / 1000:.9E}"
            case ["SENS:CORR:WAV", value]:
                wavelength = float(value)
                if 350 <= wavelength <= 1100:
                    self.wavelength = wavelength
                else:
                    self.errors.append('-222,"Data out of range"')
            case ["SENS:AVER:COUN", value]:
                self.count = int(value)
            case _:
                return None
        return ""


MICRO = 1000
FAINT = 1e-15
PARTS = 4  # number of parts of a column that a pin shades, each uniformly


@dataclass(frozen=True)
class Optics:
    """The truth for calibrations; the focus is at middle + slope · power."""

    slope: float = -40.6  # [mm/dpt]
    middle: float = 0.35  # [mm], from the middle of the camera's stage
    waist: float = 0.0138  # standard deviation of the blur in focus [mm]
    depth: float = 3.8  # depth of focus, to a blur √2 times as wide, end to end [mm]
    mirrors: tuple[int, int] = (96, 192)  # rows and columns
    pitch: float = 0.0144  # size of a mirror in the image [mm]
    view: tuple[int, int] = (104, 208)  # rows and columns of the camera
    electrons: float = 4.0e6  # electrons per pixel and second in full light
    back: float = 0.0  # of the light behind the vial, in the middle of the camera's view
    flip: bool = False  # the camera's images are mirrored left-right
    rotation: int = 0  # and then turned clockwise [deg]
    axis: float = 98.3  # of the roller [columns]
    radius: float = 55.2  # of the roller [columns]
    shadow: float = 1.3  # blur of the roller's edges [columns]
    leak: float = 0.002  # light of a mirror that is off, relative to one that is on
    turn: float = 4.0  # dark time at the start of each plane [us]
    full: float = 20.0  # light of all mirrors on the photodiode [mW]
    pin: float = 0.0  # half the width of a pin on the turntable [columns]; 0 for none
    across: tuple[float, float] = (2.4, -1.3)  # position of the pin: factors of (cos, sin) of its angle [columns]
    lean: float = 0.006  # slope of the pin [columns per row]
    wobble: tuple[float, float] = (0.010, 0.014)  # added to it, times (cos, sin)
    tilt: float = 0.0  # relative dimming of mirrors at the right edge
    falloff: float = 0.0  # relative dimming of mirrors in the corners
    ambient: float = 0.02  # [mW]
    noise: float = 0.001  # of the photodiode [mW]
    seed: int = 0

    def blur(self, position: float, power: float) -> float:
        """Standard deviation [mm] of the blur at a camera's position [mm] and a lens power [dpt]."""
        off = position - self.middle - self.slope * power
        return self.waist * float(np.hypot(1.0, 2.0 * off / self.depth))

    def modulation(self, frequency: np.ndarray, position: float, power: float, pixel: float) -> np.ndarray:
        """Modulation at frequencies [1/mm]: of the blur, the mirrors and the camera's pixels."""
        gauss = np.exp(-2.0 * (np.pi * self.blur(position, power) * frequency) ** 2)
        return gauss * np.sinc(frequency * self.pitch) * np.sinc(frequency * pixel)

    def gray(self, level: int, lit: int) -> float:
        """Light of a gray level relative to mirrors that are always on; ``lit``: time of a frame [us]."""
        planes = [lit * (1 << bit) / 255.0 - self.turn for bit in range(8) if level >> bit & 1]
        return self.leak + (1.0 - self.leak) * sum(planes) / lit

    def flat(self) -> np.ndarray:
        """Light of full-on mirrors [row, column] relative to one in the middle."""
        down, across = (np.linspace(-1.0, 1.0, length) for length in self.mirrors)
        return 1.0 - self.tilt * across[None, :] - 0.5 * self.falloff * (down[:, None] ** 2 + across[None, :] ** 2)

    def backlight(self) -> np.ndarray:
        """Light behind the vial [row, column] of the camera's view, relative to its middle."""
        down, across = (np.linspace(-1.0, 1.0, length) for length in self.view)
        return 1.0 - 0.1 * (down[:, None] ** 2 + across[None, :] ** 2)

    def turned(self, image: np.ndarray) -> np.ndarray:
        """An upright image as the camera gives it."""
        return np.rot90(image[:, ::-1] if self.flip else image, -self.rotation // 90)

    def passes(self) -> np.ndarray:
        """Share of a column's light that passes the roller."""
        from scipy.special import ndtr

        column = np.arange(self.mirrors[1])
        left = ndtr((self.axis - self.radius - column) / self.shadow)
        return left + ndtr((column - self.axis - self.radius) / self.shadow)

    def pinned(self, light: np.ndarray, angle: float) -> np.ndarray:
        """Light [row, part of a column], each column in `PARTS`, that passes a pin at the turntable's angle [rad]."""
        wave = np.array([np.cos(angle), np.sin(angle)])
        row = np.arange(light.shape[0]) - 0.5 * (light.shape[0] - 1)
        center = self.axis + wave @ self.across + (self.lean + wave @ self.wobble) * row
        edge = np.arange(light.shape[1] * PARTS + 1) / PARTS - 0.5
        covered = np.diff(np.clip(edge - center[:, None], -self.pin, self.pin), axis=1) * PARTS
        return np.repeat(light, PARTS, axis=1) * (1.0 - covered)

    def spread(self, mirrors: int, pixels: int, pixel: float, blur: float, parts: int = 1) -> np.ndarray:
        """Weights [pixel, mirror] of one axis: the overlap of a blurred mirror with a pixel; exact."""
        edge = (np.arange(mirrors + 1) - 0.5 * mirrors) * self.pitch / parts
        border = (np.arange(pixels + 1) - 0.5 * pixels) * pixel
        area = _ramp((border[:, None] - edge[None, :]) / blur) * blur
        weights = -np.diff(np.diff(area, axis=0), axis=1) / pixel
        return np.where(weights > FAINT, weights, 0.0)  # subnormal numbers would take more time than all others

    def image(self, light: np.ndarray, pixel: float, blur: float, angle: float = 0.0) -> np.ndarray:
        """Image [electrons/s] of light on the mirrors [row, column], past the pin at an angle [rad]."""
        parts = PARTS if self.pin else 1
        light = self.pinned(light, angle) if self.pin else light
        down = self.spread(light.shape[0], self.view[0], pixel, blur)
        across = self.spread(light.shape[1], self.view[1], pixel, blur, parts)
        return self.turned(self.electrons * (down @ light @ across.T) + self.back * self.backlight())


def _ramp(u: np.ndarray) -> np.ndarray:
    """Integral of the normal distribution up to u."""
    from scipy.special import ndtr

    return u * ndtr(u) + np.exp(-0.5 * u**2) / np.sqrt(2.0 * np.pi)


def box(share: np.ndarray) -> np.ndarray:
    """Cumulative weight of light up to a share of an exposure: uniform."""
    return share


def smooth(share: np.ndarray) -> np.ndarray:
    """Cumulative weight of light up to a share of a slow meter's memory: it rises and falls smoothly."""
    return share - np.sin(2.0 * np.pi * share) / (2.0 * np.pi)


MEMORY = 100_000_000  # memory of the photodiode [ns]
TRAVEL = 60.0  # of the camera's stage [mm]


class RecordingAlp(EmulatedAlp):
    """Mirrors that record when each frame was shown, with the present one."""

    def __init__(self, clock: VirtualClock, model: ArrayModel) -> None:
        super().__init__(clock, model)
        self.seen: deque[DisplayedFrame] = deque(maxlen=512)
        self.on_shown: Callable[[DisplayedFrame], None] | None = self._over

    def _show(self, start: int) -> None:
        super()._show(start)
        if self._current is not None:
            self.seen.append(self._current[0])

    def _over(self, shown: DisplayedFrame) -> None:
        """A frame has ended, perhaps early."""
        if self.seen and self.seen[-1].number == shown.number:
            self.seen[-1] = shown


class ProjectedLight:
    """The light of a projector over a time, with one channel of the lamp."""

    def __init__(self, channel: int, optics: Optics) -> None:
        self.channel = channel
        self.optics = optics
        self._lamp: deque[tuple[int, float]] = deque([(0, 0.0)], maxlen=4096)

    def lamp(self, channels: int, powers: Iterable[int], now: int) -> None:
        drive = list(powers)[self.channel] / 65535.0
        self._lamp.append((now, drive if channels >> self.channel & 1 else 0.0))

    def light(self, start: int, end: int, weight: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Mean light of each mirror [row, column] over a time [ns], 1 if it is on; ``weight`` is cumulative."""
        optics, total = self.optics, np.zeros(self.optics.mirrors)
        for lit, levels in self._levels(start, end, weight):
            total += lit * levels
        dark = optics.leak * self._lit(start, end, start, end, weight)
        return optics.flat() * (dark + (1.0 - optics.leak) * total)

    def _levels(self, start: int, end: int, weight: Callable[[np.ndarray], np.ndarray]) -> Iterator[tuple[Any, Any]]:
        """Lit shares of a time, and the light of each mirror meanwhile."""
        raise NotImplementedError

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


class MirrorLight(ProjectedLight):
    """The light of mirrors that show bit planes."""

    def __init__(self, alp: RecordingAlp, channel: int, optics: Optics) -> None:
        super().__init__(channel, optics)
        self.alp = alp

    def _levels(self, start: int, end: int, weight: Callable[[np.ndarray], np.ndarray]) -> Iterator[tuple[Any, Any]]:
        held: dict[tuple[int, int, int], tuple[DisplayedFrame, float]] = {}
        for shown in reversed(self.alp.seen):
            if shown.ends[-1] < start:
                break
            for plane, (begin, stop) in enumerate(zip(shown.starts, shown.ends, strict=True)):
                lit = self._lit(begin + round(self.optics.turn * MICRO), stop, start, end, weight)
                key = (shown.sequence, shown.frame, plane)
                held[key] = (shown, held.get(key, (shown, 0.0))[1] + lit)
        return (
            (lit, shown.mirrors(key[2], self.optics.mirrors[1])) for key, (shown, lit) in held.items() if lit
        )  # fmt: skip


class CableLight(ProjectedLight):
    """The light of a projector on a video cable."""

    def __init__(self, screen: EmulatedScreen, channel: int, optics: Optics) -> None:
        super().__init__(channel, optics)
        self._slots: deque[LitSlot] = deque(maxlen=512)
        screen.on_slot = self._slots.append

    def _levels(self, start: int, end: int, weight: Callable[[np.ndarray], np.ndarray]) -> Iterator[tuple[Any, Any]]:
        for slot in self._slots:
            if slot.end > start and slot.levels.any():
                yield self._lit(slot.start, slot.end, start, end, weight), slot.levels / slot.top


class RigCamera(EmulatedCamera):
    """A camera on a stage that faces the projector; it exposes one image after another, and keeps all."""

    def __init__(self, emulated: EmulatedCalibrationRig, sensor: Sensor, pixel: float) -> None:
        super().__init__(emulated.clock, lambda now: np.zeros(emulated.optics.view), sensor,
                         seed=emulated.optics.seed)  # fmt: skip
        self.emulated = emulated
        self.pixel = pixel
        self.flush()

    def flush(self) -> None:
        """Drop the images so far."""
        self._next = self.clock.now()

    def grab(self) -> np.ndarray:
        start = self._next
        self._next = end = start + round(self.exposure_us * MICRO)
        self.clock.sleep_until(end + self.emulated.readout)
        light = sum(sight.light(start, end, box) for sight in self.emulated.sights)
        blur, angle = self.emulated.blur((start + end) // 2), self.emulated.angle(end)
        return self._digitize(
            self.emulated.optics.image(np.asarray(light), self.pixel, blur, angle) * (end - start) * 1e-9
        )


class EmulatedCalibrationRig:
    """All machines, and the optics between them; each method opens a driver."""

    def __init__(self, optics: Optics, rig: Any) -> None:
        self.optics = optics
        self.rig = rig  # contents of its file
        self.clock: VirtualClock = VirtualClock()
        rows, columns = optics.mirrors
        self.readout = ceil(1e9 / rig.display[0].refresh) if rig.video else 0  # until a screen's light is known [ns]
        self._power = [round(65535 * rig.light.power)] * len(rig.display)
        self.box: EmulatedController = EmulatedController(channels=max(2, len(rig.display)))
        self._shown: list[Any] = [self._display(section, ArrayModel(height=rows, width=columns))
                                  for section in rig.display]  # fmt: skip
        kind = CableLight if rig.video else MirrorLight
        self.sights: list[Any] = [kind(each, k, optics) for k, each in enumerate(self._shown)]
        self.glass: EmulatedLens = EmulatedLens()
        self.axis: EmulatedStage = EmulatedStage(limit=round(TRAVEL * self._microsteps()))
        self.box.on_light = self._lamp
        if rig.light.gate == "display":  # its lamp is always on
            self._switched(True)

    def _display(self, section: Any, model: ArrayModel) -> Any:
        """Mirrors or a screen, of the optics' size."""
        if not self.rig.video:
            return RecordingAlp(self.clock, model)
        order = "".join("RGB"[channel] for channel in section.layout.channels)
        share = 1.0 - section.dark * section.refresh * len(order)
        return EmulatedScreen(self.clock, self.optics.mirrors, section.refresh, order, section.bits, section.latency,
                              share)  # fmt: skip

    def _microsteps(self) -> float:
        section = self.rig.camera_stage
        return 1000.0 if section is None else section.microsteps

    def _lamp(self, channels: int, now: int) -> None:
        for sight in self.sights:
            sight.lamp(channels, self.box.powers, now)

    def _switched(self, on: bool) -> None:
        """The lamps without a controller go on or off."""
        for sight in self.sights:
            sight.lamp((1 << len(self.sights)) - 1 if on else 0, self._power, self.clock.now())

    def blur(self, now: int) -> float:
        """Blur of the camera's image at a time [mm]."""
        section = self.rig.camera_stage
        middle = 0.0 if section is None else section.middle
        position = self.axis.true_position(now) / self._microsteps() - middle
        return self.optics.blur(position, self.glass.power(now))

    def angle(self, now: int) -> float:
        """Angle of the turntable at a time [rad]."""
        return float(np.radians(self.box.web.position(now) / self.rig.motion.microsteps))

    def controller(self) -> Controller | None:
        if self.rig.controller is None:
            return None
        return Controller(Wire(VirtualPort(self.box, self.clock, 0.02), "the controller"), self.rig.motion.microsteps)

    def lamp(self) -> TtlLamp | None:
        return TtlLamp(EmulatedLine(self._switched)) if self.rig.light.gate == "line" else None

    def displays(self) -> list[Any]:
        if not self.rig.video:
            return [Dmd(alp.library) for alp in self._shown]
        return [HdmiProjector(screen, section.layout, section.latency)
                for screen, section in zip(self._shown, self.rig.display, strict=True)]  # fmt: skip

    def lens(self) -> LensDriver:
        lens = LensDriver(Wire(VirtualPort(self.glass, self.clock, 0.25, 115200), "the lens driver"))
        lens.focal_power_mode()
        return lens

    def stage(self) -> ZaberStage:
        wire = Wire(VirtualPort(self.axis, self.clock, 0.5), "the camera's stage")
        return ZaberStage(wire, self._microsteps(), "mm", pause=lambda seconds: self.clock.sleep(round(seconds * 1e9)))

    def camera(self) -> RigCamera:
        """The camera; by default its pixels see half a mirror of the optics."""
        section = self.rig.camera
        bits, pixel = (8, None) if section is None else (section.bits, section.pixel)
        camera = RigCamera(self, Sensor(bits=bits), pixel or 0.5 * self.optics.pitch)
        camera.expose(1e4 if section is None else 1e6 * section.exposure)
        return camera

    def meter(self) -> PowerMeter:
        optics = self.optics
        passes = optics.passes()

        def light(now: int) -> float:
            seen = sum(sight.light(max(now - MEMORY, 0), max(now, 1), smooth) for sight in self.sights)
            return optics.ambient + optics.full * float((np.asarray(seen).mean(axis=0) * passes).mean())

        meter = EmulatedMeter(light, optics.noise, seed=optics.seed)
        return PowerMeter(Wire(VirtualPort(meter, self.clock, 1.0), "the photodiode"))


def marked_vial(ratio: float) -> tuple[VirtualClock, ZaberStage, EmulatedCamera]:
    """A stage whose vial turns by ``ratio`` of what it reports, and a camera that sees a mark on the vial's front."""
    clock, steps = VirtualClock(), 1000.0
    machine = EmulatedStage(rotary=True, acceleration=200_000.0, scale=ratio)
    rows, columns = np.mgrid[-1.0:1.0:48j, -1.0:1.0:64j]

    def scene(now: int) -> np.ndarray:
        angle = np.radians(machine.true_position(now) / steps)
        mark = np.exp(-(((rows - 0.7 * np.sin(angle)) / 0.1) ** 2) - (columns / 0.3) ** 2)
        return 1e6 * (0.3 + 0.5 * max(float(np.cos(angle)), 0.0) * mark)

    return clock, ZaberStage(Wire(VirtualPort(machine, clock, 0.02), "the stage"), steps), EmulatedCamera(clock, scene)
