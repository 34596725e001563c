"""Frames: the bytes for a projector, and the light that its mirrors make of them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from vamgpu.backend import open_device
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.card import card, drawable
from vamgpu.deprecated import Renamed
from vamgpu.errors import BadInput, OutOfMemory, ShapeMismatch
from vamgpu.geometry import Beam, Turntable, positive
from vamgpu.kernels.pack import unpack
from vamgpu.operators.follow import followed
from vamgpu.printing.gray import GrayCurve
from vamgpu.printing.placement import Placement
from vamgpu.schema.quantities import numeric
from vamgpu.storage.memory import afford


@dataclass(frozen=True, eq=False)
class Frames:
    """One frame for each angle. Row 0 shows the largest z, column 0 the smallest r, before the flips of ``settings``.

    Args:
        images: Table uint8 on a device, [angle, row, column] if ``bits`` is 8, and [angle, row, ⌈columns / 8⌉] if it is
            1, the leftmost column in the highest bit.
        bits: Bits per pixel, 8 or 1.
        gray: Light of the levels.
        scale: Irradiance of a full-on pixel, in the plan's units.
        columns: Pixels per row.
        settings: Flips and shift of the frames.
        flat_field: Relative brightness [row, column] of full-on mirrors, the brightest 1; None if all are alike.
        motion: The angles of the frames, once for each tile; None if unknown, or for a web.
        packed: The bytes [angle, row, column] that were packed from a plan, and that plan; see `plan`.

    Raises:
        BadInput: A value is out of its range.
        ShapeMismatch: Shapes do not fit.
    """

    images: DeviceArray
    bits: int
    gray: GrayCurve
    scale: float
    columns: int
    settings: Placement = field(default_factory=Placement)
    flat_field: np.ndarray | None = None
    motion: Turntable | None = None
    packed: tuple[DeviceArray, Any] | None = field(default=None, repr=False)

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
                f"{self.shape[0]} frames are for {self.motion} angles; expected one frame for each angle, or for each "
                "angle of every tile: pack the light of the same turntable"
            )
        if self.flat_field is not None:
            object.__setattr__(self, "flat_field", flattened(self.flat_field, self.shape[1:]))

    @classmethod
    def from_bytes(cls, images: np.ndarray, device: str | Device | None = None, **fields: Any) -> Frames:
        """Frames of a NumPy array of bytes, put on a device; ``fields`` are those of the class.

        Args:
            images: Bytes as for `Frames.images`, uint8 [angle, row, column].
            device: A name or a device; the best available device by default.
            **fields: The other fields of the class.

        Returns:
            The frames, their bytes on the device.

        Raises:
            BadInput: The array is not of uint8.
        """
        if images.dtype != np.uint8:
            raise BadInput(f"the bytes of frames are {images.dtype}; expected uint8")
        return cls(open_device(device).upload(images, table=True), **fields)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Frames, rows and columns."""
        return (self.images.shape[0], self.images.shape[1], self.columns)

    @property
    def plan(self) -> Any:
        """The plan that was packed, or its light and operator; None for frames of bytes or changed bytes.

        It holds the patterns for a job folder; frames for another machine are packed from them.
        """
        return self.packed[1] if self.packed is not None and self.packed[0] is self.images else None

    @property
    def nbytes(self) -> int:
        """Bytes of all frames."""
        return int(np.prod(self.images.shape, dtype=np.int64))

    @property
    def device(self) -> Device:
        """The device of the bytes."""
        return self.images.device

    def __repr__(self) -> str:
        angles, rows, columns = self.shape
        return f"Frames({angles} of {rows} × {columns}, {self.bits} bits, on {self.device.name!r})"

    def _repr_html_(self) -> str:
        angles, rows, columns = self.shape
        first = self.gray_levels()[0] if drawable(self.shape) else None
        numbers = {
            "frames": f"{angles:,} of {columns:,} × {rows:,} pixels",
            "depth": f"{self.bits} bit{'s' if self.bits > 1 else ''} a pixel, {self.nbytes / 1e6:.3g} MB",
            "a full-on pixel": f"{self.scale:.4g} of the dose's unit per mm",
            "on": self.device.name,
        }
        return card("Frames", numbers, {"the first frame": None if first is None else first[::-1].T})

    def on(self, device: str | Device | None) -> Frames:
        """Copy the bytes to another device.

        Args:
            device: A name or a device; the best available device by default.

        Returns:
            The same frames there.
        """
        there = open_device(device)
        if there is self.device:
            return self
        images = there.upload(self.images.numpy(), table=True)
        return replace(self, images=images, packed=None if self.plan is None else (images, self.plan))

    def save(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write a job folder for `vamgpu.load` and ``vam print``.

        Frames of a plan are stored as its patterns, with the plan's operator and target. ``vam prove`` then accepts the
        folder, and each machine packs its own frames. Other frames are stored as bytes.

        Args:
            path: The folder.
            overwrite: Replace an existing job folder.

        Returns:
            The path.

        Raises:
            StorageError: The path exists, or cannot be written.
        """
        # avoids a circular import: folders make frames
        from vamgpu.printing.folder import save_frames

        return save_frames(path, self, overwrite=overwrite).path

    def irradiance(self, device: str | Device | None = None) -> DeviceArray:
        """Compute the light that reaches the beam's pixels, only from the bytes and the projector's properties.

        The shift is undone as on the machine: a pixel that covers several beam pixels shares its light among them, and
        beam pixels beyond the frame stay completely dark.

        Args:
            device: Device of the result; by default that of the bytes.

        Returns:
            Light [angle, r, z] in the plan's units, black level included.
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

    def followed(self, beam: Beam) -> Frames:
        """Move the frames with a part that travels, turn after turn, by whole pixels; no level changes.

        Args:
            beam: The beam whose light the frames show, that of the plan's operator.

        Returns:
            The frames of all turns, (turns · angles), of more rows than the beam only if light moves beyond it. The
            frames themselves for a part at rest.

        Raises:
            BadInput: The frames compensate a flat field, which belongs to mirrors that do not move with them.
            OutOfMemory: The frames of all turns exceed the memory budget.
        """
        path = None if self.motion is None else followed(self.motion, beam)
        if self.motion is None or path is None:
            return self
        if self.flat_field is not None:
            raise BadInput("frames that follow a part got a flat field, which belongs to mirrors that do not move with "
                           'them; expected none: pack without it, or set flat = "none" in [calibration]')  # fmt: skip
        (columns, rows), upward, onward = path.size, 2 * self.settings.flip_z - 1, 1 - 2 * self.settings.flip_r
        patterns, whole = self.images.numpy(), path.whole.reshape(-1, 2)
        width, lit = columns if self.bits == 8 else -(-columns // 8), path.lit.reshape(len(whole), -1, 1)
        # on this machine and on the device
        afford(2 * len(whole) * rows * width + patterns.nbytes, f"frames of {len(path.whole)} turns", OutOfMemory)
        images = np.empty((len(whole), rows, width), np.uint8)
        for number, (column, row) in enumerate(whole):
            shown = self._unpacked(patterns[number % len(patterns)])[::upward, ::onward] * lit[number]
            there, z = _shared(row, rows, shown.shape[0])
            across, r = _shared(column, columns, shown.shape[1])
            level = np.zeros((rows, columns), np.uint8)
            level[there, across] = shown[z, r]
            level = level[::upward, ::onward]
            images[number] = level if self.bits == 8 else np.packbits(level, axis=-1)
        while images.shape[1] > beam.pixels[1] and not images[:, [0, -1]].any():
            images = images[:, 1:-1]
        images = self.device.upload(np.ascontiguousarray(images), table=True)
        return replace(self, images=images, columns=columns, motion=self.motion.along(None), packed=None)

    def levels(self, first: int = 0, last: int | None = None) -> np.ndarray:
        """The value of every pixel, of all frames or of some.

        Args:
            first: The first frame.
            last: The one after the last; None for all.

        Returns:
            Levels, uint8 (frames, rows, columns): 0 to 255, or 0 and 1 if ``bits`` is 1.
        """
        return self._unpacked(self.images.part(first, self.shape[0] if last is None else last))

    def _unpacked(self, images: np.ndarray) -> np.ndarray:
        return images if self.bits == 8 else np.unpackbits(images, axis=-1, count=self.columns)

    def gray_levels(self, first: int = 0, last: int | None = None) -> np.ndarray:
        """Gray levels for a viewer, of all frames or of some.

        Args:
            first: The first frame.
            last: The one after the last; None for all.

        Returns:
            Levels from 0 to 255 at either bit depth, uint8 (frames, rows, columns).
        """
        levels = self.levels(first, last)
        return levels if self.bits == 8 else levels * np.uint8(255)

    pictures: ClassVar[Renamed] = Renamed("gray_levels")


def _shared(first: int, size: int, count: int) -> tuple[slice, slice]:
    """Samples of a frame, and of a pattern of ``count`` samples, that are the same; ``first``: the frame's first."""
    low = max(first, 0)
    high = max(min(first + size, count), low)
    return slice(low - first, high - first), slice(low, high)


def flattened(flat_field: Any, shape: tuple[int, ...]) -> np.ndarray:
    """A flat field [row, column] as float64, its brightest mirror 1. Raises `ShapeMismatch`, `BadInput`."""
    flat = numeric("the flat field", flat_field, (), "finite brightness [row, column]")
    if flat.shape != shape:
        raise ShapeMismatch(f"the flat field has shape {flat.shape}; expected {shape} = [row, column] of the frames")
    if flat.min() <= 0:
        raise BadInput(f"the flat field falls to {flat.min():g}; expected brightness > 0: give dead mirrors the value "
                       "of the dimmest one that works")  # fmt: skip
    return flat / flat.max()


def flat_table(device: Device, flat_field: np.ndarray | None) -> DeviceArray:
    """The flat field on a device; a table with a single 1 if all mirrors are equally bright."""
    return device.table(np.ones((1, 1)) if flat_field is None else flat_field)
