"""Exact footprints against brute force: shares against averages over boxes, entries against sampled areas."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.backend.opencl import OpenclDevice
from vamgpu.backend.opencl_platforms import context_of
from vamgpu.errors import BadInput
from vamgpu.kernels.footprint import share
from vamgpu.units import deg
from vamgpu.web import Propagation

RATIOS = (0.4, 1.0, 1.5)
"""Columns a voxel: pixels wider than voxels, as wide, and narrower."""


def blurred(distance: np.ndarray, width: float, sigma: float) -> np.ndarray:
    """Share of a pixel's light, a box convolved with a Gaussian, per unit of length at a distance from its middle."""
    low, high = distance - 0.5 * width, distance + 0.5 * width
    if sigma == 0.0:
        return ((low < 0.0) & (high > 0.0)) / width
    return (ndtr(high / sigma) - ndtr(low / sigma)) / width


def box_average(distance: float, ratio: float, angle: float, fill: float, sigma: float) -> float:
    """Mean of a pixel's light over a square voxel of ``ratio`` columns, turned by ``angle``, by the midpoint rule."""
    samples = 100 if sigma else 400
    at = ratio * ((np.arange(samples) + 0.5) / samples - 0.5)
    u = distance + at[:, None] * np.cos(angle) - at[None, :] * np.sin(angle)
    return float(blurred(u, fill, sigma).mean())


@pytest.mark.parametrize("angle", [8.0, 20.0, 45.0, 78.0])
@pytest.mark.parametrize(("fill", "sigma"), [(1.0, 0.0), (0.7, 0.0), (1.0, 0.5), (0.8, 0.3), (0.5, 1.2)])
@pytest.mark.parametrize("ratio", RATIOS)
def test_shares_are_averages_over_the_voxel(ratio: float, fill: float, sigma: float, angle: float) -> None:
    """The fitted tail and its end, and with a point spread the widening of thin sides, cost 2e-3 of the greatest share.

    Without a point spread no side is thin here: what widening one costs is a matter of edges alone.
    """
    distance = np.linspace(-2.9, 2.9, 38)
    a, b = ratio * abs(np.cos(angle * deg)), ratio * abs(np.sin(angle * deg))
    wanted = np.array([box_average(d, ratio, angle * deg, fill, sigma) for d in distance])
    assert np.abs(share(distance, a, b, fill, sigma) - wanted).max() <= 2e-3 * wanted.max()


@pytest.mark.parametrize("angle", [0.0, 0.5, 1.0, 2.0])
@pytest.mark.parametrize("sigma", [0.1, 0.25, 0.5, 1.0])
def test_thin_sides_may_be_widened_where_light_is_blurred(sigma: float, angle: float) -> None:
    distance = np.linspace(-2.2, 2.2, 45)
    a, b = np.cos(angle * deg), np.sin(angle * deg)
    wanted = np.array([box_average(d, 1.0, angle * deg, 1.0, sigma) for d in distance])
    assert np.abs(share(distance, a, b, 1.0, sigma) - wanted).max() <= 2e-3 * wanted.max()


@pytest.mark.parametrize("sigma", [0.0, 0.15, 0.5, 1.0, 2.0, 4.0])
def test_shares_of_all_pixels_make_one(sigma: float) -> None:
    """However wide the blur is: what is left out of its tails is left out of the dose everywhere."""
    for angle in np.linspace(0.0, 90.0, 31) * deg:
        distance = 0.31 + np.arange(-19.0, 20.0)
        assert share(distance, np.cos(angle), np.sin(angle), 1.0, sigma).sum() == pytest.approx(1.0, abs=5e-4)


