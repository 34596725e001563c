"""Frames for a focus that follows a roller: each column of a pattern is shown while the lens focuses on its film.

Source: J. Toombs et al., "Roll-to-roll tomographic volumetric additive manufacturing", Fig. 4, S4 and S14.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.geometry import Beam, centers, counts, positive
from vamgpu.kernels.mask import mask_bytes, mask_rays
from vamgpu.printing.frames import Frames

Fields = TypeVar("Fields", Frames, DeviceArray, np.ndarray)


@dataclass(frozen=True)
class FocusMasks:
    """Focus planes of a projector and the columns of light that each of them shows; every column belongs to one.

    Args:
        columns, pitch: Columns of the beam, and their pitch [mm].
        midline: Radius [mm] of the film's middle about the roller's axis.
        planes: Depths [mm] of the focus planes along the light from the axis, rising; the outermost comes first.

    Raises:
        BadInput: A value is out of its range.
    """

    columns: int
    pitch: float
    midline: float
    planes: tuple[float, ...]

    def __post_init__(self) -> None:
        counts("columns", (self.columns,), 1)
        for name in ("pitch", "midline"):
            positive(f"{name} [mm]", getattr(self, name))
        planes = np.array(self.planes, dtype=np.float64)
        if planes.ndim != 1 or not planes.size or not np.isfinite(planes).all() or (np.diff(planes) <= 0).any():
            raise BadInput(f"planes is {self.planes!r}; expected one or more rising depths [mm]")
        object.__setattr__(self, "planes", tuple(planes.tolist()))

    @classmethod
    def around(cls, beam: Beam, radius: float, thickness: float, bins: int = 3) -> FocusMasks:
        """The ``bins`` planes that make the largest defocus of any column as small as possible.

        Args:
            beam: The beam.
            radius: Radius of the roller [mm].
            thickness: Thickness of the film on it [mm].
            bins: Number of focus planes.

        Returns:
            The masks.

        Raises:
            BadInput: A value is out of its range.
        """
        middle = positive("radius [mm]", radius) + 0.5 * positive("thickness [mm]", thickness)
        count = counts("bins", (bins,), 1)[0]
        depth = np.unique(midline_depth(beam.columns(), middle))
        if count > depth.size:
            raise BadInput(f"bins is {count}, but the beam's {depth.size} depths need no more than {depth.size}")
        low, high = 0.0, 0.5 * float(depth[-1] - depth[0])
        while high - low > 1e-12 * middle:
            half = 0.5 * (low + high)
            low, high = (low, half) if len(_groups(depth, half)) <= count else (half, high)
        groups = _groups(depth, high)
        while len(groups) < count:
            widest = max(range(len(groups)), key=lambda g: np.ptp(groups[g]))
            groups[widest : widest + 1] = np.array_split(groups[widest], 2)
        planes = tuple(0.5 * float(group[0] + group[-1]) for group in groups)
        return cls(beam.pixels[0], beam.pitch, middle, planes)

    @property
    def bins(self) -> int:
        """Number of planes."""
        return len(self.planes)

    def depth(self, x: ArrayLike) -> np.ndarray:
        """Depth of the film's middle.

        Args:
            x: Offsets from the axis [mm], (...).

        Returns:
            Depths [mm], (...); 0 beyond the mid-line.
        """
        return midline_depth(x, self.midline)

    def bin(self, x: ArrayLike) -> np.ndarray:
        """Find the plane nearest to the film's middle; of two at the same distance, the outer one.

        Args:
            x: Offsets from the axis [mm], (...).

        Returns:
            Index of the plane, [...].
        """
        planes = np.array(self.planes)
        return np.searchsorted(0.5 * (planes[1:] + planes[:-1]), self.depth(x), side="left")

    @property
    def x(self) -> np.ndarray:
        """Offsets [mm] of the beam's columns from the axis."""
        return centers(self.columns, self.pitch)

    @cached_property
    def masks(self) -> np.ndarray:
        """Columns of the beam that each plane shows, bool (bins, columns); True once in every column."""
        return self.bin(self.x) == np.arange(self.bins)[:, None]

    @cached_property
    def defocus(self) -> np.ndarray:
        """Distance [mm] of the film's middle from its column's plane, ≥ 0; shape (columns,)."""
        return np.abs(self.depth(self.x) - np.array(self.planes)[self.bin(self.x)])

    def of_frames(self, frames: Frames) -> np.ndarray:
        """Columns of a frame that each plane shows, after flips and shift.

        Args:
            frames: The frames.

        Returns:
            Boolean (bins, columns).

        Raises:
            ShapeMismatch: The frames have another number of columns.
        """
        if frames.columns != self.columns:
            raise ShapeMismatch(f"the frames have {frames.columns} columns; the masks are for {self.columns}")
        x = self.x - frames.settings.shift[0] * self.pitch
        return (self.bin(x[::-1] if frames.settings.flip_r else x)) == np.arange(self.bins)[:, None]


