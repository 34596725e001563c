"""Point spread of a limited range of angles, frequencies it carries, contrast, and windows of a web's segments."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.special import ive

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.metrics.contrast import contrast
from vamgpu.metrics.pointspread import coverage, covered_share, point_dose, spread, steepest, wedge
from vamgpu.webs.proof import piece_windows

RATIOS = (1.00, 0.92, 0.84, 0.75, 0.67)


@pytest.mark.slow
def test_the_spread_widens_along_rho_and_narrows_along_l() -> None:
    widths = 1e3 * np.array([spread(0.0324, m) for m in RATIOS])
    assert (np.diff(widths[:, 0]) < 0).all() and (np.diff(widths[:, 1]) > 0).all()
    assert widths[0] == pytest.approx([51.5, 51.5], abs=0.5)  # the reference rounds to 52 and 51
    assert widths[-1] == pytest.approx([36.0, 96.0], abs=0.5)


def test_all_angles_give_the_closed_form() -> None:
    """∫ exp(−a cos²θ) dθ over a half turn is π·exp(−a/2)·I₀(a/2)."""
    distance = np.array([0.0, 0.5, 1.0, 3.0])
    a = 4.0 * np.log(2.0) * distance**2
    for along, depth in ((distance, 0 * distance), (0 * distance, distance), (0.6 * distance, 0.8 * distance)):
        assert point_dose(along, depth, 1.0, 1.0) == pytest.approx(ive(0, 0.5 * a), abs=1e-9)
    assert spread(1.0, 1.0, 3600) == pytest.approx((1.59056, 1.59056), rel=1e-4)


def test_one_direction_is_the_beam_itself() -> None:
    assert spread(0.0324, 1e-3)[0] == pytest.approx(0.0324, rel=1e-5)


def test_coverage_of_the_paper_s_bath() -> None:
    assert coverage(1.33 / 1.49) == pytest.approx(2.2, abs=0.01)
    assert steepest(1.0) == pytest.approx(np.pi / 2) and covered_share(1.0) == 1.0


def test_the_wedge_keeps_what_some_direction_is_at_right_angles_to() -> None:
    mask = wedge((64, 48), (0.1, 0.2), 0.5)
    k_l, k_rho = np.fft.fftfreq(64, 0.1)[:, None], np.fft.fftfreq(48, 0.2)[None, :]
    angles = np.linspace(-np.pi / 6, np.pi / 6, 20_001)
    for i, j in np.random.default_rng(0).integers(0, (64, 48), (60, 2)):
        k = np.hypot(k_l[i, 0], k_rho[0, j])
        along = np.abs(k_l[i, 0] * np.sin(angles) + k_rho[0, j] * np.cos(angles)).min()  # light travels (sin, cos)
        assert mask[i, j] == (along <= 1e-4 * k)
    assert mask[0, 0] and not mask[0, 1:].any() and mask[1:, 0].all() and wedge((9, 9), 1.0, 1.0).all()
    # Over a disk of frequencies, the share of directions.
    grid = np.fft.fftfreq(401)
    disk = np.hypot(grid[:, None], grid[None, :]) < 0.5
    assert wedge((401, 401), 1.0, 0.75)[disk].mean() == pytest.approx(covered_share(0.75), abs=0.01)


def test_contrast_by_hand() -> None:
    dose, target = np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([[0.0, 0.2], [0.0, 1.0]])
    assert contrast(dose, target) == pytest.approx(0.6)
    assert contrast(dose, target, lambda f: f**2) == pytest.approx(20 / 30)
    assert contrast(target, target) == 1.0 and contrast(1 - np.ceil(target), target) == 0.0


def test_contrast_on_devices_counts_every_voxel(device: Device) -> None:
    random = np.random.default_rng(1)
    dose, target = random.random((7, 9, 5)), np.maximum(random.random((7, 9, 5)) - 0.6, 0.0)
    f, t = (device.upload(a.astype(np.float32)) for a in (dose, target))
    assert contrast(f, t) == pytest.approx(dose[target > 0].sum() / dose.sum(), rel=1e-6)
    assert contrast(f, t, np.sqrt) == pytest.approx(contrast(dose, target, np.sqrt), rel=1e-6)


def test_windows_of_pieces() -> None:
    random = np.random.default_rng(2)
    part = random.random((50, 6, 4)) > 0.6
    dose = random.random(part.shape) + 0.7 * part
    for some in (slice(0, 20), slice(20, 50), slice(0, 50)):
        inside, outside = dose[some][part[some]], dose[some][~part[some]]
        low, high = np.quantile(inside, 0.01, method="lower"), np.quantile(outside, 0.99, method="higher")
        expected = (inside.min() - outside.max()) / dose[some].max(), (low - high) / dose[some].max()
        assert piece_windows(dose[some], part[some]) == pytest.approx(expected)


def test_a_piece_without_part_or_void() -> None:
    part = np.zeros((10, 3, 2), bool)
    assert piece_windows(np.ones(part.shape), part) == (0.0, 0.0)
    assert piece_windows(np.where(part, 1.0, 0.2), ~part) == pytest.approx((1.0, 1.0))
    part[:, 1] = True
    assert piece_windows(np.where(part, 1.0, 0.2), part) == pytest.approx((0.8, 0.8))


@pytest.mark.parametrize(
    ("make", "kind", "words"),
    [
        (lambda: steepest(1.2), BadInput, "1.2"), (lambda: spread(0.0, 0.9), BadInput, "0.0"),
        (lambda: wedge((0, 4), 0.1, 0.9), BadInput, "(0, 4)"),
        (lambda: contrast(np.ones(3), np.ones(4)), ShapeMismatch, "(4,)"),
        (lambda: contrast(np.zeros(3), np.ones(3)), BadInput, "sums to 0"),
        (lambda: contrast(-np.ones(3), np.ones(3)), BadInput, "-1"),
        (lambda: contrast(np.ones(3), np.ones(3), lambda f: f.sum()), ShapeMismatch, "()"),
        (lambda: piece_windows(np.full((2, 2, 2), np.nan), np.ones((2, 2, 2), bool)), BadInput, "8 doses"),
    ],
)  # fmt: skip
def test_bad_input_is_named(make: Any, kind: type[Exception], words: str) -> None:
    with pytest.raises(kind) as caught:
        make()
    assert words in str(caught.value)
