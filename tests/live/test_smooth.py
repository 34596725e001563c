"""Means over neighborhoods, and functions of whole arrays, beside SciPy's and NumPy's."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from vamgpu.backend import open_device
from vamgpu.live.planes import TOGETHER, by_planes
from vamgpu.live.smooth import Smoothing


@pytest.mark.parametrize("sigma", [1.0, 2.0])
def test_means_are_gaussian_and_of_what_there_is(device: Any, sigma: float) -> None:
    device = open_device(device) if isinstance(device, str) else device
    values = np.random.default_rng(0).random((19, 22, 25)).astype(np.float32)
    smooth = Smoothing(device, values.shape, sigma)
    # beyond the faces nothing counts: what there is, over its share
    ends = {"mode": "constant", "truncate": 4.0}
    total, share = (gaussian_filter(each.astype(float), sigma, **ends) for each in (values, np.ones(values.shape)))
    assert np.abs(smooth.of(values) - total / share).max() < 1e-5
    assert smooth.of(np.full(values.shape, 3.0)) == pytest.approx(3.0, rel=1e-5)


@pytest.mark.parametrize("shape", [(7,), (40, 3), (5, TOGETHER // 4, 3), (300, 200, 9)])
def test_planes_are_those_of_the_whole(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(1)
    a, b = rng.random(shape), rng.random(shape)
    wanted = a + 2.0 * b
    assert (by_planes(lambda a, b, c: a + c * b, a, b, 2.0) == wanted).all()
    assert (by_planes(lambda a, b: np.stack([a, b], axis=1), a, b)[:, 1] == b).all()
    with pytest.raises(ZeroDivisionError):
        by_planes(lambda a: np.ones(1 // 0), a)
