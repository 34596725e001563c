"""Warp version of `reduce`; a thread owns four lanes of a column of `ROWS` samples."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.kernel
def fold(parts: wp.array[float], kind: int, folded: wp.array[float], n_part: int, n_folded: int) -> None:
    k = wp.tid()
    result = float(0.0)
    if kind == 1:
        result = wp.inf
    if kind == 2:
        result = -wp.inf
    part = k
    while part < n_part:
        value = parts[part]
        if kind == 0:
            result += value
        elif kind == 1:
            result = wp.min(result, value)
        else:
            result = wp.max(result, value)
        part += n_folded
    folded[k] = result
