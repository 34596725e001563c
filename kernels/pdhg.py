"""Steps of PDHG on the window's linear program; see `vamgpu.methods.pdhg`.

Source: A. Chambolle, T. Pock, J. Math. Imaging Vis. 40 (2011) 120, with the diagonal steps of T. Pock, A. Chambolle,
ICCV (2011) 1762. A voxel is inside if its target is at least one half; voxels farther than ``reach`` samples from the
axis do not count.
"""

from __future__ import annotations

import numpy as np

from vamgpu.kernels.reduce import CPU, Parts, disc
from vamgpu.kernels.reduce import GPU as PARTIAL
from vamgpu.kernels.signature import Array, ArrayInOut, ArrayOut, Real, Tiling, kernel

GPU = Tiling(major=1, minor=1)


@kernel(over="light", cpu=CPU, gpu=PARTIAL)
def primal_step(light: Array, columns: Array, step: Real, ahead: ArrayInOut, after: ArrayOut, moved: Parts) -> None:
    """after = max(0, light − step·descent / columns), dark where columns are 0; ahead, which holds the descent, becomes
    2·after − light.

    columns: sum of a pixel's entries in all limits.  Σ moved = Σ columns·(after − light)².
    """
    lit = columns > 0
    after[...] = np.where(lit, np.maximum(0.0, light - step * ahead / np.where(lit, columns, 1.0)), 0.0)
    ahead[...] = 2.0 * after - light
    moved[...] = 0.0
    moved[0] = np.sum(columns * (after - light) ** 2)


@kernel(over="lower", cpu=CPU, gpu=PARTIAL)
def dual_step(
    ahead: Array, held: Array, target: Array, rows: Array, least: Real, leak: Real, step: Real, reach: Real,
    lower: Array, upper: Array, lower_after: ArrayOut, upper_after: ArrayOut, inside: Parts, outside: Parts,
    moved: Parts, crossed: Parts,
) -> None:  # fmt: skip
    """Multipliers of a dose: ``lower`` of ≥ least inside and ≤ leak outside, ``upper`` of ≤ 1 inside.

    after = max(0, multiplier + step·excess / (rows + 1)) from the dose ahead; for ``upper`` only rows. rows: dose of
    light 1 everywhere. Σ inside, Σ outside: of ``lower`` after, on either side. Σ moved: of squared differences times
    the divisors of the steps. Σ crossed: of the change of (outside: lower, inside: upper − lower) times half of ahead −
    held.
    """
    near = disc(target.shape[0], target.shape[1], reach)[:, :, None] & (rows > 0)
    part, weight = target >= 0.5, np.where(near, rows, 1.0)
    excess = np.where(part, least - ahead, ahead - leak)
    lower_after[...] = np.where(near, np.maximum(0.0, lower + step * excess / (weight + 1.0)), 0.0)
    upper_after[...] = np.where(near & part, np.maximum(0.0, upper + step * (ahead - 1.0) / weight), 0.0)
    higher, tighter = lower_after - lower, upper_after - upper
    for parts, values in (
        (inside, np.where(part, lower_after, 0.0)),
        (outside, np.where(part, 0.0, lower_after)),
        (moved, (weight + 1.0) * higher**2 + weight * tighter**2),
        (crossed, np.where(part, tighter - higher, higher) * (0.5 * (ahead - held))),
    ):
        parts[...] = 0.0
        parts[0] = values.sum()


@kernel(over="pull", cpu=CPU, gpu=GPU)
def dual_dose(lower: Array, upper: Array, target: Array, pull: ArrayOut) -> None:
    """pull = cost of a unit of dose: ``lower`` outside, upper − lower inside."""
    pull[...] = np.where(target >= 0.5, upper - lower, lower)


@kernel(over="now", cpu=CPU, gpu=GPU)
def reflect(step: Array, anchor: Array, share: Real, now: ArrayInOut) -> None:
    """now = share·(2·step − now) + (1 − share)·anchor: reflection, pulled towards an anchor."""
    now[...] = share * (2.0 * step - now) + (1.0 - share) * anchor
