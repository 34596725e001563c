"""What a report opens with: the window over tolerance, and what the print bears."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from math import prod
from typing import Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.geometry import Grid
from vamgpu.metrics.surface_judgement import SurfaceJudgement, judge_surface
from vamgpu.metrics.tolerance import Depth, ToleranceWindow, depth_of_fractions, tolerance_window
from vamgpu.printing.proof import Proof
from vamgpu.printing.tolerances import ToleranceTable, tolerance_table

WHOLE = 2**28
"""Fine voxels up to which their surface is judged; that of the part's own voxels is beyond."""


@dataclass(frozen=True, eq=False)
class Judgement:
    """How good a proved print is beyond its strict window.

    Attributes:
        over_tolerance: W from 0 to two voxels, on voxels half as wide as the part's.
        table: the same light through machines that are off by a little.
        surface: how the surface of the print lies against the mesh.
    """

    over_tolerance: ToleranceWindow
    table: ToleranceTable
    surface: SurfaceJudgement


def judged(proof: Proof) -> Judgement:
    """Judge a proof by the light of its frames, exposed once more on finer voxels and through the tolerance table.

    Where a proof knows no finer dose than that of the part's own voxels, all is found on those. Costs about six
    projector evaluations for the finer dose, five to ten for the table, and some seconds of a processor for the
    surface.
    """
    A, at = proof.operator, proof.scores.threshold
    depth = depth_of_fractions(proof.target.numpy(), A.grid, A.beam.flat)
    radius, voxels = A.grid.inscribed_radius, prod(A.grid.shape)
    slabs: Iterable[Any] = (OwnVoxels(A.grid, proof.dose),)
    if proof.independent:
        slabs = (replace(slab, dose=slab.dose.numpy()) for slab in proof.fine(radius))  # type: ignore[arg-type]
        slabs = list(slabs) if 8 * voxels <= WHOLE else slabs
    if proof.limits is not None:
        slabs, depth = [_asked(proof, slab) for slab in slabs], _where_asked(proof, depth)
    found = tolerance_window(slabs, depth, A.grid.pitch, radius=radius)
    light = proof.frames.irradiance(A.device)
    table = tolerance_table(A, light, proof.target, proved=proof.dose, threshold=at, half_voxel=found.half_voxel,
                            limits=proof.limits)  # fmt: skip
    return Judgement(found, table, _surface(proof, slabs if isinstance(slabs, list) else None))


def _surface(proof: Proof, slabs: list[Any] | None) -> SurfaceJudgement:
    grid, fraction = proof.operator.grid, proof.target.numpy()
    if slabs is None:
        dose, place, pitch = proof.parts.dose.numpy(), [axis[0] for axis in grid.axes()], grid.pitch
    else:
        dose = np.concatenate([slab.dose for slab in slabs], axis=2)
        place, pitch = [slabs[0].x[0], slabs[0].y[0], slabs[0].z[0]], slabs[0].pitch
    at, thin = proof.scores.threshold, proof.unjudged
    return judge_surface(dose, place, pitch, at, fraction, grid, proof.joined, thin=thin)


def _asked(proof: Proof, slab: Any) -> _Asked:
    """A slab with its dose over the limits of the part's voxels."""
    assert proof.limits is not None
    scale = proof.limits.at(proof.limits.scale, proof.operator.grid.pitch)
    dose = slab.dose.numpy() if isinstance(slab.dose, DeviceArray) else np.asarray(slab.dose)
    pitch = getattr(slab, "pitch", proof.operator.grid.pitch)
    return _Asked(dose * scale(slab.x, slab.y, slab.z), slab.x, slab.y, slab.z, pitch)


def _where_asked(proof: Proof, depth: Depth) -> Depth:
    """A depth that is NaN where nothing is asked."""
    assert proof.limits is not None
    judged = proof.limits.at(proof.limits.scale, proof.operator.grid.pitch)
    return lambda x, y, z: np.where(judged(x, y, z) > 0.0, depth(x, y, z), np.nan)


@dataclass(frozen=True, eq=False)
class _Asked:
    """Some slices of a dose over its limits."""

    dose: np.ndarray
    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    pitch: float


class OwnVoxels:
    """The whole dose of a grid, as one slab."""

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray

    def __init__(self, grid: Grid, dose: DeviceArray) -> None:
        self.dose = dose
        self.x, self.y, self.z = grid.axes()
