"""Scattered light on every device: the same photons, and an exact transpose."""

from __future__ import annotations

import kernel_examples as examples
import numpy as np
import pytest

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.kernels.photons import photons


def test_photons_are_the_same_to_the_last_bit(fast_device: Device) -> None:
    """GPUs in their own arithmetic may fuse operations; processors do not."""
    if getattr(fast_device, "is_gpu", False) and "GPU layout" not in fast_device.name:
        pytest.skip("a GPU's compiler decides how it rounds")
    found, wanted = (examples.bind(device, photons, 40) for device in (fast_device, vam.open_device("numpy")))
    for bound in (found, wanted):
        bound.launch()
    for name, values in wanted.written().items():
        assert values.sum() > 100
        np.testing.assert_array_equal(found.written()[name], values)


@pytest.mark.parametrize("columns", [6, 5])
def test_the_transpose_is_exact_entry_by_entry(device: Device, columns: int) -> None:
    vial = vam.Vial(radius=2.2, wall=0.2, resin_index=1.5, wall_index=1.473, absorption=0.1)
    A = vam.Projection(vam.Grid((4, 4, 4), 0.6), vam.Beam((columns, 2), 0.5), vam.Turntable(4), vial, device)
    S = vam.ScatteringRings(A, vam.Scattering(0.4, 0.8), photons=12_000, tolerance=0.06)
    assert S.terms > 1
    matrix, back = S.dense(), S.T.dense()
    assert np.abs(matrix).max() > 0.0
    assert np.abs(back - matrix.T).max() <= 1e-6 * np.abs(matrix).max()
    assert S.dot_test() <= 1e-6
    clear = A.dense()
    assert matrix.sum() < 0.99 * clear.sum()  # what leaves through the faces above, below and beside
