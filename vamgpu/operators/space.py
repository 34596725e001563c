"""The spaces between which operators map: those of volumes and sinograms, of rings, of webs and the light on them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.operators.polar import PolarGrid
from vamgpu.operators.web_motion import WebMotion
from vamgpu.web import WebGrid

AXES: dict[type, tuple[str, str, str]] = {
    Grid: ("x", "y", "z"), PolarGrid: ("angle", "cell", "z"), WebGrid: ("l", "rho", "z"),
}  # fmt: skip
"""Axes of the values on a grid."""


@dataclass(frozen=True)
class VolumeSpace:
    """Values on the voxels of a grid, on the cells of rings, or on the voxels of a web."""

    grid: Grid | PolarGrid | WebGrid

    @property
    def axes(self) -> tuple[str, str, str]:
        """Names of the axes."""
        return next(names for kind, names in AXES.items() if isinstance(self.grid, kind))

    @property
    def shape(self) -> tuple[int, int, int]:
        """Voxels along each axis."""
        return self.grid.shape


@dataclass(frozen=True)
class SinogramSpace:
    """Values on the pixels of a beam at every angle of a turntable or of a web, axes ``[angle, r, z]``."""

    beam: Beam
    motion: Turntable | WebMotion
    axes: ClassVar[tuple[str, str, str]] = ("angle", "r", "z")

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of angles, columns and rows."""
        motion = self.motion
        return (motion.poses if isinstance(motion, WebMotion) else motion.angles, *self.beam.pixels)


Space = VolumeSpace | SinogramSpace


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
