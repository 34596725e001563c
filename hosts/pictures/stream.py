"""Pictures of a job as mirrors take them: bit planes of the numbered frames of a vial or a web, made when asked for."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.hosts.pictures.sources import FrameSource, RunSource, Source
from vamgpu.hosts.schedules.schedule import NONE
from vamgpu.printing.focus import FocusMasks
from vamgpu.printing.frames import Frames


class Pictures(Protocol):
    """Numbered pictures of one projector."""

    bits: int

    def planes(self, numbers: np.ndarray) -> np.ndarray:
        """Bit planes of pictures, uint8 [picture, plane, row, byte], the highest bit first and leftmost."""
        ...

    def picture(self, number: int) -> np.ndarray:
        """One picture for people, uint8 [row, column]."""
        ...


@runtime_checkable
class MadePictures(Protocol):
    """Pictures that a device can make."""

    def source(self, batch: int) -> Source | None:
        """Pictures as their device makes them, ``batch`` at once; None for mirrors that its kernels do not write."""
        ...


@dataclass(frozen=True)
class Mirrors:
    """The array that pictures are for. row_bytes: of a packed row, which may be longer than the columns need."""

    rows: int
    columns: int
    row_bytes: int

    def place(self, rows: int, columns: int) -> tuple[slice, slice]:
        """Where a picture goes: to the middle. Raises `BadInput` for one that is too large."""
        if rows > self.rows or columns > self.columns:
            raise BadInput(
                f"the job's pictures are {rows} × {columns}, the mirrors {self.rows} × {self.columns}: the job was "
                "made for another projector; solve it again with [beam] pixels that fit"
            )
        top, left = (self.rows - rows) // 2, (self.columns - columns) // 2
        return slice(top, top + rows), slice(left, left + columns)

    def packed(self, levels: np.ndarray, bits: int) -> np.ndarray:
        """Levels, uint8 [picture, row, column], as bit planes in the middle of the mirrors."""
        down, across = self.place(*levels.shape[1:])
        full = np.zeros((self.rows, 8 * self.row_bytes), np.uint8)
        planes = np.empty((len(levels), bits, self.rows, self.row_bytes), np.uint8)
        for picture, packed in zip(levels, planes, strict=True):  # one by one, where caches hold them
            full[down, across] = picture
            for plane in range(bits):
                packed[plane] = np.packbits((full >> (bits - 1 - plane)) & 1, axis=-1)
        return planes


class PackedSource:
    """Pictures that are packed by the host when they are read.

    shape: of one picture's bytes [plane, row, byte].  frames: how many pictures there are.
    """

    def __init__(self, pictures: Pictures, shape: tuple[int, ...], frames: int) -> None:
        self._pictures, self.shape, self.frames = pictures, shape, frames

    def read(self, frames: np.ndarray, out: np.ndarray) -> None:
        """See `vamgpu.hosts.pictures.sources.Source`."""
        lit = np.flatnonzero(frames != NONE)
        if len(lit) < len(out):
            out[:] = 0
        if lit.size:
            out[lit] = self._pictures.planes(frames[lit])


def source(pictures: Pictures, shape: tuple[int, ...], frames: int, batch: int) -> Source:
    """Where a feed reads pictures: made on their device where its kernels can, else packed by the host."""
    if isinstance(pictures, MadePictures):
        made = pictures.source(batch)
        if made is not None and made.shape == shape:
            return made
    return PackedSource(pictures, shape, frames)


class FramePictures:
    """The frames of a vial's job: number k is frame k."""

    def __init__(self, frames: Frames, mirrors: Mirrors) -> None:
        self.bits, self.count = frames.bits, frames.shape[0]
        mirrors.place(*frames.shape[1:])
        self._levels, self._mirrors, self._full = frames.levels(), mirrors, 255 if frames.bits == 1 else 1
        self._frames = frames

    def source(self, batch: int) -> FrameSource | None:
        """The frames as their device packs them; None for mirrors whose rows its kernels do not write."""
        frames, mirrors = self._frames, self._mirrors
        step = mirrors.row_bytes if frames.bits == 8 else (mirrors.columns - frames.shape[2]) // 2
        if step % 8:
            return None
        size = (mirrors.rows, mirrors.columns)
        return FrameSource(frames, row_bytes=mirrors.row_bytes, batch=batch, size=size)

    def planes(self, numbers: np.ndarray) -> np.ndarray:
        """See `Pictures`."""
        return self._mirrors.packed(self._levels[np.asarray(numbers)], self.bits)

    def levels(self, numbers: np.ndarray) -> np.ndarray:
        """Of pictures, uint8 [picture, row, column], 255 full on."""
        return self._levels[np.asarray(numbers)] * np.uint8(self._full)

    def picture(self, number: int) -> np.ndarray:
        """See `Pictures`."""
        return self._levels[number] * np.uint8(self._full)


class WebPictures:
    """The frames of a web, cut by columns among its focus planes: number pose · planes + plane.

    read: frames from one pose to another, uint8 [pose, row, column], never by two threads at once.  masks: which
    plane shows which column, bool (planes, columns) or those of a roller; None for one focus.  device: that cuts and
    splits them; None for the host.  Frames are read in runs when they are wanted, and only those of a batch are held,
    however long the web is.
    """

    bits = 8

    def __init__(
        self, read: Callable[[int, int], np.ndarray], poses: int, mirrors: Mirrors,
        masks: FocusMasks | np.ndarray | None = None, device: Device | None = None,
    ) -> None:  # fmt: skip
        rows, columns = read(0, 1).shape[1:]
        mirrors.place(rows, columns)
        self._read, self._mirrors, self._own, self._device = read, mirrors, (rows, columns), device
        shown = masks.masks if isinstance(masks, FocusMasks) else masks
        self._masks = np.ones((1, columns), bool) if shown is None else shown
        self._reading = threading.Lock()
        self.count = poses * len(self._masks)

    def source(self, batch: int) -> RunSource | None:
        """See `MadePictures`."""
        mirrors = self._mirrors
        if self._device is None or mirrors.row_bytes % 8:
            return None
        size = (mirrors.rows, mirrors.columns)
        return RunSource(
            self._poses, self.count, self._own, self._device, self._masks, row_bytes=mirrors.row_bytes, batch=batch,
            size=size,
        )  # fmt: skip

    def planes(self, numbers: np.ndarray) -> np.ndarray:
        """See `Pictures`."""
        return self._mirrors.packed(self.levels(numbers), self.bits)

    def levels(self, numbers: np.ndarray) -> np.ndarray:
        """Of pictures, uint8 [picture, row, column], 255 full on."""
        poses, planes = np.divmod(np.asarray(numbers), len(self._masks))
        wanted, place = np.unique(poses, return_inverse=True)
        levels = self._poses(wanted)[place]
        levels *= self._masks[planes][:, None, :]
        return levels

    def picture(self, number: int) -> np.ndarray:
        """See `Pictures`."""
        return self.levels(np.array([number]))[0]

    def _poses(self, poses: np.ndarray) -> np.ndarray:
        """Frames of rising poses, uint8 [pose, row, column], each run of neighbors read at once."""
        out = np.empty((len(poses), *self._own), np.uint8)
        cuts = [0, *(1 + np.flatnonzero(np.diff(poses) != 1)).tolist(), len(poses)]
        with self._reading:
            for low, high in zip(cuts[:-1], cuts[1:], strict=True):
                out[low:high] = self._read(int(poses[low]), int(poses[high - 1]) + 1)
        return out
