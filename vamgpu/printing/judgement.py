"""What a report opens with: the window over tolerance, and what the print bears."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from vamgpu.metrics.tolerance import Slab, ToleranceWindow, depth_of_fractions, tolerance_window
from vamgpu.operators.projection import Projection
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


def judged(proof: Proof, slabs: Iterable[Slab] | None = None) -> Judgement:
    """Judge a proof by the light of its frames, exposed once more on finer voxels and through the tolerance table.

    Args:
        proof: of an operator that is a `Projection`.
        slabs: the proved dose on finer voxels; exposed here by default.
    """
    A = proof.operator
    light = proof.frames.irradiance(A.device)
    depth = depth_of_fractions(proof.target.numpy(), A.grid)
    fine = _exposed(A, light) if slabs is None else slabs
    found = tolerance_window(fine, depth, A.grid.pitch, radius=A.grid.inscribed_radius)
    table = tolerance_table(A, light, proof.target, proved=proof.scores, half_voxel=found.half_voxel)
    return Judgement(found, table)


def _exposed(A: Projection, light: Any) -> Iterable[Slab]:
    from vamgpu.printing.independent import IndependentExposure

    return IndependentExposure(A).fine(light, A.grid.inscribed_radius)
