"""Calibrated dose at points, and energy over the voxels, against rays traced one by one."""

from __future__ import annotations

import numpy as np
import pytest
from raytracer import ray_to, trace

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.operators.dose_unit import dose_unit

PAPER = vam.Vial(radius=12.4, wall=1.0, resin_index=1.49962, wall_index=1.473, bath_index=1.0, absorption=0.05)
WATER = vam.Vial(radius=8.0, wall=0.7, resin_index=1.48, wall_index=1.52, bath_index=1.333, absorption=0.2)
VAT = vam.Vat(width=18.0, absorption=0.1, resin_index=1.49, wall_index=1.52, bath_index=1.0)
CASES = {"paper": (PAPER, 0.2), "water": (WATER, 0.16), "vat": (VAT, 0.18), "fine columns": (PAPER, 0.11)}
N, SLICES, POSES, DWELL = 96, 4, 90, 0.25
every_case = pytest.mark.parametrize("case", CASES)


def operator(case: str, device: Device) -> vam.Projection:
    vessel, column = CASES[case]
    pitch = 2.0 * vessel.printable_radius / N
    width = 25.0 if vessel is not WATER else 16.1
    pixels = (int(width / column), int(SLICES * pitch / column) + 2)
    grid, motion = vam.Grid((N, N, SLICES), pitch), vam.Turntable(POSES, lit_share=0)
    return vam.Projection(grid, vam.Beam(pixels, column, spread=0), motion, vessel, device)


def irradiance(angle: np.ndarray, u: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Smooth light in air [mW/mm²]."""
    return 2.0 * (1.3 + np.cos(angle + 0.3)) * (1.4 + np.sin(0.5 * u + 0.2)) * (1.0 + 0.1 * z)


def light_of(A: vam.Projection) -> np.ndarray:
    u, z = ((np.arange(n) - 0.5 * (n - 1)) * A.beam.pitch for n in A.beam.pixels)
    return irradiance(A.motion.poses[:, None, None], u[:, None], z)


@every_case
def test_absorbed_dose_in_millijoule_per_cubic_millimeter(fast_device: Device, case: str) -> None:
    A = operator(case, fast_device)
    rng = np.random.default_rng(8)
    radius, around = 0.9 * CASES[case][0].printable_radius * np.sqrt(rng.random(20)), 2 * np.pi * rng.random(20)
    x, y, z = A.grid.axes()
    i, j = (np.rint((radius * f(around)) / A.grid.pitch + 0.5 * (N - 1)).astype(int) for f in (np.cos, np.sin))
    k = rng.integers(0, SLICES, 20)
    angles = A.motion.poses[:, None]
    u, share = ray_to(CASES[case][0], angles, x[i], y[j], 0.999 * CASES[case][0].aperture)
    wanted = DWELL * np.sum(irradiance(angles, u, z[k]) * share, axis=0)
    dose = dose_unit(A, DWELL) * np.asarray(A.T(light_of(A)), float)[i, j, k]
    assert dose == pytest.approx(wanted, rel=0.01)


@every_case
def test_energy_absorbed_inside_the_printable_radius(fast_device: Device, case: str) -> None:
    """Each ray leaves in the disc what it still carries on its way in, less what it carries on its way out."""
    A = operator(case, fast_device)
    vessel = CASES[case][0]
    radius = 0.9 * vessel.printable_radius
    x, y, _ = A.grid.axes()
    cover = np.clip(0.5 + (radius - np.hypot(x[:, None], y[None, :])) / A.grid.pitch, 0.0, 1.0)
    dose = dose_unit(A, DWELL) * np.asarray(A.T(light_of(A)), float)
    got = np.sum(dose * cover[..., None]) * A.grid.voxel_volume

    fine = 4
    u = (np.arange(fine * A.beam.pixels[0]) - 0.5 * (fine * A.beam.pixels[0] - 1)) * A.beam.pitch / fine
    angles = A.motion.poses[:, None]
    rays = trace(vessel, angles, u[None, :])
    middle = -np.sum(rays.start * rays.heading, axis=-1)
    apart = np.linalg.norm(rays.at(middle), axis=-1)
    half = np.sqrt(np.maximum(radius**2 - apart**2, 0.0))
    left = np.exp(-vessel.absorption * (middle - half)) - np.exp(-vessel.absorption * (middle + half))
    height = A.grid.shape[2] * A.grid.pitch
    power = irradiance(angles, u[None, :], np.zeros(())) * (A.beam.pitch / fine) * height
    assert got == pytest.approx(DWELL * np.sum(power * rays.power * left), rel=2e-3)
