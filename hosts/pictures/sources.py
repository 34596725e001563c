"""Where the pictures of a print come from, in the form the mirrors are loaded with."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, ShapeMismatch, WrongDevice
from vamgpu.hosts.schedules.schedule import NONE
from vamgpu.kernels.planes import pick_pictures, split_planes, strips_for
from vamgpu.kernels.signature import Kernel
from vamgpu.printing.focus import FocusMasks
from vamgpu.printing.frames import Frames


class Source(Protocol):
    """Pictures by number."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Of one picture's bytes."""
        ...

    @property
    def frames(self) -> int:
        """How many there are."""
        ...

    def read(self, frames: np.ndarray, out: np.ndarray) -> None:
        """Write pictures to ``out`` [picture, …]; those beyond the last are black, as number −1 is."""
        ...


class ArraySource:
    """Pictures that lie ready in host memory, uint8 [picture, …]."""

    def __init__(self, pictures: np.ndarray) -> None:
        if pictures.dtype != np.uint8 or pictures.ndim < 2:
            raise ShapeMismatch(f"pictures are {pictures.dtype}{list(pictures.shape)}; wanted uint8 [picture, …]")
        self._pictures = pictures

    @property
    def shape(self) -> tuple[int, ...]:
        """Of one picture's bytes."""
        return self._pictures.shape[1:]

    @property
    def frames(self) -> int:
        """How many there are."""
        return len(self._pictures)

    def read(self, frames: np.ndarray, out: np.ndarray) -> None:
        """See `Source`."""
        for place, frame in enumerate(frames.tolist()):
            out[place] = 0 if frame == NONE else self._pictures[frame]
        out[len(frames) :] = 0


