"""A mesh as a stack of slices, voxelized block by block."""

from __future__ import annotations

from contextlib import AbstractContextManager
from math import ceil

import numpy as np

from vamgpu.backend import open_device
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, TargetTooLarge
from vamgpu.geometry import Grid, counts, positive
from vamgpu.targets.solid import Solid
from vamgpu.targets.voxelize import voxelize

MARGIN = 2  # default margin of empty pixels on every side
SLACK = 1e-6


class MeshStack(AbstractContextManager["MeshStack"]):
    """Slices of a solid, uint8 [slice, y, x]: 255 if it fills a pixel, less if it fills part of it.

    Columns of a slice run along +x, rows along −y.

    Args:
        solid: The solid, in mm; its lowest point lies on the platform.
        pitch: Pixel edge [mm].
        slice_height: Height of a slice [mm].
        pixels: Number along x and y; the solid's position is counted from their middle. None takes as many as needed.
        device: Device, or its name; None takes the best one.

    Raises:
        BadInput: A value is out of range.
        TargetTooLarge: The solid reaches beyond the pixels.
    """

    def __init__(
        self, solid: Solid, pitch: float, slice_height: float, pixels: tuple[int, int] | None = None,
        device: str | Device | None = None,
    ) -> None:  # fmt: skip
        self._solid, self._device = solid, open_device(device)
        edge, step = positive("pitch [mm]", pitch), positive("slice height [mm]", slice_height)
        (low, high), place = solid.bounds, (0.0, 0.0)
        if pixels is None:
            middle = 0.5 * (low + high)
            place = (float(middle[0]), float(middle[1]))
            pixels = tuple(2 * MARGIN + ceil((high[k] - low[k]) / edge - SLACK) for k in range(2))  # type: ignore[assignment]
        nx, ny = counts("pixels (along x and y)", pixels, 2)  # type: ignore[arg-type]
        half = 0.5 * edge * np.array([nx, ny])
        if (low[:2] < place - half - edge * SLACK).any() or (high[:2] > place + half + edge * SLACK).any():
            raise TargetTooLarge(
                f"{solid.name} reaches from {low[0]:.4g}, {low[1]:.4g} to {high[0]:.4g}, {high[1]:.4g} mm; {nx} × {ny} "
                f"pixels of {edge:g} mm cover ±{half[0]:.4g}, ±{half[1]:.4g} mm: move it, or use more or larger pixels"
            )
        self._edges, self._origin = np.array([edge, edge, step]), np.array([*place, float(low[2])])
        slices = max(1, ceil((high[2] - low[2]) / step - SLACK))
        self.shape: tuple[int, int, int] = (slices, ny, nx)
        digits = max(4, len(str(slices)))
        self.names: tuple[str, ...] = tuple(f"slice_{k:0{digits}d}.png" for k in range(slices))

    def __getitem__(self, key: slice, /) -> np.ndarray:
        """Slices, uint8 [slice, y, x]. Raises `OutOfMemory`, `DeviceError`."""
        start, stop, step = key.indices(self.shape[0])
        if step != 1:
            raise BadInput(f"slices come in steps of 1; got {step}")
        count, (_, ny, nx) = stop - start, self.shape
        if count <= 0:
            return np.zeros((0, ny, nx), np.uint8)
        middle = self._origin + (0.0, 0.0, 0.5 * (start + stop) * self._edges[2])
        cubes = Solid((self._solid.vertices - middle) / self._edges, self._solid.faces, self._solid.name)
        fraction = voxelize(cubes, Grid((nx, ny, count), 1.0), self._device).fraction.numpy()
        levels = np.rint(255.0 * np.asarray(fraction)).astype(np.uint8)
        return np.ascontiguousarray(levels.transpose(2, 1, 0)[:, ::-1])

    def __exit__(self, *_: object) -> None:
        pass
