"""Projection on rings, against the sum over poses that it replaces and against voxels in a box."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from transposes import transpose_gap

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.backend.slabs import SlabDevice
from vamgpu.errors import BadInput
from vamgpu.kernels.spectrum import FACTOR, ROWS, factors
from vamgpu.operators.polar import PolarGrid, tiles_of_vessel
from vamgpu.operators.ray_table import OpenAir
from vamgpu.operators.spectral import SpectralProjection
from vamgpu.operators.transforms import straight_passes

VIAL = vam.Vial(radius=1.0, wall=0.08, resin_index=1.49962, wall_index=1.473, bath_index=1.0, absorption=0.5)
ASIDE = vam.Misaligned(VIAL, offset=0.07)
GEOMETRIES: dict[str, Any] = {
    "straight": (PolarGrid(8, 4, 0.1, 9), vam.Beam((15, 4), 0.1), None),
    "one row": (PolarGrid(8, 2, 0.1, 6), vam.Beam((16, 1), 0.1), None),
    "several bands": (PolarGrid(24, 2, 0.05, 12), vam.Beam((40, 4), 0.06), None),
    "angles that take three passes": (PolarGrid(8, 2, 0.1, 420), vam.Beam((16, 2), 0.1), None),
    "a prime number of angles": (PolarGrid(8, 2, 0.1, 53), vam.Beam((16, 2), 0.1), None),
    "angles with a factor that is great": (PolarGrid(16, 2, 0.05, 22), vam.Beam((32, 2), 0.05), None),
    "many samples between two angles": (PolarGrid(24, 2, 0.04, 6), vam.Beam((48, 2), 0.04), None),
    "refracted and absorbed": (PolarGrid(8, 2, 0.11, 12), vam.Beam((13, 3), 0.15), VIAL),
    "light that nothing mirrors": (PolarGrid(8, 2, 0.11, 12), vam.Beam((14, 3), 0.15), ASIDE),
    "whole slabs of slices": (PolarGrid(40, 70, 0.05, 7), vam.Beam((80, 70), 0.05), None),
    "whole slabs, light that nothing mirrors": (PolarGrid(16, 132, 0.055, 8), vam.Beam((30, 132), 0.075), ASIDE),
}
every_geometry = pytest.mark.parametrize("geometry", GEOMETRIES)


def operator(geometry: str, device: Device | str) -> SpectralProjection:
    grid, beam, vessel = GEOMETRIES[geometry]
    return SpectralProjection(grid, beam, vessel, device, motion=vam.Turntable(grid.angles, lit_share=0))


def summed(A: SpectralProjection, slices: np.ndarray) -> np.ndarray:
    """The dose pose by pose, of light with one row a slice."""
    grid, dose = A.grid, np.zeros(A.grid.shape)
    given = iter(tiles_of_vessel(grid, A.beam, A.vessel or OpenAir()))
    for band in grid.bands:
        own = dose[:, band.cell : band.cell + band.rings * band.samples]
        own = own.reshape(grid.angles, band.samples, band.rings // ROWS, ROWS, -1)
        for number in range(band.rings // ROWS):
            pose = vam.open_device("numpy").empty((grid.angles, band.samples * ROWS, A.beam.pixels[0]))
            next(given).pose(A.beam, pose.shape[:2], pose.device)(0, 1.0, pose)
            turned = [np.roll(pose.numpy(), angle, axis=0) for angle in range(grid.angles)]
            cells = np.einsum("atqc,acz->tqz", turned, slices)
            own[:, :, number] = cells.reshape(grid.angles, band.samples, ROWS, -1)
    return dose


@cache
def of_poses(geometry: str) -> tuple[np.ndarray, np.ndarray]:
    """Light, and its dose pose by pose."""
    reference = operator(geometry, "numpy")
    light = np.random.default_rng(0).random(reference.range.shape)
    slices = reference.device.empty((*reference.range.shape[:2], reference.grid.slices))
    reference._rows.to_slices(reference.device.upload(light), slices)
    return light, summed(reference, slices.numpy())


@every_geometry
def test_it_is_the_sum_over_poses(device: Device, geometry: str) -> None:
    light, wanted = of_poses(geometry)
    assert np.abs(operator(geometry, device).T(light) - wanted).max() <= 3e-6 * wanted.max()


@every_geometry
def test_the_transpose_is_exact(device: Device, geometry: str) -> None:
    A = operator(geometry, device)
    assert A.dot_test() <= 1e-7
    if np.prod(A.domain.shape) < 4000:
        assert transpose_gap(A) <= 3e-6


@pytest.mark.parametrize("geometry", ["refracted and absorbed", "whole slabs of slices"])
def test_products_of_eleven_bits_are_near(device: Device, geometry: str) -> None:
    """As they are on devices without units for them, which leave numbers whole."""
    grid, beam, vessel = GEOMETRIES[geometry]
    whole, part = (SpectralProjection(grid, beam, vessel, device, tf32=tf32) for tf32 in (False, True))
    light, volume = (np.random.default_rng(0).random(space.shape) for space in (whole.range, whole.domain))
    for wanted, found in ((whole.T(light), part.T(light)), (whole(volume), part(volume))):
        assert np.abs(np.asarray(found) - np.asarray(wanted)).max() <= 1e-3 * np.asarray(wanted).max()


@pytest.mark.parametrize(("n", "slices"), [
    *((n, 20) for n in (*range(2, 11), 11, 14, 49, 53, 60, 96, 105, 360, 420, 720, 1000, 1440)),
    *((n, slices) for slices in (2, 28, 36) for n in (7, 53, 420)),
])  # fmt: skip
def test_transforms_of_every_length(device: Device, n: int, slices: int) -> None:
    given = np.random.default_rng(n).random((n, 3, slices))
    numbers = given[..., ::2] + 1j * given[..., 1::2]
    passes, fields = straight_passes(device, n, 2, 3), [device.empty((n, 2, slices)) for _ in range(2)]
    for sign in (-1.0, 1.0):
        found = passes.run(sign, device.upload(given), fields.__getitem__).numpy()
        wanted = np.fft.fft(numbers, axis=0) if sign < 0 else n * np.fft.ifft(numbers, axis=0)
        off = found[..., ::2] + 1j * found[..., 1::2] - wanted[:, :2]
        assert np.abs(off).max() <= 1e-6 * np.abs(wanted).max()


@pytest.mark.parametrize("n", [*range(1, 130), 360, 768, 1080, 1440, 2048, 2187, 3600])
def test_factors_make_the_radix(n: int) -> None:
    found = factors(n)
    if any(found):
        assert np.prod(found) == n and max(found) <= FACTOR and found[0] == max(found)
    else:
        assert n > 2048 or any(n % prime == 0 for prime in range(11, n + 1) if all(prime % d for d in range(2, prime)))


def test_few_factors_are_taken_whose_sum_is_least() -> None:
    assert [factors(n) for n in (10, 12, 360, 1440)] == [(10, 1, 1, 1), (4, 1, 1, 3), (9, 8, 1, 5), (8, 6, 6, 5)]


def test_devices_that_share_slices_give_the_same(device: Device) -> None:
    """Whatever the name of what they are together: it tells no transform how samples lie."""
    if device.name == "numpy":
        pytest.skip("takes no slabs")
    grid, beam, _ = GEOMETRIES["whole slabs of slices"]
    alone, shared = (
        SpectralProjection(grid, beam, None, device),
        SpectralProjection(grid, beam, None, SlabDevice("three", [device] * 3)),
    )
    light, volume = (np.random.default_rng(0).random(space.shape) for space in (alone.range, alone.domain))
    for found, wanted in ((shared.T(light), alone.T(light)), (shared(volume), alone(volume))):
        assert np.abs(np.asarray(found) - np.asarray(wanted)).max() <= 1e-6 * np.asarray(wanted).max()


def test_outermost_columns_are_left_out_where_they_are_faint(device: Device) -> None:
    grid, beam = PolarGrid(24, 2, 0.05, 48), vam.Beam((40, 2), 0.06)
    whole, part = (SpectralProjection(grid, beam, None, device, faint=faint) for faint in (0.0, 5e-3))
    lit = [each._entries["lit"].numpy().sum() for each in (whole, part)]
    assert lit[1] < 0.9 * lit[0]
    light, volume = (np.random.default_rng(0).random(space.shape) for space in (whole.range, whole.domain))
    for a, b in ((part.T(light), whole.T(light)), (part(volume), whole(volume))):
        assert 1e-5 < np.abs(np.asarray(a) - np.asarray(b)).max() / np.asarray(b).max() < 0.02
    assert part.dot_test() <= 1e-7


def test_light_that_nothing_mirrors_is_told_apart() -> None:
    assert operator("refracted and absorbed", "numpy")._entries["mirrored"] == 1
    assert operator("light that nothing mirrors", "numpy")._entries["mirrored"] == 0


@pytest.mark.parametrize("vessel", [None, VIAL], ids=["straight", "in a vial"])
def test_the_dose_is_that_of_voxels_in_a_box(vessel: Any) -> None:
    """The dose at voxels of a box four times finer, averaged over each cell, by the operator for boxes."""
    grid, fine = PolarGrid(8, 2, 0.1, 24), vam.Grid((80, 80, 2), 0.025)
    beam = vam.Beam((26, 12), 0.09)
    turns, columns = np.arange(24)[:, None] * np.pi / 12.0, np.linspace(-1.0, 1.0, 26)
    light = (1.0 + np.sin(3.0 * turns + 2.0 * columns) * np.cos(4.0 * columns))[:, :, None].repeat(12, axis=2)
    dose = (
        np.asarray(vam.Projection(fine, beam, vam.Turntable(24, lit_share=0), vessel, device="numpy").T(light))[:, :, 0]
        * 64.0
    )
    rings = SpectralProjection(grid, beam, vessel, "numpy", motion=vam.Turntable(24, lit_share=0))
    got = np.asarray(rings.T(light))[:, :, 0]
    x, y = (np.arange(80) - 39.5)[:, None] * 0.025, (np.arange(80) - 39.5) * 0.025
    radius, turn = np.hypot(x, y), np.mod(np.arctan2(y, x), 2.0 * np.pi)
    rho, phi = grid.places
    apart = []
    for angle, cell in np.argwhere((rho > 0.2) & (rho < 0.6) & (phi < np.pi)):  # farther out there is no light
        samples = next(band.samples for band in reversed(grid.bands) if cell >= band.cell)
        away = np.abs(np.mod(turn - phi[angle, cell] + np.pi, 2.0 * np.pi) - np.pi)
        near = (np.abs(radius - rho[cell]) <= 0.05) & (away <= np.pi / (24 * samples))
        apart.append(got[angle, cell] / dose[near].mean() - 1.0)
    assert len(apart) > 100 and np.abs(apart).max() <= 0.03 and abs(np.mean(apart)) <= 0.003


def test_cells_fill_the_disc() -> None:
    grid = PolarGrid(40, 2, 0.1, 36)
    assert grid.areas.sum() * grid.angles == pytest.approx(np.pi * 40**2, rel=1e-12)
    assert max(band.stop * 2.0 * np.pi / (36 * band.samples) for band in grid.bands) <= 1.0 + 1e-9
    assert grid.shape == (36, sum(band.rings * band.samples for band in grid.bands), 2)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ((7, 2, 0.1, 9), "multiple of 8"),
        ((8, 3, 0.1, 9), "even"),
        ((8, 2, 0.0, 9), "pitch"),
        ((8, 2, 0.1, 0), "angles"),
    ],
)
def test_bad_rings_are_refused(given: Any, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        PolarGrid(*given)


def test_bad_arguments_are_refused() -> None:
    grid, beam = PolarGrid(8, 2, 0.1, 9), vam.Beam((9, 2), 0.1)
    with pytest.raises(BadInput, match="PolarGrid"):
        SpectralProjection(vam.Grid((8, 8, 2), 0.1), beam)  # pyright: ignore[reportArgumentType]
    with pytest.raises(BadInput, match="Vial"):
        SpectralProjection(grid, beam, "vial")  # pyright: ignore[reportArgumentType]
    for given, said in (
        ({"square": -1.0}, "square"),
        ({"faint": 1.0}, "faint=1.0; expected"),
        ({"splines": True}, "with a square"),
        ({"splines": "yes", "square": 0.1}, "splines='yes'"),
    ):
        with pytest.raises(BadInput, match=said):
            SpectralProjection(grid, beam, **given)  # pyright: ignore[reportArgumentType]
    with pytest.raises(BadInput, match="tf32='yes'; expected True"):
        SpectralProjection(grid, beam, tf32="yes")  # pyright: ignore[reportArgumentType]
