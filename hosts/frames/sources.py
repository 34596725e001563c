"""Sources of numbered frames, of a vial or a web, read or made on request."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.hosts.frames.packer import DevicePacker
from vamgpu.printing.focus import FocusMasks
from vamgpu.printing.frames import Frames


class FrameSource(Protocol):
    """Numbered frames of one projector. Sources that a device packs also have a method ``packer(batch)``."""

    bits: int

    # bit planes of frames, uint8 [frame, plane, row, byte], the highest bit first and leftmost
    def planes(self, numbers: np.ndarray) -> np.ndarray: ...
    def frame(self, number: int) -> np.ndarray: ...  # one frame to display, uint8 [row, column]


@dataclass(frozen=True)
class MirrorArray:
    """The mirrors for the frames. row_bytes: bytes of a packed row, which may exceed those of the columns."""

    rows: int
    columns: int
    row_bytes: int

    def place(self, rows: int, columns: int) -> tuple[slice, slice]:
        """Position of a frame, in the middle. Raises `BadInput` if it is too large."""
        if rows > self.rows or columns > self.columns:
            raise BadInput(
                f"the job's frames are {rows} × {columns}, the mirrors {self.rows} × {self.columns}: the job was "
                "made for another projector; solve it again with [beam] pixels that fit"
            )
        top, left = (self.rows - rows) // 2, (self.columns - columns) // 2
        return slice(top, top + rows), slice(left, left + columns)

    def packed(self, levels: np.ndarray, bits: int) -> np.ndarray:
        """Levels, uint8 [frame, row, column], as bit planes in the middle of the mirrors."""
        down, across = self.place(*levels.shape[1:])
        full = np.zeros((self.rows, 8 * self.row_bytes), np.uint8)
        planes = np.empty((len(levels), bits, self.rows, self.row_bytes), np.uint8)
        for frame, packed in zip(levels, planes, strict=True):  # one by one, so that they fit in caches
            full[down, across] = frame
            for plane in range(bits):
                packed[plane] = np.packbits((full >> (bits - 1 - plane)) & 1, axis=-1)
        return planes


class _Leveled:
    """Frames given by their levels."""

    bits: int
    _mirrors: MirrorArray

    def levels(self, numbers: np.ndarray) -> np.ndarray:
        """Gray levels of frames, uint8 [frame, row, column], 255 full on."""
        raise NotImplementedError

    def planes(self, numbers: np.ndarray) -> np.ndarray:
        return self._mirrors.packed(self.levels(numbers), self.bits)

    def frame(self, number: int) -> np.ndarray:
        return self.levels(np.array([number]))[0]


class VialFrames(_Leveled):
    """The frames of a vial's job: number k is frame k."""

    def __init__(self, frames: Frames, mirrors: MirrorArray) -> None:
        mirrors.place(*frames.shape[1:])
        self.bits: int = frames.bits
        self.count: int = frames.shape[0]
        self._frames, self._mirrors = frames, mirrors
        self._levels, self._full = frames.levels(), np.uint8(255 if frames.bits == 1 else 1)

    def packer(self, batch: int) -> DevicePacker | None:
        """The frames as their device packs them; None if its kernels do not support the mirrors' rows."""
        frames, mirrors = self._frames, self._mirrors
        step = mirrors.row_bytes if frames.bits == 8 else (mirrors.columns - frames.shape[2]) // 2
        if step % 8:
            return None
        size = (mirrors.rows, mirrors.columns)
        return DevicePacker.of(frames, row_bytes=mirrors.row_bytes, batch=batch, size=size)

    def levels(self, numbers: np.ndarray) -> np.ndarray:
        return self._levels[np.asarray(numbers)] * self._full


class WebFrames(_Leveled):
    """Frames of a web, split by columns into its focus planes: number pose · planes + plane; one batch is held."""

    bits = 8

    def __init__(
        self, read: Callable[[int, int], np.ndarray], poses: int, mirrors: MirrorArray,
        masks: FocusMasks | np.ndarray | None = None, device: Device | None = None,
    ) -> None:  # fmt: skip
        rows, columns = read(0, 1).shape[1:]
        mirrors.place(rows, columns)
        self._read, self._mirrors, self._own, self._device = read, mirrors, (rows, columns), device
        shown = masks.masks if isinstance(masks, FocusMasks) else masks
        self._masks = np.ones((1, columns), bool) if shown is None else shown
        self._reading = threading.Lock()
        self.count: int = poses * len(self._masks)

    def packer(self, batch: int) -> DevicePacker | None:
        mirrors = self._mirrors
        if self._device is None or mirrors.row_bytes % 8:
            return None
        return DevicePacker(
            self._device, self._poses, self.count, self._own, 8, self._masks, row_bytes=mirrors.row_bytes,
            batch=batch, size=(mirrors.rows, mirrors.columns),
        )  # fmt: skip

    def levels(self, numbers: np.ndarray) -> np.ndarray:
        poses, planes = np.divmod(np.asarray(numbers), len(self._masks))
        wanted, place = np.unique(poses, return_inverse=True)
        levels = self._poses(wanted)[place]
        levels *= self._masks[planes][:, None, :]
        return levels

    def _poses(self, poses: np.ndarray) -> np.ndarray:
        """Frames of rising poses, uint8 [pose, row, column], each run of neighbors read at once."""
        out = np.empty((len(poses), *self._own), np.uint8)
        cuts = [0, *(1 + np.flatnonzero(np.diff(poses) != 1)).tolist(), len(poses)]
        with self._reading:
            for low, high in zip(cuts[:-1], cuts[1:], strict=True):
                out[low:high] = self._read(int(poses[low]), int(poses[high - 1]) + 1)
        return out
