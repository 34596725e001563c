"""Images moved by fractions of a pixel, summed over several moves, and cut into tiles or put together again."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.signature import Field, Integer, SinogramOut, Table, Tiling, kernel

Source = Annotated[np.ndarray, Field(("image", "column", "row"))]
Moves = Annotated[np.ndarray, Table("float32", ("move", "4"))]
"""Position of pixel (0, 0) of a moved image in its source: whole columns, their fraction, whole rows, fraction."""
Tapers = Annotated[np.ndarray, Table("float32", ("tile", "taper"))]
"""Weight of every row, of each move, or of each tile and therefore of as many moves as there are angles."""


def _moved(image: np.ndarray, move: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """One image [column, row] at the positions of another of ``shape``, linear between pixels, 0 beyond the edge."""
    for axis in (0, 1):
        first, part = np.arange(shape[axis]) + int(move[2 * axis]), move[2 * axis + 1]
        rows = np.pad(np.moveaxis(image, axis, 0), ((1, 1), (0, 0)))
        near, far = (rows[np.clip(first + k, 0, len(rows) - 1)] for k in (1, 2))
        image = np.moveaxis((1 - part) * near + part * far, 0, axis)
    return image


@kernel(over="moved", cpu=Tiling(major=1, minor=0))
def shift_images(
    source: Source, moves: Moves, tapers: Tapers, after: Integer, lanes: Integer, moved: SinogramOut
) -> None:
    """moved[a] = Σ over moves k with k % angles = a of the source's image k % images, moved, its rows weighted."""
    # after: 1 if tapers are of the moved rows, 0 if they are of the source's. lanes: of the source's layout. With
    # source and moved exchanged, opposite moves and the other ``after``, this is the transpose.
    images, angles = len(source), len(moved)
    moved[...] = 0.0
    for k in range(len(moves)):
        taper, image = tapers[k * len(tapers) // len(moves)], source[k % images]
        if after:
            moved[k % angles] += _moved(image, moves[k], moved.shape[1:]) * taper
        else:
            moved[k % angles] += _moved(image * taper, moves[k], moved.shape[1:])
