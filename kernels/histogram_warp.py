"""Warp version of `histogram`; a thread owns four lanes of z of a strip of rows."""

from __future__ import annotations

from typing import Any

import warp as wp

from vamgpu.kernels import histogram
from vamgpu.kernels.wide_warp import Vectors

wp.set_module_options({"enable_backward": False, "fast_math": False})

ROWS = histogram.GPU_ROWS
NO_CLASS: Any = wp.constant(histogram.NO_CLASS)


@wp.func
def counted(i: int, j: int, n_i: int, n_j: int, radius: float):
    x = float(i) - 0.5 * float(n_i - 1)
    y = float(j) - 0.5 * float(n_j - 1)
    return x * x + y * y <= radius * radius


@wp.kernel
def tally(
    dose: Vectors, target: Vectors, ranges: wp.array3d[float], level: float, radius: float,
    partial: wp.array4d[wp.uint32],
    n_i: int, n_j: int, n_z: int, n_slice: int, n_strip: int, n_bin: int,
) -> None:  # fmt: skip
    slab, strip, column, lane = wp.tid()
    first = 4 * (slab * dose.shape[3] + lane)
    own = wp.min(4, n_z - first)
    for k in range(own):
        for which in range(2):
            for b in range(n_bin):
                partial[strip, first + k, which, b] = wp.uint32(0)
    for i in range(strip * ROWS, wp.min(strip * ROWS + ROWS, n_i)):
        for j in range(n_j):
            if counted(i, j, n_i, n_j, radius):
                values = dose[slab, i, j, lane]
                parts = target[slab, i, j, lane]
                for k in range(own):
                    value = values[k]
                    which = wp.where(parts[k] >= level, 1, 0)
                    row = wp.where(n_slice == 1, 0, first + k)
                    low = ranges[row, which, 0]
                    b = 1 + wp.min(wp.max(int((value - low) * ranges[row, which, 2]), 0), n_bin - 3)
                    if value < low:
                        b = 0
                    elif value >= ranges[row, which, 1]:
                        b = n_bin - 1
                    if which == 1 or parts[k] >= NO_CLASS:
                        partial[strip, first + k, which, b] = partial[strip, first + k, which, b] + wp.uint32(1)


@wp.kernel
def fold_counts(
    partial: wp.array4d[wp.uint32], counts: wp.array3d[wp.uint32],
    n_strip: int, n_z: int, n_bin: int, n_slice: int,
) -> None:  # fmt: skip
    row, which, b = wp.tid()
    begin = wp.where(n_slice == n_z, row, 0)
    end = wp.where(n_slice == n_z, row + 1, n_z)
    total = wp.uint32(0)
    for strip in range(n_strip):
        for z in range(begin, end):
            total += partial[strip, z, which, b]
    counts[row, which, b] = total


@wp.kernel
def survey(
    dose: Vectors, target: Vectors, level: float, radius: float, parts: wp.array4d[float],
    n_i: int, n_j: int, n_z: int, n_strip: int,
) -> None:  # fmt: skip
    slab, strip, column, lane = wp.tid()
    first = 4 * (slab * dose.shape[3] + lane)
    for k in range(wp.min(4, n_z - first)):
        for which in range(2):
            least = float(wp.inf)
            greatest = float(-wp.inf)
            total = float(0.0)
            for i in range(strip * ROWS, wp.min(strip * ROWS + ROWS, n_i)):
                for j in range(n_j):
                    if counted(i, j, n_i, n_j, radius):
                        part = target[slab, i, j, lane][k]
                        member = wp.where(part >= level, 1, wp.where(part >= NO_CLASS, 0, -1))
                        if member == which:
                            value = dose[slab, i, j, lane][k]
                            least = wp.min(least, value)
                            greatest = wp.max(greatest, value)
                            total += value
            parts[strip, first + k, which, 0] = least
            parts[strip, first + k, which, 1] = greatest
            parts[strip, first + k, which, 2] = total


@wp.kernel
def fold_survey(parts: wp.array4d[float], statistics: wp.array3d[float], n_strip: int, n_z: int, n_slice: int) -> None:
    row, which, kind = wp.tid()
    begin = wp.where(n_slice == n_z, row, 0)
    end = wp.where(n_slice == n_z, row + 1, n_z)
    result = float(0.0)
    if kind == 0:
        result = float(wp.inf)
    elif kind == 1:
        result = float(-wp.inf)
    lost = float(0.0)
    for strip in range(n_strip):
        for z in range(begin, end):
            value = parts[strip, z, which, kind]
            if kind == 0:
                result = wp.min(result, value)
            elif kind == 1:
                result = wp.max(result, value)
            else:  # the rounding error of the sum is carried along (Kahan)
                corrected = value - lost
                following = result + corrected
                lost = (following - result) - corrected
                result = following
    statistics[row, which, kind] = result
