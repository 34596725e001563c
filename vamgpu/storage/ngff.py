"""OME-Zarr 0.5: the part of a job folder that viewers of microscopy read, with position and size of its voxels."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

VERSION = "0.5"
SPACE = ("x", "y", "z", "row", "column")
"""Names of axes that are directions in space; other axes are numbers."""
FIRST = ("dose", "target", "frames")
"""Arrays for a viewer that shows one image, the best first."""


@dataclass(frozen=True)
class Image:
    """An array of a folder that is a picture."""

    name: str
    axes: tuple[str, ...]  # names of its axes
    shape: tuple[int, ...]  # one length for each of them
    spacing: float  # distance of neighbors in space [mm]

    def multiscale(self) -> dict[str, Any]:
        """The image at its only resolution, centered on the axis of rotation, or on that of the light."""
        space = [axis in SPACE for axis in self.axes]
        scale = [self.spacing if inside else 1.0 for inside in space]
        lengths = zip(space, self.shape, strict=True)
        corner = [-0.5 * (n - 1) * self.spacing if inside else 0.0 for inside, n in lengths]
        axes = [{"name": axis, "type": "space", "unit": "millimeter"} if inside else {"name": axis, "type": axis}
                for axis, inside in zip(self.axes, space, strict=True)]  # fmt: skip
        placed = [{"type": "scale", "scale": scale}, {"type": "translation", "translation": corner}]
        return {"name": self.name, "axes": axes,
                "datasets": [{"path": self.name, "coordinateTransformations": placed}]}  # fmt: skip


def describe(folder: Path, images: Iterable[Image]) -> None:
    """Record in the Zarr group of a folder which of its arrays are images, and the positions of their voxels."""
    import zarr

    rank = {name: place for place, name in enumerate(FIRST)}
    ordered = sorted(images, key=lambda image: rank.get(image.name, len(rank)))
    if ordered:
        said = {"version": VERSION, "multiscales": [image.multiscale() for image in ordered]}
        zarr.open_group(folder, mode="a", zarr_format=3).attrs["ome"] = said
