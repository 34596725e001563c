"""Voxels of which nothing is asked belong to no class, on every device."""

from __future__ import annotations

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.metrics import score
from vamgpu.metrics.histogram import extremes
from vamgpu.metrics.parts import Parts
from vamgpu.printing.bodies import judged_parts
from vamgpu.targets.limits import BodyRequirement, Limits

SHAPE = (21, 20, 7)
GRID = vam.Grid(SHAPE, 0.1)


def test_nothing_is_judged_where_nobody_cares(device: Device) -> None:
    rng = np.random.default_rng(3)
    dose, fraction = rng.random(SHAPE).astype(np.float32), (rng.random(SHAPE) > 0.6).astype(np.float32)
    asked = np.where(rng.random(SHAPE) > 0.3, np.float32(1.0), np.float32(0.0))
    limits = Limits(asked, np.ones(SHAPE), np.zeros(SHAPE, int), (BodyRequirement("part", "print"),))
    parts = judged_parts(device.upload(dose), device.upload(fraction), limits)
    found = score(parts.dose, parts.target, threshold=0.5)
    judged_ = (asked > 0) & GRID.cylinder()[:, :, None]
    inside, outside = dose[judged_ & (fraction > 0.5)], dose[judged_ & (fraction < 0.5)]
    assert (found.in_voxels, found.out_voxels) == (inside.size, outside.size)
    assert (found.missing, found.excess) == ((inside < 0.5).sum(), (outside >= 0.5).sum())
    assert (found.least_in, found.greatest_out) == pytest.approx((inside.min(), outside.max()), rel=1e-6)
    assert found.windows.trimmed * found.peak == pytest.approx(
        np.quantile(inside, 0.01, method="lower") - np.quantile(outside, 0.99, method="higher"), abs=1e-6
    )
    plain = Parts(device.upload(dose), parts.target)  # the dose as it is, not over limits
    per_slice = extremes(plain, per_slice=True)
    for z in range(SHAPE[2]):
        out = dose[:, :, z][(judged_ & (fraction < 0.5))[:, :, z]]
        assert per_slice.total[z, 0] == pytest.approx(out.sum(), rel=1e-5)
        assert (per_slice.least[z, 0], per_slice.greatest[z, 0]) == (out.min(), out.max())
