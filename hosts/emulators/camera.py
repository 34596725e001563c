"""An emulated camera: what a scene sends during the exposure, blurred, with noise, as whole numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vamgpu.hosts.emulators.chamber import Chamber
from vamgpu.hosts.emulators.clock import VirtualClock

MICRO = 1000
Scene = Callable[[int], np.ndarray]  # electrons a second ``[row, column]`` at a time [ns]


@dataclass(frozen=True)
class Sensor:
    """The camera's sensor: full well and noise of reading [electrons], bits, and an offset [levels]."""

    full_well: float = 30000.0
    read_noise: float = 7.0
    bits: int = 8
    offset: int = 2


@dataclass(eq=False)
class EmulatedCamera:
    """Looks at a scene; ``blur`` is the standard deviation of its optics' spot [pixel], or a function of time of it.

    The exposure is split in ``samples`` looks at the scene, at their middles, so that motion and settling smear.
    Noise comes from a generator with a seed: the same run makes the same images.
    """

    clock: VirtualClock
    scene: Scene
    sensor: Sensor = Sensor()
    blur: float | Callable[[int], float] = 0.0
    samples: int = 4
    seed: int = 0

    def __post_init__(self) -> None:
        self.exposure_us: float = 10_000.0
        self.grabbed: int = 0
        self._random = np.random.default_rng(self.seed)

    def expose(self, exposure_us: float) -> None:
        """Set the time of exposure [us]."""
        self.exposure_us = exposure_us

    def grab(self) -> np.ndarray:
        """Take an image ``[row, column]``; the clock passes the exposure."""
        part = self.exposure_us * MICRO / self.samples
        start = self.clock.now()
        electrons: np.ndarray | float = 0.0
        for sample in range(self.samples):
            middle = start + round((sample + 0.5) * part)
            self.clock.sleep_until(middle)
            electrons = electrons + self._look(middle) * (part * 1e-9)
        self.clock.sleep_until(start + round(self.samples * part))
        self.grabbed += 1
        return self._digitize(np.asarray(electrons))

    def _look(self, now: int) -> np.ndarray:
        seen = np.asarray(self.scene(now), float)
        spot = self.blur(now) if callable(self.blur) else self.blur
        if spot <= 0:
            return seen
        from scipy.ndimage import gaussian_filter

        return gaussian_filter(seen, spot, mode="nearest")

    def _digitize(self, electrons: np.ndarray) -> np.ndarray:
        sensor = self.sensor
        noisy = self._random.poisson(np.clip(electrons, 0, None)) + sensor.read_noise * self._random.standard_normal(
            electrons.shape
        )
        top = 2**sensor.bits - 1
        levels = np.rint(noisy / sensor.full_well * top) + sensor.offset
        return np.clip(levels, 0, top).astype(np.uint8 if sensor.bits <= 8 else np.uint16)

    def close(self) -> None:
        """Nothing is held."""


class RunningCamera(EmulatedCamera):
    """Takes an image each ``period`` [ns] by itself, as cameras do; nobody who asks for one holds the clock up by it.

    ``grab`` gives the newest image that was not given yet, and waits where there is none.
    """

    grabbed: int

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
        """Set the time of exposure [us], from the next image on."""
        with self.clock.lock:
            super().expose(exposure_us)
            self._ready = None
            self._begin(self.clock.now())

    def due(self) -> int | None:
        """When it looks next, or has an image [ns]."""
        return self._polls[0] if self._polls else self._end

    def advance(self, now: int) -> None:
        """Look, and begin again where the image is whole."""
        if self._polls:
            part = self.exposure_us * MICRO * 1e-9 / self.samples
            self._electrons = self._electrons + self._look(self._polls.pop(0)) * part
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
                self.grabbed += 1
                return self._digitize(ready)
            self.clock.sleep_until(until)

    def close(self) -> None:
        """No more images."""
        self.clock.detach(self)


@dataclass(frozen=True)
class ResinModel:
    """How resin scatters as it gels: little before ``critical`` [mJ/mm3], up to ``gain`` times more within ``width``.

    The signal rises along a logistic curve of dose, which is what an automatic exposure watches.
    """

    critical: float = 50.0
    width: float = 5.0
    base: float = 1.0
    gain: float = 8.0

    def scattering(self, dose: np.ndarray | float) -> np.ndarray:
        """Scattered light over that of liquid resin."""
        gelled = 1 / (1 + np.exp(-(np.asarray(dose, float) - self.critical) / self.width))
        return self.base + self.gain * gelled


class ResinScene:
    """A camera's view of resin that is being printed: collected dose makes it scatter the light of an observing lamp.

    ``deposit(rate, start, end)`` adds dose: a rate [mW/mm3] as an array ``[row, column]`` or a number, from ``start``
    to ``end`` [ns]. Called, it is a scene.
    """

    model: ResinModel

    def __init__(
        self, size: tuple[int, int], model: ResinModel = ResinModel(), electrons_per_s: float = 200_000.0
    ) -> None:
        self.model, self._electrons = model, electrons_per_s
        self.dose: np.ndarray = np.zeros(size)

    def deposit(self, rate: np.ndarray | float, start: int, end: int) -> None:
        """Add what came between two times."""
        self.dose += np.asarray(rate) * ((end - start) * 1e-9)

    def __call__(self, now: int) -> np.ndarray:
        """Electrons a second ``[row, column]``."""
        return self._electrons * self.model.scattering(self.dose)


RATE = 5.0  # dose that full drive brings [mW/mm3]
LIQUID = 1000.0  # electrons of an image's pixel where the resin is liquid: the lamp of the camera suits the exposure


def resin_camera(
    chamber: Chamber, clock: VirtualClock, exposure: float = 0.01, bits: int = 8, rate: float = RATE
) -> RunningCamera:
    """A camera that sees the resin of a chamber, a pixel for each mirror; its ``scene`` is a `ResinScene`.

    A pixel gets the light of its mirror from all sides, which is what a part looks like in the mean over a turn.
    exposure: [s].  bits: of the camera.  rate: dose of full drive [mW/mm3].
    """
    scene = ResinScene(chamber.mirrors, electrons_per_s=LIQUID / exposure)

    def lit(mirrors: np.ndarray, start: int, end: int) -> None:
        scene.deposit(rate * mirrors[: chamber.mirrors[0]], start, end)

    chamber.hears.append(lit)
    camera = RunningCamera(clock, scene, Sensor(bits=bits))
    camera.expose(1e6 * exposure)
    return camera
