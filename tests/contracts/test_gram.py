"""The inverse of how projecting and exposing blur light, against that of the whole matrix."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.kernels.pointwise import disc
from vamgpu.methods.part import reach_of
from vamgpu.methods.tolerances import Tolerances
from vamgpu.operators import gram
from vamgpu.operators.gram import GramInverse
from vamgpu.operators.ring_projection import RingProjection
from vamgpu.optics.beams import Misaligned
from vamgpu.units import mm

N, COLUMNS, ANGLES = 12, 16, 20


def projection(device: Device | str, rows: int = 2, vessel: Any = None) -> vam.Projection:
    beam = vam.Beam((COLUMNS, rows), 0.1, spread=0.08)
    return vam.Projection(vam.Grid((N, N, rows), 0.1), beam, vam.Turntable(ANGLES), vessel, device)


def blurred(A: Any, light: np.ndarray) -> np.ndarray:
    """A Aᵀ of light, voxels beyond the judged cylinder counted less; of scenarios their sum."""
    total = np.zeros(light.shape)
    for each in getattr(A, "operators", (A,)):
        counted = np.where(disc(N, N, reach_of(each.grid)), 1.0, gram.RIM)[:, :, None]
        total += np.asarray(each(np.asarray(each.T(light)) * counted))
    return total


def filtered(matrices: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Light with the matrix of each angular frequency applied."""
    spectrum = np.fft.fft(light, axis=0)
    every = [matrices[k] if 2 * k <= ANGLES else matrices[ANGLES - k].conj() for k in range(ANGLES)]
    return np.real(np.fft.ifft(np.einsum("kij,kjz->kiz", np.array(every), spectrum), axis=0))


VESSELS = pytest.mark.parametrize("vessel", [None, Misaligned(offset=0.13 * mm)], ids=["centered", "off the axis"])


@cache
def exact_blur(rows: int, offset: float) -> np.ndarray:
    """The blur of every frequency by the float64 reference, which is the same for all devices."""
    A = projection("numpy", rows, Misaligned(offset=offset) if offset else None)
    return gram._blur(A, reach_of(A.grid), gram.RIM).astype(complex)


@VESSELS
@pytest.mark.parametrize("rows", [1, 2, 3])
def test_it_is_the_inverse_of_each_frequency(device: Device, vessel: Any, rows: int) -> None:
    A, light = projection(device, rows, vessel), np.random.default_rng(0).standard_normal((ANGLES, COLUMNS, rows))
    reach = reach_of(A.grid)
    inverse, found = GramInverse(A, reach), device.empty(A.range.shape)
    blur = gram._shared(A) * exact_blur(rows, getattr(vessel, "offset", 0.0))
    wanted = filtered(np.linalg.inv(blur + inverse.base * np.eye(COLUMNS)), light)
    for _ in range(2):  # what an odd number of rows is filled up with stays dark
        inverse(device.upload(light.astype(np.float32)), found)
        lit = np.abs(blur[0].diagonal()) > gram.DARK * np.abs(blur[0]).max()
        assert np.abs(found.numpy() - wanted)[:, lit].max() < 1e-4 * np.abs(wanted).max()


@pytest.mark.parametrize("columns", [1, 6, 7])
def test_mirrored_columns_are_inverted_in_pairs(columns: int) -> None:
    rng = np.random.default_rng(0)
    half = rng.standard_normal((5, columns, columns, 2)) @ [1.0, 1j]
    blur = half @ half.conj().swapaxes(1, 2)
    blur = (blur + blur[:, ::-1, ::-1].conj()).astype(np.complex64)
    wanted = np.linalg.inv(blur.astype(complex) + 0.5 * np.eye(columns))
    np.testing.assert_allclose(gram._mirrored_inverse(blur, 0.5), wanted, atol=1e-5 * np.abs(wanted).max())


