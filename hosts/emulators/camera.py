"""An emulated camera: the light of a scene during the exposure, with noise, as whole numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.dose import DoseRecorder

MICRO = 1000
Scene = Callable[[int], np.ndarray]  # electrons per second ``[row, column]`` at a time [ns]


@dataclass(frozen=True)
class Sensor:
    """The camera's sensor: full well and read noise [electrons], bits, and an offset [levels]."""

    full_well: float = 30000.0
    read_noise: float = 7.0
    bits: int = 8
    offset: int = 2


@dataclass(eq=False)
class EmulatedCamera:
    """A camera of a scene, sampled ``samples`` times per exposure; its seed makes the noise repeatable."""

    clock: VirtualClock
    scene: Scene
    sensor: Sensor = Sensor()
    samples: int = 4
    seed: int = 0

    def __post_init__(self) -> None:
        self.exposure_us: float = 10_000.0
        self._random = np.random.default_rng(self.seed)

    def expose(self, exposure_us: float) -> None:
        self.exposure_us = exposure_us

    def grab(self) -> np.ndarray:
        """Take an image ``[row, column]``; the clock passes the exposure."""
        part = self.exposure_us * MICRO / self.samples
        start = self.clock.now()
        electrons: np.ndarray | float = 0.0
        for sample in range(self.samples):
            middle = start + round((sample + 0.5) * part)
            self.clock.sleep_until(middle)
            electrons = electrons + np.asarray(self.scene(middle), float) * (part * 1e-9)
        self.clock.sleep_until(start + round(self.samples * part))
        return self._digitize(np.asarray(electrons))

    def _digitize(self, electrons: np.ndarray) -> np.ndarray:
        sensor = self.sensor
        noisy = self._random.poisson(np.clip(electrons, 0, None)) + sensor.read_noise * self._random.standard_normal(
            electrons.shape
        )
        top = 2**sensor.bits - 1
        levels = np.rint(noisy / sensor.full_well * top) + sensor.offset
        return np.clip(levels, 0, top).astype(np.uint8 if sensor.bits <= 8 else np.uint16)

    def close(self) -> None:
        """Nothing to release."""


class RunningCamera(EmulatedCamera):
    """A free-running camera with an image every ``period`` [ns]; `grab` waits for a new one."""

    def __init__(
        self, clock: VirtualClock, scene: Scene, sensor: Sensor = Sensor(), period: int = 100_000_000, samples: int = 2,
        seed: int = 0,
    ) -> None:  # fmt: skip
        super().__init__(clock, scene, sensor, samples=samples, seed=seed)
        self._period, self._ready = period, None
        self._begin(clock.now())
        clock.attach(self)

    def _begin(self, start: int) -> None:
        """An image whose exposure ends a period after ``start`` [ns]."""
        part = self.exposure_us * MICRO / self.samples
        self._end = start + max(self._period, round(self.samples * part))
        self._polls = [self._end - round((k + 0.5) * part) for k in reversed(range(self.samples))]
        self._electrons: np.ndarray | float = 0.0

    def expose(self, exposure_us: float) -> None:
        """Set the exposure time [us], from the next image on."""
        with self.clock.lock:
            super().expose(exposure_us)
            self._ready = None
            self._begin(self.clock.now())

    def flush(self) -> None:
        """Start again, without the image taken so far."""
        self.expose(self.exposure_us)

    def due(self) -> int | None:
        """Time of its next sample or image [ns]."""
        return self._polls[0] if self._polls else self._end

    def advance(self, now: int) -> None:
        """Sample, and start again if the image is complete."""
        if self._polls:
            part = self.exposure_us * MICRO * 1e-9 / self.samples
            self._electrons = self._electrons + np.asarray(self.scene(self._polls.pop(0)), float) * part
            return
        self._ready = np.asarray(self._electrons)
        self._begin(now)

    def grab(self) -> np.ndarray:
        """The newest image ``[row, column]``."""
        while True:
            with self.clock.lock:
                ready, self._ready = self._ready, None
                until = self._end
            if ready is not None:
                return self._digitize(ready)
            self.clock.sleep_until(until)

    def close(self) -> None:
        self.clock.detach(self)


@dataclass(frozen=True)
class ResinModel:
    """Scattering of gelling resin: a logistic curve of dose."""

    critical: float = 50.0  # [mJ/mm3]
    width: float = 5.0  # [mJ/mm3]
    base: float = 1.0  # of liquid resin
    gain: float = 8.0  # added by gelled resin

    def scattering(self, dose: np.ndarray | float) -> np.ndarray:
        """Scattered light relative to liquid resin."""
        gelled = 1 / (1 + np.exp(-(np.asarray(dose, float) - self.critical) / self.width))
        return self.base + self.gain * gelled


class ResinScene:
    """A scene of resin, which scatters the light of a lamp according to its dose [mJ/mm3]."""

    def __init__(
        self, size: tuple[int, int], model: ResinModel = ResinModel(), electrons_per_s: float = 200_000.0
    ) -> None:
        self.model = model
        self._electrons = electrons_per_s
        self.dose: np.ndarray = np.zeros(size)

    def deposit(self, rate: np.ndarray | float, start: int, end: int) -> None:
        """Add the light between two times."""
        self.dose += np.asarray(rate) * ((end - start) * 1e-9)

    def __call__(self, now: int) -> np.ndarray:
        """Electrons per second ``[row, column]``."""
        return self._electrons * self.model.scattering(self.dose)


RATE = 5.0  # dose rate at full drive [mW/mm3]
LIQUID = 1000.0  # electrons of an image's pixel in liquid resin: the lamp of the camera is adapted to the exposure


def resin_camera(recorder: DoseRecorder, clock: VirtualClock, exposure: float = 0.01, bits: int = 8) -> RunningCamera:
    """Watch the resin with one pixel per mirror, which receives its mirror's light from all sides; exposure [s]."""
    scene = ResinScene(recorder.mirrors, electrons_per_s=LIQUID / exposure)

    def lit(mirrors: np.ndarray, start: int, end: int) -> None:
        scene.deposit(RATE * mirrors[: recorder.mirrors[0]], start, end)

    recorder.listeners.append(lit)
    camera = RunningCamera(clock, scene, Sensor(bits=bits))
    camera.expose(1e6 * exposure)
    return camera
