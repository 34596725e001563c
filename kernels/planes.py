"""From frames to what mirrors are loaded with: pictures picked in the order they are shown, cut by columns, and split
into bit planes.

A plane has rows from the top, and in a row eight columns a byte, the leftmost in the highest bit; bytes beyond the last
column are 0. The planes of a picture come by falling weight: the first is that of 128, the last that of 1.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.signature import Table, Tiling, kernel

BLOCK = 64
"""Columns split together; rows of planes are whole blocks."""

Images = Annotated[np.ndarray, Table("uint8", ("angle", "row", "byte"))]
Masks = Annotated[np.ndarray, Table("uint8", ("bin", "byte"))]
Chosen = Annotated[np.ndarray, Table("int32", ("picture", "2"))]
Packed = Annotated[np.ndarray, Table("uint8", ("picture", "8", "row", "width"), writes=True)]
Picked = Annotated[np.ndarray, Table("uint8", ("picture", "row", "width"), writes=True)]
Sent = Annotated[np.ndarray, Table("int32", ("picture", "strip"), writes=True)]


@kernel(over="sent", gpu=Tiling(group=(128, 1)))
def split_planes(images: Images, masks: Masks, chosen: Chosen, packed: Packed, sent: Sent) -> None:
    """packed = the bit planes of the 8-bit pictures images[angle] & masks[bin], (angle, bin) = chosen[picture].

    sent: sum of the levels in each strip; strips are equal runs of blocks of 64 columns, row by row, the last one cut.
    width: a multiple of 8.
    """
    pictures, _, rows, width = packed.shape
    strips = sent.shape[1]
    blocks = rows * width // 8
    strip = np.arange(blocks) // -(-blocks // strips)
    for picture in range(pictures):
        angle, focus = chosen[picture]
        levels = np.zeros((rows, 8 * width), np.uint8)
        levels[:, : images.shape[2]] = images[angle] & masks[focus]
        for plane in range(8):
            packed[picture, plane] = np.packbits((levels >> (7 - plane)) & 1, axis=-1)
        sums = levels.reshape(blocks, BLOCK).sum(axis=1, dtype=np.int64)
        sent[picture] = np.bincount(strip, sums, minlength=strips).astype(sent.dtype)


@kernel(over="picked")
def pick_pictures(images: Images, masks: Masks, chosen: Chosen, picked: Picked) -> None:
    """picked = images[angle] & masks[bin] with (angle, bin) = chosen[picture], byte by byte; rows are filled up with 0.

    Bytes are levels, or eight columns each where pictures are of one bit.
    """
    picked[...] = 0
    for picture, (angle, focus) in enumerate(chosen):
        picked[picture, :, : images.shape[2]] = images[angle] & masks[focus]
