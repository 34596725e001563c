"""Rays marched on a device from face to face of a film whose index is a field.

Over the roller, rays are marched to the outer and to the inner circle, and the first end counts; a run is a box.
"""

from __future__ import annotations

from math import ceil, hypot, sqrt
from typing import Any

import numpy as np

from vamgpu.backend.device import Device
from vamgpu.errors import RayError
from vamgpu.optics.index_field import FAR, IndexField
from vamgpu.optics.inputs import Floats
from vamgpu.optics.march import Marcher

PATHS = 1 << 26  # bytes of the paths of the rays that are marched at a time
DETOUR = 1.2
"""Steps marched at a time, relative to those of the longest straight path; rays that bend more continue from there."""
INNER, OUTER, MIDDLE, FINISH, NONE = range(5)  # the faces, numbered as in `roller_rays`


class FilmMarcher:
    """A film's medium on a device; radii of the film, length of the straight runs and stride in mm."""

    def __init__(
        self, medium: IndexField, inner: float, outer: float, leg: float, stride: float, device: str | Device | None
    ) -> None:
        self.marcher: Marcher = Marcher(medium, device)
        self.inner: float = inner
        self.outer: float = outer
        self.leg: float = leg
        self.stride: float = stride

    def run(self, rays: dict[str, Any], index: Floats, powers: Floats, pieces: list[dict[str, Any]]) -> np.ndarray:
        """Take the rays in the film to the faces that they meet next, and record the segments of their paths."""
        # rays: position, direction and path so far of all; updated. index: of the resin where they are. powers: of the
        # segments. pieces: are appended to, as in `roller_rays.Segments`. Returns the faces; none for rays that are
        # still running or have left.
        face = np.full(index.size, NONE)
        for side in (-1, 0, 1):
            rows = np.flatnonzero(rays["film"] & (rays["side"] == side))
            together = max(1, PATHS // (12 * (self._steps(side) + 1)))
            for first in range(0, rows.size, together):
                some = rows[first : first + together]
                face[some] = self._marched(rays, some, side, index[some], powers[some], pieces)
        return face

    def _steps(self, side: int) -> int:
        longest = hypot(self.outer - self.inner, self.leg) if side else 2.0 * sqrt(self.outer**2 - self.inner**2)
        return ceil(DETOUR * longest / self.stride)

    def _marched(
        self, rays: dict[str, Any], some: np.ndarray, side: int, index: Floats, power: Floats,
        pieces: list[dict[str, Any]],
    ) -> np.ndarray:  # fmt: skip
        starts = np.zeros((some.size, 6))
        starts[:, 0], starts[:, 1] = rays["x"][some], rays["y"][some]
        starts[:, 3], starts[:, 4] = index * rays["dx"][some], index * rays["dy"][some]
        steps, step = self._steps(side), self.stride / float(index.max())
        table = self.marcher.device.table(starts)
        if side:
            low, high = sorted((side * self.inner, side * self.outer))
            far, path, time = self._to(table, step, steps, (0.0, 0.0, 0.0, 1.0, low, 0.0, -FAR, high, self.leg, FAR))
            ends, left = far, time >= 0.0
        else:
            circle = (-self.outer, -self.outer, -FAR, self.outer, 0.0, FAR)
            far, path, time = self._to(table, step, steps, (1.0, 1.0, 0.0, self.outer**2, *circle))
            near, short, first = self._to(table, step, steps, (-1.0, -1.0, 0.0, -(self.inner**2), *circle))
            sinks = (first >= 0.0) & ~((time >= 0.0) & (time < first)) & (np.hypot(near[:, 0], near[:, 1]) < self.outer)
            ends, path = np.where(sinks[:, None], near, far), np.where(sinks[:, None, None], short, path)
            left = sinks | (time >= 0.0)
        if not np.isfinite(ends[:, :6]).all():
            raise RayError("rays in the film meet n² ≤ 0; expected a medium with an index above 0 throughout")
        x, y, dx, dy = ends[:, 0], ends[:, 1], ends[:, 3], ends[:, 4]
        face = np.where(left, self._face(side, x, y, dx, dy), NONE)
        x, y = self._on(face, side, x, y)
        path[:, 0], path[:, -1, 0], path[:, -1, 1] = starts[:, :3], x, y
        way = np.diff(path[:, :, :2], axis=1)
        length = np.hypot(way[..., 0], way[..., 1])
        total = np.cumsum(length, axis=1)
        before = rays["path"][some][:, None] + total - length
        kept = (length > 1e-9) & (power > 0.0)[:, None]
        ray, row = np.nonzero(kept)
        pieces.append({
            "ray": rays["ray"][some][ray], "x": path[ray, row, 0], "y": path[ray, row, 1],
            "dx": way[ray, row, 0] / length[kept], "dy": way[ray, row, 1] / length[kept],
            "side": rays["side"][some][ray], "length": length[kept], "before": before[kept], "power": power[ray],
        })  # fmt: skip
        size = np.hypot(dx, dy)
        for name, value in (("x", x), ("y", y), ("dx", dx / size), ("dy", dy / size)):
            rays[name][some] = value
        rays["path"][some] += total[:, -1]
        return face

    def _to(self, starts: Any, step: float, steps: int, region: tuple[float, ...]) -> tuple[Floats, Floats, Floats]:
        """Ends, paths and times of a march to a region's border, in float64; the paths' last points are the ends."""
        tables = self.marcher.run(starts, step, steps, rows=steps + 1, region=np.array(region))
        ends, path, times = (one.numpy().astype(np.float64) for one in tables)
        return ends, path, times

    def _face(self, side: int, x: Floats, y: Floats, dx: Floats, dy: Floats) -> np.ndarray:
        """The nearest face through which rays at the border of a zone leave it."""
        if side:
            ways, leans = (
                (side * x - self.inner, self.outer - side * x, y, self.leg - y),
                (-side * dx, side * dx, -dy, dy),
            )
        else:
            r, rising = np.hypot(x, y), x * dx + y * dy
            ways, leans = (r - self.inner, self.outer - r, -y, np.full(x.shape, np.inf)), (-rising, rising, dy, dy)
        gaps = np.stack([np.where(lean > 0.0, np.abs(way), np.inf) for way, lean in zip(ways, leans, strict=True)])
        return np.argmin(gaps, axis=0)

    def _on(self, face: np.ndarray, side: int, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Positions moved onto their faces, from which float32 rounding has shifted them."""
        radius = np.where(face == INNER, self.inner, self.outer)
        meets = (face == INNER) | (face == OUTER)
        if side:
            x = np.where(meets, side * radius, x)
            return x, np.where(face == MIDDLE, 0.0, np.where(face == FINISH, self.leg, y))
        size = np.where(meets, radius / np.hypot(x, y), 1.0)
        return x * size, np.where(face == MIDDLE, 0.0, y * size)
