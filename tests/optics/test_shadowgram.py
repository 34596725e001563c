"""Shadows of weak blobs against their integrals, and the books of light."""

from __future__ import annotations

import numpy as np
import pytest

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.geometry import Grid
from vamgpu.optics.index_field import GridField
from vamgpu.optics.shadowgram import Camera, Shadowgram, cured_index, shadowgram

INDEX, CONTRAST, WIDTH = 1.48, 2e-4, 0.5
CENTER = np.array([0.4, -0.3, 0.2])


def weak(pose: float, device: Device, focus: float = 0.0, flat: bool = False) -> Shadowgram:
    n, pitch = 49, 0.125
    x = (np.arange(n) - 24) * pitch
    square = sum((a - c) ** 2 for a, c in zip(np.meshgrid(x, x, x, indexing="ij", sparse=True), CENTER, strict=True))
    cured = np.exp(-square / (2.0 * WIDTH**2))
    if flat:
        middle = np.exp(-((x[:, None] - CENTER[0]) ** 2 + (x - CENTER[1]) ** 2) / (2.0 * WIDTH**2))
        field = cured_index(middle[:, :, None], Grid((n, n, 1), pitch), INDEX, CONTRAST)
        return shadowgram(field, Camera((48, 1), 0.1, focus), INDEX, pose=pose, device=device)
    field = cured_index(cured, Grid((n, n, n), pitch), INDEX, CONTRAST)
    return shadowgram(field, Camera((24, 18), 0.15, focus), INDEX, pose=pose, rays=2, step=0.1, device=device)


def expected(start: np.ndarray, pose: float, flat: bool) -> np.ndarray:
    """∫∇n dY / n across a Gaussian blob, along parallel light."""
    center = np.array([CENTER[1] * np.cos(pose) - CENTER[0] * np.sin(pose), CENTER[2]])
    away = start - center
    reach = np.exp(-(away[:, 0] ** 2 + (0 if flat else away[:, 1] ** 2)) / (2.0 * WIDTH**2))
    phase = CONTRAST * WIDTH * np.sqrt(2.0 * np.pi) * reach / INDEX
    slopes = -away * (phase / WIDTH**2)[:, None]
    return slopes * [1.0, 0.0] if flat else slopes


@pytest.mark.slow
@pytest.mark.parametrize("flat", [True, False])
@pytest.mark.parametrize("pose", [0.0, 2.1])
def test_the_deflection_is_the_integral_of_the_gradient(device: Device, pose: float, flat: bool) -> None:
    seen = weak(pose, device, flat=flat)
    want = expected(seen.start, pose, flat)
    gap = np.abs(seen.deflection - want).max() / np.abs(want).max()
    assert gap < (5e-3 if device.real == np.float64 else 1e-2)


def test_weak_shadows_are_the_divergence_of_the_deflection(device: Device) -> None:
    focus, step = 20.0, 1e-3
    seen = weak(0.7, device, focus, flat=True)
    x = (np.arange(48) - 23.5) * 0.1
    middle = np.stack([x, 0 * x], axis=1)
    slope = (expected(middle + [step, 0], 0.7, True) - expected(middle - [step, 0], 0.7, True))[:, 0] / (2.0 * step)
    want = 1.0 - focus * slope
    assert np.abs(want - 1.0).max() > 0.008
    np.testing.assert_allclose(seen.image[:, 0], want, atol=0.05 * np.abs(want - 1.0).max())


def test_no_light_is_lost(device: Device) -> None:
    for focus in (-30.0, 0.0, 50.0):
        seen = weak(0.3, device, focus)
        assert seen.image.sum() + seen.lost == pytest.approx(seen.light, rel=1e-12)
        assert seen.light == pytest.approx(28 * 22)
        assert seen.image.sum() == pytest.approx(24 * 18, rel=0.01)
    bright = weak(0.3, device, 300.0)
    assert bright.image.max() > 1.15


def test_focused_on_the_print_its_shadow_vanishes(device: Device) -> None:
    center = -(CENTER[0] * np.cos(0.3) + CENTER[1] * np.sin(0.3))
    images = (weak(0.3, device, focus, flat=True).image[:, 0] for focus in (center, center + 40.0))
    sharp, blurred = (np.abs(image - 1.0).max() for image in images)
    assert sharp < 0.05 * blurred


def test_nothing_cured_casts_no_shadow() -> None:
    field = GridField.from_array(np.full((20, 20), INDEX), 0.3)
    seen = shadowgram(field, Camera((30, 1), 0.3, 12.0), INDEX, device="numpy")
    np.testing.assert_allclose(seen.image, 1.0, rtol=1e-9)
    assert np.abs(seen.deflection).max() < 1e-12


def test_a_small_aperture_darkens_what_bends_most() -> None:
    x = (np.arange(49) - 24) * 0.125
    field = GridField.from_array(INDEX + 0.02 * np.exp(-(x[:, None] ** 2 + x**2) / 0.5), 0.125)
    full, stopped = (shadowgram(field, Camera((40, 1), 0.1, 0.0, a), INDEX, device="numpy") for a in (1.0, 0.005))
    assert stopped.lost > full.lost + 5
    edge = np.argmin(np.abs((np.arange(40) - 19.5) * 0.1 - 0.5))
    assert stopped.image[edge, 0] < 0.2 < full.image[edge, 0]


def test_bad_values_are_refused() -> None:
    with pytest.raises(BadInput, match="pitch"):
        Camera((10, 10), 0.0)
    with pytest.raises(BadInput, match="focus"):
        Camera((10, 10), 0.1, float("inf"))
    with pytest.raises(ShapeMismatch, match="equal"):
        cured_index(np.zeros((8, 8, 8)), Grid((8, 8, 9), 0.1), 1.5, 0.01)
    with pytest.raises(BadInput, match="one row"):
        shadowgram(GridField.from_array(np.full((9, 9), 1.5), 0.1), Camera((9, 9), 0.1), 1.5)
    with pytest.raises(BadInput, match="GridField"):
        shadowgram(np.ones((9, 9)), Camera((9, 9), 0.1), 1.5)  # type: ignore[arg-type]
