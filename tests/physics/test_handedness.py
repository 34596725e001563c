"""Which way r counts, light travels and dose falls off: r = y cos t − x sin t, light towards −(cos t, sin t)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.backend.device import Device

N, PITCH = 80, 0.1
X0, Y0, A0, B0, TILT = 1.5, 0.7, 0.9, 0.4, 0.5
ALPHA = 0.3
MATCHED: dict[str, Any] = {"resin_index": 1.5, "wall_index": 1.5, "bath_index": 1.5}
VESSELS = {
    "vial": vam.Vial(radius=4.5, wall=0.3, absorption=ALPHA, **MATCHED),
    "vat": vam.Vat(width=8.4, absorption=ALPHA),
}
every_vessel = pytest.mark.parametrize("vessel", VESSELS)


def ellipse() -> np.ndarray:
    """An unequal-axed, tilted, off-centre ellipse with a soft edge, [x, y, 1]."""
    x, y, _ = vam.Grid((N, N, 1), PITCH).axes()
    dx, dy = x[:, None] - X0, y[None, :] - Y0
    a, b = dx * np.cos(TILT) + dy * np.sin(TILT), dy * np.cos(TILT) - dx * np.sin(TILT)
    return np.clip(0.5 + (1.0 - np.hypot(a / A0, b / B0)) * B0 / PITCH, 0.0, 1.0)[..., None]


def sinogram(device: Device, vessel: vam.Vial | vam.Vat | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Poses, columns and the ellipse's sinogram [angle, r]."""
    A = vam.Projection(
        vam.Grid((N, N, 1), PITCH), vam.Beam((N, 1), PITCH, spread=0), vam.Turntable(12, lit_share=0), vessel, device
    )
    return A.motion.poses, A.beam.columns(), A(ellipse())[..., 0]


@pytest.mark.parametrize("vessel", [None, *VESSELS])
def test_a_point_falls_on_its_column(device: Device, vessel: str | None) -> None:
    angles, r, image = sinogram(device, VESSELS[vessel] if vessel else None)
    middle = (image @ r) / image.sum(axis=1)
    slack = 0.02 if vessel is None else 0.08  # absorption favors the lit side of the ellipse
    assert np.abs(middle - (Y0 * np.cos(angles) - X0 * np.sin(angles))).max() <= slack


def test_the_long_axis_shows_its_length_across(device: Device) -> None:
    angles, r, image = sinogram(device, None)
    share = image / image.sum(axis=1, keepdims=True)
    spread = np.sqrt(share @ r**2 - (share @ r) ** 2)
    across = angles + 0.5 * np.pi - TILT
    assert np.abs(2 * spread - np.hypot(A0 * np.cos(across), B0 * np.sin(across))).max() <= 0.02


@every_vessel
def test_light_comes_from_plus_cos_sin_and_fades(device: Device, vessel: str) -> None:
    angles, _, image = sinogram(device, VESSELS[vessel])
    volume, (x, y, _) = ellipse()[..., 0], vam.Grid((N, N, 1), PITCH).axes()
    x, y = x[:, None], y[None, :]
    wanted = []
    for c, s in zip(np.cos(angles), np.sin(angles), strict=True):
        across, along = y * c - x * s, -(x * c + y * s)
        half = np.sqrt(np.maximum(4.2**2 - across**2, 0.0)) if vessel == "vial" else 4.2
        wanted.append(np.sum(volume * ALPHA * np.exp(-ALPHA * (half + along))) * PITCH)
    assert image.sum(axis=1) == pytest.approx(np.array(wanted), rel=3e-3)
    assert image[0].sum() > 2.0 * image[6].sum()  # the ellipse lies towards +x, where light comes from at pose 0


def around(dose: np.ndarray, place: np.ndarray) -> float:
    """The dose of the four voxels whose common corner is ``place``."""
    i, j = place
    return float(dose[i - 1 : i + 1, j - 1 : j + 1].sum())


@every_vessel
def test_dose_falls_along_the_light(device: Device, vessel: str) -> None:
    grid, beam = vam.Grid((N, N, 1), PITCH), vam.Beam((N, 1), PITCH, spread=0)
    A = vam.Projection(grid, beam, vam.Turntable(4, lit_share=0), VESSELS[vessel], device)
    source, side = np.array([(1, 0), (0, 1), (-1, 0), (0, -1)]), np.array([(0, 1), (-1, 0), (0, -1), (1, 0)])
    for pose in range(4):
        light = np.zeros(A.range.shape)
        light[pose, N // 2 + 9 : N // 2 + 12] = 1.0
        dose = A.T(light)[..., 0]
        near, far, beside = (
            around(dose, N // 2 + depth * source[pose] + across * side[pose])
            for depth, across in ((20, 10), (-20, 10), (20, -10))
        )
        assert near / far == pytest.approx(np.exp(ALPHA * 40 * PITCH), rel=1e-3)
        assert beside == 0.0
