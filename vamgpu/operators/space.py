"""The spaces between which operators map: those of volumes and sinograms, of rings, of webs and the light on them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.operators.polar import PolarGrid
from vamgpu.operators.web_motion import WebMotion
from vamgpu.web import WebGrid


@dataclass(frozen=True)
class VolumeSpace:
    """Values on the voxels of a grid, axes ``[x, y, z]``."""

    grid: Grid
    axes: ClassVar[tuple[str, str, str]] = ("x", "y", "z")

    @property
    def shape(self) -> tuple[int, int, int]:
        """Voxels along x, y and z."""
        return self.grid.shape


@dataclass(frozen=True)
class SinogramSpace:
    """Values on the pixels of a beam at every pose of a turntable, axes ``[angle, r, z]``."""

    beam: Beam
    motion: Turntable
    axes: ClassVar[tuple[str, str, str]] = ("angle", "r", "z")

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of angles, columns and rows."""
        return (self.motion.angles, *self.beam.pixels)

    @property
    def angles(self) -> np.ndarray:
        """Pose angles [rad]."""
        return self.motion.poses


@dataclass(frozen=True)
class WebSpace:
    """Values on the voxels of a web, axes ``[l, rho, z]``."""

    grid: WebGrid
    axes: ClassVar[tuple[str, str, str]] = ("l", "rho", "z")

    @property
    def shape(self) -> tuple[int, int, int]:
        """Voxels along l, rho and z."""
        return self.grid.shape


@dataclass(frozen=True)
class WebSinogramSpace:
    """Values on the pixels of a beam at every angle of a web, axes ``[angle, r, z]``."""

    beam: Beam
    motion: WebMotion
    axes: ClassVar[tuple[str, str, str]] = ("pose", "r", "z")

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of angles, columns and rows."""
        return (self.motion.poses, *self.beam.pixels)


@dataclass(frozen=True)
class PolarSpace:
    """Values on the cells of rings, axes ``[angle, cell, z]``."""

    grid: PolarGrid
    axes: ClassVar[tuple[str, str, str]] = ("angle", "cell", "z")

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of angles, of cells between two of them, and of slices."""
        return self.grid.shape


Space = VolumeSpace | SinogramSpace | PolarSpace | WebSpace | WebSinogramSpace


def require(space: Space, value: Any, name: str) -> None:
    """Raise `ShapeMismatch` unless ``value`` has the shape of ``space``."""
    shape = getattr(value, "shape", None)
    if shape is None or tuple(shape) != space.shape:
        got = f"is a {type(value).__name__}" if shape is None else f"has shape {tuple(shape)}"
        raise ShapeMismatch(
            f"{name} {got}; expected an array of shape {space.shape} = [{', '.join(space.axes)}]: build it on the same "
            "geometry"
        )


def require_kinds(usage: str, *given: tuple[Any, type]) -> None:
    """Raise `BadInput` unless each value is of its kind; ``usage`` shows the call."""
    for value, kind in given:
        if not isinstance(value, kind):
            raise BadInput(f"got {value!r} where a {kind.__name__} is expected; {usage}")
