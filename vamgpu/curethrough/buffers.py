"""Memory for blocks of slices that is reused: accessing fresh memory takes longer than the computation."""

from __future__ import annotations

import sys

import numpy as np

HELD = 3  # number of references to an unused array: the list's, the loop's, and that of the call that counts them


class SliceBuffers:
    """Arrays of bytes that are reused once nobody holds them, or a view of them, any more."""

    def __init__(self, most: int = 6) -> None:
        self._most = most
        self._held: list[np.ndarray] = []

    def take(self, shape: tuple[int, ...]) -> np.ndarray:
        """A uint8 array, C contiguous, with arbitrary contents."""
        size = int(np.prod(shape))
        for held in self._held:
            if held.size >= size and sys.getrefcount(held) <= HELD:
                return held[:size].reshape(shape)
        fresh = np.empty(size, np.uint8)
        if len(self._held) < self._most:
            self._held.append(fresh)
        return fresh.reshape(shape)
