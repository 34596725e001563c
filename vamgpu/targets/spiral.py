"""A web wound into a spiral: solids thicker than the film are cut along a spiral into flat film, and wound up again.

Source: J. Toombs et al., Roll-to-roll tomographic volumetric additive manufacturing, section S9.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np
import numpy.typing as npt

from vamgpu.errors import ShapeMismatch
from vamgpu.geometry import Grid, centers, positive
from vamgpu.schema import check
from vamgpu.schema.quantities import Length, Positive, Share, Thickness
from vamgpu.targets.implicit import Bounded, Implicit
from vamgpu.web import WebGrid

Array = npt.NDArray[np.float64]

_STEPS = 30  # greatest number of Newton steps from a length to its angle; a few suffice


@dataclass(frozen=True)
class Spiral:
    """A film wound into r = inner + ρ + kψ, layer on layer, with 2πk = thickness + substrate (eq. S8).

    Layers keep their thickness along the radius; they fill the wound body without gap or overlap.

    Args:
        inner: Radius at which the film's roller side (ρ = 0) starts [mm].
        thickness: Thickness of the film [mm].
        turns: Number of turns, relative to a full turn.
        substrate: Distance between layers [mm].
        neutral: Depth of the line that winding does not stretch, as a share of the thickness; l of the flat film is the
            arc length along it.

    Raises:
        BadInput: A value is out of its range.
    """

    inner: Length
    thickness: Length
    turns: Positive
    substrate: Thickness = 0.0
    neutral: Share = 0.5

    def __post_init__(self) -> None:
        check(self)

    @property
    def rise(self) -> float:
        """k, increase of the radius per angle [mm/rad]."""
        return (self.thickness + self.substrate) / (2.0 * pi)

    @property
    def end(self) -> float:
        """Angle ψ of the film's end [rad]."""
        return 2.0 * pi * self.turns

    @property
    def length(self) -> float:
        """Length [mm] of the flat film (eq. S10, along the neutral line)."""
        return float(self.arc(np.array(self.end)))

    @property
    def outer(self) -> float:
        """Greatest radius [mm] of the wound film."""
        return self.inner + self.rise * self.end + self.thickness

    def arc(self, angle: Array) -> Array:
        """Length along the neutral line from ψ = 0: the integral of eq. S10 in closed form.

        Args:
            angle: ψ [rad], (...,).

        Returns:
            Lengths [mm], (...,).
        """
        start = self.inner + self.neutral * self.thickness
        return self._integral(start + self.rise * np.asarray(angle, np.float64)) - self._integral(np.array(start))

    def angle(self, along: Array) -> Array:
        """The inverse of `arc`, also beyond the film's ends.

        Args:
            along: Lengths l [mm], (...,).

        Returns:
            ψ [rad], (...,).
        """
        start = self.inner + self.neutral * self.thickness
        along = np.asarray(along, np.float64)
        psi = (np.sqrt(np.maximum(start**2 + 2.0 * self.rise * along, 0.0)) - start) / self.rise
        for _ in range(_STEPS):
            step = (self.arc(psi) - along) / np.hypot(start + self.rise * psi, self.rise)
            psi = psi - step
            if step.size == 0 or np.abs(step).max() < 1e-13 * (1.0 + self.end):
                break
        return psi

    def wound(self, along: Array, depth: Array) -> tuple[Array, Array]:
        """Positions in the wound body of points of the flat film.

        Args:
            along: Lengths l [mm], (...,).
            depth: Depths ρ [mm], (...,).

        Returns:
            Positions x and y [mm], (...,) each.
        """
        psi = self.angle(along)
        r = self.inner + self.rise * psi + depth
        return r * np.cos(psi), r * np.sin(psi)

    def flat(self, x: Array, y: Array) -> tuple[Array, Array, npt.NDArray[np.bool_]]:
        """Points of the flat film at given positions in the wound body.

        Args:
            x: Positions [mm], (...,).
            y: Positions [mm], (...,).

        Returns:
            l and ρ [mm], and whether the position lies in the film, (...,) each.
        """
        r, turn = np.hypot(x, y), np.arctan2(y, x) % (2.0 * pi)
        above = r - self.inner - self.rise * turn
        whole = np.floor(above / (2.0 * pi * self.rise))
        psi, depth = turn + 2.0 * pi * whole, above - 2.0 * pi * self.rise * whole
        held = (psi >= 0.0) & (psi <= self.end) & (depth <= self.thickness)
        return self.arc(np.clip(psi, 0.0, self.end)), depth, held

    def web(self, pitch: tuple[float, float, float] | float, width: float) -> WebGrid:
        """The grid of the flat film.

        Args:
            pitch: Voxel edges [mm] along l, rho, z; one number for cubes.
            width: Width along z [mm].

        Returns:
            Whole voxels that cover length, thickness and width.
        """
        edges = WebGrid((1, 1, 1), pitch).edges
        size = (self.length, self.thickness, positive("width [mm]", width))
        n_l, n_rho, n_z = (int(np.ceil(s / e - 1e-6)) for s, e in zip(size, edges, strict=True))
        return WebGrid((n_l, n_rho, n_z), edges)

    def film(self, shape: Implicit) -> Implicit:
        """A solid in the coordinates of the flat film.

        Args:
            shape: The solid, a function of (x, y, z).

        Returns:
            A function of (l, ρ, z), for `voxelize` on a web and `stream`.
        """
        return _BoundedFilm(self, shape) if isinstance(shape, Bounded) else _Film(self, shape)

    def wind(self, fraction: npt.ArrayLike, web: WebGrid, grid: Grid, samples: int = 3) -> npt.NDArray[np.float32]:
        """Voxels of a flat film, resampled to those of the wound body.

        Args:
            fraction: Fractions of the film, [l, rho, z].
            web: Voxels of the film.
            grid: Voxels of the wound body.
            samples: Sample points along x and y in each voxel; values between centers of voxels are interpolated.

        Returns:
            Fractions float32 [x, y, z].

        Raises:
            ShapeMismatch: The fractions have the shape of another web.
        """
        values = np.asarray(fraction, np.float32)
        if values.shape != web.shape:
            raise ShapeMismatch(f"the film has shape {values.shape}, its grid {web.shape}; expected the same")
        x, y, z = grid.axes()
        body = np.zeros(grid.shape, np.float32)
        for dx in centers(samples, grid.pitch / samples):
            for dy in centers(samples, grid.pitch / samples):
                along, depth, held = self.flat(x[:, None] + dx, y[None, :] + dy)
                at = (along / web.edges[0] - 0.5, depth / web.edges[1] - 0.5)
                body += _looked_up(values, *at, z / web.edges[2] + 0.5 * (web.shape[2] - 1), held)
        return body / np.float32(samples**2)

    def _integral(self, r: Array) -> Array:
        """∫ √(r² + k²) dψ with r = … + kψ."""
        u = r / self.rise
        return 0.5 * self.rise * (u * np.hypot(u, 1.0) + np.arcsinh(u))

    @property
    def _stretch(self) -> float:
        """The largest stretch of a length in the film by winding."""
        start = self.inner + self.neutral * self.thickness
        across = float(np.hypot(start, self.rise))
        return max((self.inner + self.thickness) / across, 1.0) + self.rise / across


