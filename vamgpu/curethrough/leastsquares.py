"""Correction of whole columns at once, by least squares.

With Ω at the borders as unknowns, light and doses are banded; the method of multipliers solves all columns at once.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from vamgpu.backend.device import Device
from vamgpu.curethrough.correction import Correction, Corrector
from vamgpu.curethrough.dose import Judge, Stack, blocks
from vamgpu.curethrough.printer import Machine
from vamgpu.errors import BadInput

WEIGHT = 20.0  # ratio of the penalty of a dose on the wrong side to that of the augmented Lagrangian
PULL = 0.3  # scale of the bounds of light in the augmented Lagrangian
MARGINS = (2.0, 8.0, 30.0, 100.0)
"""Margins of the required doses beyond the critical one, in half levels; the best resulting column is used."""
MOST_WEIGHED = 1 << 27  # greatest number of bytes of columns that are corrected as a whole
WEIGHED_AT_ONCE = 1024

StageProgress = Callable[[str, float], None]  # called with the stage and the share of it that is done, 0..1
BetterColumns = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Rows and columns of pixels, and their levels, uint8 [slice + tail, column]."""


def better_columns(
    correction: Correction, stack: Stack, device: Device, progress: StageProgress
) -> BetterColumns | None:  # fmt: skip
    """Better levels of columns that cannot be printed, or None. Raises `BadInput` for too many columns."""
    corrector = Corrector(correction, stack.shape, device)
    for block in corrector.run(stack):
        progress("survey", 1.0 - block.start / corrector.slices)
    rows, columns = np.nonzero(corrector.missed + corrector.closed)
    if not len(rows):
        return None
    if len(rows) * stack.shape[0] > MOST_WEIGHED:
        raise BadInput(
            f"{len(rows):,} columns of {stack.shape[0]:,} slices have unprintable features or voids; expected at most "
            f"{MOST_WEIGHED // stack.shape[0]:,} for least squares: print slower, or without least squares"
        )
    target = np.empty((stack.shape[0], len(rows)), np.uint8)
    for start, stop in blocks(stack.shape[0]):
        target[start:stop] = stack[start:stop][:, rows, columns]
    levels = np.empty((corrector.slices, len(rows)), np.uint8)
    for first in range(0, len(rows), WEIGHED_AT_ONCE):
        part = slice(first, first + WEIGHED_AT_ONCE)
        progress("columns", first / len(rows))
        levels[:, part] = least_squares(correction, np.ascontiguousarray(target[:, part]))
    return rows, columns, levels


def least_squares(correction: Correction, columns: np.ndarray, iterations: int = 150) -> np.ndarray:
    """Levels of corrected columns, uint8 [slice + tail, column], optimized if necessary. Raises `BadInput`."""
    if columns.ndim != 2 or columns.dtype != np.uint8:
        raise BadInput(f"columns have shape {columns.shape} of {columns.dtype}; expected uint8 [slice, column]")
    if correction.machine.layered:
        raise BadInput("layer by layer there is nothing to optimize: every layer has its own light; use the correction")
    stack = np.ascontiguousarray(columns[:, None, :])
    corrector = Corrector(correction, stack.shape, "numpy")
    levels = np.empty((corrector.slices, columns.shape[1]), np.uint8)
    for block in corrector.run(stack):
        levels[block.start : block.start + block.table.shape[0]] = block.levels[:, 0]
    at = np.flatnonzero((corrector.missed + corrector.closed)[0])
    if not at.size:
        return levels
    target = np.zeros_like(levels)
    target[: len(columns)] = np.where(columns >= correction.threshold, 255, 0)
    error = np.add(*heights(correction.machine, levels[:, at], target[:, at]))
    for margin in MARGINS:
        found = _follow(correction.machine, _solve(correction, target[:, at] > 0, margin, iterations))
        new = np.add(*heights(correction.machine, found, target[:, at]))
        better = new < error
        levels[:, at[better]], error = found[:, better], np.minimum(new, error)
    return levels


def heights(machine: Machine, levels: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cured height of the void and uncured height of the part [mm] of columns [slice, column], by the reference."""
    judge = Judge(machine, (1, levels.shape[1]), "numpy")
    for start, stop in blocks(len(levels)):
        judge.step(levels[start:stop, None], target[start:stop, None])
    return judge.over()[0], judge.under()[0]


def _solve(correction: Correction, solid: np.ndarray, margin: float, iterations: int) -> np.ndarray:
    """Ω at the borders with the least cost; [slice, column]."""
    from scipy.linalg import cho_solve_banded, cholesky_banded

    machine = correction.machine
    decay, half = machine.decay, 10.0 ** (-0.5 * machine.eta)
    fade, scale = 1.0 - decay, PULL
    mid = (1.0 - half) / decay, half - (1.0 - half) * fade / decay  # of this border and of the next
    bound = scale, -scale * fade
    low, high = scale * machine.doses[0], scale * machine.doses[-1]
    bands = np.zeros((2, len(solid)))
    bands[1] = mid[0] ** 2 + bound[0] ** 2
    bands[1, 1:] += mid[1] ** 2 + bound[1] ** 2
    bands[0, 1:] = mid[0] * mid[1] + bound[0] * bound[1]
    factor = cholesky_banded(bands)
    edge = np.where(solid, 1.0, -1.0) * margin * machine.tolerance + 1.0
    middle, light = np.zeros(solid.shape), np.full(solid.shape, low)
    pull_m, pull_l, dose = np.zeros(solid.shape), np.zeros(solid.shape), np.zeros(solid.shape)
    for _ in range(iterations):
        dose = cho_solve_banded((factor, False), _back(mid, middle - pull_m) + _back(bound, light - pull_l))
        at_m, at_l = _forth(mid, dose), _forth(bound, dose)
        asked = at_m + pull_m
        wrong = np.where(solid, asked < edge, asked > edge)
        middle = np.where(wrong, (asked + WEIGHT * edge) / (1.0 + WEIGHT), asked)
        light = np.clip(at_l + pull_l, low, high)
        pull_m, pull_l = asked - middle, pull_l + at_l - light
    return dose


def _forth(pair: tuple[float, float], dose: np.ndarray) -> np.ndarray:
    out = pair[0] * dose
    out[:-1] += pair[1] * dose[1:]
    return out


def _back(pair: tuple[float, float], values: np.ndarray) -> np.ndarray:
    out = pair[0] * values
    out[1:] += pair[1] * values[:-1]
    return out


def _follow(machine: Machine, doses: np.ndarray) -> np.ndarray:
    """Levels whose doses stay closest to the required ones, chosen slice by slice with feedback."""
    added = machine.doses
    edges, out = 0.5 * (added[1:] + added[:-1]), np.empty(doses.shape, np.uint8)
    dose = np.zeros(doses.shape[1])
    for n in range(len(doses) - 1, -1, -1):
        out[n] = np.searchsorted(edges, doses[n] - (1.0 - machine.decay) * dose)
        dose = added[out[n]] + (1.0 - machine.decay) * dose
    return out
