"""Reductions agree with NumPy on every device, whatever the padding."""

from __future__ import annotations

import numpy as np
import pytest

from vamgpu.backend.device import Device
from vamgpu.operators import reductions

SHAPES = [(5, 7, 3), (24, 24, 24), (40, 33, 70)]


@pytest.mark.parametrize("shape", SHAPES)
def test_sums_and_extremes(device: Device, shape: tuple[int, int, int]) -> None:
    rng = np.random.default_rng(3)
    a, b = rng.normal(size=shape).astype(np.float32), rng.normal(size=shape).astype(np.float32)
    x, y = device.upload(a), device.upload(b)
    size = float(np.abs(a).sum())
    with device.no_transfers():
        assert reductions.total(x) == pytest.approx(a.sum(dtype=np.float64), abs=1e-6 * size)
        assert reductions.dot(x, y) == pytest.approx(np.vdot(a.astype(float), b), abs=1e-6 * size)
        assert reductions.extent(x) == (a.min(), a.max())
        i, j = ((np.arange(n) - 0.5 * (n - 1)) ** 2 for n in shape[:2])
        distance = i[:, None] + j
        chosen = (b >= -0.5) & (b < 0.75) & (distance <= 9.0**2)[:, :, None]
        wanted = (a[chosen].min(), a[chosen].max())
        assert reductions.extent(x, y, -0.5, 0.75, 9.0) == wanted


def test_nothing_chosen_is_infinite(device: Device) -> None:
    x = device.upload(np.ones((4, 4, 4)))
    assert reductions.extent(x, x, 2.0, 3.0) == (np.inf, -np.inf)
