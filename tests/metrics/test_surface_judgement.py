"""Prints judged in space: distances, walls, bodies, holes and what was too thin, against shapes known exactly."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vamgpu.errors import BadInput, EmptyMesh, ShapeMismatch
from vamgpu.geometry import Grid
from vamgpu.metrics.nearest_points import Nearest
from vamgpu.metrics.runs import runs_of
from vamgpu.metrics.surface_judgement import SurfaceJudgement, judge_surface
from vamgpu.targets.implicit import voxelize as sampled
from vamgpu.targets.lattices import CubicLattice
from vamgpu.targets.repair import repaired
from vamgpu.targets.solid import Solid
from vamgpu.targets.target import Target
from vamgpu.targets.voxelize import voxelize

PITCH = 0.15
GRID = Grid((44, 44, 44), PITCH)
FINE, START = 0.5 * PITCH, np.array([-3.3, -3.3, -3.3]) + 0.25 * 0.5 * PITCH
"""Voxels half as wide, shifted by a quarter."""


def solid_of(*meshes: Any) -> Solid:
    import trimesh

    mesh: Any = trimesh.util.concatenate(meshes)
    return Solid(np.asarray(mesh.vertices), np.asarray(mesh.faces), "part")


def box(low: Any, high: Any) -> Any:
    import trimesh

    return trimesh.creation.box(bounds=[low, high])


def ball(radius: float, center: Any = (0.0, 0.0, 0.0), level: int = 4) -> Any:
    import trimesh

    return trimesh.creation.icosphere(level, radius).apply_translation(center)


def points(pitch: float = FINE, start: Any = START, number: int = 88) -> list[np.ndarray]:
    return list(np.meshgrid(*(first + pitch * np.arange(number) for first in start), indexing="ij", sparse=True))


def box_distance(low: Any, high: Any, at: list[np.ndarray]) -> np.ndarray:
    """Signed distance from a box, by the largest norm: right on its faces."""
    sides = [np.maximum(a - x, x - b) for a, b, x in zip(low, high, at, strict=True)]
    return np.maximum(np.maximum(sides[0], sides[1]), sides[2])


def ball_distance(radius: float, at: list[np.ndarray], center: Any = (0, 0, 0)) -> np.ndarray:
    return np.sqrt(sum((x - c) ** 2 for x, c in zip(at, center, strict=True))) - radius


def judged(
    distance: np.ndarray, solid: Solid | None, fraction: np.ndarray | None = None, **more: Any
) -> SurfaceJudgement:
    """A dose that falls from 2 to 0 over a millimeter on both sides of a print's surface, printed from 1 on."""
    dose = np.clip(1.0 - distance, 0.0, 2.0).astype(np.float32)
    if fraction is None:
        assert solid is not None
        fraction = voxelize(solid, GRID, "numpy").fraction.numpy()
    return judge_surface(dose, START, FINE, 1.0, fraction, GRID, solid, **{"samples": 1000, **more})


@pytest.mark.parametrize("excess", [0.05, -0.05, pytest.param(0.01, marks=pytest.mark.slow)])
def test_a_ball_printed_too_large_is_so_by_its_excess(excess: float) -> None:
    found = judged(ball_distance(2.0 + excess, points()), solid_of(ball(2.0, level=5)))
    assert found.mean == pytest.approx(excess, abs=0.02 * PITCH)
    assert found.rms == pytest.approx(abs(excess), abs=0.02 * PITCH)
    assert found.p95 == pytest.approx(abs(excess), abs=0.02 * PITCH)
    assert found.greatest == pytest.approx(excess, abs=0.03 * PITCH)
    assert found.changes.none and found.walls.share_lost == 0 and not found.unjudged


def test_a_ball_printed_beside_its_place() -> None:
    """Too thick by the shift on one side, too thin by it on the other, and nowhere on the mean."""
    found = judged(ball_distance(2.0, points(), (0.06, 0.0, 0.0)), solid_of(ball(2.0)))
    assert found.mean == pytest.approx(0.0, abs=2e-3) and found.rms == pytest.approx(0.06 / np.sqrt(3), rel=0.03)
    assert found.greatest_excess == pytest.approx(0.06, abs=3e-3)
    assert found.greatest_lack == pytest.approx(0.06, abs=3e-3)


