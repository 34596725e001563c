"""Distances of surfaces: exact ones, their signs, alignment, and the Gaussian of Table 1."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from profiling.gallery.deviation import print_to_print
from profiling.gallery.gaussian import fit_gaussian
from vamgpu.errors import BadInput, EmptyMesh, NotWatertight
from vamgpu.geometry import Grid
from vamgpu.metrics.alignment import Alignment, align
from vamgpu.metrics.nearest_points import Nearest, barycentric
from vamgpu.metrics.surface_distance import drawn, iso_solid, surface_distance
from vamgpu.targets.implicit import voxelize
from vamgpu.targets.shapes import build
from vamgpu.targets.solid import Solid

BOX = np.array([3.0, 2.0, 1.0])


def box() -> Solid:
    import trimesh

    mesh = trimesh.creation.box(2.0 * BOX)
    return Solid(np.asarray(mesh.vertices), np.asarray(mesh.faces), "box")


def ball(radius: float, level: int = 4) -> Solid:
    import trimesh

    mesh = trimesh.creation.icosphere(level, radius)
    return Solid(np.asarray(mesh.vertices), np.asarray(mesh.faces), "ball")


def turn(degrees: float, axis: tuple[float, float, float]) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(np.radians(degrees) * np.array(axis) / np.linalg.norm(axis)).as_matrix()


def test_distances_to_a_box_are_exact_inside_and_outside() -> None:
    """Twelve large triangles: faces, edges and corners all are nearest somewhere."""
    points = np.random.default_rng(0).uniform(-5, 5, (4000, 3))
    q = np.abs(points) - BOX
    truth = np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)
    found = Nearest(box())(points)
    assert found.distance == pytest.approx(truth, abs=1e-12)
    assert np.linalg.norm(points - found.point, axis=1) == pytest.approx(np.abs(truth), abs=1e-12)
    assert np.linalg.norm(found.normal, axis=1) == pytest.approx(1.0)


def test_nearest_points_agree_with_trying_every_triangle() -> None:
    solid = build("pentamode", cells=1)
    points = np.random.default_rng(1).uniform(-2.5, 2.5, (40, 3))
    corners = solid.vertices[solid.faces]
    best = []
    for point in points:
        asked = np.broadcast_to(point, (len(corners), 3))
        foot = np.einsum("nk,nki->ni", barycentric(asked, corners), corners)
        best.append(np.linalg.norm(foot - point, axis=1).min())
    assert np.abs(Nearest(solid)(points).distance) == pytest.approx(best, abs=1e-12)


def test_signs_agree_with_the_voxels_of_a_sharp_part() -> None:
    """The winding of triangles seen from each point tells inside from outside on its own."""
    solid = build("nut")
    points = np.random.default_rng(2).uniform(-1.0, 1.0, (300, 3)) * np.abs(solid.bounds).max(axis=0)
    a, b, c = np.moveaxis(solid.vertices[solid.faces][None] - points[:, None, None], 2, 0)
    la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    dot = [np.einsum("nmi,nmi->nm", p, q) for p, q in ((a, b), (b, c), (c, a))]
    below = la * lb * lc + dot[0] * lc + dot[1] * la + dot[2] * lb
    winding = np.arctan2(np.einsum("nmi,nmi->nm", a, np.cross(b, c)), below).sum(axis=1) / (2 * np.pi)
    assert np.array_equal(Nearest(solid)(points).distance < 0, np.abs(winding) > 0.5)


@pytest.mark.slow
@pytest.mark.parametrize("delta", [0.05, -0.05, pytest.param(0.2, marks=pytest.mark.slow)])
def test_a_ball_that_is_too_large_is_so_by_its_excess(delta: float) -> None:
    found = surface_distance(ball(2.0 + delta), ball(2.0), aligned=False)
    assert found.mean == pytest.approx(delta, rel=0.02) and found.alignment is None
    assert found.rms == pytest.approx(abs(delta), rel=0.02)
    assert surface_distance(ball(2.0 + delta).vertices, ball(2.0, 5)).mean == pytest.approx(delta, rel=0.02)


@pytest.mark.slow
def test_a_thicker_print_from_its_voxels() -> None:
    """The whole way: voxels, iso-surface, drawn points, distances."""
    grid = Grid((64, 64, 64), 0.1)
    fraction = [voxelize(lambda x, y, z, r=r: np.sqrt(x * x + y * y + z * z) - r, grid) for r in (2.4, 2.5)]
    target, thick = (iso_solid(f, grid.pitch) for f in fraction)
    assert target.open_edges == 0 and target.volume == pytest.approx(4 / 3 * np.pi * 2.4**3, rel=5e-3)
    assert surface_distance(thick, target, aligned=False).mean == pytest.approx(0.1, rel=0.02)
    flat = iso_solid(np.ones((4, 5, 6)), (0.1, 0.2, 0.3), 0.5)
    assert flat.bounds[1] * 2 == pytest.approx([0.4, 1.0, 1.8])


@pytest.mark.parametrize(
    ("degrees", "axis", "shift"), [(10.0, (1, 2, 3), (0.4, -0.3, 0.2)),
                                   pytest.param(0.0, (1, 0, 0), (0.7, 0.0, 0.7), marks=pytest.mark.slow),
                                   pytest.param(5.0, (0, 0, 1), (-0.5, 0.5, 0.0), marks=pytest.mark.slow),
                                   pytest.param(-10.0, (1, 0, -1), (0.1, 0.6, -0.4), marks=pytest.mark.slow)]
)  # fmt: skip
def test_alignment_recovers_a_known_motion(degrees: float, axis: Any, shift: Any) -> None:
    part = build("boat")
    rotation, move = turn(degrees, axis), np.array(shift, float)
    there = drawn(part, 1500) @ rotation.T + move
    found = align(there, Nearest(part))
    assert found(there) == pytest.approx((there - move) @ rotation, abs=1e-3)
    assert found.rotation == pytest.approx(rotation.T, abs=1e-4)
    assert found.shift == pytest.approx(-rotation.T @ move, abs=1e-3)
    assert found.rms < 1e-3 and found.angle == pytest.approx(abs(np.radians(degrees)), abs=1e-4)


@pytest.mark.slow
def test_alignment_through_noise_and_damage() -> None:
    part = build("boat")
    random = np.random.default_rng(6)
    points = drawn(part, 4000)
    there = points @ turn(6.0, (1, 1, 0)).T + (0.2, 0.1, -0.3)
    noisy = there + random.normal(0.0, 0.05, there.shape)
    assert np.abs(align(noisy, Nearest(part))(there) - points).max() < 0.02
    blob = np.concatenate([there, there[:200] + random.uniform(1, 2, (200, 3))])
    assert np.abs(align(blob, Nearest(part), keep=0.9)(there) - points).max() < 1e-2


def test_alignment_starts_where_it_is_told() -> None:
    part = build("boat")
    rotation = turn(150.0, (0, 0, 1))
    there = drawn(part, 4000) @ rotation.T
    rough = Alignment(turn(-145.0, (0, 0, 1)), np.array([0.2, 0.0, 0.0]), np.nan, 0)
    assert align(there, Nearest(part), start=rough).rotation == pytest.approx(rotation.T, abs=1e-4)


def test_prints_are_compared_pair_by_pair() -> None:
    rms = print_to_print([ball(2.0, 3), ball(2.1, 3), ball(2.25, 3)], aligned=False, samples=2000)
    assert rms == pytest.approx(np.array([[0, 0.1, 0.25], [0.1, 0, 0.15], [0.25, 0.15, 0]]), rel=0.05)
    assert np.array_equal(rms, rms.T)


@pytest.mark.slow
def test_the_automatic_exposure_papers_deviations_come_back_from_prints_that_have_them() -> None:
    """Boats of 11.5 mm, as scans of prints lie: an RMS of 0.100 mm to the reference and 0.053 mm from print to print.

    That is 0.093 mm that all prints share and 0.037 mm of each alone, as bends over 5 mm. Alignment takes some of the
    bends for motion, and the nearest point is not the one that was bent: within 6 % the paper's numbers come back.
    """
    boat, random = build("boat"), np.random.default_rng(3)
    corners = boat.vertices[boat.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)

    def bent(rms: float) -> np.ndarray:
        """Smooth shifts of the vertices (n, 3), so much RMS along the normals over the surface."""
        ways = random.normal(size=(12, 3))
        ways *= 2.0 * np.pi / 5.0 / np.linalg.norm(ways, axis=1)[:, None]
        waves = np.cos(boat.vertices @ ways.T + random.uniform(0.0, 2.0 * np.pi, 12))
        shift = waves @ random.normal(size=(12, 3))
        along = (shift[boat.faces].mean(axis=1) * normal).sum(axis=1) / area
        return shift * (rms / np.sqrt(np.average(along**2, weights=area)))

    accuracy, repeatability = 0.100, 0.053
    shared = boat.vertices + bent(np.sqrt(accuracy**2 - repeatability**2 / 2.0))
    prints = [
        Solid((shared + bent(repeatability / np.sqrt(2.0))) @ turn(degrees, (1, 2, 3)).T + move, boat.faces, "boat")
        for degrees, move in ((4.0, (0.3, -0.2, 0.1)), (-3.0, (0.0, 0.4, 0.0)))
    ]
    reference = Nearest(boat)
    found = [surface_distance(one, reference, samples=1000).rms for one in prints]
    assert np.mean(found) == pytest.approx(accuracy, rel=0.06)
    between = print_to_print(prints, samples=1000)[0, 1]
    assert between == pytest.approx(repeatability, rel=0.06)


@pytest.mark.parametrize(("mean", "sigma"), [(0.099, 0.200), (0.229, 0.307), (-0.05, 0.02)])
def test_a_gaussian_is_found_again(mean: float, sigma: float) -> None:
    found = fit_gaussian(np.random.default_rng(7).normal(mean, sigma, 100_000))
    assert found.mean == pytest.approx(mean, abs=0.02 * sigma) and found.sigma == pytest.approx(sigma, rel=0.02)
    assert 0.99 < found.r2 <= 1.0 and found(found.mean) == pytest.approx(found.height)


def test_r2_falls_for_what_is_no_gaussian() -> None:
    random = np.random.default_rng(8)
    two = np.concatenate([random.normal(-1, 0.2, 20_000), random.normal(1, 0.2, 10_000)])
    found = fit_gaussian(two)
    assert found.r2 < 0.95 and found.mean == pytest.approx(-1.0, abs=0.1)
    assert found.counts.sum() <= 30_000 and len(found.edges) == 101


def test_deviations_of_a_print_are_summed_up() -> None:
    part = build("boat")
    points = drawn(part)
    surface = Nearest(part)
    normal = surface(points + 1e-9).normal
    rough = points + np.random.default_rng(9).normal(0.03, 0.02, (len(points), 1)) * normal
    bell = fit_gaussian(surface_distance(rough, surface, aligned=False).distance)
    assert bell.mean == pytest.approx(0.03, abs=2e-3) and bell.sigma == pytest.approx(0.02, rel=0.1)
    assert bell.r2 > 0.97


@pytest.mark.parametrize(
    ("make", "kind", "words"),
    [
        (lambda: Nearest(Solid(box().vertices, box().faces[:6])), NotWatertight, "open edges"),
        (lambda: Nearest(box())(np.zeros((4, 2))), BadInput, "(4, 2)"),
        (lambda: Nearest(box())([[0.0, np.nan, 0.0]]), BadInput, "1 numbers"),
        (lambda: align(np.zeros((2, 3)), Nearest(box())), BadInput, "got 2 points"),
        (lambda: align(drawn(box(), 50) + 0.3, Nearest(box()), steps=3), BadInput, "3 steps"),
        (lambda: align(drawn(box(), 50), Nearest(box()), keep=0.0), BadInput, "0.0"),
        (lambda: print_to_print([box()]), BadInput, "1 prints"),
        (lambda: iso_solid(np.zeros((4, 4, 4)), 0.1), EmptyMesh, "0.5"),
        (lambda: iso_solid(np.zeros((4, 4)), 0.1), BadInput, "(4, 4)"),
        (lambda: fit_gaussian(np.ones(100)), BadInput, "100 values are 1"),
        (lambda: fit_gaussian([1.0, 2.0]), BadInput, "2 values"),
        (lambda: fit_gaussian(np.arange(100.0), limits=(3.0, 1.0)), BadInput, "3 and 1"),
    ],
)
def test_bad_input_is_named(make: Any, kind: type[Exception], words: str) -> None:
    with pytest.raises(kind) as caught:
        make()
    assert words in str(caught.value)
