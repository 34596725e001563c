"""Voxels of small surfaces on every device: exact where the answer is known, and the same everywhere."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import vamgpu
from vamgpu.backend.device import Device
from vamgpu.errors import OutOfMemory, TargetTooLarge
from vamgpu.geometry import Grid
from vamgpu.kernels.voxelize import SAMPLES, sample_points
from vamgpu.targets.solid import Solid
from vamgpu.targets.voxelize import binned, listed, oriented, snapped, voxelize

BOX_FACES = np.asarray(trimesh.creation.box((1.0, 1.0, 1.0)).faces)
BOX_CORNERS = np.asarray(trimesh.creation.box((1.0, 1.0, 1.0)).vertices)


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Solid:
    return Solid(np.where(BOX_CORNERS > 0, high, low), BOX_FACES, "box")


def ball(radius: float, subdivisions: int = 4) -> Solid:
    mesh = trimesh.creation.icosphere(subdivisions, radius)
    return Solid(np.asarray(mesh.vertices), np.asarray(mesh.faces), "ball")


def inward(solid: Solid) -> Solid:
    return Solid(solid.vertices, solid.faces[:, ::-1], solid.name)


def joined(*solids: Solid) -> Solid:
    starts = np.cumsum([0, *(len(solid.vertices) for solid in solids)])
    faces = np.concatenate([solid.faces + start for solid, start in zip(solids, starts, strict=False)])
    return Solid(np.concatenate([solid.vertices for solid in solids]), faces)


def rotation(a: float, b: float) -> np.ndarray:
    about_z = np.array([[np.cos(a), -np.sin(a), 0.0], [np.sin(a), np.cos(a), 0.0], [0.0, 0.0, 1.0]])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(b), -np.sin(b)], [0.0, np.sin(b), np.cos(b)]])
    return about_z @ about_x


def test_a_box_on_voxel_boundaries_is_sharp(device: Device) -> None:
    grid = Grid((8, 10, 20), 0.5)
    fraction, volume = voxelize(box((-1.0, -1.5, -3.0), (1.0, 1.5, 3.0)), grid, device)
    wanted = np.zeros(grid.shape)
    wanted[2:6, 2:8, 4:16] = 1.0
    np.testing.assert_array_equal(fraction.numpy(), wanted)
    assert volume == pytest.approx(36.0, rel=1e-6)


def test_a_cut_voxel_holds_the_part_inside(device: Device) -> None:
    # walls at sixteenths of a voxel, top and bottom at quarters: all on the sampling lattice, so the answer is exact
    grid = Grid((6, 7, 5), 1.0)
    low, high = (-1.0 - 3 / 16, -1.5, -1.25), (1.0, 1.5 + 5 / 16, 1.5)
    got = voxelize(box(low, high), grid, device).fraction.numpy()
    parts = []
    for n, a, b in zip(grid.shape, low, high, strict=True):
        edges = np.arange(n + 1) - 0.5 * n
        parts.append(np.clip(np.minimum(edges[1:], b) - np.maximum(edges[:-1], a), 0.0, 1.0))
    x, y, z = parts
    exact = x[:, None, None] * y[None, :, None] * z
    cut_once = (x[:, None] == x.round()[:, None]) | (y == y.round())[None, :]
    np.testing.assert_allclose(got[cut_once], exact[cut_once], atol=1e-7)
    np.testing.assert_allclose(got, exact, atol=1.0 / SAMPLES)


def test_a_sphere_has_the_volume_of_its_mesh(device: Device) -> None:
    solid = ball(3.0)
    fraction, volume = voxelize(solid, Grid((36, 36, 33), 0.2), device)
    values = fraction.numpy()
    assert volume == pytest.approx(solid.volume, rel=1e-3)
    assert values.sum(dtype=np.float64) * 0.2**3 == pytest.approx(volume, rel=1e-6)
    assert values.min() == 0.0 and values.max() == 1.0


def test_a_tilted_box_agrees_with_points_inside_it(device: Device) -> None:
    turn, half = rotation(0.4, 0.7), np.array([1.1, 0.8, 1.5])
    solid = Solid(2.0 * half * BOX_CORNERS @ turn.T + (0.05, -0.1, 0.02), BOX_FACES)
    grid = Grid((20, 22, 19), 0.25)
    got, volume = voxelize(solid, grid, device)
    fine = 8
    axes = [np.repeat(c, fine) + np.tile((np.arange(fine) + 0.5) / fine - 0.5, len(c)) * 0.25 for c in grid.axes()]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1) - (0.05, -0.1, 0.02)
    inside = (np.abs(points @ turn) <= half).all(axis=-1)
    wanted = inside.reshape(20, fine, 22, fine, 19, fine).mean(axis=(1, 3, 5))
    assert volume == pytest.approx(8.0 * half.prod(), rel=2e-3)
    assert np.abs(got.numpy() - wanted).max() < 0.08  # 16 rays against 512 points
    assert np.abs(got.numpy() - wanted).mean() < 2e-3


@pytest.mark.parametrize("bits", [5, 10])
def test_sample_points_hold_every_row_and_column_once_and_are_their_own_half_turn(bits: int) -> None:
    points = sample_points(bits)
    middles = (2 * np.arange(SAMPLES) + 1) * (1 << bits) // (2 * SAMPLES)
    for axis in range(2):
        np.testing.assert_array_equal(np.sort(points[:, axis]), middles)
    turned = (1 << bits) - points
    assert {tuple(p) for p in turned.tolist()} == {tuple(p) for p in points.tolist()}


def test_a_part_that_is_its_own_half_turn_is_so_in_voxels(device: Device) -> None:
    turn = rotation(0.3, 0.0)
    wall = Solid(BOX_CORNERS * (5.1, 0.7, 1.9) @ turn.T, BOX_FACES, "wall")
    values = voxelize(wall, Grid((24, 20, 8), 0.3), device).fraction.numpy()
    np.testing.assert_array_equal(values, values[::-1, ::-1])
    assert len(np.unique(values)) > 5


def test_rays_through_vertices_and_edges_cross_once(device: Device) -> None:
    """Every vertex of a bumpy slab sits on a sampling point, so rays meet vertices and edges all over."""
    points = sample_points(10) / 1024.0
    rng = np.random.default_rng(3)
    n = 9
    i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    xy = np.stack([i, j], axis=-1).reshape(-1, 2) + points[rng.integers(0, SAMPLES, n * n)] - 0.5 * n
    top = np.column_stack([xy, rng.uniform(0.2, 3.0, n * n)])
    bottom = np.column_stack([xy, rng.uniform(-3.0, -0.2, n * n)])
    a = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    upper = np.concatenate([np.stack([a, a + n, a + n + 1], 1), np.stack([a, a + n + 1, a + 1], 1)])
    solid = Solid(np.concatenate([top, bottom]), np.concatenate([upper, upper[:, ::-1] + n * n, _walls(n)]))
    assert solid.open_edges == 0
    grid = Grid((n, n, 8), 1.0)
    got, volume = voxelize(solid, grid, device)
    values = got.numpy()
    assert (values[:, :, [0, -1]] == 0.0).all()  # a ray that misses one of its two crossings would fill to the top
    assert (values[2:-2, 2:-2, 4] >= 0.19).all()
    assert (values[2:-2, 2:-2, 3] >= 0.19).all()
    # each ray stands for 1/16 of a column, and the whole is cut by the rim only
    assert volume == pytest.approx(solid.volume, rel=0.05)


def _walls(n: int) -> np.ndarray:
    """Faces between the rims of two n × n sheets of vertices, the upper sheet first."""
    along = np.arange(n)
    rim = np.concatenate([along[:-1] * n, (n - 1) * n + along[:-1], along[:0:-1] * n + n - 1, along[:0:-1]])
    after = np.roll(rim, -1)
    down = n * n
    return np.concatenate([np.stack([rim, after + down, after], 1), np.stack([rim, rim + down, after + down], 1)])


def test_cavities_are_empty_and_overlaps_count_once(device: Device) -> None:
    grid = Grid((8, 8, 8), 1.0)
    outer = box((-3.0, -3.0, -3.0), (3.0, 3.0, 3.0))
    hollow = voxelize(joined(outer, inward(box((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)))), grid, device)
    assert hollow.volume == pytest.approx(216.0 - 8.0)
    assert (hollow.fraction.numpy()[3:5, 3:5, 3:5] == 0.0).all()
    twice = voxelize(joined(outer, box((-1.0, -1.0, -1.0), (3.0, 3.0, 4.0))), grid, device)
    assert twice.volume == pytest.approx(216.0 + 16.0)
    assert twice.fraction.numpy().max() == 1.0


def boxes(number: int, seed: int) -> tuple[Solid, np.ndarray]:
    """Boxes of 4 × 4 × 4 voxels and less, some wound inward, on sixteenths of a voxel, and how they wind: a number for
    every cell of a sixteenth of a voxel in a grid of 4 × 4 × 4."""
    rng = np.random.default_rng(seed)
    winding, solids = np.zeros((64, 64, 64), int), []
    for sign in rng.choice([1, 1, 1, -1], number):
        low, high = np.sort(rng.integers(-8, 73, (2, 3)), axis=0)
        high = np.maximum(high, low + 1)
        solid = box(tuple(low / 16.0 - 2.0), tuple(high / 16.0 - 2.0))
        solids.append(solid if sign > 0 else inward(solid))
        winding[tuple(slice(max(a, 0), max(b, 0)) for a, b in zip(low, high, strict=True))] += sign
    return joined(*solids), winding


@pytest.mark.parametrize("number", [2, 7, 60])
def test_every_sample_counts_where_it_is_wound_once_or_more(number: int, device: Device) -> None:
    # Boxes on sixteenths hold or miss whole cells around the sample points, so that the truth is a count of cells.
    for seed in range(4):
        solid, winding = boxes(number, seed)
        cells = (winding >= 1).reshape(4, 16, 4, 16, 4, 16)
        points = sample_points(10) // 64
        wanted = np.mean([cells[:, i, :, j].mean(axis=-1) for i, j in points], axis=0)
        got, volume = voxelize(solid, Grid((4, 4, 4), 1.0), device)
        np.testing.assert_array_equal(got.numpy(), wanted)
        assert volume == pytest.approx(wanted.sum(), rel=1e-6)


def test_the_same_body_twice_is_that_body(device: Device) -> None:
    cube, grid = box((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)), Grid((12, 12, 10), 0.3)
    once = voxelize(cube, grid, device)
    for many in (joined(cube, cube), joined(cube, cube, cube, box((-0.7, -1.0, 0.0), (1.0, 0.9, 1.0)))):
        got = voxelize(many, grid, device)
        np.testing.assert_array_equal(got.fraction.numpy(), once.fraction.numpy())
        assert got.volume == once.volume
    assert ((once.fraction.numpy() > 0.0) & (once.fraction.numpy() < 1.0)).any()


def test_flush_overlaps_and_touching_bodies_count_once(device: Device) -> None:
    def cylinder(low: float, high: float) -> Solid:
        mesh = trimesh.creation.cylinder(1.0, high - low, sections=64)
        return Solid(np.asarray(mesh.vertices) + (0.0, 0.0, 0.5 * (low + high)), np.asarray(mesh.faces))

    grid = Grid((24, 24, 49), 0.1)
    whole = voxelize(cylinder(-1.51, 2.24), grid, device)
    overlapping = voxelize(joined(cylinder(-1.51, 1.5), cylinder(0.0, 2.24)), grid, device)
    touching = voxelize(joined(cylinder(-1.51, 0.33), cylinder(0.33, 2.24)), grid, device)
    assert whole.volume == pytest.approx(cylinder(-1.51, 2.24).volume, rel=1e-3)
    for got in (overlapping, touching):
        np.testing.assert_array_equal(got.fraction.numpy(), whole.fraction.numpy())


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("pitch", [0.1, 0.3, 0.07, 0.045, 1.0 / 3.0])
def test_a_wall_of_one_voxel_that_straddles_two_keeps_its_volume(axis: int, pitch: float, fast_device: Device) -> None:
    grid = Grid((14, 14, 14), pitch)
    for middle in (0.0, 3 * pitch, 0.013, -1.25 * pitch, 2.47 * pitch):
        size = np.full(3, 8.0 * pitch)
        size[axis] = pitch
        place = np.zeros(3)
        place[axis] = middle
        values, volume = voxelize(box(tuple(place - 0.5 * size), tuple(place + 0.5 * size)), grid, fast_device)
        assert volume == pytest.approx(size.prod(), rel=1e-6)
        across = np.moveaxis(values.numpy(), axis, 0)[:, 5, 6]
        assert across.sum() == 1.0 and np.count_nonzero(across) <= 2
        assert across.max() >= 0.5  # never lost where half a voxel decides
        if middle in (0.0, 3 * pitch):
            assert sorted(across)[-2:] == [0.5, 0.5]


def test_what_lies_outside_the_grid_is_cut_off(device: Device) -> None:
    fraction, volume = voxelize(box((-9.0, -1.0, -9.0), (0.0, 1.0, 9.0)), Grid((4, 6, 5), 1.0), device)
    wanted = np.zeros((4, 6, 5))
    wanted[:2, 2:4, :] = 1.0
    np.testing.assert_array_equal(fraction.numpy(), wanted)
    assert volume == pytest.approx(20.0)


@pytest.mark.parametrize("shape", [(33, 40, 1), (40, 33, 17), (35, 35, 70)])
def test_every_device_gives_the_very_same_voxels(fast_device: Device, shape: tuple[int, int, int]) -> None:
    grid = Grid(shape, 0.21)
    solid = joined(ball(3.0, 3), ball(2.0, 2).translated((0.3, 0.5, 1.7)))
    wanted = voxelize(solid, grid, "numpy")
    got = voxelize(solid, grid, fast_device)
    np.testing.assert_array_equal(got.fraction.numpy(), wanted.fraction.numpy())
    assert got.volume == pytest.approx(wanted.volume, rel=1e-6)


def test_bands_of_little_memory_give_the_same_voxels(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    grid, solid = Grid((37, 21, 12), 0.2), joined(ball(3.0, 3), ball(2.0, 2).translated((0.3, 0.5, 0.7)))
    wanted = voxelize(solid, grid, device)
    monkeypatch.setattr("vamgpu.targets.voxelize._ROOM", 1500)
    got = voxelize(solid, grid, device)
    np.testing.assert_array_equal(got.fraction.numpy(), wanted.fraction.numpy())
    assert got.volume == pytest.approx(wanted.volume, rel=1e-7)


@pytest.mark.parametrize("room", [1, 300, 1100, 10**9])
def test_lists_of_crossings_share_what_room_there_is(room: int) -> None:
    counts = np.random.default_rng(4).integers(0, 9, (35, 12))
    bands, start, longest = listed(counts, 8, room)
    assert [band.start for band in bands[1:]] == [band.stop for band in bands[:-1]]
    assert bands[0].start == 0 and bands[-1].stop == 5
    for band in bands:
        columns = slice(8 * band.start, 8 * band.stop)
        begin, number = start[columns].ravel(), counts[columns].ravel()
        np.testing.assert_array_equal(begin[1:], (begin + 1 + number)[:-1])
        assert begin[0] == 0 and begin[-1] + 1 + number[-1] <= longest
        assert (number + 1).sum() <= room or band.stop == band.start + 1
    with pytest.raises(TargetTooLarge, match="cross the surface"):
        listed(np.full((8, 1000), 1 << 20), 8, 1000)


def test_huge_grids_use_a_coarser_fine_grid_and_refuse_in_the_end() -> None:
    solid = box((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0))
    assert snapped(solid, Grid((1024, 1024, 4), 0.01))[1] == 10
    assert snapped(solid, Grid((1025, 8, 4), 0.01))[1] == 9
    corners, bits = snapped(solid, Grid((1 << 15, 8, 4), 0.1))
    assert bits == 5 and corners.max() <= 1 << 20
    with pytest.raises(TargetTooLarge, match="40000 voxels wide.*larger pitch"):
        snapped(solid, Grid((40000, 8, 4), 0.1))


def test_triangles_above_the_grid_are_left_out() -> None:
    corners = np.array([(0, 0, 5), (9, 0, 4), (0, 9, 7), (3, 3, 3)])
    faces = np.array([(0, 1, 2), (0, 1, 3)], np.int32)
    assert len(oriented(corners, faces)) == len(oriented(corners, faces, 5)) == 2
    np.testing.assert_array_equal(oriented(corners, faces, 4)[:, 8], [3])


def test_lists_hold_every_triangle_that_touches_a_square() -> None:
    solid, grid = ball(3.0, 2), Grid((33, 30, 4), 0.2)
    corners, bits = snapped(solid, grid)
    triangles = oriented(corners, solid.faces)
    members, first, last = binned(triangles, grid, bits, 8)
    assert first.shape == last.shape == (5, 4)
    box_xy = triangles[:, :9].reshape(-1, 3, 3)[:, :, :2] / (8 << bits)
    for i in range(5):
        for j in range(4):
            touches = (np.floor(box_xy.min(axis=1)) <= (i, j)).all(axis=1) & (box_xy.max(axis=1) >= (i, j)).all(axis=1)
            assert sorted(members[first[i, j] : last[i, j]]) == np.flatnonzero(touches).tolist()


def test_a_grid_that_no_memory_holds_says_how_large_it_is(opencl_name: str) -> None:
    with pytest.raises(OutOfMemory, match=r"128000\.0 GB"):
        voxelize(ball(1.0, 1), Grid((32000, 32000, 31250), 0.1), vamgpu.open_device(opencl_name))