def test_the_part_may_be_given_by_its_voxels_alone() -> None:
    fraction = sampled(lambda x, y, z: np.sqrt(x * x + y * y + z * z) - 2.0, GRID)
    found = judged(ball_distance(2.05, points()), None, fraction)
    assert found.mean == pytest.approx(0.05, abs=0.03 * PITCH) and found.changes.none


def test_a_missing_fin_is_as_far_away_as_it_is_long_and_was_not_judged() -> None:
    """A fin of 40 µm on voxels of 90 µm: its block prints, every judged voxel is right, and the fin is gone."""
    part = repaired(solid_of(box((-1.5, -1.5, -1), (1.5, 1.5, 1)), box((0.29, 1.45, -1), (0.33, 3.85, 1))))
    target = Target.from_mesh(part, factor=1, pitch=0.09, device="numpy")
    placed = part.placed(factor=1)
    low, high = placed.bounds
    at = points(0.045, low - 0.5, 140)
    dose = np.clip(1.0 - box_distance(low, (1.5, low[1] + 3.0, 1.0), at), 0.0, 2.0)
    found = judge_surface(dose, low - 0.5, 0.045, 1.0, target.numpy(), target.grid, placed, samples=5000)
    assert found.greatest == pytest.approx(-2.35, abs=0.02)
    assert found.greatest_excess < 0.03
    assert len(found.unjudged.regions) == 1 and found.unjudged.volume == pytest.approx(2.35 * 0.04 * 2, rel=0.06)
    assert found.unjudged.thickness == pytest.approx(0.04, rel=1e-6)
    # It begins where no voxel of the block is a neighbor any more: up to one and a half from the block.
    assert found.unjudged.regions[0].center == pytest.approx((0.31, high[1] - 0.5 * 2.35, 0.0), abs=0.75 * 0.09)
    assert found.walls.thickest_lost == pytest.approx(0.04, rel=1e-6) and np.isnan(found.walls.thinnest_printed)
    assert "could not be judged" in found.unjudged.reason() and "40 µm" in found.unjudged.reason()


@pytest.mark.slow
def test_two_balls_printed_as_one_are_one_merged() -> None:
    at = points()
    balls = np.minimum(ball_distance(1.0, at, (-1.2, 0, 0)), ball_distance(1.0, at, (1.2, 0, 0)))
    bridge = np.maximum(np.hypot(at[1], at[2]) - 0.2, np.abs(at[0]) - 1.2)
    part = solid_of(ball(1.0, (-1.2, 0, 0)), ball(1.0, (1.2, 0, 0)))
    apart, joint = judged(balls, part), judged(np.minimum(balls, bridge), part)
    assert apart.changes.none and apart.changes.bodies == 2 and apart.changes.bodies_merged == 0
    assert joint.changes.bodies_merged == 1 and joint.changes.bodies_lost == joint.changes.holes_opened == 0
    cut = judged(np.maximum(balls, 0.15 - np.abs(at[1])), part)
    assert cut.changes.bodies_broken == 2 and cut.changes.bodies_extra == 0


@pytest.mark.slow
def test_bodies_are_those_of_the_mesh_however_voxels_break_them() -> None:
    """Two balls on a wire that no voxel sees are one body; a ball in a hollow one is a body of its own."""
    import trimesh

    at, apart = points(), ((-1.2, 0.0, 0.0), (1.2, 0.0, 0.0))
    balls = np.minimum(*(ball_distance(1.0, at, place) for place in apart))
    wire = box((-1.2, 0.51 * FINE, 0.51 * FINE), (1.2, 0.6 * FINE, 0.6 * FINE))
    part = solid_of(trimesh.boolean.union([*(ball(1.0, place) for place in apart), wire], engine="manifold"))
    bridge = np.maximum(np.hypot(at[1], at[2]) - 0.2, np.abs(at[0]) - 1.2)
    assert judged(np.minimum(balls, bridge), part).changes.none
    broken = judged(balls, part).changes
    assert (broken.bodies, broken.bodies_lost, broken.bodies_merged, broken.bodies_broken) == (1, 0, 0, 1)
    nested = solid_of(ball(2.0), ball(1.2).invert(), ball(0.8))
    shell = np.maximum(ball_distance(2.0, at), -ball_distance(1.2, at))
    assert judged(np.minimum(shell, ball_distance(0.8, at)), nested).changes.bodies == 2
    assert judged(shell, nested).changes.bodies_lost == 1


