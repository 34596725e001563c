"""Features of columns: runs of solid slices, and the void behind each."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

from vamgpu.curethrough.dose import Stack

BLOCK = 32


@dataclass(frozen=True)
class Feature:
    """A run of solid slices ``upper`` to ``lower`` − 1: ζ_U = upper, ζ_L = lower; ``pixels`` share it.

    void: slices to the next feature behind it, or to the end of the stack where ``last``.
    """

    upper: int
    lower: int
    void: int
    last: bool
    pixels: int = 1

    @property
    def height(self) -> int:
        """δ in slices."""
        return self.lower - self.upper


def column_features(levels: Any, threshold: int = 128) -> tuple[Feature, ...]:
    """Features of one column of gray levels [slice], front to back."""
    solid = np.concatenate([[False], np.asarray(levels) >= threshold, [False]])
    edges = np.flatnonzero(solid[1:] != solid[:-1])
    upper, lower = edges[::2], edges[1::2]
    following = np.append(upper[1:], len(solid) - 2)
    return tuple(
        Feature(int(a), int(b), int(c - b), n == len(upper) - 1)
        for n, (a, b, c) in enumerate(zip(upper, lower, following, strict=True))
    )


def survey(stack: Stack, threshold: int = 128) -> tuple[Feature, ...]:
    """Features of a whole stack, like ones counted together; the stack is read once, from its first slice."""
    slices, *plane = stack.shape
    found: Counter[tuple[int, int, int, bool]] = Counter()
    upper, lower = (np.full(plane, -1, np.int32) for _ in range(2))  # of the last feature begun, of the last ended
    first = np.full(plane, -1, np.int32)  # front of the feature that ``lower`` ended
    before = np.zeros(plane, bool)
    for start in range(0, slices, BLOCK):
        for n, picture in enumerate(stack[start : start + BLOCK], start):
            solid = picture >= threshold
            begins, ends = solid & ~before, before & ~solid
            done = begins & (lower >= 0)
            _tally(found, first[done], lower[done], np.full(int(done.sum()), n), False)
            upper[begins] = n
            first[ends], lower[ends] = upper[ends], n
            before = solid
    first[before], lower[before] = upper[before], slices
    done = lower >= 0
    _tally(found, first[done], lower[done], np.full(int(done.sum()), slices), True)
    return tuple(Feature(a, b, c, last, n) for (a, b, c, last), n in sorted(found.items()))


def _tally(found: Counter, upper: np.ndarray, lower: np.ndarray, following: np.ndarray, last: bool) -> None:
    if not upper.size:
        return
    rows = np.stack([upper, lower, following - lower], axis=1)
    kinds, counts = np.unique(rows, axis=0, return_counts=True)
    for (a, b, c), n in zip(kinds.tolist(), counts.tolist(), strict=True):
        found[(a, b, c, last)] += n
