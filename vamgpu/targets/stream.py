"""Targets without an end: tiles of fractions along a web, from a function of space or a mesh repeated along it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil, floor

import numpy as np
import numpy.typing as npt

from vamgpu.backend import open_device
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, EmptyMesh
from vamgpu.geometry import Grid, counts, positive
from vamgpu.targets.implicit import SAMPLES, Implicit
from vamgpu.targets.implicit import voxelize as sampled
from vamgpu.targets.solid import Solid
from vamgpu.targets.voxelize import voxelize
from vamgpu.web import WebGrid

_SLACK = 1e-6  # tolerance, in voxels, within which a length counts as a whole number of them
MOST_OVERLAPS = 1000  # number of copies of a part that may overlap; more mean a period in the wrong unit


@dataclass(frozen=True, eq=False)
class Repeated:
    """A closed surface in a film's coordinates (l, ρ, z) [mm], and endless copies, a ``period`` [mm] apart along l."""

    solid: Solid
    period: float

    def __post_init__(self) -> None:
        if not isinstance(self.solid, Solid):
            raise BadInput(f"got a {type(self.solid).__name__}; expected a Solid: load_mesh reads one from a file")
        period, extent = positive("period [mm]", self.period), float(np.ptp(self.solid.bounds[:, 0]))
        if extent > MOST_OVERLAPS * period:
            raise BadInput(
                f"period is {period:g} mm, but {self.solid.name} is {extent:.4g} mm long, so that "
                f"{extent / period:.3g} copies would overlap; expected at most {MOST_OVERLAPS}: use a longer period "
                "[mm]"
            )

    def copies(self, low: float, high: float) -> Solid | None:
        """All copies at least partly between two positions along l [mm], as one surface; or None."""
        begin, end = self.solid.bounds[:, 0]
        numbers = range(ceil((low - end) / self.period), floor((high - begin) / self.period) + 1)
        if not numbers:
            return None
        vertices, faces = self.solid.vertices, self.solid.faces
        moved = [vertices + (k * self.period, 0.0, 0.0) for k in numbers]
        return Solid(np.concatenate(moved), np.concatenate([faces + k * len(vertices) for k in range(len(moved))]),
                     self.solid.name)  # fmt: skip


def tile(
    shape: Implicit | Repeated, grid: WebGrid, start: float = 0.0, *, samples: int = SAMPLES,
    device: str | Device | None = None,
) -> npt.NDArray[np.float32]:  # fmt: skip
    """Filled fractions [l, rho, z] of a piece of web that begins ``start`` [mm] along it."""
    if not isinstance(shape, Repeated):
        return sampled(shape, grid, start=start, samples=samples)
    solid = shape.copies(start, start + grid.size[0])
    if solid is None:
        return np.zeros(grid.shape, np.float32)
    return section(solid, grid, start, device)


def section(
    solid: Solid, grid: WebGrid, start: float = 0.0, device: str | Device | None = None
) -> npt.NDArray[np.float32]:
    """Filled fractions [l, rho, z] of a surface in a piece of web that begins ``start`` [mm] along it."""
    # After scaling each axis, voxels are cubes of edge 1 about the middle of the tile: shares of volumes do not change.
    middle = (start + 0.5 * grid.size[0], 0.5 * grid.size[1], 0.0)
    cubes = Solid((solid.vertices - middle) / grid.edges, solid.faces, solid.name)
    return voxelize(cubes, Grid(grid.shape, 1.0), open_device(device)).fraction.numpy().astype(np.float32)


def stream(
    shape: Implicit | Repeated, section: tuple[int, int], pitch: tuple[float, float, float] | float, length: float,
    along: int, *, samples: int = SAMPLES, device: str | Device | None = None,
) -> Iterator[npt.NDArray[np.float32]]:  # fmt: skip
    """Tiles of fractions float32 [l, rho, z], one after another, that make a web of ``length`` [mm]."""
    section = counts("section (voxels along rho and z)", section, 2)  # type: ignore[assignment]
    grid = WebGrid((counts("along (voxels of a tile)", (along,), 1)[0], *section), pitch)
    voxels = ceil(positive("length [mm]", length) / grid.edges[0] - _SLACK)
    if not (callable(shape) or isinstance(shape, Repeated)):
        raise BadInput(f"got a {type(shape).__name__}; expected a function φ(l, ρ, z), or Repeated(solid, period)")
    if isinstance(shape, Repeated) and not _meets(shape.solid, grid):
        low, high = shape.solid.bounds
        raise EmptyMesh(
            f"{shape.solid.name} reaches from ρ = {low[1]:.4g} to {high[1]:.4g} mm and z = {low[2]:.4g} to "
            f"{high[2]:.4g} mm; expected part of it in the web, from ρ = 0 to {grid.size[1]:.4g} mm and ±"
            f"{0.5 * grid.size[2]:.4g} mm: move it"
        )
    starts, edge = range(0, voxels, grid.shape[0]), grid.edges[0]
    pieces = (WebGrid((min(grid.shape[0], voxels - k), *grid.shape[1:]), grid.pitch) for k in starts)
    return (
        tile(shape, piece, k * edge, samples=samples, device=device) for k, piece in zip(starts, pieces, strict=True)
    )


def _meets(solid: Solid, grid: WebGrid) -> bool:
    """Whether the surface's box and the web's section overlap."""
    low, high = solid.bounds
    return bool(high[1] > 0 and low[1] < grid.size[1]
                and low[2] < 0.5 * grid.size[2] and high[2] > -0.5 * grid.size[2])  # fmt: skip