def test_holes_that_voxels_leave_in_a_thin_wall_are_not_the_parts() -> None:
    """A cup whose wall is a voxel thick has none; voxels pierce it, in the part as in its print."""
    import trimesh

    turn = np.linspace(0.0, 0.5 * np.pi, 40)
    rim, inner = (radius * np.stack([np.sin(turn), -np.cos(turn)], axis=1) for radius in (0.8, 0.7))
    mesh = trimesh.creation.revolve(np.concatenate([rim, inner[::-1]]), sections=96)
    mesh.merge_vertices()
    cup, axes = (
        Solid(np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int32)),
        [*2 * [np.arange(20)], np.arange(12)],
    )
    x, y, z = np.meshgrid(
        *(0.1 * each + low for each, low in zip(axes, (-0.99, -0.99, -0.94), strict=True)), indexing="ij"
    )
    out = np.sqrt(x**2 + y**2 + z**2)

    def changes(wall: np.ndarray) -> Any:
        dose = np.where(wall & (z <= 0.0), 2.0, 0.0)
        return judge_surface(
            dose, (-0.99, -0.99, -0.94), 0.1, 1.0, dose, Grid((20, 20, 12), 0.1), cup, samples=100
        ).changes

    whole, thin = changes((out <= 0.85) & (out >= 0.6)), changes((out <= 0.8) & (out >= 0.7))
    assert (whole.bodies, whole.holes, whole.holes_closed, whole.holes_opened) == (1, 0, 0, 0)
    assert (thin.holes, thin.holes_closed, thin.holes_opened) == (0, 0, 0)