class Maker:
    """Makes on a device what mirrors are loaded with, of pictures that are there; only finished bytes cross the bus.

    own: rows and columns of the pictures, of 8 bits or of 1.  shown: which columns each focus plane shows, bool
    (planes, columns).  row_bytes: of a row in the mirrors' memory, a multiple of 8 for 8-bit pictures; None: what is
    needed.  batch: pictures at once.  whole: leave 8-bit pictures as bytes [row, column], for a video cable.  Pictures
    are uint8 [plane, row, byte] otherwise, the most significant plane first.  size: rows and columns of the mirrors, in
    whose middle smaller pictures go; None for those of the pictures. Raises `BadInput`; `WrongDevice` for pictures
    larger than the mirrors.
    """

    def __init__(
        self, device: Device, own: tuple[int, int], bits: int, shown: np.ndarray, *, row_bytes: int | None = None,
        batch: int = 8, whole: bool = False, size: tuple[int, int] | None = None,
    ) -> None:  # fmt: skip
        self.device, self.batch = device, batch
        rows, columns = size or own
        top, left = _middle(own, (rows, columns), 8 if bits == 1 else 1)
        self.kernel, step = (split_planes, 8) if bits == 8 and not whole else (pick_pictures, 1)
        needed = columns if whole and bits == 8 else -(-columns // (8 * step)) * step
        width = needed if row_bytes is None else row_bytes
        if width < -(-columns // 8) or width % step or (whole and width != columns):
            raise BadInput(f"row_bytes is {row_bytes!r}; wanted {needed} or more, in steps of {step}")
        self.planes = len(shown)
        shown = np.concatenate([shown, np.zeros((1, own[1]), bool)])  # the last shows nothing
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
        self.shape = (1, *shape) if bits == 1 else shape

    def fits(self, frames: np.ndarray, out: np.ndarray) -> None:
        """Raise `ShapeMismatch` for more pictures than at once, or another shape to write to."""
        if len(frames) > self.batch or out.shape != (self.batch, *self.shape):
            raise ShapeMismatch(f"{len(frames)} pictures into {out.shape}; wanted at most {(self.batch, *self.shape)}")

    def make(self, images: DeviceArray, places: np.ndarray, out: np.ndarray) -> None:
        """Write pictures to ``out``, uint8 (batch, …), C contiguous; those beyond the last are black.

        images: uint8 table [image, row, column or byte].  places: image · planes + plane of each; `NONE` is black.
        """
        self._chosen[:] = (0, self.planes)
        lit = np.flatnonzero(places != NONE)
        self._chosen[lit, 0], self._chosen[lit, 1] = np.divmod(places[lit], self.planes)
        chosen = self.device.upload(self._chosen, table=True)
        whole = out.reshape(self._made)
        lent = self.device.lend(whole)
        made = self._stage() if lent is None else lent
        self.device.launch(self.kernel, **self._fixed, **{self._target: made}, images=images, chosen=chosen)
        if lent is None:
            made.numpy(whole)
        self.device.synchronize()

    def _stage(self) -> DeviceArray:
        """Where pictures are made on a device that does not share the host's memory."""
        if self._staged is None:
            self._staged = self.device.empty(self._made, np.uint8, table=True)
        return self._staged


class FrameSource:
    """Frames that lie on a device, cut by focus plane and split into bit planes there.

    masks: focus planes; frame number = pose · planes + plane.  options: row_bytes, batch, whole, size of `Maker`.
    Raises `BadInput`, `ShapeMismatch`; `WrongDevice` for pictures larger than the mirrors.
    """

    def __init__(self, frames: Frames, *, masks: FocusMasks | None = None, **options: Any) -> None:
        count, *own = frames.shape
        shown = np.ones((1, own[1]), bool) if masks is None else masks.of_frames(frames)
        self._images, self.device = frames.images, frames.device
        self._maker = Maker(frames.device, (own[0], own[1]), frames.bits, shown, **options)
        self.shape, self.planes, self.batch = self._maker.shape, self._maker.planes, self._maker.batch
        self.frames = count * self.planes

    @property
    def kernel(self) -> Kernel:
        """What makes the bytes."""
        return self._maker.kernel

    def read(self, frames: np.ndarray, out: np.ndarray) -> None:
        """Make pictures on the device and bring them to ``out``, uint8 (batch, …), C contiguous."""
        self._maker.fits(frames, out)
        lit = frames[frames != NONE]
        if lit.size and not 0 <= lit.min() <= lit.max() < self.frames:
            raise BadInput(f"pictures {lit.min()} to {lit.max()}; there are {self.frames}")
        self._maker.make(self._images, frames, out)


class RunSource:
    """Pictures of 8 bits that are read in runs of poses when they are wanted, and cut and split on a device.

    read: images of poses, uint8 [pose, row, column], of poses in rising order.  frames: how many pictures there are,
    pose · planes + plane.  shown, options: of `Maker`.  Holds the images of one batch, however long the web is.
    """

    def __init__(
        self, read: Callable[[np.ndarray], np.ndarray], frames: int, own: tuple[int, int], device: Device,
        shown: np.ndarray, **options: Any,
    ) -> None:  # fmt: skip
        self._read, self.frames, self.device = read, frames, device
        self._maker = Maker(device, own, 8, shown, **options)
        self.shape, self.planes, self.batch = self._maker.shape, self._maker.planes, self._maker.batch
        self._own = own

    def read(self, frames: np.ndarray, out: np.ndarray) -> None:
        """See `Source`."""
        self._maker.fits(frames, out)
        lit = frames != NONE
        poses, planes = np.divmod(frames[lit], self.planes)
        wanted, place = np.unique(poses, return_inverse=True)
        images = self._read(wanted) if wanted.size else np.zeros((1, *self._own), np.uint8)
        places = np.full(len(frames), NONE, np.int64)
        places[lit] = place * self.planes + planes
        self._maker.make(self.device.borrow(images), places, out)


def _middle(own: tuple[int, int], size: tuple[int, int], step: int) -> tuple[int, int]:
    """Rows, and bytes or columns, before pictures in the middle of mirrors. Raises `WrongDevice`, `BadInput`."""
    if own[0] > size[0] or own[1] > size[1]:
        raise WrongDevice(
            f"the job's pictures have {own[0]} × {own[1]} pixels, the mirrors {size[0]} × {size[1]}: it was made for "
            "another device; pack it again for this one, or check the rig's file"
        )
    left = (size[1] - own[1]) // 2
    if left % step:
        raise BadInput(f"pictures of 1 bit would begin at column {left} of the mirrors; wanted a multiple of {step}")
    return (size[0] - own[0]) // 2, left // step
