"""Means over neighborhoods, beside SciPy's."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from vamgpu.backend import open_device
from vamgpu.live.smoothing import Smoothing


@pytest.mark.parametrize("sigma", [1.0, 2.0])
def test_means_are_gaussian_and_of_what_there_is(device: Any, sigma: float) -> None:
    device = open_device(device) if isinstance(device, str) else device
    values = np.random.default_rng(0).random((19, 22, 25)).astype(np.float32)
    smooth = Smoothing(device, values.shape, sigma)
    # beyond the faces nothing counts: what there is, over its share
    ends = {"mode": "constant", "truncate": 4.0}
    total, share = (gaussian_filter(each.astype(float), sigma, **ends) for each in (values, np.ones(values.shape)))
    assert np.abs(smooth(device.upload(values)).numpy() - total / share).max() < 1e-5
    assert smooth(device.upload(np.full(values.shape, 3.0))).numpy() == pytest.approx(3.0, rel=1e-5)
