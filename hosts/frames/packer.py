"""Packers of frames to bit planes for mirrors, on the host or on a device."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, ShapeMismatch, WrongDevice
from vamgpu.hosts.schedules.schedule import NONE
from vamgpu.kernels.planes import pick_frames, split_planes, strips_for
from vamgpu.kernels.signature import Kernel
from vamgpu.printing.focus import FocusMasks
from vamgpu.printing.frames import Frames

if TYPE_CHECKING:
    from vamgpu.hosts.frames.sources import FrameSource


class PlanePacker:
    """Packs numbered frames on the host. shape: shape of one frame's bytes [plane, row, byte]."""

    device: Device | None = None

    def __init__(self, source: FrameSource | None, shape: tuple[int, ...], frames: int) -> None:
        self.shape = shape
        self.frames = frames
        self._source = source

    def read(self, frames: np.ndarray, out: np.ndarray) -> None:
        """Write frames, by their numbers, to ``out`` uint8 [frame, …]; `NONE` and numbers beyond the last are black."""
        assert self._source is not None
        lit = np.flatnonzero(frames != NONE)
        if len(lit) < len(out):
            out[:] = 0
        if lit.size:
            out[lit] = self._source.planes(frames[lit])


class DevicePacker(PlanePacker):
    """Packs frames on a device, split by focus plane and centered on the mirrors: only finished bytes cross the bus."""

    device: Device
    kernel: Kernel

    def __init__(
        self, device: Device, images: DeviceArray | Callable[[np.ndarray], np.ndarray], frames: int,
        own: tuple[int, int], bits: int, shown: np.ndarray, *, row_bytes: int | None = None, batch: int = 8,
        size: tuple[int, int] | None = None,
    ) -> None:  # fmt: skip
        self.device = self._device = device
        self.batch = batch
        self.planes: int = len(shown)
        self._images, self._own = images, own
        rows, columns = size or own
        top, left = _middle(own, (rows, columns), 8 if bits == 1 else 1)
        self.kernel, step = (split_planes, 8) if bits == 8 else (pick_frames, 1)
        needed = -(-columns // (8 * step)) * step
        width = needed if row_bytes is None else row_bytes
        if width < -(-columns // 8) or width % step:
            raise BadInput(f"row_bytes is {row_bytes!r}; expected {needed} or more, in steps of {step}")
        shown = np.concatenate([shown, np.zeros((1, own[1]), bool)])  # the last one is black
        masks = shown.astype(np.uint8) * np.uint8(255) if bits == 8 else np.packbits(shown, axis=1)
        self._chosen = np.empty((batch, 2), np.int32)
        shape = (8, rows, width) if self.kernel is split_planes else (rows, width)
        self._made = (batch, *shape)
        self._staged: DeviceArray | None = None
        self._fixed: dict[str, Any] = {"masks": device.upload(masks, table=True), "top": top, "left": left}
        self._target = "picked"
        if self.kernel is split_planes:
            self._target, strips = "packed", strips_for(rows, width, device.is_gpu)
            self._fixed["sent"] = device.empty((batch, strips), np.int32, table=True)
        super().__init__(None, (1, *shape) if bits == 1 else shape, frames)

    @classmethod
    def of(cls, frames: Frames, *, masks: FocusMasks | None = None, **options: Any) -> Self:
        """A packer of frames on a device. masks: focus planes.  options: as above."""
        count, *own = frames.shape
        shown = np.ones((1, own[1]), bool) if masks is None else masks.of_frames(frames)
        return cls(
            frames.device, frames.images, count * len(shown), (own[0], own[1]), frames.bits, shown, **options
        )  # fmt: skip

    def read(self, frames: np.ndarray, out: np.ndarray) -> None:
        """See `PlanePacker`; ``out`` is C contiguous, as long as the batch."""
        if len(frames) > self.batch or out.shape != (self.batch, *self.shape):
            raise ShapeMismatch(f"{len(frames)} frames into {out.shape}; expected at most {(self.batch, *self.shape)}")
        lit = np.flatnonzero(frames != NONE)
        numbers = frames[lit]
        if lit.size and not 0 <= numbers.min() <= numbers.max() < self.frames:
            raise BadInput(f"frames {numbers.min()} to {numbers.max()}; there are {self.frames}")
        place, plane = np.divmod(numbers, self.planes)
        images = self._images
        if callable(images):
            poses, place = np.unique(place, return_inverse=True)
            images = self._device.borrow(images(poses) if poses.size else np.zeros((1, *self._own), np.uint8))
        self._chosen[:] = (0, self.planes)
        self._chosen[lit, 0], self._chosen[lit, 1] = place, plane
        self._make(images, out.reshape(self._made))

    def _make(self, images: DeviceArray, out: np.ndarray) -> None:
        """Launch; a device without shared host memory makes frames in its own memory."""
        chosen, made = self._device.upload(self._chosen, table=True), self._device.lend(out)
        lent = made is not None
        if made is None:
            if self._staged is None:
                self._staged = self._device.empty(self._made, np.uint8, table=True)
            made = self._staged
        self._device.launch(self.kernel, **self._fixed, **{self._target: made}, images=images, chosen=chosen)
        if not lent:
            made.numpy(out)
        self._device.synchronize()


def packer(source: FrameSource, shape: tuple[int, ...], frames: int, batch: int) -> PlanePacker:
    """Packs a source's frames, ``batch`` at once, to bytes of a shape: on its device if possible, else on the host."""
    packs = getattr(source, "packer", None)
    made = None if packs is None else packs(batch)
    return made if made is not None and made.shape == shape else PlanePacker(source, shape, frames)


def _middle(own: tuple[int, int], size: tuple[int, int], step: int) -> tuple[int, int]:
    """Rows, and bytes or columns, before images in the middle of mirrors. Raises `WrongDevice`, `BadInput`."""
    if own[0] > size[0] or own[1] > size[1]:
        raise WrongDevice(
            f"the job's frames have {own[0]} × {own[1]} pixels, the mirrors {size[0]} × {size[1]}: it was made for "
            "another device; pack it again for these mirrors, or check the rig's file"
        )
    left = (size[1] - own[1]) // 2
    if left % step:
        raise BadInput(f"frames of 1 bit would begin at column {left} of the mirrors; expected a multiple of {step}")
    return (size[0] - own[0]) // 2, left // step
