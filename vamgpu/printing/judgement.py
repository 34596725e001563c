"""What a report opens with: the window over tolerance, and what the print bears."""

from __future__ import annotations

from dataclasses import dataclass

from vamgpu.backend.array import DeviceArray
from vamgpu.geometry import Grid
from vamgpu.metrics.tolerance import ToleranceWindow, depth_of_fractions, tolerance_window
from vamgpu.printing.proof import Proof
from vamgpu.printing.tolerances import ToleranceTable, tolerance_table


@dataclass(frozen=True, eq=False)
class Judgement:
    """How good a proved print is beyond its strict window.

    Args:
        over_tolerance: W from 0 to two voxels, on voxels half as wide as the part's.
        table: the same light through machines that are off by a little.
    """

    over_tolerance: ToleranceWindow
    table: ToleranceTable


def judged(proof: Proof) -> Judgement:
    """Judge a proof by the light of its frames, exposed once more on finer voxels and through the tolerance table.

    Where a proof knows no finer dose than that of the part's own voxels, W is found on those.
    """
    A = proof.operator
    depth = depth_of_fractions(proof.target.numpy(), A.grid)
    radius = A.grid.inscribed_radius
    slabs = proof.fine(radius) if proof.independent else (OwnVoxels(A.grid, proof.dose),)
    found = tolerance_window(slabs, depth, A.grid.pitch, radius=radius)
    light = proof.frames.irradiance(A.device)
    at = proof.scores.threshold
    table = tolerance_table(A, light, proof.target, proved=proof.dose, threshold=at, half_voxel=found.half_voxel)
    return Judgement(found, table)


class OwnVoxels:
    """The whole dose of a grid, as one slab."""

    def __init__(self, grid: Grid, dose: DeviceArray) -> None:
        self.dose = dose
        self.x, self.y, self.z = grid.axes()
