"""Histograms, extremes and order statistics on every device against NumPy's own."""

from __future__ import annotations

import numpy as np
import pytest

from vamgpu.backend.device import Device
from vamgpu.metrics.histogram import above, extremes, histogram, order_statistic
from vamgpu.metrics.parts import Parts

SHAPE = (35, 27, 37)


def _fields(device: Device, steps: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray, Parts]:
    """dose, target, (x, y) of counted columns, and the same on a device; steps: dose in whole steps."""
    rng = np.random.default_rng(7)
    dose = rng.integers(0, steps, SHAPE) + 0.5 if steps else rng.gamma(2.0, 1.0, SHAPE)
    dose, target = dose.astype(np.float32), rng.random(SHAPE).astype(np.float32)
    x, y = (np.arange(n) - (n - 1) / 2 for n in SHAPE[:2])
    counted = np.hypot(x[:, None], y) <= 9.25
    return dose, target, counted, Parts(device.upload(dose), device.upload(target), level=0.7, reach=9.25)


@pytest.mark.parametrize("per_slice", [False, True])
def test_counts_agree_exactly(device: Device, per_slice: bool) -> None:
    dose, target, counted, parts = _fields(device, steps=64)
    got = histogram(parts, bins=32, top=32.0, per_slice=per_slice)
    assert got.edges.tolist() == np.arange(33.0).tolist()
    for which, member in enumerate((target < 0.7, target >= 0.7)):
        for index, z in enumerate(range(SHAPE[2]) if per_slice else [slice(None)]):
            values = np.minimum(dose[:, :, z][member[:, :, z] & (counted if per_slice else counted[..., None])], 31.5)
            assert got.counts[index, which].tolist() == np.histogram(values, got.edges)[0].tolist()


@pytest.mark.parametrize("per_slice", [False, True])
def test_extremes_and_sums(device: Device, per_slice: bool) -> None:
    dose, target, counted, parts = _fields(device)
    got = extremes(parts, per_slice=per_slice)
    assert got.least.shape == ((SHAPE[2] if per_slice else 1), 2)
    for which, member in enumerate((target < 0.7, target >= 0.7)):
        for index, z in enumerate(range(SHAPE[2]) if per_slice else [slice(None)]):
            values = dose[:, :, z][member[:, :, z] & (counted if per_slice else counted[..., None])]
            assert got.least[index, which] == values.min() and got.greatest[index, which] == values.max()
            assert got.total[index, which] == pytest.approx(values.sum(dtype=np.float64), rel=1e-6)


def test_order_statistics_are_exact(device: Device) -> None:
    dose, target, counted, parts = _fields(device)
    for share in (0.0, 0.013, 0.5, 0.999, 1.0):
        values = [np.sort(dose[(m & counted[..., None])]) for m in (target < 0.7, target >= 0.7)]
        rank = np.array([[int(share * (len(v) - 1)) for v in values]])
        wanted = [v[r] for v, r in zip(values, rank[0], strict=True)]
        assert order_statistic(parts, rank)[0] == pytest.approx(wanted, abs=1e-6)


def test_a_quantile_of_a_sinogram(device: Device) -> None:
    light = np.random.default_rng(3).random((22, 31, 9)).astype(np.float32)
    rank = np.full((1, 2), int(0.995 * (light.size - 1)))
    got = order_statistic(Parts.whole(device.upload(light)), rank)
    assert np.isnan(got[0, 0])
    assert got[0, 1] == pytest.approx(np.quantile(light, 0.995, method="lower"), abs=1e-7)


def test_a_threshold_equal_to_a_dose_counts_it_as_reached(device: Device) -> None:
    values = np.full((3, 3, 2), 0.3, np.float32)
    field = device.upload(values)
    got = above(Parts(field, field, level=0.1, reach=10.0), float(np.float32(0.3)))
    assert got.tolist() == [[[0, 0], [0, 18]]]
