"""The spaces operators map between: a volume's and a sinogram's, a web's and that of the light on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from vamgpu.errors import ShapeMismatch
from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.operators.feed import Feed
from vamgpu.web import WebGrid


@dataclass(frozen=True)
class VolumeSpace:
    """Values on the voxels of a grid, axes ``[x, y, z]``."""

    grid: Grid
    axes = ("x", "y", "z")

    @property
    def shape(self) -> tuple[int, int, int]:
        """Voxels along x, y and z."""
        return self.grid.shape


@dataclass(frozen=True)
class SinogramSpace:
    """Values on the pixels of a beam at every pose of a turntable, axes ``[angle, r, z]``."""

    beam: Beam
    motion: Turntable
    axes = ("angle", "r", "z")

    @property
    def shape(self) -> tuple[int, int, int]:
        """Poses, columns and rows."""
        return (self.motion.angles, *self.beam.pixels)

    @property
    def angles(self) -> np.ndarray:
        """Pose angles [rad]."""
        return self.motion.poses


@dataclass(frozen=True)
class WebSpace:
    """Values on the voxels of a web, axes ``[l, rho, z]``."""

    grid: WebGrid
    axes = ("l", "rho", "z")

    @property
    def shape(self) -> tuple[int, int, int]:
        """Voxels along l, rho and z."""
        return self.grid.shape


@dataclass(frozen=True)
class FeedSpace:
    """Values on the pixels of a beam at every pose of a web, axes ``[pose, r, z]``."""

    beam: Beam
    motion: Feed
    axes = ("pose", "r", "z")

    @property
    def shape(self) -> tuple[int, int, int]:
        """Poses, columns and rows."""
        return (self.motion.poses, *self.beam.pixels)


Space = VolumeSpace | SinogramSpace | WebSpace | FeedSpace


def require(space: Space, value: Any, name: str) -> None:
    """Raise `ShapeMismatch` unless ``value`` has the shape of ``space``."""
    shape = tuple(getattr(value, "shape", ()))
    if shape != space.shape:
        axes = ", ".join(space.axes)
        raise ShapeMismatch(f"{name} has shape {shape}; wanted {space.shape} = [{axes}]: build it on the same geometry")
