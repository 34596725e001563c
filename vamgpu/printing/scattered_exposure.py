"""Exposure of frames in a resin that scatters, by other photons and on other rings than the solver's."""

from __future__ import annotations

from math import ceil
from typing import Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.chemistry.oxygen import OxygenModel
from vamgpu.geometry import Grid
from vamgpu.kernels.gather import gather_rows
from vamgpu.operators.compose import combine
from vamgpu.operators.projection import Projection
from vamgpu.operators.ring_projection import in_voxels, rings_of
from vamgpu.operators.scattering_rings import ScatteringRings
from vamgpu.operators.traced_projection import BLOCK
from vamgpu.printing.independent_exposure import IndependentExposure, _Disc
from vamgpu.printing.oxygen_exposure import OxygenExposure

OTHER = 7919  # difference of the seed from that of the solver's photons
MORE = 2  # photons for each of the solver's
NARROW = 1.0  # ratio of the width of rings to that of voxels


class ScatteredExposure(IndependentExposure):
    """The light of frames in a resin that scatters: rays up to their first collision, and photons after it."""

    def __init__(self, A: ScatteringRings) -> None:
        rays = A.operator
        super().__init__(Projection(rays.grid, rays.beam, rays.motion, A.attenuated, rays.device))
        self._share = A.absorbed_share
        across = 2 * ceil(self.radius / self.grid.pitch)
        rings = rings_of(Grid((across, across, self.grid.shape[2]), self.grid.pitch), rays.motion.angles, NARROW)
        self._scattered = A.scattered(rings, MORE * A.photons, A.seed + OTHER)
        self._lit: tuple[DeviceArray, list[DeviceArray]] | None = None
        self._voxels: dict[tuple[float, int], dict[str, DeviceArray]] = {}

    def _expose(self, disc: _Disc, light: DeviceArray, z: np.ndarray, height: float) -> DeviceArray:
        dose, scattered, size = super()._expose(disc, light, z, height), self._scattered, disc.axis.size
        if self._lit is None or self._lit[0] is not light:
            self._lit = light, scattered.lit(light)
        profiles = scattered.profiles((z - self.grid.axes()[2][0]) / self.grid.pitch)
        work = (self.device.empty((*scattered.rings.shape[:2], z.size)) for _ in range(2))
        total = scattered.summed(profiles, self._lit[1], *work)
        if (disc.width, size) not in self._voxels:
            table = in_voxels(scattered.rings, Grid((size, size, 1), disc.width), self.radius)
            self._voxels[disc.width, size] = table.table(self.device, (size, size), BLOCK)
        part = self.device.empty(dose.shape)
        self.device.launch(gather_rows, source=total, **self._voxels[disc.width, size], out=part)
        return combine(self._share, dose, self._share, part, dose)


def is_traced(A: Any) -> bool:
    """Whether there are independent rays for an operator."""
    oxygen = isinstance(A, OxygenModel) and isinstance(A.operator, Projection)
    return oxygen or isinstance(A, Projection | ScatteringRings)


def exposure_of(A: Any) -> IndependentExposure | None:
    """The independent exposure of an operator's frames; None if there is none."""
    kinds: dict[type, Any] = {ScatteringRings: ScatteredExposure, OxygenModel: OxygenExposure}
    return kinds.get(type(A), IndependentExposure)(A) if is_traced(A) else None
