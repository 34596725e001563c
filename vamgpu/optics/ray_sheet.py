"""A sheet of bent rays as one smooth map: from (number of the ray, distance along it) to positions, and back."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vamgpu.errors import RayError
from vamgpu.kernels.eikonal import State
from vamgpu.kernels.index_field import Look, bspline, cell_of
from vamgpu.optics.index_field import EXTRAPOLATE
from vamgpu.optics.inputs import Floats

COARSE = 4  # step between the rays that are scanned for the first one beyond a point
CHUNK = 8192  # number of points at a time that fits the cache
NEWTON = 12
CLOSE = 1e-9  # tolerance, as a share of the sheet's size, within which a ray meets a point


@dataclass(frozen=True, eq=False)
class RaySheet:
    """Rays in order of their offsets, each sampled at equal shares of its ∫ds/n: (ray, share)."""

    # across, along: positions [mm]. path: length from the ray's start [mm].  Light travels towards larger ``along``.

    across: Floats
    along: Floats
    path: Floats

    @classmethod
    def traced(cls, look: Look, starts: Floats, times: Floats, rows: int) -> RaySheet:
        """Rays from positions and headings (rays, 6), each over its own ∫ds/n [mm], in ``rows`` − 1 steps by Sharma."""
        state, step = State.begun(look, starts), times / (rows - 1)
        across, along, path = ([value] for value in (state.place[:, 0], state.place[:, 1], state.length))
        for _ in range(rows - 1):
            state = state.advanced(look, step, 0)
            across.append(state.place[:, 0])
            along.append(state.place[:, 1])
            path.append(state.length)
        sheet = cls(*(np.stack(rows_of, axis=1) for rows_of in (across, along, path)))
        back = (np.diff(sheet.along, axis=1) <= 0).any(axis=1) & (times > 1e-6 * times.max())
        if back.any():
            raise RayError(
                f"{np.count_nonzero(back)} of {len(back)} rays turn back against the light; "
                "expected a medium that bends them by less than a right angle"
            )
        return sheet

    @property
    def size(self) -> float:
        """Greatest distance [mm] from the origin."""
        return float(np.hypot(self.across, self.along).max())

    @cached_property
    def _splines(self) -> tuple[Floats, Floats, Floats]:
        return _coefficients(self.across), _coefficients(self.along), _coefficients(self.path)

    def at(self, ray: Floats, share: Floats) -> tuple[Floats, Floats, Floats]:
        """Across, along and path at fractional indices; each (3, points): value, slope by ray, slope by share."""
        i, wi, di = cell_of(ray, self.across.shape[0] + 2)
        j, wj, dj = cell_of(share, self.across.shape[1] + 2)
        taps = np.arange(4)
        rows, columns = (i[:, None] + taps)[:, :, None], (j[:, None] + taps)[:, None, :]
        out = []
        for table in self._splines:
            block = table[rows, columns]
            even, steep = np.einsum("pab,pb->pa", block, wj), np.einsum("pab,pb->pa", block, dj)
            out.append(np.stack([(even * wi).sum(1), (even * di).sum(1), (steep * wi).sum(1)]))
        return out[0], out[1], out[2]

    @cached_property
    def turned(self) -> Floats:
        """Determinant of the map at its nodes: positive unless neighbouring rays have crossed."""
        by_ray, by_share = ([np.gradient(f, axis=a) for f in (self.across, self.along)] for a in (0, 1))
        return by_ray[0] * by_share[1] - by_ray[1] * by_share[0]

    @cached_property
    def _levels(self) -> tuple[Floats, Floats, Floats, NDArray[np.int_]]:
        """Levels of ``along``; ``across`` and share of some rays there, straight beyond their ends; their index."""
        rays = np.append(np.arange(0, len(self.across) - 1, COARSE), len(self.across) - 1)
        levels = np.linspace(-self.size, self.size, self.across.shape[1])
        across, share = np.empty((rays.size, levels.size)), np.empty((rays.size, levels.size))
        steps = np.arange(self.across.shape[1], dtype=float)
        for row, ray in enumerate(rays):
            x, y = self.across[ray], self.along[ray]
            across[row], share[row] = np.interp(levels, y, x), np.interp(levels, y, steps)
            for end, beside, out in ((0, 1, levels < y[0]), (-1, -2, levels > y[-1])):
                rise = y[end] - y[beside]
                slope = (x[end] - x[beside]) / rise if rise else 0.0
                across[row, out] = x[end] + (levels[out] - y[end]) * slope
        return levels, across, share, rays

    def find(self, x: Floats, y: Floats, middle: float) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Fractional ray and share through each point, and whether there is one; the first from ``middle`` counts."""
        ray, share, met = np.empty_like(x), np.empty_like(x), np.zeros(x.shape, bool)
        for start in range(0, x.size, CHUNK):
            part = slice(start, start + CHUNK)
            ray[part], share[part], met[part] = self._newton(x[part], y[part], *self._guess(x[part], y[part], middle))
        return ray, share, met

    def _guess(self, x: Floats, y: Floats, middle: float) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        levels, table, shares, rays = self._levels
        place = np.clip((y - levels[0]) / (levels[1] - levels[0]), 0.0, levels.size - 1.001)
        low = place.astype(int)
        f = place - low
        across = table[:, low] * (1 - f) + table[:, low + 1] * f  # (rays, points)
        center = int(np.argmin(np.abs(rays - middle)))
        side = np.where(x >= across[center], 1, -1)
        beyond = (across - x) * side >= 0.0
        outwards = np.where(side > 0, np.argmax(beyond[center:], axis=0), -np.argmax(beyond[center::-1], axis=0))
        found = np.where(side > 0, beyond[center:].any(axis=0), beyond[center::-1].any(axis=0))
        outer = np.clip(center + outwards, 0, rays.size - 1)
        inner = np.clip(outer - side, 0, rays.size - 1)
        points = np.arange(x.size)
        far, near = across[outer, points] - x, across[inner, points] - x
        t = np.where(far != near, near / np.where(far != near, near - far, 1.0), 0.0)
        t = np.clip(t, 0.0, 1.0)
        share = shares[inner, low] * (1 - t) + shares[outer, low] * t
        return np.asarray(rays[inner] * (1 - t) + rays[outer] * t, np.float64), share, found

    def _newton(self, x: Floats, y: Floats, ray: Floats, share: Floats, found: NDArray[np.bool_]
                ) -> tuple[Floats, Floats, NDArray[np.bool_]]:  # fmt: skip
        last_ray, last_share = (n - 1.0 for n in self.across.shape)
        low, high = np.maximum(ray - COARSE, 0.0), np.minimum(ray + COARSE, last_ray)
        for _ in range(NEWTON):
            across, along, _ = self.at(ray, share)
            miss_x, miss_y = across[0] - x, along[0] - y
            det = across[1] * along[2] - across[2] * along[1]
            det = np.where(np.abs(det) > 1e-30, det, 1e-30)
            ray = np.clip(ray - (miss_x * along[2] - miss_y * across[2]) / det, low, high)
            share = np.clip(share - (miss_y * across[1] - miss_x * along[1]) / det, -1.0, last_share + 1.0)
        across, along, _ = self.at(ray, share)
        return ray, share, found & (np.hypot(across[0] - x, along[0] - y) <= CLOSE * self.size)


def _coefficients(values: Floats) -> Floats:
    for axis in range(2):
        v = np.moveaxis(values, axis, 0)
        v = np.concatenate([np.tensordot(EXTRAPOLATE, v[:4], 1), v, np.tensordot(EXTRAPOLATE, v[:-5:-1], 1)[::-1]])
        values = np.moveaxis((8.0 * v[1:-1] - v[:-2] - v[2:]) / 6.0, 0, axis)
    return values


def through(values: Floats, index: Floats) -> tuple[Floats, Floats]:
    """Value and slope per index of a smooth table at fractional indices, by cubic B-splines."""
    v = np.concatenate([EXTRAPOLATE @ values[:4], values, (EXTRAPOLATE @ values[:-5:-1])[::-1]])
    table = (8.0 * v[1:-1] - v[:-2] - v[2:]) / 6.0
    cell = np.clip(index.astype(int), 0, values.size - 2)
    weights, slopes = bspline(index - cell)
    taps = table[cell[..., None] + np.arange(4)]
    return (taps * weights).sum(-1), (taps * slopes).sum(-1)
