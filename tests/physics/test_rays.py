"""Every projector against rays traced one by one in float64, in both directions."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from raytracer import projected, ray_to

import vamgpu as vam
from vamgpu.backend.device import Device

N, SLICES, PITCH = 96, 6, 0.125
RADIUS = 0.5 * N * PITCH
BLOBS = (  # x, y, z [mm], σ across and along [mm], tilt, height: no symmetry to hide behind
    (1.6, 0.9, 0.1, 0.9, 0.55, 0.4, 1.0),
    (-1.1, 2.1, -0.1, 0.6, 0.8, 1.1, 0.7),
    (-0.6, -1.7, 0.2, 1.0, 0.65, 2.3, 0.9),
)
GLASS: dict[str, Any] = {"wall": 1.0, "resin_index": 1.49962, "wall_index": 1.473}


def phantom(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Three unequal blobs, wide compared with a voxel so that interpolation hardly shows."""
    total = np.zeros(np.broadcast(x, y, z).shape)
    for x0, y0, z0, across, along, tilt, height in BLOBS:
        c, s = np.cos(tilt), np.sin(tilt)
        a, b = ((x - x0) * c + (y - y0) * s) / across, ((y - y0) * c - (x - x0) * s) / along
        total += height * np.exp(-0.5 * (a**2 + b**2) - 0.5 * ((z - z0) / 0.8) ** 2)
    return total


def sinogram(angle: np.ndarray, u: np.ndarray, z: np.ndarray, width: float) -> np.ndarray:
    """Smooth light that differs from pose to pose, from side to side and from top to bottom."""
    return (1.5 + np.cos(angle - 0.7) + 0.4 * np.sin(2 * angle)) * (1.2 + np.sin(2.5 * u / width + 0.4)) * (1 + 0.2 * z)


def vial(absorption: float) -> vam.Vial:
    return vam.Vial(radius=12.4, bath_index=1.0, absorption=absorption, **GLASS)


WATER = vam.Vial(radius=9.0, wall=0.6, resin_index=1.48, wall_index=1.52, bath_index=1.333, absorption=0.2)
VAT = vam.Vat(width=16.0, absorption=0.15, resin_index=1.49, wall_index=1.52, bath_index=1.0)
ROUND = vam.Vat(width=16.0, radius=7.0, absorption=0.15)

# Vessel, columns and rows, their pitch [mm], relative L2 error allowed forward and back. Voxels of a grid that lies
# askew to fine columns ripple forward; coarse columns blur.
CASES = {
    "straight": (None, (N, SLICES), PITCH, 2e-3, 1.2e-2),
    "straight, wider and lower": (None, (N + 11, SLICES - 1), PITCH, 5e-3, 1e-2),
    "finer columns and rows": (None, (160, 10), 0.075, 8e-3, 1e-3),
    "coarser columns and rows": (None, (66, 4), 0.19, 2e-2, 2e-4),
    "refracted": (vial(0.0), (N + 60, SLICES), PITCH, 1e-2, 2e-4),
    "refracted, finer": (vial(0.0), (210, 9), 0.0875, 2.5e-2, 1.5e-3),
    "refracted and absorbed": (vial(0.12), (100, 4), 0.1875, 1.5e-2, 2e-4),
    "in a bath": (WATER, (N + 20, SLICES), PITCH, 1e-2, 2e-4),
    "square vat": (VAT, (N, SLICES), PITCH, 5e-3, 1e-4),
    "round vat": (ROUND, (N, SLICES), PITCH, 5e-3, 1e-4),
}
RARE = ("straight, wider and lower", "coarser columns and rows", "refracted, finer")
every_case = pytest.mark.parametrize(
    "case", [pytest.param(case, marks=[pytest.mark.slow] * (case in RARE)) for case in CASES]
)


def operator(case: str, device: Device | str, angles: int) -> vam.Projection:
    vessel, pixels, pitch, *_ = CASES[case]
    grid = vam.Grid((N, N, SLICES), PITCH)
    return vam.Projection(grid, vam.Beam(pixels, pitch, spread=0), vam.Turntable(angles, lit_share=0), vessel, device)


