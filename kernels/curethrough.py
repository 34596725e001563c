"""Dose that light leaves while a print rises; for gray levels that keep it inside the part, see `levels`."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.signature import Integer, Real, Table, kernel

BITS = 32
"""Slices in a block: the bits of one word tell which of them are solid at a pixel."""

Slices = Annotated[np.ndarray, Table("uint8", ("slice", "y", "x"))]
Words = Annotated[np.ndarray, Table("uint32", ("word", "y", "x"))]
"""Bit k of word j: slice 32·j + k is solid. Words are stored in a ring buffer: word j is at j modulo its length."""
WordsOut = Annotated[np.ndarray, Table("uint32", ("word", "y", "x"), writes=True)]
Light = Annotated[np.ndarray, Table("float32", ("256",))]
Pair = Annotated[np.ndarray, Table("float32", ("2", "y", "x"), writes=True, updates=True)]
Kept = Annotated[np.ndarray, Table("float32", ("kept", "y", "x"), writes=True)]
Peaks = Annotated[np.ndarray, Table("float32", ("y", "strip"), writes=True)]
Counts = Annotated[np.ndarray, Table("int32", ("y", "strip"), writes=True)]
"""One number for each work item: a strip of neighbors along x; all strips except the last have the same width."""


def in_strips(values: np.ndarray, out: np.ndarray, fold: np.ufunc) -> None:
    """Fold [y, x] along the strips of x into out [y, strip]; strips beyond the last pixel hold 0."""
    n_x, n_strip = values.shape[1], out.shape[1]
    width = -(-n_x // n_strip)
    starts = np.arange(0, n_x, width)
    out[...] = 0
    out[:, : len(starts)] = fold.reduceat(values, starts, axis=1)


def add(state: np.ndarray, change: np.ndarray) -> None:
    """Ω += change, and keep the rounding error of the sum (W. Kahan's summation)."""
    change = change + state[1]
    total = state[0] + change
    state[1] = change - (total - state[0])
    state[0] = total


@kernel(over="solid")
def pack_slices(levels: Slices, threshold: Integer, block: Integer, words: WordsOut, solid: Counts) -> None:
    """Bit k of the block's word: whether slice k reaches the threshold; solid = number of set bits in a strip."""
    above = levels >= threshold
    bits = np.arange(len(levels), dtype=np.uint32)[:, None, None]
    words[block % len(words)] = np.bitwise_or.reduce(above.astype(np.uint32) << bits, axis=0)
    in_strips(above.sum(axis=0), solid, np.add)


@kernel(over="peaks")
def expose_slices(
    levels: Slices, light: Light, decay: Real, part: Real, fade: Real, state: Pair, doses: Kept, peaks: Peaks
) -> None:
    """Ω of a block's slices, and the state of the next block."""
    # light: dose that a slice of each level adds. doses: of the first ``kept`` slices, (Ω beyond the slice + part · its
    # change) · fade, which is Ω between borders. peaks: greatest Ω at a border.
    peak = np.zeros(levels.shape[1:])
    for n in range(len(levels) - 1, -1, -1):
        change = light[levels[n]] - decay * state[0]
        if n < len(doses):
            doses[n] = (state[0] + part * change) * fade
        add(state, change)
        peak = np.maximum(peak, state[0])
    in_strips(peak, peaks, np.maximum)


@kernel(over="peaks")
def judge_slices(
    levels: Slices, words: Words, block: Integer, light: Light, decay: Real, scale: Real, layered: Integer,
    critical: Real, state: Pair, heights: Pair, peaks: Peaks,
) -> None:  # fmt: skip
    """heights += cured height of the void, and uncured height of the part, in slices, also between borders."""
    # scale: minus the number of slices over which light falls by a factor e. layered: the dose at the border belongs to
    # the whole slice and decays towards the platform; otherwise it builds up from border to border.
    peak = np.zeros(levels.shape[1:])
    for n in range(len(levels) - 1, -1, -1):
        dose = state[0].copy()
        change = light[levels[n]] - decay * dose
        add(state, change)
        start, stop = (state[0], (1.0 - decay) * state[0]) if layered else (dose, state[0])
        rest = 0.0 if layered else light[levels[n]] / decay
        crosses = (start >= critical) != (stop >= critical)
        with np.errstate(divide="ignore", invalid="ignore"):
            done = np.log((critical - rest) / (start - rest)) * scale
        share = np.where(crosses, np.clip(done, 0.0, 1.0), 1.0)
        cured = np.where(start >= critical, share, 1.0 - share)
        solid = (words[block % len(words)] >> np.uint32(n) & np.uint32(1)) == 1
        heights[0] += np.where(solid, 0.0, cured)
        heights[1] += np.where(solid, 1.0 - cured, 0.0)
        peak = np.maximum(peak, state[0])
    in_strips(peak, peaks, np.maximum)
