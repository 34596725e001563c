"""Dose that light leaves behind while a print rises, and gray levels that keep it inside the part.

Slices are counted in the order of exposure, slice n from ζ = n to n + 1 (ζ in slice heights from the platform), and the
dose Ω at ζ = n is what slices n, n + 1, … leave there. It follows from the last slice to the first (Pritchard et al.
2019, eq. S14): Ω ← Ω + light[level] − decay·Ω, decay = 1 − 10^−η. Everything a column needs from later slices is its
state, so a stack passes in blocks of at most 32 slices, the last block first.

A sum over thousands of slices loses digits in float32. So the state keeps beside Ω what the last addition rounded off.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.signature import Integer, Real, Table, kernel

BITS = 32
"""Slices in a block: one word holds which of them are solid at a pixel."""
BEYOND = 1 << 20
"""Slices to an edge that is out of sight."""
NEVER = 1e30
START_X, START_Y = 0.7548776662466927, 0.5698402909980532
"""Powers of the inverse plastic number: their multiples fill the unit square evenly (M. Roberts' R2 sequence)."""

Slices = Annotated[np.ndarray, Table("uint8", ("slice", "y", "x"))]
SlicesOut = Annotated[np.ndarray, Table("uint8", ("slice", "y", "x"), writes=True)]
Words = Annotated[np.ndarray, Table("uint32", ("word", "y", "x"))]
"""Bit k of word j: slice 32·j + k is solid. Words follow each other in a ring: word j stands at j modulo its length."""
WordsOut = Annotated[np.ndarray, Table("uint32", ("word", "y", "x"), writes=True)]
Light = Annotated[np.ndarray, Table("float32", ("256",))]
First = Annotated[np.ndarray, Table("uint8", ("bin",))]
Inner = Annotated[np.ndarray, Table("float32", ("below", "above"))]
Back = Annotated[np.ndarray, Table("float32", ("void",))]
State = Annotated[np.ndarray, Table("float32", ("4", "y", "x"), writes=True)]
"""Ω, what rounding took off it, the least Ω of the void, and slices of the feature so far."""
Pair = Annotated[np.ndarray, Table("float32", ("2", "y", "x"), writes=True)]
Flaws = Annotated[np.ndarray, Table("int32", ("2", "y", "x"), writes=True)]
Kept = Annotated[np.ndarray, Table("float32", ("kept", "y", "x"), writes=True)]
Peaks = Annotated[np.ndarray, Table("float32", ("y", "strip"), writes=True)]
Counts = Annotated[np.ndarray, Table("int32", ("y", "strip"), writes=True)]
"""One number for each work item: a strip of neighbours along x, all of one width but the last."""


def in_strips(values: np.ndarray, out: np.ndarray, fold: np.ufunc) -> None:
    """Fold [y, x] along the strips of x into out [y, strip]; strips beyond the last pixel hold 0."""
    n_x, n_strip = values.shape[1], out.shape[1]
    width = -(-n_x // n_strip)
    starts = np.arange(0, n_x, width)
    out[...] = 0
    out[:, : len(starts)] = fold.reduceat(values, starts, axis=1)


def add(state: np.ndarray, change: np.ndarray) -> None:
    """Ω += change, and keep what the sum rounds off (W. Kahan's summation)."""
    change = change + state[1]
    total = state[0] + change
    state[1] = change - (total - state[0])
    state[0] = total


@kernel(over="solid")
def pack_slices(levels: Slices, threshold: Integer, block: Integer, words: WordsOut, solid: Counts) -> None:
    """The block's word = which of its slices reach the threshold, slice k as bit k; solid = how many do in a strip."""
    above = levels >= threshold
    bits = np.arange(len(levels), dtype=np.uint32)[:, None, None]
    words[block % len(words)] = np.bitwise_or.reduce(above.astype(np.uint32) << bits, axis=0)
    in_strips(above.sum(axis=0), solid, np.add)


@kernel(over="peaks")
def expose_slices(
    levels: Slices, light: Light, decay: Real, part: Real, fade: Real, state: Pair, doses: Kept, peaks: Peaks
) -> None:
    """Ω of a block's slices, and the state of the next block.

    light: dose that a slice of each level adds.  doses: of the first ``kept`` slices, (Ω beyond the slice + part · what
    it changes) · fade, which is Ω between borders.  peaks: greatest Ω at a border.
    """
    peak = np.zeros(levels.shape[1:])
    for n in range(len(levels) - 1, -1, -1):
        change = light[levels[n]] - decay * state[0]
        if n < len(doses):
            doses[n] = (state[0] + part * change) * fade
        add(state, change)
        peak = np.maximum(peak, state[0])
    in_strips(peak, peaks, np.maximum)


def ahead(words: np.ndarray, block: int, platform: int) -> tuple[np.ndarray, np.ndarray]:
    """Slices before a block that are like its first, should that be void, or solid; `BEYOND` if out of sight."""
    shape = words.shape[1:]
    if block == 0:
        return np.full(shape, BEYOND), np.full(shape, BEYOND if platform else 0)
    last = words[(block - 1) % len(words)] >> np.uint32(BITS - 1)
    run, open_end = np.zeros(shape, int), np.ones(shape, bool)
    for j in range(block - 1, max(block - len(words), -1), -1):
        word = words[j % len(words)]
        for bit in range(BITS - 1, -1, -1):
            open_end &= (word >> np.uint32(bit) & np.uint32(1)) == last
            run += open_end
    head = block < len(words)
    beyond = np.where(last == 1, BEYOND if platform or not head else 0, BEYOND)
    run = np.where(open_end, run + beyond, run)
    return np.where(last == 0, run, 0), np.where(last == 1, run, 0)


@kernel(over="missed")
def correct_slices(
    words: Words,
    block: Integer,
    light: Light,
    edges: Light,
    first: First,
    bins: Real,
    decay: Real,
    inner: Inner,
    back: Back,
    platform: Integer,
    reached: Real,
    opened: Real,
    spread: Real,
    state: State,
    flaws: Flaws,
    levels: SlicesOut,
    missed: Counts,
) -> None:
    """levels = what makes Ω what it should be at every border, as far as light can; in closed loop with the levels.

    inner: Ω wanted inside a feature, by slices done since its back side and slices to come before its front; back: in
    the void behind a feature, by slices to come before its back side; the last entries hold beyond.  edges: light
    midway between a level and the next; first: least level in each of evenly spaced bins of light, ``bins`` to a unit.
    flaws[0] counts features whose back side has less than ``reached``, flaws[1] voids that never fell to ``opened``;
    missed sums the former.  spread: light by which neighbors aim higher or lower, 0 rounds.  platform: what begins with
    the first slice ends at the platform, so nothing above it can be cured through.
    """
    to_void, to_solid = ahead(words, block, platform)
    word = words[block % len(words)]
    rows, columns = np.meshgrid(*(np.arange(n) for n in word.shape), indexing="ij")
    shift = spread * ((rows * START_Y + columns * START_X) % 1.0 - 0.5)
    runs = np.empty((len(levels), *word.shape), int)
    run, before = np.zeros(word.shape, int), np.zeros(word.shape, np.uint32)
    for n in range(len(levels)):
        bit = word >> np.uint32(n) & np.uint32(1)
        run = np.where(bit == 1, to_solid, to_void) if n == 0 else np.where(bit == before, run + 1, 0)
        runs[n], before = run, bit
    lost = np.zeros(word.shape, int)
    for n in range(len(levels) - 1, -1, -1):
        dose, lowest, done = state[0].copy(), state[2], state[3]
        solid = (word >> np.uint32(n) & np.uint32(1)) == 1
        starts = solid & (done == 0)
        low = starts & (dose < reached)
        lost += low
        flaws[0] += low
        flaws[1] += starts & (lowest > opened)
        place = np.minimum(done.astype(int), inner.shape[0] - 1), np.minimum(runs[n], inner.shape[1] - 1)
        target = np.where(solid, inner[place], back[np.minimum(runs[n], len(back) - 1)])
        wanted = target - dose + decay * dose
        between = (wanted > light[0]) & (wanted < light[255])
        aim = np.where(between, wanted + shift, wanted)
        level = np.searchsorted(edges[:255], aim, side="left")
        level += between & ~solid & (runs[n] > 0) & (light[level] < wanted) & (level < 255)
        levels[n] = level
        add(state, light[level] - decay * dose)
        state[2] = np.where(solid, NEVER, np.minimum(np.minimum(lowest, dose), state[0]))
        state[3] = np.where(solid, done + 1, 0)
    in_strips(lost, missed, np.add)


@kernel(over="peaks")
def judge_slices(
    levels: Slices,
    words: Words,
    block: Integer,
    light: Light,
    decay: Real,
    scale: Real,
    layered: Integer,
    critical: Real,
    state: Pair,
    heights: Pair,
    peaks: Peaks,
) -> None:
    """heights += cured height of the void, and uncured height of the part, in slices, between borders too.

    scale: slices over which light fades e-fold, over minus one.  layered: dose at the border belongs to the slice whole
    and fades towards the platform; else it builds up from border to border.
    """
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
