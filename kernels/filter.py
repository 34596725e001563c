"""Filtering of sinograms along r by a symmetric table of taps, plain and as the preconditioner of a step."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.pointwise import CPU
from vamgpu.kernels.pointwise import PARTIAL as GPU
from vamgpu.kernels.signature import Integer, Real, Sinogram, SinogramInOut, SinogramOut, Table, kernel

Taps = Annotated[np.ndarray, Table("float32", ("tap",))]


def convolve(rows: np.ndarray, taps: np.ndarray, stride: int) -> np.ndarray:
    """Σ_t taps[|t|]·rows[a, r + t, z] over t = 0 and ±1, ±(1 + stride), …"""
    result = taps[0] * rows
    for t in range(1, min(len(taps), rows.shape[1]), stride):
        result[:, t:] += taps[t] * rows[:, :-t]
        result[:, :-t] += taps[t] * rows[:, t:]
    return result


@kernel(over="filtered", cpu=CPU, gpu=GPU)
def filter_rows(sinogram: Sinogram, taps: Taps, stride: Integer, floor: Real, filtered: SinogramOut) -> None:
    """filtered = max(floor, sinogram convolved with the taps along r)."""
    filtered[...] = np.maximum(floor, convolve(sinogram, taps, stride))


@kernel(over="light", cpu=CPU, gpu=GPU)
def filtered_step(
    gradient: Sinogram, taps: Taps, stride: Integer, step: Real, momentum: Real, light: SinogramInOut,
    ahead: SinogramInOut,
) -> None:  # fmt: skip
    """One accelerated step that keeps light ≥ 0: new = max(0, ahead − step·filtered gradient); 0 where held."""
    # Light is held if ahead ≤ 0 and the gradient does not increase it (`apply_penalty` leaves 0 there). Then ahead =
    # new + momentum·(new − light) and light = new. Source: Y. Nesterov, Soviet Math. Dokl. 27 (1983) 372.
    new = np.maximum(0.0, ahead - step * convolve(gradient, taps, stride))
    new[(ahead <= 0) & (gradient >= 0)] = 0.0
    ahead[...] = new + momentum * (new - light)
    light[...] = new
