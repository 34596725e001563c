"""Scores of the leaderboard on bodies with known distances, holes and doses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from profiling.leaderboard import cases
from profiling.leaderboard.judge import Exposure, RoundVial, Setup
from profiling.leaderboard.scores import Counts, Part, distance, inside, read_stl, scores

RADIUS = 1.0


@pytest.fixture(scope="module")
def ball() -> Part:
    """A ball of 1 mm by pixels of 0.2 mm."""
    setup = Setup(RoundVial(7.0, 1.0, 1.5, 1.5, 1.5, 0.08), 0.2, 0.1, 1.0, 2.0, 3.0, Path())
    exposure = Exposure(setup, (60, 16, 16))
    return Part(exposure, trimesh.creation.icosphere(5, RADIUS).triangles)


def away(part: Part) -> np.ndarray:
    """Distance of voxels from the middle of the ball [mm]."""
    x, z = part.exposure.x, part.exposure.z
    return np.sqrt(x[:, None, None] ** 2 + x[None, :, None] ** 2 + z**2)


def test_depth_is_the_distance_from_the_mesh(ball: Part) -> None:
    expected = np.clip((RADIUS - away(ball)) / 0.2, -2.0, 2.0)
    np.testing.assert_allclose(ball.depth, expected, atol=0.01)
    np.testing.assert_allclose(ball.volume, 4.0 / 3.0 * np.pi, rtol=3e-3)


def test_points_of_overlapping_bodies_are_inside() -> None:
    boxes = [trimesh.creation.box((2.0, 2.0, 2.0)).triangles, trimesh.creation.box((3.0, 1.0, 1.0)).triangles]
    x = np.linspace(-1.87, 1.87, 20)
    found = inside(np.concatenate(boxes), x, x, x)
    a, b, c = np.meshgrid(x, x, x, indexing="ij")
    first = np.maximum(np.maximum(abs(a), abs(b)), abs(c)) < 1.0
    assert np.array_equal(found, first | ((abs(a) < 1.5) & (abs(b) < 0.5) & (abs(c) < 0.5)))


def test_distances_from_a_triangle() -> None:
    triangle = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 3.0, 0.0]])
    points = np.array([[1.0, 1.0, 2.0], [-3.0, 0.0, 4.0], [2.0, -1.0, 0.0], [4.0, 3.0, 0.0]])
    np.testing.assert_allclose(distance(points, np.repeat(triangle[None], 4, 0)), [2.0, 5.0, 1.0, 2.4])


def test_bodies_holes_and_cavities_are_counted() -> None:
    solid = np.zeros((12, 12, 12), bool)
    solid[1:7, 1:11, 1:6] = True
    solid[3, 3, :], solid[3, 6, :], solid[3, 9, 3] = False, False, False
    solid[9:, 9:, 9:] = True
    assert Counts.of(solid) == Counts(bodies=2, holes=2, cavities=1)
    assert Counts(2, 2, 1).differ(Counts(1, 4, 1)) == 3


def test_scores_of_a_dose_that_falls_evenly(ball: Part) -> None:
    dose = np.maximum(2.0 - away(ball), 0.0)  # solid from 1: the ball
    found = scores(ball, np.full(ball.exposure.shape, 0.5), dose)
    assert found["right"] and found["wrong"] == 0 and found["stray"] == 0.0
    np.testing.assert_allclose(found["threshold"], 1.0, atol=0.03)
    np.testing.assert_allclose(found["rms_um"], 1e3 * abs(1.0 - found["threshold"]), atol=3.0)
    np.testing.assert_allclose(found["W1"], 2 * 0.2 / 2.0, atol=0.1)
    np.testing.assert_allclose(found["seconds"], 3.0 / found["threshold"], rtol=1e-12)
    np.testing.assert_allclose(found["energy_mJ"], 0.5 * 16 * 16 * 0.2**2 * 2.0 * found["seconds"], rtol=1e-12)


def test_resin_far_from_the_part_is_stray(ball: Part) -> None:
    dose = np.where(ball.solid, 2.0, 0.0)
    dose[2:4, 10, 10] = 2.0
    dose[(ball.depth > -1.0) & ~ball.solid] = 2.0  # within a pixel of the part
    found = scores(ball, np.ones(ball.exposure.shape), dose)
    assert (found["bodies"], found["wrong"], found["latitude"]) == (2, 1, 0.0)
    np.testing.assert_allclose(found["stray"], 2 * ball.exposure.voxel**3 / ball.volume)


def test_a_case_is_written_as_its_readme_says(tmp_path: Path) -> None:
    folder = cases.make(tmp_path, "thin walls", "air", 24.0, 60)
    setup, triangles = Setup.load(folder / "judge.toml"), read_stl(folder / "part.stl")
    assert setup.pixel == pytest.approx(cases.PIXEL)
    line = (np.arange(4000) - 1999.5) * 0.01 * cases.PIXEL  # across the walls, above their plate
    met = inside(triangles, line, np.array([0.0, cases.PIXEL]), np.array([1.0, 2.0]) * cases.PIXEL)[:, 0, 1]
    edges = np.nonzero(np.diff(met.astype(int)))[0]
    np.testing.assert_allclose(np.diff(edges)[::2] * 0.01, [1, 2, 3, 4, 5, 6], atol=0.02)
    voxels = np.load(folder / "voxels.npy")
    volume = np.einsum("nj,nj->", triangles[:, 0], np.cross(triangles[:, 1], triangles[:, 2])) / 6.0
    np.testing.assert_allclose(voxels.sum() * setup.pixel**2 * setup.pitch, volume, rtol=0.1)
