"""Walls thinner than a voxel are found, thicker ones never; thickness along normals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import trimesh

from vamgpu.errors import ShapeMismatch
from vamgpu.geometry import Grid
from vamgpu.metrics.mesh_runs import mesh_runs
from vamgpu.metrics.nearest_points import Nearest
from vamgpu.metrics.thin_regions import unjudged
from vamgpu.metrics.triangle_search import TriangleSearch, barycentric
from vamgpu.metrics.walls import walls
from vamgpu.targets.shapes import build
from vamgpu.targets.solid import Solid
from vamgpu.targets.voxelize import voxelize

GRID = Grid((24, 24, 24), 0.1)


def solid_of(mesh: Any) -> Solid:
    return Solid(np.asarray(mesh.vertices), np.asarray(mesh.faces), "part")


def box(low: Any, high: Any) -> Solid:
    return solid_of(trimesh.creation.box(bounds=[low, high]))


def found_in(solid: Solid, with_mesh: bool = True) -> Any:
    return unjudged(voxelize(solid, GRID, "numpy").fraction.numpy(), GRID, solid if with_mesh else None)


def filled(solid: Solid) -> float:
    """Volume [mm³] of all voxels."""
    return voxelize(solid, GRID, "numpy").volume


@pytest.mark.parametrize("place", [0.0, 0.013, 0.031, 0.05, 0.077])
def test_a_wall_of_a_voxel_is_judged_wherever_it_stands(place: float) -> None:
    assert not found_in(box((place, -1, -1), (place + 0.1001, 1, 1)))
    wall = box((place, -1, -1), (place + 0.045, 1, 1))
    thin = found_in(wall)
    assert len(thin.regions) == 1 and thin.volume == pytest.approx(filled(wall), rel=1e-6)
    assert thin.thickness == pytest.approx(0.045, rel=1e-6)
    assert thin.regions[0].center == pytest.approx((place + 0.0225, 0, 0), abs=0.02)


def test_a_wall_that_straddles_two_voxels_is_not_judged_and_one_that_fills_a_voxel_is() -> None:
    assert found_in(box((-0.04, -1, -1), (0.04, 1, 1)))
    assert not found_in(box((0.01, -1, -1), (0.09, 1, 1)))


def test_square_pins_count_and_oblique_thick_walls_do_not() -> None:
    pin = box((0.02, 0.03, -1), (0.06, 0.07, 1))
    assert found_in(pin).volume == pytest.approx(filled(pin), rel=1e-6) and found_in(pin).thickness == pytest.approx(
        0.04
    )
    mesh = trimesh.creation.box((0.13, 1.2, 1.2))
    mesh.apply_transform(trimesh.transformations.rotation_matrix(0.955, (0.0, -1.0, 1.0)))
    assert not found_in(solid_of(mesh))


def test_voxels_alone_tell_of_what_has_no_neighbor_in_the_part() -> None:
    fin = trimesh.boolean.union(
        [
            trimesh.creation.box(bounds=[(-1, -1, -1), (1, 0, 1)]),
            trimesh.creation.box(bounds=[(0.01, -0.1, -1), (0.0475, 1, 1)]),
        ],
        engine="manifold",
    )
    with_mesh, without = (found_in(solid_of(fin), some) for some in (True, False))
    assert with_mesh.volume == pytest.approx(0.0375 * 1.0 * 2, rel=0.08)
    assert len(without.regions) == 1 and without.thickness is None
    assert without.volume == pytest.approx(0.0375 * 0.9 * 2, rel=1e-6)  # the row beside the block has neighbors
    assert without.regions[0].low == pytest.approx((0.0, 0.1, -1.0)) and "µm thick" not in without.reason()
    assert not found_in(box((-0.53, -0.5, -0.5), (0.5, 0.5, 0.5)), False)
    with pytest.raises(ShapeMismatch, match="24, 24"):
        unjudged(np.ones((3, 3, 3)), GRID)


def test_thickness_along_the_normal() -> None:
    plate = box((0, 0, 0), (2, 2, 0.3))
    near = Nearest(plate)
    points = np.array([[1.0, 1.0, 0.3], [0.02, 0.03, 0.0], [0.0, 1.0, 0.2]])
    normals = np.array([[0.0, 0, 1], [0, 0, -1], [-1, 0, 0]])
    found = walls(near.search, points, normals, 1.0)
    assert found.is_wall.tolist() == [True, True, False] and found.thickness == pytest.approx([0.3, 0.3, np.inf])
    assert found.center == pytest.approx(np.array([[1, 1, 0.15], [0.02, 0.03, 0.15], [0, 1, 0.2]]))


def test_a_mask_agrees_with_the_sides_of_the_surface() -> None:
    solid = build("nut")
    low, pitch = solid.bounds[0] - 0.1, 0.31
    shape = tuple(int(n) for n in np.ceil((solid.bounds[1] - low) / pitch + 1))
    inside = mesh_runs(solid, low, pitch, shape)  # type: ignore[arg-type]
    index = np.random.default_rng(0).integers(0, shape, (500, 3))
    distance = Nearest(solid)(low + index * pitch).distance
    sure = np.abs(distance) > 1e-6
    assert np.array_equal(inside.holds(index)[sure], (distance < 0)[sure])
    twice = Solid(
        np.concatenate([solid.vertices, solid.vertices + 0.05]),
        np.concatenate([solid.faces, solid.faces + len(solid.vertices)]),
    )
    both = mesh_runs(twice, low, pitch, shape)  # type: ignore[arg-type]
    assert (both.holds(index) >= inside.holds(index)).all()
    assert (both.start[1:] > both.stop[:-1]).all() and (both.start < both.stop).all()


def test_triangles_that_do_not_close_are_searched_exactly() -> None:
    random = np.random.default_rng(3)
    corners = random.uniform(-1, 1, (60, 3, 3)) * np.array([1.0, 1.0, 0.2])
    points = random.uniform(-2, 2, (200, 3))
    search = TriangleSearch(corners)
    distance, weight, face = search(points)
    feet = [np.einsum("nk,nki->ni", barycentric(np.tile(p, (60, 1)), corners), corners) - p for p in points]
    truth = np.linalg.norm(feet, axis=2).min(axis=1)
    assert distance == pytest.approx(truth, abs=1e-12)
    there = np.einsum("nk,nki->ni", weight, search.corners[face])
    assert np.linalg.norm(there - points, axis=1) == pytest.approx(distance, abs=1e-12)
    low, high = search.bounds(points)
    assert (low <= truth).all() and (truth <= high).all()
    few, _, _ = search(points, most=32)
    assert few == pytest.approx(truth, abs=search.reach)
