"""Emulated resin that scatters as it gels, before a camera: it gets what was truly lit in a chamber."""

from __future__ import annotations

import numpy as np

from vamgpu.hosts.emulators.camera import ResinScene, RunningCamera, Sensor
from vamgpu.hosts.emulators.chamber import Chamber
from vamgpu.hosts.emulators.clock import VirtualClock

RATE = 5.0
"""Dose that full drive brings [mW/mm3]."""
LIQUID = 1000.0
"""Electrons of a picture's pixel where the resin is liquid: the lamp that is looked by fits the exposure."""


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
