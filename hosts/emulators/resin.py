"""A vial whose resin cures by the recorded light, and its camera."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.dose import DoseRecorder
from vamgpu.live import VirtualPrinter


class CuringCamera:
    """Images through a vial of curing resin; the light of each turn takes effect at its end."""

    printer: VirtualPrinter

    def __init__(
        self, recorder: DoseRecorder, clock: VirtualClock, printer: VirtualPrinter, seen: Callable[[], np.ndarray],
        light: Callable[[np.ndarray], np.ndarray],
    ) -> None:  # fmt: skip
        self._recorder, self._clock, self.printer, self._seen, self._light = recorder, clock, printer, seen, light
        self._before: np.ndarray | float = 0.0
        self._images: np.ndarray | None = None
        self._random = np.random.default_rng(printer.seed)

    def expose(self, exposure_us: float) -> None:
        """The camera's images have the same brightness for every exposure."""

    def grab(self) -> np.ndarray:
        """The image at the vial's present angle, [row, column]."""
        turn, rest = divmod(self._recorder.pose(self._clock.now()) / self.printer.plan.motion.angles, 1.0)
        if turn > self.printer.turns:
            self.cure()
        if self._images is None:
            self._images = self.printer.images()
        return self.printer.camera.noise.expose(
            self._images[int(rest * len(self._images))], int(self._random.integers(2**31))
        )

    def cure(self) -> None:
        """Let the light since the last turn take effect."""
        seen = self._seen()
        self.printer.turn(self.printer.dose(self._light(seen - self._before)))
        self._before, self._images = seen, None

    def close(self) -> None:
        """Nothing to release."""
