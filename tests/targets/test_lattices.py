"""Periodic solids: their volumes, symmetry, distances, connections and endless tiles."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.ndimage import label

from vamgpu.errors import BadInput, EmptyMesh
from vamgpu.geometry import Grid
from vamgpu.targets.implicit import Implicit, voxelize
from vamgpu.targets.lattices import (
    Capsules,
    CubicLattice,
    OctetTruss,
    Pentamode,
    SchwarzP,
    SheetGyroid,
    SkeletalDiamond,
    SkeletalGyroid,
)
from vamgpu.targets.shapes.csg import rod, to_solid
from vamgpu.targets.stream import Repeated, stream, tile
from vamgpu.targets.target import Target
from vamgpu.web import WebGrid

ALL: tuple[Any, ...] = (
    SheetGyroid(), SkeletalGyroid(), SchwarzP(), SkeletalDiamond(), CubicLattice(), OctetTruss(), Pentamode(),
    Capsules(),
)  # fmt: skip
TRUE_DISTANCES: tuple[Any, ...] = (CubicLattice(), OctetTruss(), Pentamode(), Capsules())


def cell_of(shape: Implicit, n: int) -> tuple[np.ndarray, Grid]:
    grid = Grid((n, n, n), getattr(shape, "cell", 3.0) / n)
    return voxelize(shape, grid), grid


def points(count: int, reach: float = 6.0) -> np.ndarray:
    return np.random.default_rng(3).uniform(-reach, reach, (3, count))


@pytest.mark.parametrize(
    ("shape", "percent"), [(SheetGyroid(3.0, 0.5), 32.4), (SkeletalGyroid(3.0, 1.2), 9.9), (SkeletalDiamond(), 20.7)]
)
def test_minimal_surfaces_fill_what_the_paper_s_levels_fill(shape: Any, percent: float) -> None:
    assert 100.0 * cell_of(shape, 48)[0].mean() == pytest.approx(percent, abs=0.2)


def test_the_paper_s_functions_in_web_coordinates() -> None:
    l, rho, z = points(400)  # noqa: E741
    k = 2.0 * np.pi / 3.0
    f = np.sin(k * rho) * np.cos(k * l) + np.sin(k * l) * np.cos(k * z) + np.sin(k * z) * np.cos(k * rho)
    p = np.cos(k * rho) + np.cos(k * l) + np.cos(k * z)
    d = np.cos(k * rho) * np.cos(k * l) * np.cos(k * z) - np.sin(k * rho) * np.sin(k * l) * np.sin(k * z)
    for shape, value in (
        (SheetGyroid(3.0, 0.5), f**2 - 0.25),
        (SkeletalGyroid(3.0, 1.2), f + 1.2),
        (SchwarzP(3.0, 0.8), p - 0.8),
        (SkeletalDiamond(3.0, 0.5), d + 0.5),
    ):
        assert np.array_equal(shape(l, rho, z) < 0, value < 0)


@pytest.mark.parametrize("shape", ALL[:4], ids=lambda s: type(s).__name__)
def test_minimal_surfaces_tell_distances_near_the_surface(shape: Any) -> None:
    """A step of the value along the gradient misses the surface by something of second order."""
    at = points(40_000)
    value = shape(*at)
    at, value = at[:, np.abs(value) < 0.02], value[np.abs(value) < 0.02]
    h = 1e-5
    slope = np.stack([(shape(*(at + h * e)) - shape(*(at - h * e))) / (2 * h) for e in np.eye(3)[:, :, None]])
    assert value.size > 50
    assert (np.abs(shape(*(at - value * slope))) <= 10.0 * value**2 + 1e-8).all()


@pytest.mark.parametrize("shape", ALL, ids=lambda s: type(s).__name__)
def test_bounds_never_exceed_the_distance(shape: Any) -> None:
    at = points(3000)
    bound, value = shape.bound(*at), shape(*at)
    assert np.array_equal(bound < 0, value < 0)
    way = np.random.default_rng(5).normal(size=(3, 3000))
    there = at + 0.999 * np.abs(bound) * way / np.linalg.norm(way, axis=0)
    assert np.array_equal(shape(*there) < 0, value < 0)


@pytest.mark.parametrize("shape", TRUE_DISTANCES, ids=lambda s: type(s).__name__)
def test_struts_and_shells_tell_true_distances_outside(shape: Any) -> None:
    """Unit gradient, and a step of the distance against it lands on the surface."""
    at = points(4000)
    value = shape(*at)
    at, value = at[:, value > 1e-3], value[value > 1e-3]
    h = 1e-6
    slope = np.stack([(shape(*(at + h * e)) - shape(*(at - h * e))) / (2 * h) for e in np.eye(3)[:, :, None]])
    smooth = np.abs(np.linalg.norm(slope, axis=0) - 1.0) < 1e-5  # all but points midway between two struts
    assert smooth.mean() > 0.99
    assert np.abs(shape(*(at - value * slope))[smooth]).max() < 1e-4


@pytest.mark.parametrize("shape", ALL[:7], ids=lambda s: type(s).__name__)
def test_lattices_repeat_every_cell(shape: Any) -> None:
    x, y, z = points(500)
    assert shape(x + shape.cell, y - 2 * shape.cell, z + 3 * shape.cell) == pytest.approx(shape(x, y, z), abs=1e-9)


def test_capsules_repeat_and_stay_apart() -> None:
    shape = Capsules()
    x, y, z = points(500)
    assert shape(x + 3.2, y, z - 2.4) == pytest.approx(shape(x, y, z), abs=1e-9)
    grid = WebGrid((64, 30, 48), 0.1)
    shells = voxelize(shape, grid)
    assert label(shells > 0)[1] == 6 and label(shells == 0)[1] == 7  # type: ignore[index]
    outer = np.pi * 0.8**2 * 0.8 + 4 / 3 * np.pi * 0.8**3
    inner = np.pi * 0.55**2 * 0.8 + 4 / 3 * np.pi * 0.55**3
    assert shells.sum() * grid.voxel_volume == pytest.approx(4 * (outer - inner), rel=2e-3)


@pytest.mark.parametrize(
    "shape", [OctetTruss(1.0, 0.1), Pentamode(1.0, 0.05, 0.2), CubicLattice(1.0, 0.1)], ids=lambda s: type(s).__name__
)
def test_trusses_are_one_piece(shape: Any) -> None:
    n = 48
    filled = voxelize(shape, Grid((n, n, n), 2.0 / n), samples=2) > 0
    piece: np.ndarray = label(filled, np.ones((3, 3, 3)))[0]  # type: ignore[index]
    inner = piece[3:-3, 3:-3, 3:-3]  # without the ends of bonds that belong to cells outside
    assert len(np.unique(inner[inner > 0])) == 1


def test_octet_struts_join_neighbors_of_a_face_centered_lattice() -> None:
    shape, nodes = OctetTruss(2.0, 0.2), np.array([(0, 0, 0), (1, 1, 0), (1, 0, 1), (0, 1, 1), (2, 1, 1), (1, 1, 2)])
    apart = np.linalg.norm(nodes[:, None] - nodes[None], axis=2)
    for i, j in zip(*np.nonzero(np.isclose(apart, np.sqrt(2.0))), strict=True):
        x, y, z = 0.5 * (nodes[i] + nodes[j])[:, None].astype(float)
        assert shape(x, y, z)[0] == pytest.approx(-0.1, abs=1e-12)
    assert shape(np.array(1.0), np.array(1.0), np.array(1.0)) > 0.5


def test_pentamode_touches_and_bulges() -> None:
    shape = Pentamode(4.0, 0.2, 0.6)
    ends = shape(np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 0.0]))
    assert ends == pytest.approx([-0.1, -0.1, -0.1], abs=1e-9)
    slant = np.hypot(0.5 * np.sqrt(3.0), 0.2)
    middle = shape(np.array(0.5), np.array(0.5), np.array(0.5))
    assert middle == pytest.approx(-0.3 * 0.5 * np.sqrt(3.0) / slant, rel=1e-9)


def test_fractions_are_the_same_with_and_without_bounds() -> None:
    shape, grid = OctetTruss(), WebGrid((30, 20, 10), (0.08, 0.1, 0.12))
    plain = voxelize(lambda x, y, z: shape(x, y, z), grid, start=1.7)
    assert plain.dtype == np.float32 and np.array_equal(plain, voxelize(shape, grid, start=1.7))


def test_tiles_join_without_a_seam() -> None:
    shape, pitch = SkeletalGyroid(), (0.0787, 0.1, 0.15)
    tiles = list(stream(shape, (12, 8), pitch, 7.0, 25))
    assert [t.shape for t in tiles] == [(25, 12, 8)] * 3 + [(14, 12, 8)] and tiles[0].dtype == np.float32
    whole = voxelize(shape, WebGrid((89, 12, 8), pitch))
    assert np.array_equal(np.concatenate(tiles), whole)
    assert np.array_equal(tile(shape, WebGrid((25, 12, 8), pitch), 25 * pitch[0]), tiles[1])


def test_a_mesh_repeats_along_the_web() -> None:
    """A slanted rod every 1.1 mm over voxels that are no cubes: its volume per period, and the next period alike."""
    solid = to_solid(rod((0.0, 0.4, -0.5), (1.6, 1.1, 0.6), 0.2, segments=48), "rod").translated((0.8, 0.75, 0.0))
    shape, pitch = Repeated(solid, 4.0), (0.1, 0.08, 0.125)
    tiles = list(stream(shape, (20, 16), pitch, 12.0, 33, device="numpy"))
    web = np.concatenate(tiles)
    assert web.shape == (120, 20, 16)
    assert web[40:80] == pytest.approx(web[80:], abs=2e-3)
    assert web[40:80].sum() * np.prod(pitch) == pytest.approx(solid.volume, rel=2e-3)
    crowd = np.concatenate(list(stream(Repeated(solid, 1.1), (20, 16), pitch, 4.0, 11, device="numpy")))
    assert crowd.max() <= 1.0 and crowd[:11] == pytest.approx(crowd[22:33], abs=2e-3)


def test_a_lattice_is_a_target_for_a_vial() -> None:
    target = Target.from_array(voxelize(CubicLattice(), Grid((48, 48, 48), 0.125)), 0.125, "cube")
    volume = 8 * (3 * np.pi * 0.25**2 * 3.0 - 8 * np.sqrt(2.0) * 0.25**3)
    assert target.name == "cube" and target.volume == pytest.approx(volume, rel=5e-3)


@pytest.mark.parametrize(
    ("make", "number"),
    [
        (lambda: SchwarzP(3.0, 1.0), "1.0"), (lambda: SkeletalGyroid(0.0), "0.0"),
        (lambda: SheetGyroid(3.0, float("nan")), "nan"), (lambda: SkeletalDiamond(3.0, 0.8), "0.7071"),
        (lambda: OctetTruss(3.0, 2.5), "2.121"), (lambda: Pentamode(3.2, 0.7, 0.6), "0.6"),
        (lambda: Capsules(spacing=(2.0, 2.4)), "2.4"), (lambda: Capsules(wall=0.9), "0.9"),
        (lambda: voxelize(lambda x, y, z: x.sum(), Grid((2, 2, 2), 1.0)), "(8, 64)"),
        (lambda: voxelize(lambda x, y, z: (x + y + z) * np.nan, Grid((2, 2, 2), 1.0)), "512 NaN"),
        (lambda: voxelize(OctetTruss(), Grid((2, 2, 2), 1.0), samples=0), "0"),
        (lambda: stream(OctetTruss(), (4, 4), 0.1, -1.0, 5), "-1.0"),
        (lambda: stream(3, (4, 4), 0.1, 1.0, 5), "int"),  # type: ignore[arg-type]
    ],
)  # fmt: skip
def test_bad_input_is_named(make: Any, number: str) -> None:
    with pytest.raises(BadInput) as caught:
        make()
    assert number in str(caught.value)


def test_a_mesh_beside_the_web_is_refused() -> None:
    solid = to_solid(rod((0.0, 4.0, 0.0), (1.0, 4.0, 0.0), 0.2, segments=12), "rod").translated((0, 4, 0))
    with pytest.raises(EmptyMesh, match="3.8"):
        stream(Repeated(solid, 2.0), (10, 10), 0.1, 5.0, 10)


def test_a_period_that_piles_copies_up_is_refused() -> None:
    solid = to_solid(rod((0.0, 1.0, 0.0), (1.0, 1.0, 0.0), 0.2, segments=12), "rod")
    with pytest.raises(BadInput, match="copies would overlap; expected at most 1000"):
        Repeated(solid, 1e-6)
