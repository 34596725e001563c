"""Bodies of a scene in the film of a web."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from vamgpu.backend import open_device
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.scene.body import Body, Place
from vamgpu.targets.implicit import voxelize as filled
from vamgpu.targets.limits import Limits
from vamgpu.targets.stream import section
from vamgpu.targets.target import Target
from vamgpu.web import WebGrid


@dataclass(frozen=True, eq=False)
class WebPart:
    """Part of a scene on a web; a target of `optimize`.

    Args:
        grid: The voxels of the film.
        name: In messages.
        fraction: Filled share of each voxel, [l, rho, z].
        limits: What single voxels are asked for; None where the part is to print and nothing else.
    """

    grid: WebGrid
    name: str
    fraction: npt.NDArray[np.floating]
    limits: Limits | None = None
    _copies: dict[str, DeviceArray] = field(default_factory=dict, init=False, repr=False)

    def on(self, device: str | Device | None = None) -> DeviceArray:
        """The fractions as a field on a device; copied there once, then kept.

        Args:
            device: A name or a device; the best one here by default.

        Returns:
            Fractions [l, rho, z].
        """
        place = open_device(device)
        if place.name not in self._copies:
            self._copies[place.name] = place.upload(self.fraction)
        return self._copies[place.name]

    def numpy(self) -> npt.NDArray[np.floating]:
        """The fractions in NumPy.

        Returns:
            Fractions [l, rho, z].
        """
        return self.fraction


def shares_on_web(body: Body, grid: WebGrid, place: Place, device: Device) -> npt.NDArray[np.float32]:
    """The share of every voxel of a film that a body fills. Raises `BadInput`."""
    solid = body.solid(place)
    if solid is not None:
        return section(solid, grid, 0.0, device)
    if not isinstance(body.source, Target):
        return filled(body.placed(place), grid)
    pitch = grid.edges[0]
    if not np.allclose(grid.edges, pitch, rtol=1e-9):
        edges = " × ".join(f"{edge:g}" for edge in grid.edges)
        raise BadInput(f"body {body.name!r} is a mask, and the voxels of the web are {edges} mm; expected cubes: give "
                       "a mesh or a function, or one pitch")  # fmt: skip
    middle = (0.5 * grid.size[0], 0.5 * grid.size[1], 0.0)
    return body.averaged_mask(grid.shape, pitch, middle, place, device)
