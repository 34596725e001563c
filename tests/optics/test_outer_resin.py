"""The dose of resin outside the judged cylinder, against rays traced one by one, voxels, and the exposure of proofs."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.geometry import FULL_TURN
from vamgpu.optics.outer_resin import AllResin, OuterResin, OuterRings, outer_resin
from vamgpu.printing.independent_exposure import IndependentExposure

sys.path.insert(0, str(Path(__file__).parents[1] / "physics"))
from raytracer import trace  # noqa: E402  # pyright: ignore[reportMissingImports]

VIAL = vam.Vial(radius=1.0, wall=0.08, resin_index=1.49962, wall_index=1.473, bath_index=1.0, absorption=0.5)
ASIDE = vam.Misaligned(VIAL, offset=0.07)
GRID, BEAM = vam.Grid((10, 10, 4), 0.1), vam.Beam((19, 6), 0.11)
PLACES: dict[str, Any] = {"vial": VIAL, "light that nothing mirrors": ASIDE, "open air": None}


def projector(
    vessel: Any = VIAL, device: Device | str = "numpy", grid: vam.Grid = GRID, angles: int = 12, share: float = 0.0
) -> vam.Projection:
    return vam.Projection(grid, BEAM, vam.Turntable(angles, lit_share=share), vessel, device)


def random_light(A: vam.Projection, *, even: bool = False) -> np.ndarray:
    """Of any pixel, or of columns whose rows are alike."""
    shape = (*A.range.shape[:2], 1) if even else A.range.shape
    return np.broadcast_to(np.random.default_rng(0).random(shape), A.range.shape).astype(np.float32)


def in_order(outer: OuterResin, dose: np.ndarray, ring: int) -> np.ndarray:
    """The cells of a ring by their angle, (cells, z)."""
    radius, angle = outer.cells.places
    own = np.flatnonzero(np.isclose(radius, np.unique(radius.round(9))[ring]))
    return dose[:, own].reshape(-1, dose.shape[2])[np.argsort(angle[:, own].ravel())]


# ---- what cells there are ------------------------------------------------------------------------------------------
def test_cells_hold_all_resin_but_the_judged_cylinder() -> None:
    beside, off = outer_resin(projector())
    height, wall, judged = 4 * GRID.pitch, VIAL.inner_radius, GRID.inscribed_radius
    angles = beside.motion.angles
    volume = angles * beside.cells.volumes.sum() * beside.cells.slices
    assert volume == pytest.approx(np.pi * (wall**2 - judged**2) * height)
    reach = off.cells.slices * off.cells.slice_pitch
    assert angles * off.cells.volumes.sum() * off.cells.slices == pytest.approx(np.pi * wall**2 * reach)
    assert np.abs(off.cells.z).min() == pytest.approx(0.5 * (height + off.cells.slice_pitch))
    assert reach >= BEAM.pixels[1] * BEAM.pitch - height  # a row's light ends behind its box


def test_nothing_is_asked_of_resin_that_light_does_not_reach() -> None:
    sharp = vam.Beam((19, 3), 0.11, spread=0.0)
    filled = vam.Grid((22, 22, 4), 0.1)
    assert len(outer_resin(vam.Projection(GRID, sharp, vam.Turntable(12), VIAL, "numpy"))) == 1
    assert not outer_resin(vam.Projection(filled, sharp, vam.Turntable(12), VIAL, "numpy"))


# ---- the dose ------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("place", PLACES)
def test_the_transpose_is_exact_entry_by_entry(device: Device, place: str) -> None:
    beam, cells = vam.Beam((11, 3), 0.17), OuterRings(8, 2, 0.1, 5, 0.1, inner=0.1, gap=0.0 if place == "vial" else 0.1)
    A = vam.Projection(GRID, beam, vam.Turntable(5), PLACES[place], device)
    outer = OuterResin(A, cells)
    matrix = outer.dense()
    assert np.abs(matrix - outer.T.dense().T).max() <= 1e-6 * np.abs(matrix).max()
    assert matrix.max() > 0.0


def _summed(A: vam.Projection, light: np.ndarray, radii: np.ndarray, count: int) -> np.ndarray:
    """Mean dose over cells between radii, ``count`` a turn, of light (angle, r): ray by ray, placed where resin is."""
    u = (np.arange(4000) + 0.5) / 4000 * 2.0 * VIAL.aperture - VIAL.aperture
    theta = FULL_TURN * np.arange(A.motion.angles) / A.motion.angles
    rays = trace(VIAL, theta[:, None], u[None, :])
    apart = u[:, None] / BEAM.pitch - (np.arange(BEAM.pixels[0]) - 0.5 * (BEAM.pixels[0] - 1))
    sent = light @ (ndtr((apart + 0.5) / 0.5) - ndtr((apart - 0.5) / 0.5)).T * rays.power
    total = np.zeros((radii.size - 1, count))
    for share in (np.arange(400) + 0.5) / 400:
        x, y = np.moveaxis(rays.at(share * rays.length), -1, 0)
        ring = np.searchsorted(radii, np.hypot(x, y)) - 1
        cell = np.floor(np.arctan2(y, x) / FULL_TURN * count + 0.5).astype(int) % count
        lit = (ring >= 0) & (ring < radii.size - 1)
        left = sent * VIAL.absorption * np.exp(-VIAL.absorption * share * rays.length) * rays.length / 400
        np.add.at(total, (ring[lit], cell[lit]), left[lit])
    area = np.pi * (radii[1:] ** 2 - radii[:-1] ** 2) / count
    return total * (u[1] - u[0]) / area[:, None] * A.grid.pitch**3 / BEAM.pitch**2


def test_the_dose_is_that_of_rays_traced_one_by_one() -> None:
    """Out to the wall: two and three rays meet beyond 0.667 of 0.92 mm, and on caustics their density has no bound."""
    A = projector()
    beside = outer_resin(A, width=1.0)[0]
    light = random_light(A, even=True)
    dose, cells = beside.T(light), beside.cells
    radii = cells.inner + np.arange(cells.rings + 1) * cells.pitch
    assert len(cells.bands) == 1
    wanted = _summed(A, light[:, :, 0], radii, cells.bands[0].samples * cells.angles)
    got = np.stack([in_order(beside, dose, ring)[:, cells.slices // 2] for ring in range(cells.rings)])
    assert np.abs(got - wanted).max() <= 0.03 * dose.max()
    assert np.abs(got.mean(axis=1) / wanted.mean(axis=1) - 1.0).max() < 0.01


def test_a_dose_of_another_shape_is_refused_by_the_names_of_its_axes() -> None:
    with pytest.raises(ShapeMismatch, match=r"= \[angle, cell, z\]"):
        outer_resin(projector())[0](np.zeros((2, 2, 2), np.float32))


def test_even_straight_light_gives_even_dose() -> None:
    """Where every angle lights it."""
    A = projector(None)
    beside, off = (outer.T(np.ones(A.range.shape, np.float32)) for outer in outer_resin(A))
    even = 12 * GRID.pitch**3 / BEAM.pitch**2
    assert np.abs(beside[:, :, 1:3] / even - 1.0).max() < 0.03
    assert beside[:, :, 1:3].mean() == pytest.approx(even, rel=2e-3)
    assert off.max() < even


def test_resin_above_and_below_is_lit_as_voxels_there_would_be() -> None:
    A = projector()
    off = outer_resin(A, width=1.0)[1]
    light, more = random_light(A, even=True), off.cells.slices // 2
    tall = vam.Grid((*GRID.shape[:2], 4 + 2 * more), GRID.pitch)
    voxels, dose, inside = projector(grid=tall).T(light), off.T(light), GRID.cylinder()
    near = off.cells.places[0] < GRID.inscribed_radius
    for cell, voxel in ((more - 1, more - 1), (more, more + 4), (more + 1, more + 5)):
        weights = off.cells.volumes[near]
        mean = (dose[:, near, cell] @ weights).mean() / weights.sum()
        assert mean == pytest.approx(voxels[:, :, voxel][inside].mean(), rel=0.02)


def test_it_turns_while_it_is_lit() -> None:
    """As in five places of each step that it stands still at, on the same cells."""
    A = projector(share=1.0)
    cells = OuterRings(8, 4, 0.1, 12, 0.1, inner=0.1)
    fine = replace(cells, angles=60)
    assert cells.bands[0].samples == 5 and fine.bands[0].samples == 1
    light = random_light(A)
    parts = np.roll(np.repeat(light, 5, axis=0), -2, axis=0) / 5.0
    turning, placed = OuterResin(A, cells), OuterResin(projector(angles=60), fine)
    got, wanted, still = turning.T(light), placed.T(parts), OuterResin(projector(), cells).T(light)
    for ring in range(8):
        blurred = in_order(placed, wanted, ring)
        assert np.abs(in_order(turning, got, ring) - blurred).max() < 0.02 * got.max()
    assert np.abs(in_order(turning, still, 7) - in_order(placed, wanted, 7)).max() > 0.05 * got.max()


@pytest.mark.parametrize("place", ["vial", "open air"])
def test_no_voxel_of_a_proof_gets_much_more_than_the_brightest_cell(place: str) -> None:
    """Light of random columns and rows is rougher than any that prints."""
    grid, beam = vam.Grid((24, 24, 8), 0.035), vam.Beam((43, 8), 0.05)
    A = vam.Projection(grid, beam, vam.Turntable(90, lit_share=0.0), PLACES[place], vam.devices()[0])
    light = random_light(A)
    proved = IndependentExposure(A).averaged(A.device.upload(light))[1]
    most = max(float(outer.T(light).max()) for outer in outer_resin(A))
    assert proved is not None
    assert 0.9 * most < proved.dose < 1.06 * most


def test_part_of_a_turn_is_a_turn_whose_other_angles_are_dark(device: Device) -> None:
    whole = projector(VIAL, device)
    times = np.linspace(0.5, 1.5, 6)
    half = vam.Projection(GRID, BEAM, vam.Turntable.arc(6, np.pi, dwell=times, lit_share=0.0), VIAL, device)
    light = random_light(half)
    filled = np.concatenate([light * times[:, None, None], np.zeros_like(light)]).astype(np.float32)
    for some, all_angles in zip(outer_resin(half), outer_resin(whole), strict=True):
        wanted = all_angles.T(filled)
        assert np.abs(some.T(light) - wanted).max() <= 1e-5 * wanted.max()
        assert some.dot_test() < 1e-6


def test_measured_angles_lie_between_even_ones() -> None:
    angles = np.sort(np.random.default_rng(3).uniform(0.0, FULL_TURN, 24))
    A = vam.Projection(GRID, BEAM, vam.Turntable(angles), VIAL, "numpy")
    light, beside = random_light(A, even=True), outer_resin(A)[0]
    poses = [vam.Projection(GRID, BEAM, vam.Turntable([0.0]), VIAL, "numpy")]
    assert beside.cells.angles >= 24 and beside.dot_test() < 1e-12
    turned = IndependentExposure(A).averaged(A.device.upload(light))[1]
    assert turned is not None and 0.9 * turned.dose < beside.T(light).max() < 1.1 * turned.dose
    assert outer_resin(poses[0])


def test_higher_cells_have_the_mean_of_lower_ones() -> None:
    A = projector()
    light, (low, high) = random_light(A), (outer_resin(A, height=height)[0] for height in (1.0, 2.0))
    dose = low.T(light)
    assert high.cells.slices == 2 == low.cells.slices // 2
    assert high.T(light) == pytest.approx(0.5 * (dose[:, :, ::2] + dose[:, :, 1::2]), abs=1e-3 * dose.max())


@pytest.mark.parametrize("rings", [False, True])
def test_all_resin_is_exposed_at_once_as_one_by_one(device: Device, rings: bool) -> None:
    A = projector(VIAL, device, vam.Grid((12, 12, 4), 0.09))
    projection = vam.RingProjection.of(A) if rings else A
    resin = AllResin(projection)
    rng, upload = np.random.default_rng(1), device.upload
    light = upload(rng.random(A.range.shape).astype(np.float32))
    operators = (projection, *resin.outer)
    assert len(operators) == 3
    dose, *cells = fields = [device.empty(each.domain.shape) for each in operators]
    resin.expose(light, dose, cells)
    for each, field in zip(operators, fields, strict=True):
        wanted = each.T(light).numpy()
        assert np.abs(field.numpy() - wanted).max() <= 1e-6 * wanted.max()
    operands = [upload(rng.standard_normal(each.domain.shape).astype(np.float32)) for each in operators]
    wanted = sum(each(x).numpy() for each, x in zip(operators, operands, strict=True))
    got = device.empty(A.range.shape)
    resin.project(operands[0], operands[1:], got)
    assert np.abs(got.numpy() - wanted).max() <= 1e-5 * np.abs(wanted).max()


# ---- what is refused -----------------------------------------------------------------------------------------------
def test_light_that_one_pose_does_not_tell_is_refused_with_the_reason() -> None:
    with pytest.raises(BadInput, match="expected a Projection"):
        outer_resin(vam.TracedProjection(GRID, vam.Beam((19, 6), 0.11), vam.Turntable(3), device="numpy"))