def midline_depth(x: ArrayLike, midline: float) -> np.ndarray:
    """−√(midline²−x²) [mm], and 0 beyond; same shape as x [mm]."""
    across = np.asarray(x, dtype=np.float64)
    return -np.sqrt(np.maximum(midline**2 - across**2, 0.0)) + 0.0


def bins_needed(beam: Beam, radius: float, thickness: float, defocus: float) -> int:
    """Fewest focus planes that keep every column's film within ``defocus`` [mm]. Raises `BadInput`."""
    middle = positive("radius [mm]", radius) + 0.5 * positive("thickness [mm]", thickness)
    depth = np.unique(midline_depth(beam.columns(), middle))
    return len(_groups(depth, positive("defocus [mm]", defocus)))


def split(shown: Fields, masks: FocusMasks) -> tuple[Fields, ...]:
    """One set of frames, or of patterns, for each focus plane; their sum equals ``shown`` to the last bit."""
    # shown: `Frames`; light [angle, r, z] on a device or in NumPy; or the bytes of 8-bit frames, uint8 [angle, row,
    # column], neither flipped nor shifted. Nothing is moved. A dark mirror still gives the gray curve's black level, in
    # every bin.
    if isinstance(shown, Frames):
        return tuple(_frames(shown, mask) for mask in masks.of_frames(shown))
    frames = isinstance(shown, np.ndarray) and shown.dtype == np.uint8
    axis = 2 if frames else 1
    if not isinstance(shown, (np.ndarray, DeviceArray)) or len(shown.shape) != 3:
        raise BadInput(f"got {type(shown).__name__}; expected Frames or three-dimensional light or bytes")
    if shown.shape[axis] != masks.columns:
        raise ShapeMismatch(f"got the shape {shown.shape} with {shown.shape[axis]} columns; expected {masks.columns}")
    if isinstance(shown, DeviceArray):
        return tuple(_light(shown, mask) for mask in masks.masks)
    return tuple(np.where(mask if frames else mask[:, None], shown, shown.dtype.type(0)) for mask in masks.masks)


def slots(angles: int, bins: int, *, turning: bool = True) -> np.ndarray:
    """The plane of every slot, int (angles, bins), in the order in which planes are shown."""
    # turning: reverse the order at every other angle, which saves a move of the lens per angle and the long way back.
    angles, bins = counts("angles and bins", (angles, bins), 2)
    order = np.tile(np.arange(bins), (angles, 1))
    if turning:
        order[1::2] = order[1::2, ::-1]
    return order


def _groups(depth: np.ndarray, half: float) -> list[np.ndarray]:
    """Rising depths in as few groups as possible, none wider than 2·half."""
    groups: list[np.ndarray] = []
    while depth.size:
        last = int(np.searchsorted(depth, depth[0] + 2.0 * half, side="right"))
        groups.append(depth[:last])
        depth = depth[last:]
    return groups


def _frames(frames: Frames, mask: np.ndarray) -> Frames:
    row = mask.astype(np.uint8) * np.uint8(255) if frames.bits == 8 else np.packbits(mask)
    masked = frames.device.empty(frames.images.shape, np.uint8, table=True)
    frames.device.launch(mask_bytes, images=frames.images, mask=frames.device.table(row, "uint8"), masked=masked)
    return replace(frames, images=masked)


def _light(light: DeviceArray, mask: np.ndarray) -> DeviceArray:
    masked: Any = light.device.empty(light.shape)
    light.device.launch(mask_rays, light=light, shares=light.device.table(mask.astype(np.float64)), masked=masked)
    return masked
