"""Light of two signs that reproduces a greyscale slice exactly at its points."""

from __future__ import annotations

import numpy as np
import pytest

from profiling.exact_reconstruction import Slice, reconstruct, sufficient
from vamgpu.errors import BadInput


def phantom() -> np.ndarray:
    from skimage.data import shepp_logan_phantom
    from skimage.transform import resize

    return np.clip(np.asarray(resize(shepp_logan_phantom(), (100, 100), anti_aliasing=True)), 0.0, 1.0)


@pytest.mark.parametrize(("dtype", "most"), [(np.float64, 1e-12), (np.float32, 1e-6)])
def test_the_phantom_is_reproduced_to_rounding(dtype: type, most: float) -> None:
    design = phantom()
    plan = reconstruct(design, dtype=dtype)
    assert plan.slice.angles == 360 and plan.slice.width == 0.02 and plan.slice.extinction == 1.0
    assert not plan.blocked.any()
    assert plan.light.dtype == dtype
    assert plan.error(design) < most
    assert plan.light.min() < 0 < plan.light.max()


def test_between_the_points_it_is_not_exact() -> None:
    design = phantom()[::4, ::4]
    plan = reconstruct(design, angles=120)
    assert plan.error(design) < 1e-12
    assert plan.error(design, 4) > 0.05


def test_colors_have_their_own_extinction() -> None:
    design = phantom()[::4, ::4]
    plan = reconstruct(design, angles=120, subtraction=2.5)
    assert plan.error(design) < 1e-12
    # by hand: each color alone through its own Beer–Lambert law
    at = plan.slice
    bins, path = at.rays(*at.points())
    angle = np.arange(at.angles)
    dose = (plan.positive[angle, bins] * np.exp(-1.0 * path / at.radius)).sum(axis=1) * at.step
    dose -= (plan.negative[angle, bins] * np.exp(-2.5 * path / at.radius)).sum(axis=1) * at.step
    np.testing.assert_allclose(dose, design.ravel(), atol=1e-12)


def test_wide_bins_leave_points_without_an_angle() -> None:
    design = phantom()[::2, ::2]
    counts = [int(reconstruct(design, width=width).blocked.sum()) for width in (1.0, 0.2, 0.02)]
    assert counts[0] > counts[1] > counts[2] == 0
    assert reconstruct(design, width=1.0).error(design) > 1e-3


def test_the_first_point_is_lit_evenly() -> None:
    design = np.zeros((8, 8))
    design[0, 0] = 0.7
    plan = reconstruct(design, angles=36)
    at = plan.slice
    bins, path = at.rays(*at.points())
    first = plan.light[np.arange(36), bins[0]] * np.exp(-path[0] / at.radius)
    np.testing.assert_allclose(first, 0.7 / (2 * np.pi), rtol=1e-12)
    x, y = at.points()
    assert (x[0], y[0]) == (-3.5, -3.5)
    assert path[0, 0] == pytest.approx(np.sqrt(at.radius**2 - 3.5**2) + 3.5)


def test_what_surely_suffices() -> None:
    assert sufficient(100) == (20001, pytest.approx(3.14e-4, rel=1e-3))


@pytest.mark.parametrize("design", [np.zeros((4, 5)), np.full((4, 4), np.nan), np.zeros(4)])
def test_exact_refuses(design: np.ndarray) -> None:
    with pytest.raises(BadInput, match="square of finite"):
        reconstruct(design)
    with pytest.raises(BadInput, match="width"):
        Slice(8, width=0.0)
