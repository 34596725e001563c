"""Two matrices for tiny geometries: the projector, and its transpose as the back projector computes it."""

from __future__ import annotations

import numpy as np

from profiling.gallery.picture import Fact, Picture
from vamgpu.backend.device import Device
from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.operators.projection import Projection
from vamgpu.optics.vial import Vial
from vamgpu.reports import style

LIMIT = 3e-6
"""Allowed difference, relative to the largest entry."""


def transpose(device: Device, quick: bool = False, voxels: int = 8, angles: int = 8) -> Picture:
    """Straight rays, and rays bent and absorbed in a vial, on ``voxels``² voxels."""
    n, poses = (4, 5) if quick else (int(voxels), int(angles))
    figure, axes = style.sheet("abc;def", 6.4)
    facts: list[Fact] = []
    for letters, kind in (("abc", "straight"), ("def", "bent and absorbed")):
        A = _operator(kind, n, poses, device)
        forward, back = A.dense(), A.T.dense().T
        top = float(np.abs(forward).max())
        gap = (back - forward) / top
        reach = max(float(np.abs(gap).max()), 1e-8)
        entries = {"cmap": "Blues", "vmin": 0, "vmax": top}
        first = style.shown(axes[letters[0]], forward.T[:, ::-1], f"Projector, {kind}", **entries)
        style.shown(axes[letters[1]], back.T[:, ::-1], "Back projector, transposed", **entries)
        last = style.shown(axes[letters[2]], 1e6 * gap.T[:, ::-1], "Difference", cmap=style.GAP, vmin=-1e6 * reach,
                           vmax=1e6 * reach)  # fmt: skip
        style.bar(first, [axes[letters[0]], axes[letters[1]]], "length in the voxel [mm]" if kind == "straight"
                  else "absorbed share", fraction=0.025)  # fmt: skip
        if gap.any():
            style.bar(last, axes[letters[2]], "10⁻⁶ of the largest entry")
        else:
            axes[letters[2]].text(0.5, 0.5, "zero everywhere", transform=axes[letters[2]].transAxes, ha="center")
        axes[letters[0]].set(xlabel=f"voxel (x, y): {n}²", ylabel=f"ray (θ, r): {poses} × {A.range.shape[1]}")
        facts.append(Fact(f"largest difference, {kind}, over the largest entry", float(np.abs(gap).max()), "", 2,
                          LIMIT, bound="≤"))  # fmt: skip
        facts.append(Fact(f"entries that are not zero, {kind}", 100 * float((forward != 0).mean()), "%", 3))
        facts.append(Fact(f"gap between ⟨Ax, y⟩ and ⟨x, Aᵀy⟩ over the norms of Ax and y, {kind}", A.dot_test(), "", 2))
    caption = (
        "Each row is a ray, each column a voxel. The projection is computed for one voxel after another, the back "
        "projection for one ray after another; written as matrices, the second is the transpose of the first, to the "
        "rounding of a single number. Optimizers rely on it: their gradients are exact only then."
    )
    return Picture(figure, caption, tuple(facts))


def _operator(kind: str, n: int, poses: int, device: Device) -> Projection:
    grid = Grid((n, n, 1), 1.0)
    if kind == "straight":
        return Projection(grid, Beam((n, 1), 1.0), Turntable(poses), device=device)
    vial = Vial(radius=0.9 * n, wall=0.05 * n, resin_index=1.49962, wall_index=1.473, absorption=0.1)
    return Projection(grid, Beam((n, 1), 1.5), Turntable(poses), vial, device)
