"""A vial whose resin cures by the light that fell into the chamber, and the camera that watches it turn."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from vamgpu.hosts.emulators.chamber import Chamber
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.live import VirtualPrinter


class CuringCamera:
    """Images through a vial of curing resin; each turn's light acts when the turn is over.

    printer: the resin, and the camera's noise.  seen: light that the chamber got so far, in full-on slots [frame, row,
    column].  light: what so many slots of one turn are, in the plan's units [angle, r, z].
    """

    printer: VirtualPrinter

    def __init__(
        self, chamber: Chamber, clock: VirtualClock, printer: VirtualPrinter, seen: Callable[[], np.ndarray],
        light: Callable[[np.ndarray], np.ndarray],
    ) -> None:  # fmt: skip
        self._chamber, self._clock, self.printer, self._seen, self._light = chamber, clock, printer, seen, light
        self._before: np.ndarray | float = 0.0
        self._images: np.ndarray | None = None
        self._random = np.random.default_rng(printer.seed)

    def expose(self, exposure_us: float) -> None:
        """The light of the camera is as bright whatever its exposure."""

    def grab(self) -> np.ndarray:
        """The image at the vial's present angle, [row, column]."""
        turn, rest = divmod(self._chamber.pose(self._clock.now()) / self.printer.plan.motion.angles, 1.0)
        if turn > self.printer.turns:
            self.cure()
        if self._images is None:
            self._images = self.printer.images()
        return self.printer.camera.noise.expose(
            self._images[int(rest * len(self._images))], int(self._random.integers(2**31))
        )

    def cure(self) -> None:
        """Let the light since the last turn act."""
        seen = self._seen()
        self.printer.turn(self.printer.dose(self._light(seen - self._before)))
        self._before, self._images = seen, None

    def close(self) -> None:
        """Nothing is held."""
