"""Light for all corners of tolerances by a judge of its own, and bounds against linear programming."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy import sparse
from scipy.ndimage import distance_transform_edt
from scipy.special import ndtr
from widest import entries_of, widest

import vamgpu as vam
from vamgpu.errors import BadInput, Cancelled
from vamgpu.methods import bound
from vamgpu.methods.tolerances import Tolerances, at

SIZE, PITCH = 20, 0.1
OFF = Tolerances(axis=0.25 * PITCH, spread=(0.5 * PITCH, PITCH))
PARTS = ("ring", "cross", "bars")


@cache
def projection() -> vam.Projection:
    return vam.Projection(vam.Grid((SIZE, SIZE, 1), PITCH), vam.Beam((30, 1), PITCH), vam.Turntable(30, lit_share=0.0))


def plane() -> tuple[np.ndarray, np.ndarray]:
    x, y = np.meshgrid(*2 * [np.arange(SIZE) - 0.5 * (SIZE - 1)], indexing="ij")
    return x, y


def part(name: str) -> np.ndarray:
    x, y = plane()
    r = np.hypot(x, y)
    return {
        "ring": (r < 7.5) & (r > 3), "cross": ((abs(x) < 3) | (abs(y) < 3)) & (r < 8),
        "bars": (abs(x) < 7) & (abs(y) < 7) & (np.mod(x + 7, 9) < 5),
    }[name]  # fmt: skip


@cache
def entries() -> list[Any]:
    """Those of every corner."""
    return [entries_of(at(projection(), corner)) for corner in OFF.corners()]


@cache
def optimum(name: str) -> float:
    """That of one light and one threshold for all corners."""
    inside, near = part(name).ravel(), projection().grid.cylinder().ravel()
    wanted, void = (sparse.vstack([each[where & near] for each in entries()]) for where in (inside, ~inside))
    return widest(wanted, void)


def judged(light: np.ndarray, name: str, axis: float, spread: float) -> tuple[float, float, float]:
    """Least dose half a pixel inside the surface, greatest half a pixel outside, and the greatest, summed over pixels.

    Places are 6 times as fine as voxels. A pixel is a box blurred by the point spread; frames are exposed at four
    places of their step.
    """
    fine = 6
    solid = np.kron(part(name), np.ones((fine, fine))) > 0.5
    depth = (distance_transform_edt(solid) - distance_transform_edt(~solid)) / fine  # type: ignore[operator]
    places = (np.arange(fine * SIZE) - 0.5 * (fine * SIZE - 1)) * PITCH / fine
    x, y = (each[1::3, 1::3] for each in np.meshgrid(places, places, indexing="ij"))
    angles, columns, _ = light.shape
    r, dose = (np.arange(columns) - 0.5 * (columns - 1)) * PITCH, np.zeros(x.shape)
    for pose, row in zip(projection().motion.poses, light[:, :, 0], strict=True):
        for turn in (np.arange(4) - 1.5) / 4 * 2.0 * np.pi / angles:
            away = (y * np.cos(pose + turn) - x * np.sin(pose + turn) + axis)[..., None] - r
            seen = ndtr((away + 0.5 * PITCH) / spread) - ndtr((away - 0.5 * PITCH) / spread)
            dose += seen @ row.astype(np.float64)
    depth, near = depth[1::3, 1::3], np.hypot(x, y) <= 0.5 * SIZE * PITCH
    return dose[near & (depth >= 0.5)].min(), dose[near & (depth <= -0.5)].max(), dose[near].max()


@pytest.mark.slow
def test_light_holds_at_corners_and_at_points_inside_the_box() -> None:
    """Half a pixel from the surface while the vial turns; light that knows no corner does not."""
    A = vam.Projection(projection().grid, projection().beam, vam.Turntable(30))
    off = Tolerances(axis=0.6 * PITCH, spread=(0.5 * PITCH, PITCH))
    target, axis, (low, high) = part("bars")[:, :, None].astype(np.float32), off.axis, off.spread or (0.0, 0.0)
    rng, windows = np.random.default_rng(5), []
    inside = [(rng.uniform(-axis, axis), rng.uniform(low, high)) for _ in range(5)]
    corners = [(sign * axis, spread) for sign in (-1, 1) for spread in (low, high)]
    for tolerances in (off, None):
        light = vam.optimize(A, target, iterations=30, tolerances=tolerances).sinogram.numpy()
        doses = np.array([judged(light, "bars", *at) for at in (*corners, *inside)])
        windows.append((doses[:, 0].min() - doses[:, 1].max()) / doses[:, 2].max())
    assert windows[0] > max(0.02, windows[1] + 0.01), windows


def stacked() -> tuple[vam.Projection, np.ndarray]:
    """A ring of two slices on bars of three, with light of the same rows."""
    fractions = np.stack([part("bars")] * 3 + [part("ring")] * 2, axis=2).astype(np.float32)
    grid = vam.Grid(fractions.shape, PITCH)
    return vam.Projection(grid, vam.Beam((30, 5), PITCH), vam.Turntable(30)), fractions


@pytest.mark.slow
def test_the_bound_of_some_slices_holds_for_all_light_at_all_corners() -> None:
    A, fractions = stacked()
    ring = bound(A, fractions, evaluations=2500, tolerances=OFF, slices=(4, 5))
    alone = bound(projection(), part("ring")[:, :, None].astype(np.float32), evaluations=2500, tolerances=OFF)
    assert ring.prices.shape == (SIZE, SIZE, len(OFF.corners())) == alone.prices.shape
    # without a point spread along z one row would be all there is; with one, others add no more than it
    assert optimum("ring") - 2e-4 <= ring.value <= alone.value + 0.03
    pair = bound(A, fractions, evaluations=1000, tolerances=OFF, slices=(2, 4))
    plan = vam.optimize(A, fractions, iterations=20, tolerances=OFF)
    assert plan.window < min(ring.value, pair.value) < 0.5


def test_a_bound_ends_with_what_its_prices_tell_so_far() -> None:
    A, fractions = stacked()
    asked: list[int] = []
    found = bound(A, fractions, evaluations=9000, slices=(0, 1), cancel=lambda: asked.append(0) or len(asked) > 150)
    assert found.evaluations < 170 and 0.0 < found.value < 1.0
    with pytest.raises(Cancelled):
        bound(A, fractions, evaluations=9000, slices=(0, 1), cancel=lambda: True)


@pytest.mark.parametrize(("slices", "said"), [((2, 2), "first"), ((-1, 2), "first"), ((3, 6), "behind ≤ 5")])
def test_slices_that_are_not_there_are_refused(slices: tuple[int, int], said: str) -> None:
    with pytest.raises(BadInput, match=said):
        bound(*stacked(), slices=slices)
