"""Functions of arrays in host memory, some planes at a time: what they make on the way stays in the cache."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from vamgpu.backend.cores import threads

TOGETHER = 1 << 17
"""Numbers of an array that are worked on at once."""


def by_planes(function: Callable[..., np.ndarray], *arrays: Any) -> np.ndarray:
    """A function of single elements, in all cores.

    Args:
        function: Of as many arrays, which are parts of theirs; of each element by itself.
        arrays: The first [x, …]; the others of the same first axis, or numbers.

    Returns:
        What it gives for the whole arrays, [x, …].
    """
    count = len(arrays[0])
    step = max(TOGETHER * count // max(np.size(arrays[0]), 1), 1)

    def part(first: int) -> np.ndarray:
        some = slice(first, first + step)
        return np.asarray(function(*(each[some] if np.ndim(each) else each for each in arrays)))

    begin = part(0)
    found = np.empty((count, *begin.shape[1:]), begin.dtype)
    found[:step] = begin

    def put(first: int) -> None:
        found[first : first + step] = part(first)

    with ThreadPoolExecutor(threads()) as pool:
        list(pool.map(put, range(step, count, step)))
    return found
