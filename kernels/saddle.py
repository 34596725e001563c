"""Steps towards the widest process window: light as the primal side, its limits in every voxel as the dual one.

Source: A. Chambolle, T. Pock, J. Math. Imaging Vis. 40 (2011) 120, with the diagonal steps of T. Pock, A. Chambolle,
ICCV (2011) 1762. Inside is a target of at least one half; voxels farther than ``reach`` samples from the axis count
neither way. A target of 2 + t is gray: its dose is to be that of the part within a share t; see `limit_step`.
"""

from __future__ import annotations

import numpy as np

from vamgpu.kernels.reduce import CPU, Parts, disc
from vamgpu.kernels.reduce import GPU as PARTIAL
from vamgpu.kernels.signature import Array, ArrayInOut, ArrayOut, Real, Tiling, kernel

GPU = Tiling(major=1, minor=1)


@kernel(over="light", cpu=CPU, gpu=PARTIAL)
def light_step(
    light: Array, columns: Array, step: Real, most: Real, ahead: ArrayInOut, after: ArrayOut, moved: Parts
) -> None:
    """after = light − step·descent / columns from 0 to most, dark where columns are 0; ahead, the descent, becomes
    2·after − light.

    columns: what a pixel adds to all limits together.  Σ moved = Σ columns·(after − light)².
    """
    lit = columns > 0
    after[...] = np.where(lit, np.clip(light - step * ahead / np.where(lit, columns, 1.0), 0.0, most), 0.0)
    ahead[...] = 2.0 * after - light
    moved[...] = 0.0
    moved[0] = np.sum(columns * (after - light) ** 2)


@kernel(over="wall", cpu=CPU, gpu=PARTIAL)
def limit_step(
    ahead: Array, held: Array, target: Array, rows: Array, least: Real, leak: Real, loose: Real, step: Real,
    reach: Real, wall: Array, cap: Array, wall_after: ArrayOut, cap_after: ArrayOut, inside: Parts, outside: Parts,
    moved: Parts, crossed: Parts,
) -> None:  # fmt: skip
    """Prices of the limits of a dose: ``wall`` of ≥ least inside and ≤ leak outside, ``cap`` of ≤ 1 inside.

    A gray dose of t < ``loose`` keeps half of least − leak from both ends of (1 ± t)·(1 + least)/2: it is at least
    ((1 − t) + (2 − t)·least − leak)/2 and at most (1 + t + t·least + leak)/2. Of other t the limits are the part's.

    after = max(0, price + step·excess / (rows + 1)) by the dose ahead; rows alone for the cap, 1.5 more for both where
    gray.  rows: dose of light 1 everywhere.  Σ inside, Σ outside: what the prices after come to on least, and on leak.
    Σ moved: of squared differences times what divided the steps.  Σ crossed: of the change of (outside: wall, inside:
    cap − wall) times half of ahead − held.
    """
    near = disc(target.shape[0], target.shape[1], reach)[:, :, None] & (rows > 0)
    part, gray, weight = target >= 0.5, target >= 1.5, np.where(near, rows, 1.0)
    share = target - 2.0
    tight = gray & (share < loose)
    lower = np.where(tight, 0.5 * (1.0 - share + (2.0 - share) * least - leak), least)
    upper = np.where(tight, 0.5 * (1.0 + share + share * least + leak), 1.0)
    wide_wall, wide_cap = weight + np.where(gray, 1.5, 1.0), weight + np.where(gray, 1.5, 0.0)
    excess = np.where(part, lower - ahead, ahead - leak)
    wall_after[...] = np.where(near, np.maximum(0.0, wall + step * excess / wide_wall), 0.0)
    cap_after[...] = np.where(near & part, np.maximum(0.0, cap + step * (ahead - upper) / wide_cap), 0.0)
    higher, tighter = wall_after - wall, cap_after - cap
    on_least = np.where(tight, 1.0 - 0.5 * share, 1.0) * wall_after - np.where(tight, 0.5 * share, 0.0) * cap_after
    on_leak = np.where(tight, 0.5 * (wall_after + cap_after), 0.0)
    for parts, values in (
        (inside, np.where(part, on_least, 0.0)),
        (outside, np.where(part, on_leak, wall_after)),
        (moved, wide_wall * higher**2 + wide_cap * tighter**2),
        (crossed, np.where(part, tighter - higher, higher) * (0.5 * (ahead - held))),
    ):
        parts[...] = 0.0
        parts[0] = values.sum()


@kernel(over="pull", cpu=CPU, gpu=GPU)
def price_dose(wall: Array, cap: Array, target: Array, pull: ArrayOut) -> None:
    """pull = what a unit of dose costs: the wall's price outside, the cap's less the wall's inside."""
    pull[...] = np.where(target >= 0.5, cap - wall, wall)


@kernel(over="now", cpu=CPU, gpu=GPU)
def reflect(step: Array, anchor: Array, share: Real, now: ArrayInOut) -> None:
    """now = share·(2·step − now) + (1 − share)·anchor: beyond the step, held back by an anchor."""
    now[...] = share * (2.0 * step - now) + (1.0 - share) * anchor