@dataclass(frozen=True)
class _Film:
    spiral: Spiral
    shape: Implicit

    def __call__(self, along: Array, depth: Array, z: Array) -> Array:
        value = self.shape(*self._placed(along, depth, z))
        return np.maximum(value, self._beyond(along))

    def _placed(self, along: Array, depth: Array, z: Array) -> tuple[Array, Array, Array]:
        x, y = self.spiral.wound(along, depth)
        return x, y, np.asarray(z, np.float64)

    def _beyond(self, along: Array) -> Array:
        """Distance of l beyond the nearer end of the film."""
        return np.maximum(-np.asarray(along), along - self.spiral.length)


@dataclass(frozen=True)
class _BoundedFilm(_Film):
    def bound(self, along: Array, depth: Array, z: Array) -> Array:
        """At most the distance [mm] to the surface in the flat film, negative inside."""
        value = self.shape.bound(*self._placed(along, depth, z)) / self.spiral._stretch  # type: ignore[attr-defined]
        return np.maximum(value, self._beyond(along))


def _looked_up(
    values: npt.NDArray[np.float32], first: Array, second: Array, third: Array, held: npt.NDArray[np.bool_]
) -> npt.NDArray[np.float32]:
    """Values at fractional indices (first, second) for every third index; to the last voxels' faces, 0 beyond."""
    from scipy.ndimage import map_coordinates

    limits = zip((first, second), values.shape, strict=False)
    rows = held & np.logical_and.reduce([(at >= -0.5) & (at <= n - 0.5) for at, n in limits])
    layers = np.flatnonzero((third >= -0.5) & (third <= values.shape[2] - 0.5))
    found = np.zeros((*held.shape, len(third)), np.float32)
    index = [np.broadcast_to(at, held.shape)[rows] for at in (first, second)]
    size = (len(index[0]), len(layers))
    points = [np.broadcast_to(at[:, None], size) for at in index] + [np.broadcast_to(third[layers], size)]
    part = np.zeros((size[0], len(third)), np.float32)
    part[:, layers] = map_coordinates(values, points, order=1, mode="nearest")
    found[rows] = part
    return found
