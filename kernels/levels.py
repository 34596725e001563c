"""Gray levels that keep the dose of a rising print inside the part; for doses, see `curethrough`."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.curethrough import BITS, Counts, Light, Words, add, in_strips
from vamgpu.kernels.pack import START_R, START_Z
from vamgpu.kernels.signature import Integer, Real, Table, kernel

BEYOND = 1 << 20
"""Number of slices to an edge that is out of sight."""
NEVER = 1e30

SlicesOut = Annotated[np.ndarray, Table("uint8", ("slice", "y", "x"), writes=True)]
First = Annotated[np.ndarray, Table("uint8", ("bin",))]
Inner = Annotated[np.ndarray, Table("float32", ("below", "above"))]
Back = Annotated[np.ndarray, Table("float32", ("void",))]
State = Annotated[np.ndarray, Table("float32", ("4", "y", "x"), writes=True, updates=True)]
"""Ω, its rounding error, the least Ω of the void, and slices of the feature so far."""
Flaws = Annotated[np.ndarray, Table("int32", ("2", "y", "x"), writes=True, updates=True)]


def ahead(words: np.ndarray, block: int, platform: int) -> tuple[np.ndarray, np.ndarray]:
    """Slices before a block that equal its first slice, if that is void, or solid; `BEYOND` if out of sight."""
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
    words: Words, block: Integer, light: Light, edges: Light, first: First, bins: Real, decay: Real, inner: Inner,
    back: Back, platform: Integer, reached: Real, opened: Real, spread: Real, state: State, flaws: Flaws,
    levels: SlicesOut, missed: Counts,
) -> None:  # fmt: skip
    """Choose levels that bring Ω as close to its target at every border as light can, given the Ω of later slices."""
    # inner: target of Ω in a feature, by slices since its back side until its front; back: in the void behind it, by
    # slices until its back side; the last entries hold beyond. edges: light midway between levels; first: least level
    # in each of even bins of light, ``bins`` per unit. flaws: of features whose back side has less than ``reached``
    # (missed sums them), and voids that never fell to ``opened``. spread: light by which neighbors aim higher or lower.
    # platform: features that begin with the first slice end there, and nothing above them can be cured through.
    to_void, to_solid = ahead(words, block, platform)
    word = words[block % len(words)]
    rows, columns = np.meshgrid(*(np.arange(n) for n in word.shape), indexing="ij")
    shift = spread * ((rows * START_Z + columns * START_R) % 1.0 - 0.5)
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
        required = target - dose + decay * dose
        between = (required > light[0]) & (required < light[255])
        aim = np.where(between, required + shift, required)
        level = np.searchsorted(edges[:255], aim, side="left")
        level += between & ~solid & (runs[n] > 0) & (light[level] < required) & (level < 255)
        levels[n] = level
        add(state, light[level] - decay * dose)
        state[2] = np.where(solid, NEVER, np.minimum(np.minimum(lowest, dose), state[0]))
        state[3] = np.where(solid, done + 1, 0)
    in_strips(lost, missed, np.add)
