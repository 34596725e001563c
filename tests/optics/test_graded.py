"""A vial of graded resin: beside the vial of one index, beside rays traced one by one, and as an exact operator."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, RayError
from vamgpu.geometry import Beam, Grid, Turntable, Vessel
from vamgpu.operators.projection import Projection
from vamgpu.optics.graded_vial import GradedVial
from vamgpu.optics.index_field import FormulaField, FunctionField, GridField, Region
from vamgpu.optics.interface import refract, transmittance
from vamgpu.optics.march import march
from vamgpu.optics.vial import Vial

PAPER = Vial(12.4, 1.0, 1.49962, 1.473, 1.0, 0.05)
VIALS = [PAPER, Vial(8.0, 0.7, 1.48, 1.52, 1.333, 0.2), Vial(10.0, 0.0, 1.5, 1.47, 1.0, 0.1),
         Vial(10.0, 1.5, 1.45, 1.47, 1.5, 0.1)]  # fmt: skip


def blob(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 1.48 + 0.012 * np.exp(-((x - 1.5) ** 2 + (y + 1.0) ** 2) / 9.0)


RING = FormulaField((1.0, 1.0, 0.0), (1.5**2, -4e-4))
"""Cured more in the middle: the index falls outwards, round about the axis."""
GRADED = GradedVial(6.0, 0.5, FunctionField(blob, Region.cylinder(5.6)), 1.473, 1.0, 0.08)
GRIDDED = replace(GRADED, resin=GridField.from_function(blob, (96, 96), 12.0 / 95))
ROUND = GradedVial(6.0, 0.5, RING, 1.473, 1.333, 0.08)


def even(vial: Vial) -> GradedVial:
    medium = FormulaField((1.0, 1.0, 1.0), (vial.resin_index**2,), region=Region.cylinder(1.0))
    return GradedVial(vial.radius, vial.wall, medium, vial.wall_index, vial.bath_index, vial.absorption)


# ---- one index -----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("vial", VIALS)
def test_one_index_is_the_vial(vial: Vial) -> None:
    graded, u = even(vial), np.linspace(-0.999, 0.999, 501) * vial.aperture
    assert isinstance(graded, Vessel)
    assert graded.lit_radius == pytest.approx(vial.lit_radius, abs=1e-4)
    got, want = graded.chords(u), vial.chords(u)
    for name in ("p", "angle", "transmittance", "length"):
        np.testing.assert_allclose(getattr(got, name), getattr(want, name), atol=1e-6, err_msg=name)
    np.testing.assert_allclose(got.spread, want.spread, atol=1e-5)
    x = np.linspace(-1.0, 1.0, 81) * vial.inner_radius
    across, along = np.meshgrid(x, x, indexing="ij")
    lit = np.hypot(across, along) < 0.995 * vial.lit_radius
    (u_got, w_got), (u_want, w_want) = (v.illuminate(across[lit], along[lit]) for v in (graded, vial))
    np.testing.assert_allclose(u_got, u_want, atol=1e-6)
    np.testing.assert_allclose(w_got, w_want, rtol=1e-5)


def test_columns_beyond_the_aperture_bring_nothing() -> None:
    graded = even(PAPER)
    beyond = graded.chords(np.array([-13.0, -12.41, 12.41, 20.0]))
    assert (beyond.transmittance == 0).all() and (beyond.length == 0).all()
    u, weight = graded.illuminate([0.0, 12.0, -20.0], [11.5, 0.0, 0.0])
    assert (weight[[0, 2]] == 0).all() and np.isfinite(u).all()


# ---- bent rays -----------------------------------------------------------------------------------------------------
def enter(vial: GradedVial, u: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Place and direction behind the inner face and transmitted share, by Snell's law in vectors, face by face."""
    place, along, faces, before = np.array([u, -9.0 * vial.radius]), np.array([0.0, 1.0]), [], vial.bath_index
    for radius, after in ((vial.radius, vial.wall_index), (vial.inner_radius, None)):
        b = place @ along
        place = place + (-b - np.sqrt(b**2 - place @ place + radius**2)) * along
        after = after or float(np.sqrt(vial.resin.evaluate(np.array([[*place, 0.0]]))[1][0]))
        out = refract(along, place / radius, before, after)
        cos_in, cos_out = (np.abs(np.array([d @ place / radius])) for d in (along, out))
        faces.append((cos_in, cos_out, before, after))
        along, before = out, after
    return place, along, float(transmittance(faces, vial.polarization)[0])


