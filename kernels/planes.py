"""Frames in the form that mirrors load: in the order in which they are shown, masked by columns, as bit planes."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.signature import Integer, Table, Tiling, kernel

BLOCK = 64
"""Columns split together; rows of planes are whole blocks."""

Images = Annotated[np.ndarray, Table("uint8", ("angle", "line", "byte"))]
Masks = Annotated[np.ndarray, Table("uint8", ("bin", "byte"))]
Chosen = Annotated[np.ndarray, Table("int32", ("frame", "2"))]
Packed = Annotated[np.ndarray, Table("uint8", ("frame", "8", "row", "width"), writes=True)]
Picked = Annotated[np.ndarray, Table("uint8", ("frame", "row", "width"), writes=True)]
Sent = Annotated[np.ndarray, Table("int32", ("frame", "strip"), writes=True)]


def put(whole: np.ndarray, part: np.ndarray, top: int, left: int) -> None:
    """Write a frame into a larger one; pixels beyond its edges are left out."""
    room = whole[top : top + part.shape[0], left : left + part.shape[1]]
    room[...] = part[: room.shape[0], : room.shape[1]]


def strips_for(rows: int, width: int, gpu: bool) -> int:
    """Best number of strips for a frame of planes with this number of rows, and of bytes in a row."""
    blocks = 8 * width // BLOCK
    return max(blocks * -(-rows // 8), 1) if gpu else min(128, rows)


def strips_of(rows: int, width: int, strips: int) -> np.ndarray:
    """The strip of every block, [row, block]."""
    blocks = 8 * width // BLOCK
    row, block = np.indices((rows, blocks))
    if strips > rows and strips % blocks == 0:
        band = -(-rows // (strips // blocks))
        return row // band * blocks + block
    return (row * blocks + block) // (8 * -(-rows * blocks // (8 * strips)))


@kernel(over="sent", gpu=Tiling(group=(128, 1)))
def split_planes(
    images: Images, masks: Masks, chosen: Chosen, top: Integer, left: Integer, packed: Packed, sent: Sent
) -> None:  # fmt: skip
    """packed = the bit planes of the 8-bit frames images[angle] & masks[bin], (angle, bin) = chosen[frame]."""
    # top, left: dark rows and columns of mirrors before the first of the frame. sent: sum of the levels in each of the
    # strips (`strips_of`). width: a multiple of 8.
    frames, _, rows, width = packed.shape
    strips = sent.shape[1]
    strip = strips_of(rows, width, strips).ravel()
    for frame in range(frames):
        angle, focus = chosen[frame]
        levels = np.zeros((rows, 8 * width), np.uint8)
        put(levels, images[angle] & masks[focus], top, left)
        for plane in range(8):
            packed[frame, plane] = np.packbits((levels >> (7 - plane)) & 1, axis=-1)
        sums = levels.reshape(-1, BLOCK).sum(axis=1, dtype=np.int64)
        sent[frame] = np.bincount(strip, sums, minlength=strips).astype(sent.dtype)


@kernel(over="picked", cpu=Tiling(minor=0))
def pick_frames(
    images: Images, masks: Masks, chosen: Chosen, top: Integer, left: Integer, picked: Picked
) -> None:  # fmt: skip
    """picked = images[angle] & masks[bin] with (angle, bin) = chosen[frame], byte by byte, and 0 around it."""
    # Bytes are levels, or eight columns each for frames of one bit; left counts them.
    picked[...] = 0
    for frame, (angle, focus) in enumerate(chosen):
        put(picked[frame], images[angle] & masks[focus], top, left)
