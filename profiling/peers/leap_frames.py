"""LEAP's entry in the leaderboard, its script VAM/VAM.py: ``leap_frames.py CASE OUT``.

Parallel light without refraction. Its cylinder of resin is as wide as the volume, and absorbs as the resin of the case.
"""

from __future__ import annotations

import numpy as np
from VAM import VAM  # LEAP's folder VAM

from profiling.leaderboard.entry import Case, Found, enter

USUAL = {"VAM": 20}
"""Iterations by default."""


def solve(case: Case, method: str, iterations: int) -> Found:
    """Its light intensity field."""
    part = np.ascontiguousarray(case.voxels().transpose(2, 1, 0), np.float32)  # [z, y, x]
    solver = VAM(alpha=case.setup.vial.absorption, D_c=1.0)
    light, _ = solver.execute(part, numIter=iterations, pixelSize=case.setup.pixel, numAngles=case.shape[0])
    light = np.asarray(light, float).swapaxes(1, 2)  # from [angle, row, column]
    return Found(np.roll(light, 3 * case.shape[0] // 4, axis=0), {})  # its angle 0 is our 270°


if __name__ == "__main__":
    enter("LEAP", "1.26", solve, USUAL)
