"""Estimate memory and time of a run before it begins."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np

from vamgpu.methods.surface import CELLS, SINOGRAMS, VOLUMES, SurfaceRamp, as_fine_as_light, finer_voxels
from vamgpu.operators.reductions import total
from vamgpu.optics.outer_resin import outer_cells
from vamgpu.storage.memory import size

FEW_VOLUMES, FEW_SINOGRAMS = 15, 18
"""Fields of the other methods, at most: L-BFGS with five pairs takes 97 % of them on a boat of 32 voxels."""

BEFORE = 8.0
"""Evaluations that take as long as a run's work before the first. The estimate was 0.6 to 1.4 of the processor time,
on boats of 32 to 96 voxels in a vial, for 20 and 40 evaluations of the default and of L-BFGS."""
PASSES = 20
"""Sums over light whose time an evaluation's other work takes: products of pairs, losses, the window."""
TIMED = 3
"""Times that something is timed, of which the least counts: others waited for a machine that is busy."""


@dataclass(frozen=True)
class Expected:
    """Memory [bytes] and time [s] of a run."""

    nbytes: int  # at most, on the device
    evaluations: float  # of the projector, at all corners together
    seconds: float  # of one evaluation and the method's other work
    corners: int = 1

    def __str__(self) -> str:
        whole = (BEFORE * self.corners + self.evaluations) * self.seconds
        lasts = f"about {whole:.2g} s" if whole < 100.0 else f"about {whole / 60.0:.3g} min"
        each = f"{self.evaluations:g} evaluations of {self.seconds:.2g} s"
        each += f", at {self.corners} corners" if self.corners > 1 else ""
        return f"about {size(self.nbytes)} of memory, {each}: {lasts} in all"


def expected(A: Any, target: Any, method: Any, evaluations: float, corners: int = 1) -> Expected:
    """Memory and time of a run, by the fields of the method that takes most and by an evaluation that is timed."""
    voxels, pixels = prod(A.domain.shape), prod(A.range.shape)
    counted = FEW_VOLUMES * voxels * corners + FEW_SINOGRAMS * pixels
    if isinstance(method, SurfaceRamp):
        fine = None if finer_voxels(method, A, target) is None else as_fine_as_light(A, keep=True)
        A = A if fine is None else fine
        beside = () if fine is None else outer_cells(fine.grid, fine.beam, fine.motion, fine.vessel)
        cells = sum(prod(each.shape) for each in beside)
        counted = VOLUMES * prod(A.domain.shape) + SINOGRAMS * pixels + CELLS * cells
    light = A.device.upload(np.ones(A.range.shape, np.float32))
    dose = A.T(light)
    seconds = _quickest(lambda: total(A(A.T(light, out=dose), out=light))) + PASSES * _quickest(lambda: total(light))
    return Expected(counted * A.device.real.itemsize, float(evaluations), seconds, corners)


def _quickest(work: Callable[[], Any]) -> float:
    """Least time of a few runs [s]."""
    took: list[float] = []
    for _ in range(1 + TIMED):  # the first one compiles
        began = time.perf_counter()
        work()
        took.append(time.perf_counter() - began)
    return min(took[1:])