def test_rings_are_tried_with_their_own_tables(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two slices light as those of all, and no projector by rays is made."""
    grid, beam = vam.Grid((N, N, 6), 0.1), vam.Beam((COLUMNS, 6), 0.1, spread=0.08)
    A = RingProjection(grid, beam, vam.Turntable(ANGLES), None, "numpy")
    light = np.broadcast_to(np.random.default_rng(0).random((ANGLES, COLUMNS, 1)), A.range.shape)
    thin = A._thinned(2)
    shares = A.row_weights.sum(axis=1)[3], thin.row_weights.sum(axis=1)[1]
    np.testing.assert_allclose(thin.T(light[:, :, :2])[:, :, 1] / shares[1], A.T(light)[:, :, 3] / shares[0], rtol=1e-9)
    monkeypatch.setattr(gram, "Projection", lambda *_: pytest.fail("made a projector by rays"))
    assert 0.8 < GramInverse(A, reach_of(grid)).pace <= 1.0


@pytest.mark.parametrize("angles", [ANGLES, 23, 250], ids=["one pass", "one long pass", "several passes"])
def test_it_may_take_the_place_of_its_light(device: Device, angles: int) -> None:
    grid, beam = vam.Grid((N, N, 2), 0.1), vam.Beam((COLUMNS, 2), 0.1, spread=0.08)
    A = vam.Projection(grid, beam, vam.Turntable(angles), None, device)
    inverse, found = GramInverse(A, reach_of(grid)), device.empty(A.range.shape)
    given = np.random.default_rng(0).standard_normal(A.range.shape).astype(np.float32)
    light = device.upload(given)
    inverse(light, found)
    np.testing.assert_array_equal(light.numpy(), given)
    inverse(light, light)
    np.testing.assert_array_equal(light.numpy(), found.numpy())


@VESSELS
def test_rings_blur_light_as_voxels_do(vessel: Any) -> None:
    """Of voxels that are judged; by a tenth more at most, as those on the rim count whole rings."""
    n, columns = 40, 48
    beam, grid = vam.Beam((columns, 1), 0.1), vam.Grid((n, n, 1), 0.1)
    A = vam.Projection(grid, beam, vam.Turntable(ANGLES), vessel, "numpy")
    column = np.exp(-0.5 * ((np.arange(columns) - 23.1) / 6.0) ** 2)
    turn = 1.0 + 0.5 * np.cos(2.0 * np.pi * np.arange(ANGLES) / ANGLES - 0.7)
    light = turn[:, None, None] * column[None, :, None]
    near = disc(n, n, reach_of(grid))[:, :, None]
    wanted = np.asarray(A(np.asarray(A.T(light)) * near))
    found = filtered(gram._shared(A) * gram._blur(A, reach_of(grid), 0.0).astype(complex), light)
    assert -0.02 * wanted.max() < (found - wanted).min() and (found - wanted).max() < 0.1 * wanted.max()


@pytest.mark.parametrize("rows", [pytest.param(1, marks=pytest.mark.slow), 2, pytest.param(3, marks=pytest.mark.slow)])
@pytest.mark.parametrize("fine", [1, 2], ids=["pixels as voxels", "sharp pixels of half a voxel"])
def test_a_step_makes_no_light_brighter_than_it_was(rows: int, fine: int) -> None:
    """By power steps, which took 150 to find what 40 did not see of pixels narrower than voxels."""
    A = projection("numpy", rows)
    if fine > 1:
        beam = vam.Beam((fine * COLUMNS, rows), 0.1 / fine, spread=0.0)
        A = vam.Projection(A.grid, beam, A.motion, None, A.device)
    inverse, device = GramInverse(A, reach_of(A.grid)), A.device
    light, found = np.random.default_rng(1).standard_normal(A.range.shape), device.empty(A.range.shape)
    grown = 0.0
    for _ in range(150):
        light /= np.linalg.norm(light)
        inverse(device.upload(blurred(A, light) + inverse.base * light), found)
        light = found.numpy()
        grown = float(np.linalg.norm(light))
    assert 0.8 < grown * inverse.pace < 1.001


def greatest(A: vam.Projection) -> float:
    """The greatest that A Aᵀ makes of light, about."""
    even = np.ones(A.range.shape)
    return float(np.linalg.norm(blurred(A, even)) / np.linalg.norm(even))


def test_sharp_pixels_take_a_greater_base() -> None:
    A = projection("numpy")
    sharp = vam.Projection(A.grid, vam.Beam((2 * COLUMNS, 2), 0.05, spread=0.0), A.motion, None, A.device)
    shares = [GramInverse(each, reach_of(A.grid)).base / greatest(each) for each in (A, sharp)]
    assert shares[1] > 1.5 * shares[0]


def test_scenarios_add_up() -> None:
    A = projection("numpy")
    scenarios = Tolerances(axis=0.02).scenarios(A)
    one, all_ = (GramInverse(each, reach_of(A.grid)) for each in (A, scenarios))
    assert all_.base == pytest.approx(3.0 * one.base, rel=0.05)  # nominal, and an axis to either side


def test_what_does_not_turn_is_named() -> None:
    uneven = vam.Projection(
        vam.Grid((N, N, 2), 0.1), vam.Beam((COLUMNS, 2), 0.1), vam.Turntable(np.array([0.0, 1.0, 2.5])), None, "numpy"
    )
    assert "even over a full turn" in GramInverse.unsupported_reason(uneven)
    assert GramInverse.unsupported_reason(projection("numpy")) == ""
