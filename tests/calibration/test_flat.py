"""A flat field from readings of blocks: exact without noise, and as far off as it says with it."""

from __future__ import annotations

import numpy as np
import pytest

from vamgpu.calibration.flat import cuts, fit_flat
from vamgpu.errors import BadInput, ShapeMismatch

MIRRORS = (54, 96)


def field() -> np.ndarray:
    down, across = np.meshgrid(*(np.linspace(-1.0, 1.0, length) for length in MIRRORS), indexing="ij")
    return 1.0 - 0.08 * across + 0.03 * down - 0.15 * (down**2 + across**2) - 0.02 * across**3


def readings(noise: float, seed: int, blocks: tuple[int, int] = (8, 12)) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    down, across = (cuts(length, count) for length, count in zip(MIRRORS, blocks, strict=True))
    light = np.add.reduceat(np.add.reduceat(field(), down[:-1], axis=0), across[:-1], axis=1)
    return light[..., None] + 0.5 + noise * rng.normal(size=(*blocks, 4)), 0.5 + noise * rng.normal(size=64)


def test_without_noise_the_field_is_exact() -> None:
    found = fit_flat(*readings(0.0, 0), MIRRORS)
    np.testing.assert_allclose(found.field, field() / field().max(), atol=1e-12)
    assert found.field.max() == 1.0 and found.error < 1e-12


def test_errors_hold_the_truth_as_often_as_they_say() -> None:
    true = field() / field().max()
    pulls = []
    for seed in range(24):
        found = fit_flat(*readings(0.2, seed), MIRRORS)
        pulls.append((found.field - true)[0, 0] / found.error)
        assert found.left == pytest.approx(found.noise, rel=0.35)
    assert (np.abs(pulls) < 2.0).mean() >= 0.9 and np.std(pulls) > 0.4


def test_what_cannot_be_told_is_refused() -> None:
    read, dark = readings(0.2, 1)
    for wrong in (read[..., :1], read[0], dark):
        with pytest.raises(ShapeMismatch):
            fit_flat(wrong, dark, MIRRORS)
    with pytest.raises(BadInput, match="use more blocks"):
        fit_flat(read[:4, :4], dark, MIRRORS)
    with pytest.raises(BadInput, match="light the meter"):
        fit_flat(1e-3 * read, dark, MIRRORS)
    with pytest.raises(BadInput, match="not finite"):
        fit_flat(np.where(read > read.mean(), np.nan, read), dark, MIRRORS)
    with pytest.raises(BadInput, match="expected 1 to 54"):
        cuts(54, 55)
