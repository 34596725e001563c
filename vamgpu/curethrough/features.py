"""Features of columns: runs of solid slices, and the void behind each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Feature:
    """A run of solid slices ``upper`` to ``lower`` − 1: ζ_U = upper, ζ_L = lower."""

    upper: int
    lower: int
    void: int  # slices to the next feature behind it, or to the end of the stack where ``last``
    last: bool

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