def sampled(A: vam.Projection, samples: int = 60) -> np.ndarray:
    """Every entry from the definition: means over a voxel's box, across the axis on points, along it in closed form."""
    grid, beam = A.grid, A.beam
    side, sigma = np.sqrt(beam.fill) * beam.pitch, beam.sigma * beam.pitch
    x, y, z = grid.axes()
    at = grid.pitch * ((np.arange(samples) + 0.5) / samples - 0.5)
    fine_x, fine_y = (x[:, None] + at).ravel(), (y[:, None] + at).ravel()
    across = []
    for theta in A.motion.poses:
        r = fine_y[None, :] * np.cos(theta) - fine_x[:, None] * np.sin(theta)
        light = [blurred(r - u, side, sigma) for u in beam.columns()]
        boxes = (len(light), len(x), samples, len(y), samples)
        across.append(np.reshape(light, boxes).mean(axis=(2, 4)))
    rows = (np.arange(beam.pixels[1]) - 0.5 * (beam.pixels[1] - 1)) * beam.pitch
    fine_z = grid.pitch * ((np.arange(4000) + 0.5) / 4000 - 0.5)
    up = np.array([[blurred(k + fine_z - w, side, sigma).mean() for k in z] for w in rows])
    entries = np.einsum("aucd,we->auwcde", np.array(across), up) * grid.voxel_volume
    return entries.reshape(int(np.prod(A.range.shape)), int(np.prod(A.domain.shape)))


@pytest.mark.parametrize(("fill", "spread"), [(1.0, None), (1.0, 0.0), (0.7, 0.03)])
@pytest.mark.parametrize("ratio", RATIOS)
def test_entries_are_areas_of_light_in_voxels(device: Device, ratio: float, fill: float, spread: float | None) -> None:
    """The mean over a voxel of the light that 1 mW/mm² on a pixel of the whole pitch sends, times its volume [mm]."""
    grid = vam.Grid((5, 4, 3), 0.1)
    beam = vam.Beam((7, 5), grid.pitch / ratio, fill=fill, spread=spread)
    A = vam.Projection(grid, beam, vam.Turntable(3, lit_share=0), device=device)
    wanted = sampled(A)
    assert np.abs(A.dense() - wanted).max() <= 1e-2 * wanted.max()


@pytest.mark.parametrize("spread", [None, 0.0])
@pytest.mark.parametrize("angles", [1, 5, 45, 90])
def test_even_light_is_an_even_dose(device: Device, angles: int, spread: float | None) -> None:
    A = vam.Projection(
        vam.Grid((15, 14, 4), 0.1), vam.Beam((36, 16), 0.08, spread=spread), vam.Turntable(angles), device=device
    )
    dose = np.asarray(A.T(np.ones(A.range.shape)), np.float64) / angles
    assert np.ptp(dose) <= 1e-3 * dose.mean()


def test_every_opencl_compiler_agrees_in_the_layout_of_gpus(opencl_name: str) -> None:
    """Compilers for processors keep values across barriers in their own ways; other tests try one compiler only."""
    device = OpenclDevice(opencl_name, context_of(opencl_name))
    device.is_gpu = True
    geometry = (vam.Grid((5, 4, 2), 0.15), vam.Beam((6, 2), 0.15), vam.Turntable(8))
    expected = vam.Projection(*geometry, device="numpy").dense()
    A = vam.Projection(*geometry, device=device)
    for computed in (A.dense(), A.T.dense().T):
        assert np.abs(computed - expected).max() <= 1e-5 * expected.max()


AIR = vam.Grid((6, 6, 2), 0.1)


@pytest.mark.parametrize("told", [{"fill": 0.9}, {"spread": 0.05}])
def test_rays_refuse_pixels_with_a_shape(told: dict[str, float]) -> None:
    beam, web, once = vam.Beam((8, 3), 0.1, **told), vam.WebGrid((8, 4, 3), (0.1, 0.1, 0.1)), np.arange(4)
    light = Propagation.gathered((8, 4, 4), once, once, once, np.ones(4))
    builds: dict[str, Any] = {
        "Oblique": lambda: vam.Oblique(AIR, beam, vam.Turntable(3), device="numpy"),
        "TracedProjection": lambda: vam.TracedProjection(AIR, beam, vam.Turntable(3), device="numpy"),
        "WebProjection": lambda: vam.WebProjection.from_light(web, light, beam=beam, device="numpy"),
    }
    for name, build in builds.items():
        with pytest.raises(BadInput, match=rf"Beam\(.*{name} traces one ray per pixel and knows no point spread"):
            build()
