"""vamgpu's entry: ``python -m profiling.leaderboard.ours CASE OUT --method default``."""

from __future__ import annotations

import warnings
from math import ceil, sqrt
from typing import Any

import numpy as np

import vamgpu
from profiling.leaderboard.entry import Case, Found, enter
from profiling.leaderboard.judge import RoundVial
from vamgpu.targets.mesh import load_mesh

VOXEL = 0.75
"""Width of voxels over that of a pixel in the resin; 1 in a square vial, because they fill all of it."""
METHODS = {"limited": "default"}
"""Names that are no method's."""
USUAL = {"default": 120, "limited": 120, "lbfgs": 40, "recipe": 2}
"""Evaluations; "recipe" is our version of the recipe of automatic exposure, which its authors correct twice."""


def solve(case: Case, method: str, iterations: int) -> Found:
    """Patterns of a method, packed into bytes; those of "limited" print in the time of the case."""
    A, target = projected(case)
    lamp = {"irradiance": case.setup.irradiance, "critical_dose": case.setup.critical_dose}
    limit: Any = {"exposure_limit": case.longest, **lamp} if case.longest else {}
    plan = vamgpu.optimize(A, target, METHODS.get(method, method), evaluations=iterations, progress=False, **limit)
    levels = vamgpu.pack(plan).levels()
    facts = {"device": str(A.device), "voxels": list(target.grid.shape), "evaluations": plan.evaluations}
    return Found(levels[:, ::-1].swapaxes(1, 2).astype(np.float64), facts)


def projected(case: Case) -> tuple[Any, vamgpu.Target]:
    """Projector and target; through a square vial a ray for each pixel, without Fresnel's losses, vial at rest."""
    setup, (angles, columns, rows) = case.setup, case.shape
    part, vial = load_mesh(setup.part), setup.vial
    if isinstance(vial, RoundVial):
        target = vamgpu.Target.from_mesh(part, factor=1.0, pitch=VOXEL * setup.pixel)
        beam = vamgpu.Beam((columns, rows), setup.pitch, spread=setup.spread)
        motion = vamgpu.Turntable(angles, lit_share=setup.lit_share)
        return vamgpu.projector(target.grid, beam, motion, vamgpu.Vial(**vars(vial))), target
    across = 2 * ceil(sqrt(2.0) * vial.radius / setup.pixel)
    target = vamgpu.Target.from_mesh(part, factor=1.0, pitch=setup.pixel, shape=(across, across, rows))
    away = np.abs(target.grid.axes()[0])
    inner, outer = (np.clip((half - away) / setup.pixel + 0.5, 0.0, 1.0) for half in (vial.inner, vial.radius))
    resin, full = np.outer(inner, inner), np.outer(outer, outer)
    index = vial.bath_index + (vial.wall_index - vial.bath_index) * full + (vial.resin_index - vial.wall_index) * resin
    medium = vamgpu.CoRotatingMedium(index, vial.absorption * resin, bath=vial.bath_index)
    beam, motion = vamgpu.Beam((columns, rows), setup.pitch), vamgpu.Turntable(angles, lit_share=0.0)
    return vamgpu.TracedProjection(target.grid, beam, motion, medium), target


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    enter("vamgpu", vamgpu.__version__, solve, USUAL)