def some_voxels() -> tuple[np.ndarray, np.ndarray]:
    """Sixty voxels between 6 and 38 voxels from the axis."""
    rng = np.random.default_rng(3)
    radius, around = rng.uniform(6.0, 38.0, 60), rng.uniform(0.0, 2 * np.pi, 60)
    return tuple(np.rint(0.5 * N + radius * side(around)).astype(int) for side in (np.cos, np.sin))  # type: ignore[return-value]


@cache
def traced_integrals(case: str) -> np.ndarray:
    """The sinogram of the phantom, ray by ray; the same for every device."""
    return projected(operator(case, "numpy", 21), phantom, RADIUS, 0.5 * PITCH)


@cache
def traced_light(case: str) -> np.ndarray:
    """The back projection of the light at some voxels, ray by ray; the same for every device."""
    A = operator(case, "numpy", 180)
    (i, j), (x, y, z) = some_voxels(), A.grid.axes()
    angles = A.motion.poses
    vessel = CASES[case][0]
    if vessel is None:
        return _straight_light(A, x[i], y[j], _shown_at(A, z)[1:-1]) * A.grid.voxel_volume / A.beam.pixel_area
    limit = 0.999 * vessel.aperture
    offset, share = ray_to(vessel, angles[:, None], x[i], y[j], limit)
    per_ray = sinogram(angles[:, None, None], offset[..., None], _shown_at(A, z)[1:-1], 6.0) * share[..., None]
    return per_ray.sum(axis=0) * A.grid.voxel_volume / A.beam.pixel_area


def _straight_light(A: vam.Projection, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Mean over 20 × 20 places of each voxel of the light of the pixels there, over all angles; (voxels, z)."""
    within, total = ((np.arange(20) + 0.5) / 20 - 0.5) * A.grid.pitch, np.zeros((x.size, z.size))
    for angle in A.motion.poses:
        u = (y[:, None] + within)[:, None, :] * np.cos(angle) - (x[:, None] + within)[:, :, None] * np.sin(angle)
        columns = A.beam.pixels[0]
        shown = (np.floor(u / A.beam.pitch + 0.5 * columns) + 0.5 - 0.5 * columns) * A.beam.pitch
        total += sinogram(angle, shown[..., None], z, 6.0).mean(axis=(1, 2))
    return total


def _shown_at(A: vam.Projection, z: np.ndarray) -> np.ndarray:
    """Mean over each slice of the heights of the rows that light it: a pixel is a box, and the light is linear in z."""
    pitch, rows = A.beam.pitch, A.beam.pixels[1]
    inside = z[:, None] + ((np.arange(1200) + 0.5) / 1200 - 0.5) * A.grid.pitch
    return ((np.floor(inside / pitch + 0.5 * rows) + 0.5 - 0.5 * rows) * pitch).mean(axis=1)


def apart(got: np.ndarray, wanted: np.ndarray) -> float:
    return float(np.linalg.norm(got - wanted) / np.linalg.norm(wanted))


@every_case
def test_projection_is_the_integral_along_traced_rays(fast_device: Device, case: str) -> None:
    A = operator(case, fast_device, 21)
    x, y, z = np.meshgrid(*A.grid.axes(), indexing="ij")
    volume = np.where(np.hypot(x, y) <= RADIUS, phantom(x, y, z), 0.0)
    wanted = traced_integrals(case)
    inner = slice(1, -1)  # the outermost rows of another pitch look beyond the slices
    assert apart(A(volume)[..., inner], wanted[..., inner]) <= CASES[case][3]


@every_case
def test_back_projection_is_the_light_of_traced_rays(fast_device: Device, case: str) -> None:
    A = operator(case, fast_device, 180)
    (columns, rows), pitch = A.beam.pixels, A.beam.pitch
    u, h = ((np.arange(n) - 0.5 * (n - 1)) * pitch for n in (columns, rows))
    light = sinogram(A.motion.poses[:, None, None], u[:, None], h, 6.0)
    i, j = some_voxels()
    assert apart(A.T(light)[i, j, 1:-1], traced_light(case)) <= CASES[case][4]