def test_thresholds_are_searched_only_if_all_bodies_are_right(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = list[float]()

    def counted(values: np.ndarray, level: float) -> Any:
        seen.append(level)
        return runs_of(values, level)

    monkeypatch.setattr("vamgpu.metrics.steadiness.runs_of", counted)
    right = judged(ball_distance(2.0, points()), solid_of(ball(2.0)))
    assert seen and right.changes.none and right.thresholds and right.thresholds[0] < 1.0 < right.thresholds[1]
    seen.clear()
    near = judged(ball_distance(2.0, points()), solid_of(ball(2.0)), between=(0.9, 1.1))
    assert seen == [0.9, 1.1] and near.thresholds == (0.9, 1.1), "one threshold each"
    seen.clear()
    two = solid_of(ball(0.8, (-1.5, 0.0, 0.0)), ball(0.8, (1.5, 0.0, 0.0)))
    wrong = judged(ball_distance(0.8, points(), (-1.5, 0.0, 0.0)), two)
    assert wrong.changes.bodies_lost == 1 and not seen and wrong.thresholds is None
    nothing = judged(np.full(points()[0].shape, 0.9), two)
    assert np.isnan(nothing.mean) and not seen and nothing.thresholds is None


def plate() -> tuple[Solid, np.ndarray, np.ndarray]:
    """A plate with a round hole, and the distances of the plate and of the hole's wall."""
    import trimesh

    at = points()
    whole, hole = box((-2, -2, -0.5), (2, 2, 0.5)), trimesh.creation.cylinder(0.5, 2.0, sections=64)
    mesh = trimesh.boolean.difference([whole, hole], engine="manifold")
    return solid_of(mesh), box_distance((-2, -2, -0.5), (2, 2, 0.5), at), np.hypot(at[0], at[1]) - 0.5


@pytest.mark.slow
def test_a_ring_that_voxels_break_has_its_hole() -> None:
    import trimesh

    mesh = trimesh.creation.torus(1.5, 0.055, major_sections=32, minor_sections=12)
    ring, pitch = Solid(mesh.vertices, np.asarray(mesh.faces, np.int32), "ring"), 0.1
    grid = Grid((34, 34, 4), pitch)
    fraction = voxelize(ring, grid, "numpy").fraction.numpy()
    x, y, z = np.meshgrid(*grid.axes(), indexing="ij")
    dose = 1.0 / (1.0 + np.hypot(np.hypot(x, y) - 1.5, z) / 0.1)  # above a half within a voxel of the ring
    changes = judge_surface(dose, [axis[0] for axis in grid.axes()], pitch, 0.5, fraction, grid, ring).changes
    assert (changes.bodies, changes.holes) == (1, 1) and changes.none, changes


@pytest.mark.slow
def test_a_hole_that_prints_closed() -> None:
    part, whole, hole = plate()
    right = judged(np.maximum(whole, -hole), part)
    assert right.changes.none and right.changes.holes == 1 and right.greatest < 0.03
    closed = judged(whole, part)
    assert (closed.changes.holes_closed, closed.changes.holes_opened, closed.changes.cavities_extra) == (1, 0, 0)
    assert closed.greatest == pytest.approx(0.5, abs=0.02)  # its wall is half a millimeter inside the print
    z = points()[2]
    mouths = judged(np.maximum(whole, -np.maximum(hole, np.abs(z) - 0.3)), part)
    assert (mouths.changes.holes_closed, mouths.changes.cavities_extra) == (1, 1)
    opened = judged(np.maximum(np.maximum(whole, -hole), 0.3 - np.hypot(points()[0] - 1.2, points()[1])), part)
    assert (opened.changes.holes_closed, opened.changes.holes_opened) == (0, 1)


@pytest.mark.slow
def test_a_lost_pin_as_a_body_and_on_a_block() -> None:
    at = points()
    block = box_distance((-2, -2, -1), (2, 2, 0), at)
    body = box((-2, -2, -1), (2, 2, 0))
    alone = judged(block, solid_of(body, box((-0.2, -0.2, 0.5), (0.2, 0.2, 2))))
    assert (alone.changes.bodies, alone.changes.bodies_lost, alone.changes.bodies_merged) == (2, 1, 0)
    joined = judged(block, solid_of(body, box((-0.2, -0.2, -0.5), (0.2, 0.2, 2))), samples=8000)
    assert joined.changes.bodies == 1 and joined.changes.bodies_lost == 0
    assert joined.walls.thickest_lost == pytest.approx(0.4, rel=1e-6)
    assert joined.greatest == pytest.approx(-2.0, abs=0.02)
    plates = judged(block, solid_of(box((-2, -2, -1), (2, 2, -0.5)), box((-2, -2, 1.5), (2, 2, 1.7)))).walls
    assert (plates.thinnest_lost, plates.thickest_lost, plates.thinnest_printed) == pytest.approx((0.2, 0.2, 0.5))
    assert plates.share_lost == pytest.approx(0.5, abs=0.05)


def test_overlapping_bodies_leave_no_surface_inside() -> None:
    """A quarter of one block lies in the other: their print is right, though the mesh has faces deep inside."""
    at = points()
    lows, highs = ((-2, -1, -1), (-0.5, -0.8, -0.6)), ((0.5, 1, 1), (2, 0.8, 0.6))
    part = solid_of(*(box(low, high) for low, high in zip(lows, highs, strict=True)))
    printed = np.minimum(*(box_distance(low, high, at) for low, high in zip(lows, highs, strict=True)))
    found = judged(printed, part)
    # Corners print round by less than a voxel; the faces inside lie 0.2 and more below the surface.
    assert abs(found.greatest) < FINE and found.changes.none and found.changes.bodies == 1


@pytest.mark.slow
def test_specks_pores_and_filled_cavities() -> None:
    at = points()
    hollow = solid_of(ball(2.0), ball(0.8).invert())
    print_ = np.maximum(ball_distance(2.0, at), -ball_distance(0.8, at))
    assert judged(print_, hollow).changes.none
    full = judged(ball_distance(2.0, at), hollow).changes
    assert (full.cavities, full.cavities_filled, full.cavities_extra, full.holes_closed) == (1, 1, 0, 0)
    speck = judged(np.minimum(print_, ball_distance(0.15, at, (0, 0, 2.9))), hollow)
    assert speck.changes.bodies_extra == 1
    assert speck.changes.extra_volume == pytest.approx(4 / 3 * np.pi * 0.15**3, rel=0.1)
    assert speck.greatest == pytest.approx(1.05, abs=0.01)
    pore = judged(np.maximum(print_, -ball_distance(0.15, at, (0, 0, 1.4))), hollow)
    assert (pore.changes.cavities_extra, pore.changes.cavities_filled) == (1, 0)


@pytest.mark.slow
def test_holes_of_a_lattice_close_as_its_struts_grow() -> None:
    grid = Grid((32, 32, 32), PITCH)

    def fraction(strut: float) -> np.ndarray:
        return sampled(CubicLattice(cell=2.4, strut=strut), grid, samples=3)

    part = fraction(0.9)
    start = [axis[0] for axis in grid.axes()]
    right = judge_surface(part, start, PITCH, 0.5, part, grid, samples=1000)
    assert right.changes.none and right.changes.holes == 28 and abs(right.greatest) < 0.1 * PITCH
    thick = judge_surface(fraction(1.0), start, PITCH, 0.5, part, grid, samples=1000)
    assert thick.changes.none and 0.015 < thick.mean < 0.05  # nothing grows on the grid's ends
    closed = judge_surface(fraction(2.3), start, PITCH, 0.5, part, grid, samples=1000).changes
    assert (closed.holes_closed, closed.holes_opened, closed.cavities_extra) == (28, 0, 8)


def test_a_print_that_fills_its_grid_ends_with_it() -> None:
    """The part is as high as the grid, so the dose has no voxel above it: no excess is made up there."""
    grid = Grid((32, 32, 20), PITCH)
    x, y, z = grid.axes()
    inside = (np.abs(x)[:, None, None] < 1.05) & (np.abs(y)[None, :, None] < 1.05) & (z < 9)
    block = solid_of(box((-1.05, -1.05, -1.5), (1.05, 1.05, 1.5)))
    dose = np.where(inside, 3.0, -1.0)
    found = judge_surface(dose, (x[0], y[0], z[0]), PITCH, 1.0, inside * 1.0, grid, block)
    assert found.greatest_excess < 1e-6 and found.changes.none
    assert found.greatest_lack < 0.5 * PITCH  # corners between voxels print round


def test_nothing_prints() -> None:
    found = judged(np.full((88,) * 3, 5.0), solid_of(box((-2, -2, -0.2), (2, 2, 0.2))))
    assert np.isnan([found.mean, found.rms, found.p95, found.greatest]).all()
    assert found.changes.bodies_lost == 1 and found.walls.share_lost == 1.0
    assert {line.value for line in found.lines()} >= {"nothing prints", "none"}


def test_lines_name_every_number() -> None:
    found = judged(ball_distance(2.05, points()), solid_of(ball(2.0)))
    values = {line.name: line.value for line in found.lines()}
    assert float(values["surface distance, mean"].removesuffix(" µm")) == pytest.approx(50, abs=0.02 * 1e3 * PITCH)
    assert values["walls lost"] == "none" and values["surface distance, mean"].startswith("+")
    assert values["bodies changed"] == "0 + 0 + 0 + 0 of 1" and values["too thin to be judged"] == "none"
    assert all(line.meaning for line in found.lines())


@pytest.mark.parametrize(
    ("change", "kind", "words"),
    [
        ({"dose": np.ones((4, 4))}, BadInput, "(4, 4)"),
        ({"dose": np.full(GRID.shape, np.nan)}, BadInput, "NaN"),
        ({"origin": (0.0, 1.0)}, BadInput, "origin"),
        ({"pitch": 0.0}, BadInput, "pitch"),
        ({"threshold": -1.0}, BadInput, "threshold"),
        ({"fraction": np.ones((4, 4, 4))}, ShapeMismatch, "(4, 4, 4)"),
        ({"fraction": np.zeros(GRID.shape)}, EmptyMesh, "0.5"),
        ({"samples": 0}, BadInput, "samples"),
    ],
)
def test_bad_input_is_named(change: dict[str, Any], kind: type[Exception], words: str) -> None:
    given = {"dose": np.ones(GRID.shape), "origin": START, "pitch": PITCH, "threshold": 0.5, "grid": GRID}
    given["fraction"] = sampled(lambda x, y, z: np.sqrt(x * x + y * y + z * z) - 2.0, GRID, samples=1)
    with pytest.raises(kind) as caught:
        judge_surface(**{**given, **change})
    assert words in str(caught.value)


def test_the_greatest_distance_is_looked_for_among_all_points() -> None:
    """A thorn on a ball, so thin that few of the points for the mean lie on it."""
    at = points()
    thorn = np.maximum(np.hypot(at[0], at[1]) - 0.12, np.abs(at[2] - 2.2) - 0.5)
    part = solid_of(ball(2.0))
    found = judged(np.minimum(ball_distance(2.0, at), thorn), part, samples=40)
    assert found.greatest == pytest.approx(0.7, abs=0.03)
    assert Nearest(part)([[0.0, 0.0, 2.7]]).distance[0] == pytest.approx(0.7, abs=1e-3)
