"""Runs of like pixels, as the files of resin printers pack them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from vamgpu.errors import SliceError


def runs(levels: np.ndarray) -> Iterator[tuple[int, int]]:
    """Level and length of each run of like pixels in a layer [y, x]."""
    flat = np.ascontiguousarray(levels).ravel()
    starts = np.concatenate([[0], np.flatnonzero(flat[1:] != flat[:-1]) + 1, [flat.size]])
    return zip(flat[starts[:-1]].tolist(), np.diff(starts).tolist(), strict=True)


def unpack(found: Iterable[tuple[int, int]], out: np.ndarray, layer: str) -> None:
    """Write runs into uint8 ``out`` [y, x]; raises `SliceError` if they do not fill it."""
    try:
        levels, lengths = np.array(list(found), np.int64).reshape(-1, 2).T
    except IndexError:
        levels = lengths = np.zeros(0, np.int64)
    if lengths.sum() != out.size:
        raise SliceError(f"{layer} has {lengths.sum():,} pixels; expected {out.size:,}: export it again")
    out[...] = np.repeat(levels.astype(np.uint8), lengths).reshape(out.shape)
