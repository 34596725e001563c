"""Rays of a beam's pixels as they leave the source, in fixed coordinates: any directions, several per pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.geometry import Beam, Grid, centers, positive


@dataclass(frozen=True, eq=False)
class RayBundle:
    """Start points and directions of the rays of every pixel, the same at every angle.

    Args:
        start: Any point on each ray outside the grid, (columns, rows or 1, rays, 3) [mm]: across the light from the
            axis, along it, and above the middle of the pixel's row.
        direction: In the same three axes, (columns, rows or 1, rays, 3), of any length and not along the rotation axis.
        weight: Share of the pixel's light in each ray, (rays,) or (columns, rows or 1, rays); None divides it equally.

    Raises:
        BadInput: Shapes differ, a number is not finite, or a direction is zero or upright.
    """

    start: np.ndarray
    direction: np.ndarray
    weight: np.ndarray | None = None

    def __post_init__(self) -> None:
        start, direction = (np.asarray(a, np.float64) for a in (self.start, self.direction))
        if start.shape != direction.shape or start.ndim != 4 or start.shape[3] != 3:
            raise BadInput(
                f"rays start in an array {start.shape} and head in one {direction.shape}; "
                "expected (columns, rows or 1, rays, 3) of both"
            )
        length = np.linalg.norm(direction, axis=3, keepdims=True)
        flat = np.linalg.norm(direction[..., :2], axis=3, keepdims=True)
        if not (np.isfinite(start).all() and np.isfinite(length).all() and (flat > 1e-3 * length).all()):
            raise BadInput("starts and directions of rays must be finite, and no direction zero or upright")
        count = start.shape[2]
        weight = np.full(count, 1.0 / count) if self.weight is None else np.asarray(self.weight, np.float64)
        if weight.shape not in ((count,), start.shape[:3]) or not np.isfinite(weight).all() or (weight < 0).any():
            raise BadInput(
                f"weights of rays have shape {weight.shape}; expected {count} finite numbers ≥ 0, or as many per pixel"
            )
        length[np.abs(length - 1.0) < 1e-15] = 1.0  # a bundle that is read back is then the same to the bit
        for name, value in (("start", start), ("direction", direction / length), ("weight", weight)):
            object.__setattr__(self, name, value)

    @classmethod
    def parallel(cls, beam: Beam, rise: float = 0.0) -> RayBundle:
        """Parallel light that rises; at the axis it is at its row's height.

        Args:
            beam: Its pixels.
            rise: Elevation [rad].

        Returns:
            One ray per pixel.
        """
        columns = beam.columns()
        start = np.zeros((columns.size, 1, 1, 3))
        start[:, 0, 0, 0] = columns
        return cls(start, np.broadcast_to([0.0, np.cos(rise), np.sin(rise)], start.shape))

    @classmethod
    def fan(cls, beam: Beam, distance: float) -> RayBundle:
        """Light from a level line of sources; columns are as wide as the pitch at the axis.

        Args:
            beam: Its pixels.
            distance: Distance of the sources from the axis [mm].

        Returns:
            One ray per pixel.
        """
        distance = positive("distance of the source [mm]", distance)
        columns = beam.columns()
        start = np.zeros((columns.size, 1, 1, 3))
        start[..., 1] = -distance
        direction = np.zeros_like(start)
        direction[:, 0, 0, 0], direction[..., 1] = columns, distance
        return cls(start, direction)

    @classmethod
    def cone(cls, beam: Beam, half_angle: float, rays: int = 7, focus: float = 0.0, level: bool = False) -> RayBundle:
        """A horizontal cone of light from each pixel, in equal shares.

        Args:
            beam: Its pixels.
            half_angle: Half angle of the cone [rad]; directions fill its disc in a sunflower pattern.
            rays: Rays per pixel.
            focus: Position of the focus, downstream of the axis [mm].
            level: Spread the rays on a horizontal line instead.

        Returns:
            ``rays`` rays per pixel.
        """
        half_angle = positive("half angle of the cone [rad]", half_angle, zero=True)
        k = np.arange(rays)
        if level:
            across, up = half_angle * centers(rays, 2.0 / max(rays, 1)), np.zeros(rays)
        else:
            reach, turn = half_angle * np.sqrt((k + 0.5) / rays), np.pi * (3.0 - np.sqrt(5.0)) * k
            across, up = reach * np.cos(turn), reach * np.sin(turn)
        columns = beam.columns()
        start = np.zeros((columns.size, 1, rays, 3))
        start[..., 0] = columns[:, None, None] - focus * across
        start[..., 2] = -focus * up
        direction = np.broadcast_to(np.stack([across, np.ones(rays), up], axis=1), start.shape)
        return cls(start, direction)

    @property
    def rays(self) -> int:
        """Rays per pixel."""
        return self.start.shape[2]

    @property
    def is_level(self) -> bool:
        """Whether rays of all rows share one path, at their own height."""
        flat = (self.start[..., 2] == 0.0).all() and (np.abs(self.direction[..., 2]) < 1e-12).all()
        return self.start.shape[1] == 1 and bool(flat)

    def table(self, grid: Grid, beam: Beam, *, level: bool, unit: float) -> np.ndarray:
        """The rays in the form for the kernels of `trace`; they start at the grid's circle, where float32 suffices.

        Args:
            grid: Grid whose voxels are the unit of length.
            beam: Its pixels.
            level: Use one row, in slice 0.
            unit: A factor of the weights.

        Returns:
            Start, direction and weight, (columns · rows · rays, 8).

        Raises:
            ShapeMismatch: The rays were made for other pixels.
        """
        columns, rows = beam.pixels[0], 1 if level else beam.pixels[1]
        if self.start.shape[0] != columns or self.start.shape[1] not in (1, rows):
            raise ShapeMismatch(
                f"rays are given for {self.start.shape[:2]} pixels; expected ({columns}, {rows}) or "
                f"({columns}, 1) for {beam}"
            )
        shape = (columns, rows, self.rays, 3)
        start = np.broadcast_to(self.start, shape) / grid.pitch
        direction = np.broadcast_to(self.direction, shape)
        start = start.copy()
        if not level:
            start[..., 2] += (centers(rows, beam.pitch) / grid.pitch + 0.5 * (grid.shape[2] - 1))[:, None]
        table = np.zeros((*shape[:3], 8))
        table[..., :3], lit = _nearer(start, direction, 0.5 * float(np.hypot(*grid.shape[:2])) + 6.0)
        table[..., 3:6] = direction
        table[..., 6] = np.where(lit, unit * np.asarray(self.weight), 0.0)
        return table.reshape(-1, 8)


def _nearer(start: np.ndarray, direction: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Where rays enter the cylinder about the axis, and which ones do."""
    across, heading = start[..., :2], direction[..., :2]
    a = (heading**2).sum(-1)
    b, c = (across * heading).sum(-1), (across**2).sum(-1) - radius**2
    root = b**2 - a * c
    back = (-b - np.sqrt(np.maximum(root, 0.0))) / a
    return start + back[..., None] * direction, root > 0
