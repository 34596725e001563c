"""Gray curves from noisy readings: near the truth, never falling, and readings that tell none."""

from __future__ import annotations

import numpy as np
import pytest

from vamgpu.calibration.gray import fit_gray
from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.printing.gray import GrayCurve

LEVELS = tuple(range(0, 256, 15))
TRUTH = 0.01 + 3.0 * (np.array(LEVELS) / 255.0) ** 2.2
AMBIENT = 0.4


def readings(noise: float = 0.003, repeats: int = 4, seed: int = 5) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    light = AMBIENT + TRUTH[:, None] + noise * rng.standard_normal((len(LEVELS), repeats))
    return light, AMBIENT + noise * rng.standard_normal(repeats)


def test_a_curve_is_found_and_packs_pictures() -> None:
    light, dark = readings()
    found = fit_gray(LEVELS, light, dark)
    assert np.abs(np.array(found.intensity) - TRUTH).max() < 0.006
    assert np.array(found.error) == pytest.approx(0.0015, rel=1.0)
    assert found.black == pytest.approx(0.01 / 3.01, abs=0.001)
    curve = GrayCurve(found.levels, found.intensity)
    assert curve(128) == pytest.approx((128 / 255.0) ** 2.2, abs=0.01)


@pytest.mark.parametrize("repeats", [2, 4, 16])
def test_errors_hold_the_truth_as_often_as_they_say(repeats: int) -> None:
    """Every level of 24 curves, the dark reading's error counted; within two standard errors lie 95 % of all."""
    found = [fit_gray(LEVELS, *readings(0.02, repeats, seed)) for seed in range(24)]
    pulls = np.array([(np.array(each.intensity) - TRUTH) / np.array(each.error) for each in found])
    assert 0.91 <= (np.abs(pulls) < 2.0).mean() <= 0.99


def test_noise_that_makes_it_fall_is_smoothed() -> None:
    light, dark = readings(noise=0.1)
    assert (np.diff(light.mean(axis=1)) < 0).any()
    found = fit_gray(LEVELS, light, dark)
    assert (np.diff(found.intensity) >= 0).all() and 0.0 < found.moved < 0.15
    GrayCurve(found.levels, found.intensity)


def test_readings_that_tell_no_curve_are_told() -> None:
    light, dark = readings()
    clipped = np.minimum(light, AMBIENT + 1.5)
    fallen = light.copy()
    fallen[9] = light[5]
    for read, why in (
        (clipped, "saturated"),
        (fallen, "falls at level"),
        (AMBIENT + 0.001 * (light - AMBIENT) + 0.01 * np.sin(np.arange(light.size)).reshape(light.shape), "rises by"),
        (np.where(light > 3.3, np.nan, light), "not finite"),
    ):
        with pytest.raises(BadInput, match=why):
            fit_gray(LEVELS, read, dark)
    with pytest.raises(BadInput, match="from 0 to 255"):
        fit_gray(LEVELS[:-1], light[:-1], dark)
    with pytest.raises(ShapeMismatch, match="2 or more"):
        fit_gray(LEVELS, light[:, :1], dark)
