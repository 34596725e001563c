"""Estimate memory and time of a run before it begins."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from math import prod
from typing import Any

from vamgpu.geometry import Grid
from vamgpu.methods.surface import CELLS, SINOGRAMS, VOLUMES, SurfaceRamp, fine_grid, on_rings
from vamgpu.operators.projection import Projection
from vamgpu.operators.reductions import total
from vamgpu.operators.ring_projection import RingProjection, direct, unsupported_reason
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
    counted, finer = FEW_VOLUMES * voxels * corners + FEW_SINOGRAMS * pixels, 1.0
    if isinstance(method, SurfaceRamp):
        grid = fine_grid(A)
        finer = 1.0 if grid is None else prod(grid.shape) / voxels
        A = A if grid is None else _like(A, grid)
        beside = () if grid is None else outer_cells(grid, A.beam, A.motion, A.vessel)
        cells = sum(prod(each.shape) for each in beside)
        counted = int(VOLUMES * finer * voxels) + SINOGRAMS * pixels + CELLS * cells
    part = target.on(A.device)
    light = A(part)
    seconds = finer * _quickest(lambda: total(A.T(A(part)))) + PASSES * _quickest(lambda: total(light))
    return Expected(counted * A.device.real.itemsize, float(evaluations), seconds, corners)


def _quickest(work: Callable[[], Any]) -> float:
    """Least time of a few runs [s]."""
    took: list[float] = []
    for _ in range(1 + TIMED):  # the first one compiles
        began = time.perf_counter()
        work()
        took.append(time.perf_counter() - began)
    return min(took[1:])


def _like(A: Any, grid: Grid) -> Any:
    """A projector on its own voxels of the kind that light is found with on finer ones."""
    plain = direct(A)
    fine = Projection(grid, plain.beam, plain.motion, plain.vessel, plain.device)
    return RingProjection.of(plain) if on_rings(A, fine) and not unsupported_reason(plain) else A
