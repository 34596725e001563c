"""A vial whose resin cures by the recorded light, and its camera."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vamgpu.geometry import Beam
from vamgpu.live import LiveSetup, SensorNoise, Truth, VirtualPrinter
from vamgpu.live.sensor import BeamImages, SensorView
from vamgpu.metrics import score
from vamgpu.operators.projection import Projection

PARTS = 4  # parts of an edge of the beam's pixels that a camera sees apart


@dataclass(frozen=True, eq=False)
class EmulatedSensor:
    """A camera with pixels of its own: where they see parts of the beam's, its levels at first, and its noise."""

    view: SensorView  # of the parts
    open_field: np.ndarray  # [row, column] of the camera
    noise: SensorNoise

    def image(self, passed: np.ndarray, random: np.random.Generator) -> np.ndarray:
        """Levels of the share of light that passes each part of a pixel, [row, column], with noise."""
        light = (self.view.shown(passed) * self.open_field).astype(np.float32)
        noise = np.sqrt(self.noise.read**2 + self.noise.gain * light) * random.standard_normal(light.shape, np.float32)
        return np.clip(np.rint(self.view.dark + light + noise), 0, self.noise.brightest).astype(np.uint16)


def sensor_of(settings: Mapping[str, Any], setup: LiveSetup) -> EmulatedSensor | None:
    """The camera of a watched print's settings; None if its pixels are those of the beam."""
    if settings["view"] is None:
        return None
    view = SensorView(**settings["view"])
    field = np.asarray(setup.open_field, float) / BeamImages(view, setup.pixels).scale
    return EmulatedSensor(view.finer(PARTS), view.shown(field), SensorNoise(**settings["noise"]))


def printer_of(setup: LiveSetup, resin: Mapping[str, Any], sharp: bool) -> VirtualPrinter:
    """The print of a setup in a resin: its truth and seed. sharp: its camera sees light on parts of pixels."""
    camera, plan = setup.camera(), setup.projection(setup.vial)
    if sharp:
        rays = camera.projection
        columns, rows = setup.pixels
        beam = Beam((PARTS * columns, PARTS * rows), setup.pixel / PARTS, spread=0.0)
        rays = Projection(rays.grid, beam, rays.motion, rays.vessel, rays.device)
        camera = replace(camera, projection=rays, open_field=1.0)
    return VirtualPrinter(plan, camera, setup.resin, setup.turbidity, Truth(**resin["truth"]), resin["seed"])


class CuringCamera:
    """Images through a vial of curing resin [x, y, z]; the light of each turn takes effect at its end."""

    def __init__(
        self, emulated: Any, printer: VirtualPrinter, part: np.ndarray, seen: Callable[[], np.ndarray] | None,
        light: Callable[[np.ndarray], np.ndarray], sensor: EmulatedSensor | None = None,
    ) -> None:  # fmt: skip
        self.printer = printer
        self._emulated, self._part, self._seen, self._light = emulated, part, seen, light
        self._sensor = sensor
        self._before: np.ndarray | float = 0.0
        self._images: np.ndarray | None = None
        self._random = np.random.default_rng(printer.seed)

    def expose(self, exposure_us: float) -> None:
        """The camera's images have the same brightness for every exposure."""

    def grab(self) -> np.ndarray:
        """The image at the vial's present angle, [row, column]."""
        recorder, clock = self._emulated.recorder, self._emulated.clock
        turn, rest = divmod(recorder.pose(clock.now()) / self.printer.plan.motion.angles, 1.0)
        if turn > self.printer.turns:
            self.cure()
        if self._images is None:
            self._images = self.printer.images()
        image = self._images[int(rest * len(self._images))]
        if self._sensor is not None:
            return self._sensor.image(image, self._random)
        return self.printer.camera.noise.expose(image, int(self._random.integers(2**31)))

    def cure(self) -> None:
        """Let the light since the last turn take effect."""
        assert self._seen is not None
        seen = self._seen()
        self.printer.turn(self.printer.dose(self._light(seen - self._before)))
        self._before, self._images = seen, None

    def overlap(self) -> float:
        """Overlap of the print with its part."""
        device, printed = self.printer.plan.device, self.printer.printed().astype(np.float32)
        return float(score(device.upload(printed), device.upload(self._part), threshold=self.printer.resin.gel).iou)

    def close(self) -> None:
        """Nothing to release."""