@pytest.mark.slow
@pytest.mark.parametrize(
    "vial",
    [GRADED, replace(GRIDDED, polarization="s"), *(pytest.param(v, marks=pytest.mark.slow) for v in (GRIDDED, ROUND))],
)
def test_every_point_of_a_ray_finds_its_column_and_its_density(vial: GradedVial) -> None:
    step, columns = 2e-4, np.array([-4.1, 0.3, 1.7])
    entered = [enter(vial, u + k * step) for u in columns for k in (-1, 0, 1)]
    places, headings, shares = (np.array(part) for part in zip(*entered, strict=True))
    medium = replace(vial.resin, region=Region.cylinder(vial.inner_radius))
    traced = march(medium, places, headings, step=0.02, rows=40, device="numpy").path.reshape(3, 3, 40, 3)
    for u, paths, share in zip(columns, traced, shares[1::3], strict=True):
        path = paths[1]
        inner = np.hypot(path[:, 0], path[:, 1]) < 0.98 * vial.lit_radius
        assert inner.sum() > 4
        found, _ = vial.illuminate(path[inner, 0], path[inner, 1])
        np.testing.assert_allclose(found, u, atol=2e-6)
        for k in np.flatnonzero(inner)[1:-1]:
            along = (path[k + 1] - path[k - 1])[:2]
            normal = np.array([along[1], -along[0]]) / np.linalg.norm(along)
            gap = (paths[2][k] - paths[0][k])[:2] @ normal / (2.0 * step)
            length = np.sum(np.linalg.norm(np.diff(path[: k + 1, :2], axis=0), axis=1))
            want = share / gap * vial.absorption * np.exp(-vial.absorption * length)
            got = vial.illuminate(path[k : k + 1, 0], path[k : k + 1, 1])[1][0]
            assert got == pytest.approx(want, rel=2e-3)


def test_a_round_medium_keeps_index_times_distance() -> None:
    u = np.linspace(-4.0, 4.0, 33)
    sheet = ROUND.sheet
    mirrored = sheet.across + sheet.across[::-1]
    np.testing.assert_allclose(mirrored, 0.0, atol=1e-8)
    nearest = [np.hypot(sheet.across[ray], sheet.along[ray]).min() for ray in range(0, ROUND.rays, 64)]
    columns, _ = ROUND._column(np.arange(0.0, ROUND.rays, 64))
    n = np.sqrt(RING.evaluate(np.array([[r, 0.0, 0.0] for r in nearest]))[1])
    np.testing.assert_allclose(n * nearest, np.abs(columns) * ROUND.bath_index, rtol=1e-4, atol=1e-4)
    assert (ROUND.chords(u).length > ROUND.chords(np.abs(u) + 0.5).length).all()


# ---- as an operator ------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("vial", [GRADED, ROUND])
def test_forward_is_the_transpose_entry_by_entry(vial: GradedVial, fast_device: Device) -> None:
    A = Projection(Grid((13, 13, 2), 0.65), Beam((17, 2), 0.65), Turntable(5), vial, fast_device)  # noqa: N806
    forward, back = A.dense(), A.T.dense().T
    assert np.abs(forward - back).max() <= 1e-6 * np.abs(forward).max()
    assert np.count_nonzero(forward) == np.count_nonzero(back) > 500


@pytest.mark.parametrize("vial", [GRADED, GRIDDED])
def test_the_dot_test_and_the_reference(vial: GradedVial, fast_device: Device) -> None:
    sizes = Grid((48, 48, 3), 0.17), Beam((60, 3), 0.17), Turntable(24)
    A = Projection(*sizes, vial, fast_device)  # noqa: N806
    assert max(A.dot_test(seed) for seed in range(3)) < 1e-6
    reference = Projection(*sizes, vial, "numpy")
    x = np.random.default_rng(0).random(A.domain.shape)
    want = reference(x)
    assert np.abs(A(x) - want).max() <= 1e-5 * np.abs(want).max()


def test_a_homogeneous_projection_is_that_of_the_vial() -> None:
    sizes = Grid((40, 40, 1), 0.4), Beam((64, 1), 0.4), Turntable(12)
    x = np.random.default_rng(1).random((40, 40, 1))
    graded, exact = (Projection(*sizes, vessel, "numpy")(x) for vessel in (even(PAPER), PAPER))
    assert np.abs(graded - exact).max() <= 1e-5 * np.abs(exact).max()


# ---- bad input -----------------------------------------------------------------------------------------------------
def test_bad_values_are_refused() -> None:
    with pytest.raises(BadInput, match="wall"):
        GradedVial(5.0, 5.0, RING, 1.5)
    with pytest.raises(BadInput, match="resin"):
        GradedVial(5.0, 0.5, 1.5, 1.5)  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="at least the inner"):
        GradedVial(5.0, 0.5, GridField.from_array(np.full((20, 20), 1.5), 0.1), 1.5)
    with pytest.raises(BadInput, match="33"):
        GradedVial(5.0, 0.5, RING, 1.5, rays=5)
    with pytest.raises(RayError, match="above 0"):
        GradedVial(5.0, 0.5, FormulaField((1.0, 1.0, 0.0), (2.0, -0.2)), 1.5).chords(np.zeros(1))
