"""Frames: what a projector is handed, and the light its mirrors make of it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from vamgpu.backend import open_device
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.geometry import Turntable, positive
from vamgpu.kernels.pack import unpack
from vamgpu.printing.gray import GrayCurve
from vamgpu.printing.placement import Placement


@dataclass(frozen=True, eq=False)
class Frames:
    """One picture a pose. Row 0 shows the largest z, column 0 the smallest r, before the flips of ``settings``.

    images: uint8 table on a device, [angle, row, column] where ``bits`` is 8 and [angle, row, ⌈columns / 8⌉] where it
    is 1, the leftmost column in the highest bit.  gray: light of the levels.  scale: irradiance of a full-on pixel, in
    the plan's units.  columns: pixels a row.  flat_field: relative brightness [row, column] of full-on mirrors, the
    brightest 1; None where all are alike.  motion: the poses that pictures are for, once for each tile; None where
    nobody said, or of a web.  Raises `BadInput`, `ShapeMismatch`.
    """

    images: DeviceArray
    bits: int
    gray: GrayCurve
    scale: float
    columns: int
    settings: Placement = field(default_factory=Placement)
    flat_field: np.ndarray | None = None
    motion: Turntable | None = None

    def __post_init__(self) -> None:
        if self.bits not in (1, 8):
            raise BadInput(f"bits is {self.bits!r}; expected 1 or 8")
        positive("scale", self.scale)
        width = self.columns if self.bits == 8 else -(-self.columns // 8)
        if len(self.images.shape) != 3 or self.images.shape[2] != width or self.images.dtype != np.uint8:
            raise ShapeMismatch(
                f"images is {self.images!r}; expected uint8 [angle, row, {width}] for {self.columns} columns of "
                f"{self.bits} bits"
            )
        if self.motion is not None and self.shape[0] % self.motion.angles:
            raise ShapeMismatch(
                f"{self.shape[0]} pictures are for {self.motion} angles; expected a picture for each, or for each in "
                "every tile: pack the light of the same turntable"
            )
        if self.flat_field is not None:
            object.__setattr__(self, "flat_field", flattened(self.flat_field, self.shape[1:]))

    @classmethod
    def from_bytes(cls, images: np.ndarray, device: str | Device | None = None, **fields: Any) -> Frames:
        """Frames of a NumPy array of bytes, put on a device; ``fields`` are those of the class."""
        if images.dtype != np.uint8:
            raise BadInput(f"the bytes of frames are {images.dtype}; expected uint8")
        return cls(open_device(device).upload(images, table=True), **fields)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Pictures, rows and columns."""
        return (self.images.shape[0], self.images.shape[1], self.columns)

    @property
    def nbytes(self) -> int:
        """Bytes of all pictures."""
        return int(np.prod(self.images.shape, dtype=np.int64))

    @property
    def device(self) -> Device:
        """Where the bytes are."""
        return self.images.device

    def __repr__(self) -> str:
        angles, rows, columns = self.shape
        return f"Frames({angles} of {rows} × {columns}, {self.bits} bits, on {self.device.name!r})"

    def on(self, device: str | Device | None) -> Frames:
        """The same frames with their bytes on another device."""
        there = open_device(device)
        if there is self.device:
            return self
        return replace(self, images=there.upload(self.images.numpy(), table=True))

    def irradiance(self, device: str | Device | None = None) -> DeviceArray:
        """The light that reaches the beam's pixels, field [angle, r, z] in the plan's units, black level included.

        Computed from the bytes and what is known of the projector alone: gray curve, flat field, scale, flips, shift.
        The shift is undone as the machine undoes it, by where the picture lands: a pixel that lies across several beam
        pixels shares its light among them, and beam pixels beyond the picture stay wholly dark. device: where to, by
        default where the bytes are.
        """
        there = self.device if device is None else open_device(device)
        frames, (angles, rows, columns) = self.on(there), self.shape
        light = there.empty((angles, columns, rows))
        there.launch(
            unpack,
            images=frames.images,
            flat=flat_table(there, self.flat_field),
            curve=there.table(self.gray.table(self.bits)),
            bits=self.bits,
            scale=self.scale,
            light=light,
            **self.settings.arguments(),
        )
        return light

    def levels(self) -> np.ndarray:
        """The value of every pixel, uint8 [angle, row, column]: 0 to 255, or 0 and 1 where ``bits`` is 1."""
        images = self.images.numpy()
        return images if self.bits == 8 else np.unpackbits(images, axis=-1, count=self.columns)

    def pictures(self) -> np.ndarray:
        """Pictures for a viewer, uint8 [angle, row, column] from 0 to 255 at either bit depth."""
        return self.levels() if self.bits == 8 else self.levels() * np.uint8(255)


def flattened(flat_field: Any, shape: tuple[int, ...]) -> np.ndarray:
    """A flat field [row, column] as float64, its brightest mirror 1. Raises `ShapeMismatch`, `BadInput`."""
    flat = np.asarray(flat_field, dtype=np.float64)
    if flat.shape != shape:
        raise ShapeMismatch(f"the flat field has shape {flat.shape}; expected {shape} = [row, column] of the frames")
    if not np.isfinite(flat).all() or flat.min() <= 0:
        raise BadInput(
            f"the flat field goes from {flat.min():g} to {flat.max():g}; expected finite brightness > 0: "
            "give dead mirrors that of the dimmest one that works"
        )
    return flat / flat.max()


def flat_table(device: Device, flat_field: np.ndarray | None) -> DeviceArray:
    """The flat field on a device; a table of a single 1 where all mirrors are alike."""
    return device.table(np.ones((1, 1)) if flat_field is None else flat_field)
