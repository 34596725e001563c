"""From frames to what mirrors are loaded with: pictures picked in the order they are shown, cut by columns, and split
into bit planes.

A plane has rows from the top, and in a row eight columns a byte, the leftmost in the highest bit; bytes beyond the last
column are 0. The planes of a picture come by falling weight: the first is that of 128, the last that of 1.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.signature import Integer, Table, Tiling, kernel

BLOCK = 64
"""Columns split together; rows of planes are whole blocks."""

Images = Annotated[np.ndarray, Table("uint8", ("angle", "line", "byte"))]
Masks = Annotated[np.ndarray, Table("uint8", ("bin", "byte"))]
Chosen = Annotated[np.ndarray, Table("int32", ("picture", "2"))]
Packed = Annotated[np.ndarray, Table("uint8", ("picture", "8", "row", "width"), writes=True)]
Picked = Annotated[np.ndarray, Table("uint8", ("picture", "row", "width"), writes=True)]
Sent = Annotated[np.ndarray, Table("int32", ("picture", "strip"), writes=True)]


def put(whole: np.ndarray, part: np.ndarray, top: int, left: int) -> None:
    """Write a picture into a larger one, whatever lies over its edges left out."""
    room = whole[top : top + part.shape[0], left : left + part.shape[1]]
    room[...] = part[: room.shape[0], : room.shape[1]]


@kernel(over="sent", gpu=Tiling(group=(128, 1)))
def split_planes(
    images: Images, masks: Masks, chosen: Chosen, top: Integer, left: Integer, packed: Packed, sent: Sent
) -> None:  # fmt: skip
    """packed = the bit planes of the 8-bit pictures images[angle] & masks[bin], (angle, bin) = chosen[picture].

    top, left: rows and columns of mirrors before the first of the picture, ≥ 0; all around it is dark.  sent: sum of
    the levels in each strip; strips are equal runs of blocks of 64 columns, row by row, the last one cut.  width: a
    multiple of 8.
    """
    pictures, _, rows, width = packed.shape
    strips = sent.shape[1]
    blocks = rows * width // 8
    strip = np.arange(blocks) // -(-blocks // strips)
    for picture in range(pictures):
        angle, focus = chosen[picture]
        levels = np.zeros((rows, 8 * width), np.uint8)
        put(levels, images[angle] & masks[focus], top, left)
        for plane in range(8):
            packed[picture, plane] = np.packbits((levels >> (7 - plane)) & 1, axis=-1)
        sums = levels.reshape(blocks, BLOCK).sum(axis=1, dtype=np.int64)
        sent[picture] = np.bincount(strip, sums, minlength=strips).astype(sent.dtype)


@kernel(over="picked")
def pick_pictures(
    images: Images, masks: Masks, chosen: Chosen, top: Integer, left: Integer, picked: Picked
) -> None:  # fmt: skip
    """picked = images[angle] & masks[bin] with (angle, bin) = chosen[picture], byte by byte, and 0 around it.

    Bytes are levels, or eight columns each where pictures are of one bit; left counts them.
    """
    picked[...] = 0
    for picture, (angle, focus) in enumerate(chosen):
        put(picked[picture], images[angle] & masks[focus], top, left)
