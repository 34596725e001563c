"""Rays traced anew at every pose: exact transposes, formulas, and an independent tracer for a blob off the axis."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from transposes import transpose_gap

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, OpticsWarning, ShapeMismatch
from vamgpu.geometry import centers
from vamgpu.methods import optimize
from vamgpu.operators import traced_projection
from vamgpu.operators.bundle import RayBundle
from vamgpu.operators.medium import CoRotatingMedium
from vamgpu.operators.traced_projection import TracedProjection

BATH = 1.5


# ---- exact transposes ----------------------------------------------------------------------------------------------
def bumpy(shape: tuple[int, ...], seed: int = 0) -> np.ndarray:
    """A refractive index that no symmetry helps."""
    return BATH + 0.06 * np.random.default_rng(seed).random(shape)


def insert(shape: tuple[int, ...]) -> np.ndarray:
    """One opaque voxel off the axis."""
    opaque = np.zeros(shape, bool)
    opaque[3, 1] = True
    return opaque


GRID, BEAM = vam.Grid((5, 4, 2), 0.1), vam.Beam((6, 2), 0.1)
FLAT, DEEP = GRID.shape[:2], GRID.shape
CASES = {
    "nothing": (CoRotatingMedium(), BEAM, None),
    "index": (CoRotatingMedium(index=bumpy(FLAT), bath=BATH), BEAM, None),
    "extinction": (CoRotatingMedium(extinction=bumpy(FLAT)), BEAM, None),
    "uniform extinction": (CoRotatingMedium(extinction=0.8), BEAM, None),
    "opaque": (CoRotatingMedium(opaque=insert(FLAT)), BEAM, None),
    "shares of an insert": (CoRotatingMedium(None, bumpy(FLAT), np.random.default_rng(2).random(FLAT)), BEAM, None),
    "all three": (CoRotatingMedium(bumpy(FLAT), bumpy(FLAT, 1), insert(FLAT), BATH), BEAM, None),
    "other rows and columns": (CoRotatingMedium(bumpy(FLAT), bath=BATH), vam.Beam((9, 3), 0.07), None),
    "fan": (CoRotatingMedium(bumpy(FLAT), 0.5, bath=BATH), BEAM, RayBundle.fan(BEAM, 1.0)),
    "level cone": (CoRotatingMedium(bumpy(FLAT), bath=BATH), BEAM, RayBundle.cone(BEAM, 0.2, 3, 0.05, level=True)),
    "inclined": (CoRotatingMedium(bumpy(FLAT), 0.5, bath=BATH), BEAM, RayBundle.parallel(BEAM, 0.3)),
    "in three dimensions": (CoRotatingMedium(bumpy(DEEP), bumpy(DEEP, 1), insert(DEEP), BATH), BEAM, None),
    "cone": (
        CoRotatingMedium(opaque=insert(FLAT)),
        vam.Beam((5, 3), 0.08),
        RayBundle.cone(vam.Beam((5, 3), 0.08), 0.3, 2),
    ),
}


@cache
def reference(case: str) -> np.ndarray:
    return build(case, "numpy").dense()


def build(case: str, device: Device | str) -> TracedProjection:
    medium, beam, rays = CASES[case]
    return TracedProjection(GRID, beam, vam.Turntable(3, lit_share=0), medium, rays, device)


@pytest.mark.parametrize("case", CASES)
def test_the_transpose_is_exact_entry_by_entry_on_every_device(device: Device, case: str) -> None:
    A = build(case, device)
    matrix = reference(case) if device.name == "numpy" else A.dense()
    assert np.abs(matrix).max() > 0
    assert transpose_gap(A, matrix=matrix) <= 1e-6
    assert np.abs(matrix - reference(case)).max() <= 1e-5 * np.abs(matrix).max()


@pytest.mark.slow
@pytest.mark.parametrize("deep", [False, True], ids=["matrix", "marched"])
def test_the_dot_test_holds_at_real_size(fast_device: Device, deep: bool) -> None:
    n, slices, angles = (24, 20, 12) if deep else (96, 32, 90)
    grid = vam.Grid((n, n, slices), 9.6 / n)
    medium = CoRotatingMedium(blob(grid), 0.05, rod(grid), BATH)
    rays = RayBundle.parallel(vam.Beam((n, slices), grid.pitch), 0.1) if deep else None
    A = TracedProjection(
        grid, vam.Beam((n, slices), grid.pitch), vam.Turntable(angles, lit_share=0), medium, rays, fast_device
    )
    assert (A.entries == 0) == deep
    assert max(A.dot_test(seed) for seed in range(2)) <= 2e-8


# ---- physics -------------------------------------------------------------------------------------------------------
CENTER, WIDTH, STRENGTH = (1.5, -0.9), 1.1, 0.05


def mesh(grid: vam.Grid) -> tuple[np.ndarray, np.ndarray]:
    x, y, _ = grid.axes()
    return x[:, None], y[None, :]


def blob(grid: vam.Grid) -> np.ndarray:
    """A Gaussian of cured resin off the axis."""
    x, y = mesh(grid)
    return BATH + STRENGTH * np.exp(-((x - CENTER[0]) ** 2 + (y - CENTER[1]) ** 2) / WIDTH**2)


def rod(grid: vam.Grid, radius: float = 0.8, x0: float = -1.6, y0: float = 1.2) -> np.ndarray:
    x, y = mesh(grid)
    return (x - x0) ** 2 + (y - y0) ** 2 <= radius**2


def lump(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """What the rays are summed over: smooth, on no axis, and within every grid."""
    return np.exp(-((x + 0.4) ** 2 + (y - 0.7) ** 2) / 0.9**2) + 0.7 * np.exp(-((x - 2.2) ** 2 + y**2) / 0.6**2)


@cache
def by_brute_force(n: int, turned_with: bool) -> list[np.ndarray]:
    """Line integrals of `lump` at 8 poses of ``n`` columns."""
    return [brute_force(centers(n, 9.6 / n), angle, turned_with) for angle in vam.Turntable(8, lit_share=0).poses]


def brute_force(r: np.ndarray, angle: float, turned_with: bool = True, step: float = 0.02) -> np.ndarray:
    """Line integrals of `lump`: d(n·t)/ds = ∇n from the formula of the blob, classical Runge-Kutta along the length."""
    c, s = np.cos(angle), np.sin(angle)
    # a blob that stays in the laboratory sits, in the resin, where the resin has turned away from it
    x0, y0 = CENTER if turned_with else (CENTER[0] * c - CENTER[1] * s, CENTER[0] * s + CENTER[1] * c)

    def slope(state: np.ndarray) -> np.ndarray:
        x, y, px, py = state
        hump = STRENGTH * np.exp(-((x - x0) ** 2 + (y - y0) ** 2) / WIDTH**2)
        n = BATH + hump
        pull = -2.0 * hump / WIDTH**2
        return np.stack([px / n, py / n, pull * (x - x0), pull * (y - y0)])

    far = 5.0
    state = np.stack([-r * s + far * c, r * c + far * s, np.full_like(r, -BATH * c), np.full_like(r, -BATH * s)])
    total = np.zeros_like(r)
    for _ in range(round(2 * far / step)):
        before = lump(*state[:2])
        a = slope(state)
        b = slope(state + 0.5 * step * a)
        d = slope(state + 0.5 * step * b)
        halfway = state + 0.5 * step * b
        state = state + step / 6.0 * (a + 2 * b + 2 * d + slope(state + step * d))
        total += step / 6.0 * (before + 4.0 * lump(*halfway[:2]) + lump(*state[:2]))
    return total


@cache
def traced_lump(n: int, device: str) -> np.ndarray:
    grid = vam.Grid((n, n, 1), 9.6 / n)
    geometry = grid, vam.Beam((n, 1), grid.pitch), vam.Turntable(8, lit_share=0)
    A = TracedProjection(*geometry, CoRotatingMedium(blob(grid), bath=BATH), device=device)
    return A(lump(*mesh(grid))[..., None])[..., 0]


def worst(n: int, device: str, turned_with: bool) -> float:
    """Largest gap to brute force at 8 poses, over the largest integral."""
    gaps = [
        np.abs(row - wanted).max()
        for row, wanted in zip(traced_lump(n, device), by_brute_force(n, turned_with), strict=True)
    ]
    return max(gaps) / float(traced_lump(n, device).max())


def test_a_blob_off_the_axis_bends_light_as_an_independent_tracer_says(opencl_name: str) -> None:
    coarse, fine = worst(64, opencl_name, True), worst(128, opencl_name, True)
    assert fine <= 2e-3
    assert fine <= 0.35 * coarse  # second order in the voxel


def test_a_blob_that_stays_in_the_laboratory_is_another_thing() -> None:
    assert worst(64, "numpy", False) > 0.1


def test_without_fields_it_is_the_plain_projection_to_the_discretization(device: Device) -> None:
    gaps = []
    for n in (32, 64):
        geometry = vam.Grid((n, n, 2), 9.6 / n), vam.Beam((n, 2), 9.6 / n), vam.Turntable(10, lit_share=0)
        volume = np.repeat(lump(*mesh(geometry[0]))[..., None], 2, axis=2)
        grid, beam, motion = geometry
        plain = vam.Projection(grid, replace(beam, spread=0), motion, device=device)(volume)
        traced = TracedProjection(*geometry, device=device)(volume)
        gaps.append(np.abs(plain - traced).max() / plain.max())
    assert gaps[1] <= 2e-3 and gaps[1] <= 0.35 * gaps[0]


def test_a_disc_absorbs_as_beer_and_lambert_say(device: Device) -> None:
    extinction, radius, fine, gaps = 0.3, 3.6, 8, []
    for n in (32, 128):
        x = centers(n * fine, 9.6 / (n * fine))
        inside = (x[:, None] ** 2 + x[None, :] ** 2 <= radius**2).astype(float)
        share = inside.reshape(n, fine, n, fine).mean(axis=(1, 3))
        geometry = vam.Grid((n, n, 1), 9.6 / n), vam.Beam((n, 1), 9.6 / n), vam.Turntable(6, lit_share=0)
        A = TracedProjection(*geometry, CoRotatingMedium(extinction=extinction * share), device=device)
        r = centers(n, 9.6 / n)
        wanted = -np.expm1(-2.0 * extinction * np.sqrt(np.maximum(radius**2 - r**2, 0.0)))
        gap = np.abs(A(np.ones((n, n, 1)))[..., 0] - wanted)
        gaps.append(gap[:, np.abs(r) < 0.9 * radius].max())
    assert gaps[1] <= 2e-3 and gaps[1] <= 0.3 * gaps[0]


def test_light_fades_with_depth(device: Device) -> None:
    n, pitch, extinction = 40, 0.1, 0.9
    geometry = vam.Grid((n, n, 1), pitch), vam.Beam((n, 1), pitch), vam.Turntable(4, lit_share=0)
    A = TracedProjection(*geometry, CoRotatingMedium(extinction=extinction), device=device)
    light = np.zeros(A.range.shape)
    light[0] = 1.0  # from +x
    dose = A.T(light)[:, n // 2, 0] / pitch
    depth = (n - 0.5 - np.arange(n)) * pitch
    wanted = extinction * np.exp(-extinction * depth)
    assert np.abs(dose[2:-2] / wanted[2:-2] - 1.0).max() <= 5e-3


@pytest.mark.parametrize("rise", [0.0, 0.05], ids=["matrix", "marched"])
def test_an_insert_casts_a_full_shadow(device: Device, rise: float) -> None:
    n, pitch = 24, 0.4
    grid, beam = vam.Grid((n, n, 5), pitch), vam.Beam((n, 5), pitch)
    stop = rod(grid, 1.6, 1.0, -1.0)
    rays = RayBundle.parallel(beam, rise)
    A = TracedProjection(grid, beam, vam.Turntable(4, lit_share=0), CoRotatingMedium(opaque=stop), rays, device)
    light = np.zeros(A.range.shape)
    light[0] = 1.0  # from +x
    dose = A.T(light)[:, :, 2]
    x, y = mesh(grid)
    behind = (np.abs(y + 1.0) < 1.6 - pitch) & (x < 1.0)
    beside = (np.abs(y + 1.0) > 1.6 + pitch) & (np.abs(x) < 3.0) & (np.abs(y) < 4.0)
    before = (np.abs(y + 1.0) < 1.6 - pitch) & (x > 1.0 + 1.6 + pitch) & (x < 4.0)
    assert (dose[behind] == 0.0).all() and (dose[stop] == 0.0).all()
    free = pitch / np.cos(rise)
    assert np.allclose(dose[beside], free, rtol=0.02) and np.allclose(dose[before], free, rtol=0.02)


def test_no_light_leaks_through_a_slanted_wall() -> None:
    n = 33
    grid, beam = vam.Grid((n, n, 1), 0.1), vam.Beam((n, 1), 0.1)
    wall = np.eye(n, dtype=bool)  # voxels that touch by their edges only
    A = TracedProjection(grid, beam, vam.Turntable(360, lit_share=0), CoRotatingMedium(opaque=wall), device="numpy")
    light = np.zeros(A.range.shape)
    light[90:91] = 1.0  # from +y
    dose = A.T(light)[..., 0]
    assert dose[np.triu_indices(n, 2)].min() > 0.0
    assert dose[np.tril_indices(n, -2)].max() == 0.0


def test_lights_of_one_path_agree_however_they_are_traced(device: Device) -> None:
    grid, beam, motion = vam.Grid((16, 15, 8), 0.6), vam.Beam((17, 8), 0.6), vam.Turntable(3, lit_share=0)
    index = blob(grid)
    level = TracedProjection(grid, beam, motion, CoRotatingMedium(index, 0.2, bath=BATH), device=device)
    tall = np.repeat(index[..., None], 8, axis=2)
    deep = CoRotatingMedium(tall, np.full(grid.shape, 0.2), bath=BATH)
    marched = TracedProjection(grid, beam, motion, deep, device=device)
    assert level.entries and not marched.entries
    volume = np.random.default_rng(0).random(grid.shape)
    inner = slice(3, 5)  # the bath above and below bends rays of the outer rows
    assert np.abs(level(volume) - marched(volume))[..., inner].max() <= 1e-5 * level(volume).max()


def test_an_upright_lens_bends_light_upright(device: Device) -> None:
    """An index that falls with z turns level rays down: z″ = n′/n, so that z = −g·L²/2 behind a length L."""
    n, pitch, gradient = 32, 0.1, 0.02
    grid, beam = vam.Grid((n, n, n), pitch), vam.Beam((n, n), pitch)
    height = grid.axes()[2]
    index = np.broadcast_to(BATH * np.exp(-gradient * height), grid.shape)
    A = TracedProjection(
        grid, beam, vam.Turntable(1, lit_share=0), CoRotatingMedium(np.array(index), bath=BATH), device=device
    )
    light = np.zeros(A.range.shape)
    light[0, n // 2, n // 2] = 1.0  # enters at +x
    dose = A.T(light)[3:6].sum(axis=(0, 1))
    length = (n - 1 - 4.0 + 1.0) * pitch
    fall = height[n // 2] - float((dose * height).sum() / dose.sum())
    assert abs(fall / (0.5 * gradient * length**2) - 1.0) < 0.15


# ---- overprinting --------------------------------------------------------------------------------------------------
def test_knowing_the_insert_prints_better_around_it() -> None:
    n, device = 48, vam.open_device()
    grid, beam, motion = vam.Grid((n, n, 1), 9.6 / n), vam.Beam((n, 1), 9.6 / n), vam.Turntable(90, lit_share=0)
    steel = rod(grid, 1.0, 0.6, 0.3)
    x, y = mesh(grid)
    ring = ((x**2 + y**2 <= 3.2**2) & (x**2 + y**2 >= 2.0**2)).astype(np.float32)[..., None]
    blocked = TracedProjection(grid, beam, motion, CoRotatingMedium(opaque=steel), device=device)
    free = TracedProjection(grid, beam, motion, device=device)
    operators: tuple[Any, ...] = blocked, free
    known, unknown = (optimize(A, ring, iterations=30) for A in operators)

    def window(light: np.ndarray) -> float:
        dose, disc = blocked.T(light)[..., 0], grid.cylinder() & ~steel
        inside = ring[..., 0] > 0.5
        return float((dose[inside].min() - dose[disc & ~inside].max()) / dose.max())

    assert known.sinogram.numpy().min() >= 0.0
    assert window(known.sinogram.numpy()) > window(unknown.sinogram.numpy()) + 0.05


# ---- bad input -----------------------------------------------------------------------------------------------------
def test_fields_that_do_not_fit_are_named() -> None:
    motion = vam.Turntable(3, lit_share=0)
    with pytest.raises(ShapeMismatch, match=r"index has shape \(4, 4\); expected \(5, 4\)"):
        TracedProjection(GRID, BEAM, motion, CoRotatingMedium(index=np.full((4, 4), 1.5)), device="numpy")
    with pytest.raises(BadInput, match=r"index falls to 0\.9"):
        CoRotatingMedium(index=np.full(FLAT, 0.9))
    with pytest.raises(BadInput, match=r"extinction \[1/mm\] falls to -0\.1"):
        CoRotatingMedium(extinction=-0.1)
    with pytest.raises(BadInput, match="booleans"):
        CoRotatingMedium(opaque=np.full(FLAT, 1.5))
    with pytest.raises(ShapeMismatch, match="0 axes"):
        CoRotatingMedium(index=1.5)  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="most_steps"):
        TracedProjection(GRID, BEAM, motion, device="numpy", most_steps=0)
    with pytest.raises(BadInput, match="finite"):
        CoRotatingMedium(index=np.full(FLAT, np.nan))
    with pytest.raises(BadInput, match="upright"):
        RayBundle(np.zeros((6, 1, 1, 3)), np.broadcast_to([0.0, 0.0, 1.0], (6, 1, 1, 3)))
    with pytest.raises(ShapeMismatch, match="expected"):
        TracedProjection(GRID, BEAM, motion, rays=RayBundle.parallel(vam.Beam((7, 2), 0.1)), device="numpy")
    with pytest.raises(BadInput, match="CoRotatingMedium"):
        TracedProjection(GRID, BEAM, motion, np.ones(FLAT), device="numpy")  # type: ignore[arg-type]


def test_no_light_passes_where_all_is_opaque(device: Device) -> None:
    A = TracedProjection(
        GRID, BEAM, vam.Turntable(2, lit_share=0), CoRotatingMedium(opaque=np.ones(FLAT, bool)), device=device
    )
    assert not A(np.ones(A.domain.shape)).any() and not A.T(np.ones(A.range.shape)).any()


@pytest.mark.parametrize("rise", [0.0, 0.05], ids=["matrix", "marched"])
def test_a_ray_that_does_not_leave_is_named(device: Device, rise: float) -> None:
    with pytest.raises(BadInput, match=r"rays have not left after 7 steps of 0\.5 voxels .* column \d, row \d at 0°"):
        rays = RayBundle.parallel(BEAM, rise)
        TracedProjection(GRID, BEAM, vam.Turntable(2, lit_share=0), rays=rays, device=device, most_steps=7)


@pytest.mark.parametrize("scratch", [traced_projection.SCRATCH, 1], ids=["all poses together", "one at a time"])
def test_the_limit_of_trapped_rays_counts_all_poses(scratch: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 101 poses, two have one ray near enough to a diagonal of 20 voxels to take more than 64 half voxels."""
    monkeypatch.setattr(traced_projection, "SCRATCH", scratch)
    grid, beam, motion = vam.Grid((20, 20, 1), 0.1), vam.Beam((31, 1), 0.1), vam.Turntable(101, lit_share=0)
    with pytest.warns(OpticsWarning, match="2 of 3131 rays are guided"):
        TracedProjection(grid, beam, motion, device="numpy", most_steps=64)
    with pytest.raises(BadInput, match=r"4 of 3131 rays .* the first in column 15, row 0 at 46\.34°"):
        TracedProjection(grid, beam, motion, device="numpy", most_steps=63)
