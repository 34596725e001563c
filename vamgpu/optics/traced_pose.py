"""Traced light of one angle: the range of beam offsets whose light crosses a voxel of the fixed frame.

Positions X(u) along a row fold at caustics; each branch between folds is inverted alone, and held at its ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import numpy as np

from vamgpu.optics.inputs import Floats
from vamgpu.optics.traced_rays import Rays


@dataclass(frozen=True, eq=False)
class TracedPose:
    """The table that a kernel reads."""

    # table: [branch, across, along, 4]: offsets [mm] of the first and the last light that crosses the voxel, its
    # absorbed share [1/mm], and a zero; samples ``spacing`` [mm] apart about the axis. single: radius [mm] within which
    # only the first branch has light.

    table: Floats
    spacing: float
    single: float


def trace_pose(rays: Rays, width: float, radius: float, spacing: float) -> TracedPose:
    """Tabulate rays of one angle for voxels of a width [mm], within a radius [mm], at samples of a spacing [mm]."""
    # A voxel counts as a box across the ray, as wide as itself: a square's shadow has that variance in all directions.
    half = ceil(radius / spacing) + 1
    place: Floats = np.arange(-half, half + 1.0) * spacing
    middle = int(np.argmin(np.abs(rays.cross(0.0).across)))
    rows = [_Row(rays, middle, float(along), place, width) for along in place]
    low, high = max(row.before for row in rows), max(row.behind for row in rows)
    order = sorted(range(-low, high + 1), key=lambda branch: (abs(branch), branch < 0))
    table = np.stack([[row.branch(branch) for row in rows] for branch in order])  # [branch, along, 3, across]
    table = np.concatenate([table, np.zeros_like(table[:, :, :1])], axis=2).transpose(0, 3, 1, 2)
    others = (table[1:, :, :, 1] > table[1:, :, :, 0]).any(axis=0)
    far = np.hypot(place[:, None], place[None, :])[others]
    single = max(float(far.min(initial=np.inf)) - 2.0 * spacing, 0.0)
    return TracedPose(table, spacing, min(single, 2.0 * radius))


class _Row:
    """The branches along one row of the fixed frame; ray ``middle`` is on the branch through the axis."""

    def __init__(self, rays: Rays, middle: int, along: float, place: Floats, width: float) -> None:
        self.u, self.place, self.width = rays.u, place, width
        self.crossing = rays.cross(along)
        rising = np.sign(np.diff(self.crossing.across))
        turns = np.flatnonzero(rising[1:] * rising[:-1] < 0) + 1
        self.ends = np.concatenate([[0], turns, [self.u.size - 1]])
        # branches at columns below and above those of the branch through the axis
        self.before = int(np.clip(np.searchsorted(self.ends, middle, side="right") - 1, 0, len(self.ends) - 2))
        self.behind = len(self.ends) - 2 - self.before

    def branch(self, number: int) -> Floats:
        """First and last offset, and the share, at every position of the row: (3, positions)."""
        index = self.before + number
        if not 0 <= index < len(self.ends) - 1:
            end = self.u[0 if index < 0 else -1]
            return np.stack([np.full_like(self.place, end)] * 2 + [np.zeros_like(self.place)])
        part = slice(self.ends[index], self.ends[index + 1] + 1)
        u, across, cosine, share = (a[part] for a in (self.u, *self.crossing))
        order = slice(None, None, 1 if across[-1] >= across[0] else -1)
        across, ordered = across[order], u[order]
        reach = 0.5 * self.width / np.interp(np.interp(self.place, across, ordered), u, cosine)
        ends = np.interp(self.place - reach, across, ordered), np.interp(self.place + reach, across, ordered)
        low, high = np.minimum(*ends), np.maximum(*ends)
        return np.stack([low, high, np.interp(0.5 * (low + high), u, share)])
