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
"""Largest number of fields of the other methods: L-BFGS with five pairs takes 97 % of it on a boat of 32 voxels."""

BEFORE = 8.0
"""Time before the first evaluation, in evaluations. The estimate was 0.6 to 1.4 of the processor time, on boats of 32
to 96 voxels in a vial, for 20 and 40 evaluations of the default and of L-BFGS."""
AFTER = 8.0  # time of packing, writing and the coarse verdict, in evaluations: 3 to 8 on parts of 30 to 66 voxels
COMPILED = 6.0  # compile time of the other 30 to 40 kernels over that of the timed ones, if the driver caches none
PASSES = 20  # time of the other work of an evaluation (products of pairs, losses, the window), in sums over patterns
TIMED = 3  # number of timed runs; the shortest one counts, because the others waited for a busy machine


@dataclass(frozen=True)
class Expected:
    """Memory [bytes] and time [s] of a run."""

    nbytes: int  # most memory on the device
    evaluations: float  # evaluations of the projector, for all corners together
    seconds: float  # time of one evaluation, with the method's other work
    corners: int = 1
    compiling: float = 0.0  # time in which the rest of the kernels compile

    def __str__(self) -> str:
        whole = (BEFORE * self.corners + self.evaluations + AFTER) * self.seconds + self.compiling
        lasts = f"about {whole:.2g} s" if whole < 100.0 else f"about {whole / 60.0:.3g} min"
        each = f"{self.evaluations:g} evaluations of {self.seconds:.2g} s"
        each += f", at {self.corners} corners" if self.corners > 1 else ""
        return f"about {size(self.nbytes)} of memory, {each}: {lasts} from here to the verdict"


def expected(A: Any, target: Any, method: Any, evaluations: float, corners: int = 1) -> Expected:
    """Memory and time of a run, from the number of fields of the most demanding method and a timed evaluation."""
    voxels, pixels = prod(A.domain.shape), prod(A.range.shape)
    counted = FEW_VOLUMES * voxels * corners + FEW_SINOGRAMS * pixels
    if isinstance(method, SurfaceRamp):
        fine = None if finer_voxels(method, A, target) is None else as_fine_as_light(A, keep=True)
        A = A if fine is None else fine
        beside = () if fine is None else outer_cells(fine.grid, fine.beam, fine.motion, fine.vessel)
        cells = sum(prod(each.shape) for each in beside)
        counted = VOLUMES * prod(A.domain.shape) + SINOGRAMS * pixels + CELLS * cells
    light = A.device.upload(np.ones(A.range.shape, np.float32))
    dose = A.device.empty(A.domain.shape)
    evaluation, first = _timed(lambda: total(A(A.T(light, out=dose), out=light)))
    seconds, compiling = evaluation + PASSES * _timed(lambda: total(light))[0], COMPILED * max(first - evaluation, 0.0)
    return Expected(counted * A.device.real.itemsize, float(evaluations), seconds, corners, compiling)


def _timed(work: Callable[[], Any]) -> tuple[float, float]:
    """Shortest time of a few runs, and that of the first one, which compiles [s]."""
    took: list[float] = []
    for _ in range(1 + TIMED):
        began = time.perf_counter()
        work()
        took.append(time.perf_counter() - began)
    return min(took[1:]), took[0]
