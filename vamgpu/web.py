"""The components of a web: a film that a roller carries past the light of one angle, and the light in the flat film.

Axes are ``[l, rho, z]``: l along the web, rho from the roller's side (0) to the outer face, z across the web. At angle
k the window of light begins ``k · step`` further along the web; everything else is the same at every angle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.geometry import Beam, centers, counts
from vamgpu.schema.quantities import Length, measured


@dataclass(frozen=True)
class WebGrid:
    """Voxels of a film laid flat.

    Args:
        shape: Voxels along l, rho, z.
        pitch: Voxel edges [mm] along l, rho, z; one number for cubes.

    Raises:
        BadInput: A value is out of its range.
    """

    shape: tuple[int, int, int]
    pitch: tuple[float, float, float] | float

    def __post_init__(self) -> None:
        pitch = (self.pitch,) * 3 if isinstance(self.pitch, (int, float, str)) else tuple(self.pitch)
        if len(pitch) != 3:
            raise BadInput(f"WebGrid pitch is {self.pitch!r}; expected one length or three, along l, rho and z [mm]")
        object.__setattr__(self, "shape", counts("WebGrid shape", self.shape, 3))
        object.__setattr__(self, "pitch", tuple(measured("WebGrid pitch", p, Length) for p in pitch))

    @property
    def edges(self) -> tuple[float, float, float]:
        """Voxel edges [mm] along l, rho, z."""
        return self.pitch  # type: ignore[return-value] - three numbers once made

    @property
    def voxel_volume(self) -> float:
        """Volume of one voxel of the flat film [mm³]."""
        return float(np.prod(self.edges))

    @property
    def size(self) -> tuple[float, float, float]:
        """Extent [mm] along l, rho, z."""
        along, deep, across = (n * p for n, p in zip(self.shape, self.edges, strict=True))
        return along, deep, across

    def axes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Voxel centers: l from the web's beginning, rho from the roller, z about the middle of the web.

        Returns:
            Positions [mm] along l (nl,), rho (nrho,) and z (nz,).
        """
        (n_l, n_rho, n_z), (dl, drho, dz) = self.shape, self.edges
        return (np.arange(n_l) + 0.5) * dl, (np.arange(n_rho) + 0.5) * drho, centers(n_z, dz)


@dataclass(frozen=True)
class Propagation:
    """Light of one angle in the flat film: the sparse P[r, rho, l] of columns over the window of light."""

    # shape: (columns r, layers rho, window columns l). r, rho, l: indices of the entries, int32, in lexical order,
    # without duplicates. weight: float64: length [mm] of the ray in the voxel × transmittance × absorbed fraction per
    # mm. middle: window coordinate l [mm] of the point nearest the light. way: columns that the film moves while the
    # angle is lit, half of them before its position; entries are of a film at rest there.

    shape: tuple[int, int, int]
    r: np.ndarray
    rho: np.ndarray
    l: np.ndarray  # noqa: E741 - the web's axis
    weight: np.ndarray
    middle: float = 0.0
    way: float = 0.0

    @classmethod
    def gathered(
        cls, shape: tuple[int, int, int], r: np.ndarray, rho: np.ndarray, l: np.ndarray, weight: np.ndarray,  # noqa: E741
        middle: float = 0.0,
    ) -> Propagation:  # fmt: skip
        """Build from entries in any order; those of one voxel and ray are summed."""
        flat = np.ravel_multi_index((r, rho, l), shape)
        cells, inverse = np.unique(flat, return_inverse=True)
        total = np.bincount(inverse, weights=weight, minlength=cells.size)
        row, layer, column = (index.astype(np.int32) for index in np.unravel_index(cells, shape))
        return cls(shape, row, layer, column, total, middle)

    @property
    def moving(self) -> Propagation:
        """The mean over the film's motion, linear between whole columns; light at the window's edge stays there."""
        if self.way <= 0.0:
            return self
        way, shares = way_taps(self.way)
        columns = np.clip(self.l + way[:, None], 0, self.shape[2] - 1)
        count = way.size
        weight = (shares[:, None] * self.weight).ravel()
        return Propagation.gathered(
            self.shape, np.tile(self.r, count), np.tile(self.rho, count), columns.ravel(), weight, self.middle
        )

    def dense(self) -> np.ndarray:
        """P itself, (r, rho, l), float64."""
        matrix = np.zeros(self.shape)
        matrix[self.r, self.rho, self.l] = self.weight
        return matrix


def way_taps(width: float, share: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Columns near a position, and the fraction of light in each, if the film moves by a width [columns] meanwhile."""
    reach = int(np.ceil(0.5 * width)) + 1
    columns = np.arange(-reach, reach + 2)
    if width <= 0.0:
        shares = np.maximum(1.0 - np.abs(columns - share), 0.0)
    else:
        ends = [np.clip(columns - share + side * width, -1.0, 1.0) for side in (0.5, -0.5)]
        high, low = (0.5 + end - 0.5 * end * np.abs(end) for end in ends)  # integrals between columns
        shares = (high - low) / width
    kept = shares > 0.0
    return columns[kept], shares[kept]


@runtime_checkable
class Wrap(Protocol):
    """The machine that carries the film, with the attributes that a web projector uses."""

    @property
    def advance(self) -> float:
        """Distance [mm] that the film moves along its neutral line from one angle to the next."""
        ...

    def propagation(self, grid: WebGrid, beam: Beam) -> Propagation:
        """Light of one angle over a window of ``grid``'s voxels; only its rho and z extents and pitches count."""
        ...


def light_of_pose(wrap: Wrap, grid: WebGrid, beam: Beam, device: object) -> Propagation:
    """The sparse light P[r, rho, l] of one angle, computed on a device if the machine supports it."""
    where = {"device": device} if getattr(wrap, "marched", False) else {}
    return wrap.propagation(grid, beam, **where)
