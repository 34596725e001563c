"""The default method: its loss, its voxels, what it keeps dark, and how its light prints below the voxel."""

from __future__ import annotations

import warnings
from dataclasses import fields, replace
from functools import cache
from math import erf, sqrt
from typing import Any

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.errors import BadInput, NoLight, OpticsWarning, OutOfMemory, SamplingWarning
from vamgpu.losses import Ramp
from vamgpu.methods import LBFGS, METHODS, SurfaceRamp, run
from vamgpu.methods.limit import ExposureLimit
from vamgpu.methods.part import lit_pixels
from vamgpu.methods.plan import Plan
from vamgpu.methods.surface import FINE, across, as_fine_as_light, fine_grid
from vamgpu.operators.ring_projection import RingProjection
from vamgpu.targets.solid import Solid
from vamgpu.targets.voxelize import voxelize

PITCH = 0.12
GRID = vam.Grid((20, 20, 12), PITCH)
CENTER, RADIUS = (0.25, -0.1, 0.0), 0.55
INDICES: dict[str, Any] = {"resin_index": 1.5, "wall_index": 1.47}
VIAL = vam.Vial(radius=2.0, wall=0.2, absorption=0.1, **INDICES)


def ball(grid: vam.Grid = GRID, radius: float = RADIUS, center: tuple[float, ...] = CENTER) -> np.ndarray:
    """Fractions of a ball, right to a few hundredths."""
    return np.clip(0.5 + ball_depth(grid, radius, center) / grid.pitch, 0.0, 1.0).astype(np.float32)


def ball_depth(grid: vam.Grid, radius: float = RADIUS, center: tuple[float, ...] = CENTER) -> np.ndarray:
    x, y, z = np.meshgrid(*(axis - c for axis, c in zip(grid.axes(), center, strict=True)), indexing="ij")
    return radius - np.sqrt(x**2 + y**2 + z**2)


def box_depth(grid: vam.Grid, half: tuple[float, ...]) -> np.ndarray:
    beyond = np.stack(
        np.meshgrid(*(np.abs(axis) - h for axis, h in zip(grid.axes(), half, strict=True)), indexing="ij")
    )
    return -(np.linalg.norm(np.maximum(beyond, 0.0), axis=0) + np.minimum(beyond.max(axis=0), 0.0))


def projection(
    device: Any = None, vessel: Any = VIAL, motion: vam.Turntable | None = None, grid: vam.Grid = GRID,
    pixels: tuple[int, int] = (30, 14), pitch: float = PITCH,
) -> vam.Projection:  # fmt: skip
    return vam.Projection(grid, vam.Beam(pixels, pitch), motion or vam.Turntable(24), vessel, device)


def quietly(*given: Any, **more: Any) -> Plan:
    """A run whose angles are known to be few."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SamplingWarning)
        return vam.optimize(*given, **more)


@cache
def solved(iterations: int = 12, name: str | None = None) -> Plan:
    return quietly(projection(vam.open_device(name)), ball(), iterations=iterations)


def judged(dose: np.ndarray, part: np.ndarray, grid: vam.Grid = GRID) -> tuple[float, float, float]:
    """Least dose of the part, greatest outside, and the greatest, within the judged cylinder."""
    near = np.broadcast_to(grid.cylinder()[:, :, None], grid.shape)
    inside, outside = dose[near & (part >= 0.5)], dose[near & (part < 0.5)]
    return float(inside.min()), float(outside.max()), float(dose[near].max())


# ---- the loss --------------------------------------------------------------------------------------------------------
def written_out(dose: float, depth: float, weight: float, half: float = 0.1) -> float:
    """Of one voxel, by its definition, with a width of 1 and half a step between the thresholds."""
    threshold = 0.8 + half * min(max(depth, -1.0), 1.0)
    if depth >= 0.0:
        return 0.5 * weight * (max(0.0, threshold - dose) ** 2 + max(0.0, dose - 0.95 - half) ** 2)
    return 0.5 * weight * max(0.0, dose - threshold) ** 2


def test_the_loss_is_its_formula_and_its_gradient_that_of_differences(device: Any) -> None:
    rng = np.random.default_rng(0)
    shape = (6, 6, 4)
    depth, dose = rng.uniform(-1.6, 1.6, shape), rng.uniform(0.5, 1.3, shape).astype(np.float32)
    weight = rng.uniform(0.5, 2.0, shape).astype(np.float32)
    target = np.clip(0.5 + 0.5 * depth, 0.0, 1.0).astype(np.float32)
    loss = Ramp(0.7, 0.9, 1.05, device.upload(weight))
    out = device.empty(shape)
    value = loss.value_and_gradient(device.upload(dose), device.upload(target), out)
    each = [(float(d), float(t), float(w)) for d, t, w in zip(dose.ravel(), depth.ravel(), weight.ravel(), strict=True)]
    assert value == pytest.approx(sum(written_out(*one) for one in each), rel=1e-5)
    step = 1e-6
    slopes = [(written_out(d + step, t, w) - written_out(d - step, t, w)) / (2.0 * step) for d, t, w in each]
    np.testing.assert_allclose(out.numpy().ravel(), slopes, atol=2e-6)
    held = device.empty(shape)
    loss.value_and_gradient(device.upload(dose), device.upload(target), held, reach=2.0)
    x = np.arange(6) - 2.5
    far = np.hypot(x[:, None], x[None, :]) > 2.0
    assert (held.numpy()[far] == 0.0).all() and np.array_equal(held.numpy()[~far], out.numpy()[~far])


@pytest.mark.parametrize(("cost", "step"), [(0.01, 0.1), (1.6, None), (50.0, 0.25)])
def test_the_step_grows_to_that_of_the_least_loss_and_its_cost(device: Any, cost: float, step: float | None) -> None:
    rng = np.random.default_rng(1)
    shape = (6, 6, 4)
    depth = rng.uniform(-1.6, 1.6, shape)
    dose = (0.8 + 0.2 * np.clip(depth, -1.0, 1.0) + rng.normal(0.0, 0.1, shape)).astype(np.float32)
    target = np.clip(0.5 + 0.5 * depth, 0.0, 1.0).astype(np.float32)
    each = list(zip(dose.ravel().tolist(), depth.ravel().tolist(), strict=True))
    halves = np.linspace(0.1, 0.25, 301)
    totals = [sum(written_out(d, t, 1.0, half) for d, t in each) + cost * (0.25 - half) for half in halves]
    best = float(halves[int(np.argmin(totals))])
    assert best == pytest.approx(step) if step else 0.12 < best < 0.23
    given, out = device.upload(dose), device.empty(shape)
    value = Ramp(0.7, 0.9, 1.05, steepest=2.5, cost=cost).value_and_gradient(given, device.upload(target), out)
    assert value == pytest.approx(min(totals), rel=1e-4)
    wanted = device.empty(shape)
    Ramp(0.8 - best, 0.8 + best, 0.95 + best).value_and_gradient(given, device.upload(target), wanted)
    np.testing.assert_allclose(out.numpy(), wanted.numpy(), atol=6e-4)  # the tried steps are 5e-4 apart
    assert np.array_equal(given.numpy(), dose)


@pytest.mark.parametrize("given", [(0.9, 0.9), (-0.1, 0.9), (0.7, 1.1), (0.7, float("nan")), (0.7, 0.9, 1e13)])
def test_thresholds_that_are_none(given: tuple[float, ...]) -> None:
    with pytest.raises(BadInput, match=r"outside, inside, most are .* expected 0 ≤ outside < inside ≤ most"):
        Ramp(*given)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"outside": 1.2}, "outside, inside, most are 1.2"),
        ({"outside": "half"}, "outside is 'half'; expected a finite number"),
        ({"most": None}, "most is None; expected a number"),
        ({"width": 0}, r"width \[pixels\] is 0; expected a finite number > 0"),
        ({"width": float("inf")}, "width .* is inf"),
        ({"brightest": 0.0}, r"brightest is 0\.0; expected a finite number > 0"),
        ({"brightest": float("nan")}, "brightest is nan"),
        ({"steepest": 0.9}, r"steepest is 0\.9; expected a ratio ≥ 1"),
        ({"history": 0}, "history is 0; expected a whole number of pairs ≥ 1"),
        ({"history": True}, "history is True"),
        ({"history": 2.5}, "history is 2.5"),
        ({"history_bytes": -1}, "history_bytes is -1"),
        ({"dark": 2}, "dark is 2; expected less than inside, 0.95"),
        ({"dark": -0.1}, "dark is -0.1; expected a finite number ≥ 0"),
    ],
)
def test_parameters_that_are_out_of_range(given: dict[str, Any], told: str) -> None:
    for method in (SurfaceRamp, LBFGS) if given.keys() <= {field.name for field in fields(LBFGS)} else (SurfaceRamp,):
        with pytest.raises(BadInput, match=told):
            method(**given)


@pytest.mark.parametrize("wrong", [{"steepest": 0.5}, {"steepest": np.nan}, {"cost": -1.0}, {"cost": np.inf}])
def test_a_ramp_refuses_steps_that_shrink_and_costs_below_zero(wrong: dict[str, float]) -> None:
    with pytest.raises(BadInput, match=f"^{next(iter(wrong))} is "):
        Ramp(0.7, 0.9, **wrong)


# ---- its voxels and their depth --------------------------------------------------------------------------------------
def solid(mesh: Any) -> Solid:
    return Solid(np.asarray(mesh.vertices), np.asarray(mesh.faces), "part")


@pytest.mark.parametrize("given", ["mesh", "fractions", pytest.param("array", marks=pytest.mark.slow)])
@pytest.mark.parametrize("shape", ["ball", "box"])
@pytest.mark.parametrize(
    ("pitch", "voxel", "width"), [(0.12, 0.12, 1.0), (0.12, 0.06, 1.0), (0.36, 0.03, 1.0), (0.12, 0.12, 4.0)]
)
def test_ramps_are_those_of_the_distance(given: str, shape: str, pitch: float, voxel: float, width: float) -> None:
    """Of voxels that are wider and narrower than 3/4 of a pixel, and of ramps of more voxels than a search spans."""
    import trimesh

    n = 4 * round(0.5 / voxel)
    grid = vam.Grid((n, n, n), voxel)
    A = projection("numpy", None, vam.Turntable(4), grid, (round(3.6 / pitch), round(2.4 / pitch)), pitch)
    fine: Any = as_fine_as_light(A)
    if shape == "ball":
        mesh, depth = trimesh.creation.icosphere(4, 0.6).apply_translation((0.1, 0.0, 0.0)), ball_depth
        wanted = depth(fine.grid, 0.6, (0.1, 0.0, 0.0))
    else:
        mesh, wanted = trimesh.creation.box((1.0, 0.8, 1.3)), box_depth(fine.grid, (0.5, 0.4, 0.65))
    fractions = voxelize(solid(mesh), grid, A.device).fraction.numpy()
    target: Any = vam.Target.from_array(fractions, voxel)
    if given == "mesh":
        target = replace(target, solid=solid(mesh))
    found = across(fractions if given == "fractions" else target, grid, fine, width).numpy()
    off = np.abs(found - np.clip(0.5 + wanted / (2.0 * width * pitch), 0.0, 1.0))
    assert off.max() <= (0.16 if shape == "box" and given != "mesh" else 0.11)  # at the edges of a box seen on voxels
    assert np.sqrt((off**2).mean()) <= (0.014 if shape == "box" and given != "mesh" else 0.009)
    assert (found.min(), found.max()) == ((0.0, 1.0) if width == 1.0 else (found.min(), found.max()))


@pytest.mark.parametrize(
    ("vessel", "voxel"), [(None, PITCH), (VIAL, PITCH), (VIAL, 0.05), (vam.Fan(VIAL, throw=200.0), PITCH)]
)
def test_fine_voxels_hold_the_judged_cylinder_and_some_above_and_below(vessel: Any, voxel: float) -> None:
    grid = vam.Grid((20, 20, 12), voxel)
    A = projection(vessel=vessel, grid=grid)
    found, pixel = fine_grid(A), vam.resin_pixel(A.beam, vessel)
    assert found is not None
    assert found.pitch == pytest.approx(min(voxel, FINE * min(pixel)))
    assert found.inscribed_radius >= grid.inscribed_radius * (1.0 - 1e-9)
    assert found.shape[2] * found.pitch >= grid.shape[2] * voxel + 4.0 * pixel[1] - 1e-9
    assert max(found.shape[:2]) * found.pitch <= grid.shape[0] * voxel + 6.0 * found.pitch
    on_rings: Any = as_fine_as_light(vam.RingProjection(grid, A.beam, A.motion, vessel, "numpy"))
    assert isinstance(on_rings, RingProjection) and on_rings.grid == found


def test_a_single_row_lights_every_fine_slice() -> None:
    grid = vam.Grid((20, 20, 1), PITCH)
    x, y, _ = grid.axes()
    part = (np.hypot(x[:, None] - 0.2, y[None, :]) < 0.6)[:, :, None].astype(np.float32)
    A = projection(grid=grid, pixels=(30, 1))
    fine: Any = as_fine_as_light(A)
    even = fine.T(A.device.upload(np.ones(A.range.shape, np.float32))).numpy()
    near = np.broadcast_to(fine.grid.cylinder()[:, :, None], even.shape)
    assert even[near].min() > 0.3 * even.max()
    assert across(part, grid, fine, 1.0).numpy().max() == 1.0
    plan = quietly(A, part, iterations=8)
    assert plan.history[-1].window > -0.1 and plan.history[-1].loss < 0.2 * plan.history[0].loss
    assert plan.dose().numpy()[part >= 0.5].mean() == pytest.approx(0.9, abs=0.1)


def test_light_of_voxels_of_its_own_is_in_units_of_the_targets(fast_device: Any) -> None:
    """Eight fine voxels lie in one of the target: the dose of the part was 8."""
    A = projection(fast_device)
    assert (A.grid.pitch / fine_grid(A).pitch) ** 3 == pytest.approx(8.0, rel=1e-3)  # type: ignore[union-attr]
    method = SurfaceRamp(steepest=1.0)
    plan = quietly(A, ball(), method, iterations=6)
    assert plan.dose().numpy()[ball() > 0.99].mean() == pytest.approx(0.95, abs=0.06)
    begun = quietly(A, ball(), method, start=plan, iterations=1)
    assert begun.history[0].loss < 1.2 * plan.history[-1].loss
    assert plan.window == pytest.approx(window_of(*judged(plan.dose().numpy(), ball())), abs=1e-5)


def window_of(least: float, leak: float, greatest: float) -> float:
    return (least - leak) / greatest


# ---- what it keeps dark ----------------------------------------------------------------------------------------------
def test_pixels_that_never_meet_the_part_stay_dark(fast_device: Any) -> None:
    A = projection(fast_device)
    rng = np.random.default_rng(0)
    start = rng.random(A.range.shape, np.float32)
    for begun in ({}, {"start": start}):
        plan = quietly(A, ball(), iterations=8, **begun)
        fine: Any = as_fine_as_light(A)
        lit = lit_pixels(fine, across(ball(), GRID, fine, 1.0)).numpy()
        light = plan.sinogram.numpy()
        assert 0.3 < (lit == 0.0).mean() < 0.9 and light[lit == 0.0].max() == 0.0 < light.max()
        assert plan.idle_light <= 1e-3  # by the target's own voxels


def test_resin_beside_the_part_stays_dark(processor: str) -> None:
    """By the proof, whose rays are its own, of a rod beside the axis of a narrow vial: as dark as was asked."""
    vial, grid = vam.Vial(radius=1.5, wall=0.15, absorption=0.1, **INDICES), vam.Grid((20, 20, 8), 0.08)
    x, y, _ = grid.axes()
    rod = (np.hypot(x[:, None] - 0.3, y[None, :]) < 0.3)[:, :, None] * np.ones(8, np.float32)
    A = projection(vam.open_device(processor), vial, vam.Turntable(60), grid, (40, 8), 0.08)
    shares = []
    for method in (SurfaceRamp(), SurfaceRamp(dark=0.3)):
        plan = quietly(A, rod, method, iterations=25)
        proof = vam.simulate(A, vam.pack(plan), rod)
        assert proof.outer is not None and plan.window > 0.0
        shares.append(proof.outer_share)
    assert shares[0] <= 0.9 and shares[1] < shares[0] - 0.05
    assert shares[1] <= 1.25 * 0.3 / 0.85  # cells are as wide as two voxels: within them it is brighter


def test_the_brightest_pixel_keeps_its_bound(processor: str) -> None:
    A = projection(vam.open_device(processor))
    fine: Any = as_fine_as_light(A)
    lit = lit_pixels(fine, across(ball(), GRID, fine, 1.0)).numpy()
    free = quietly(A, ball(), SurfaceRamp(brightest=1e6), iterations=15).sinogram.numpy()
    weighted = float(((free * lit) ** 2).sum() / (free * lit).sum())
    for most in (0.5 * float(free.max()), 2.0 * float((free * lit).mean())):
        method = SurfaceRamp(brightest=most / weighted)
        light = quietly(A, ball(), method, start=free, iterations=10).sinogram.numpy()
        assert light.max() == pytest.approx(most, rel=1e-4) and light.max() < 0.6 * free.max()
    light = quietly(A, ball(), SurfaceRamp(brightest=0.8), iterations=10).sinogram.numpy()
    assert light.max() < 0.7 * free.max() and (light > 0.999 * light.max()).sum() > 20


def test_dark_pixels_beside_the_part_do_not_change_the_brightest(processor: str) -> None:
    narrow, wide = (projection(vam.open_device(processor), pixels=pixels) for pixels in ((30, 14), (48, 22)))
    most = [quietly(A, ball(), SurfaceRamp(brightest=1.0), iterations=2).sinogram.numpy().max() for A in (narrow, wide)]
    assert most[1] == pytest.approx(most[0], rel=0.02)


def limit_of(plan: Plan, given: dict[str, float]) -> float:
    """How long its exposure lasts [s], by its dose."""
    least, leak, _ = judged(plan.dose().numpy(), ball())
    limit = ExposureLimit.of(1.0, **given)
    assert limit is not None
    return limit.seconds_of(plan.operator, plan.sinogram, 0.5 * (least + leak))


def test_an_exposure_limit_holds_on_the_targets_voxels(processor: str) -> None:
    given: dict[str, Any] = {"irradiance": 100.0, "critical_dose": 50.0}
    A = projection(vam.open_device(processor))
    free = quietly(A, ball(), iterations=25)
    whole = limit_of(free, given)
    with pytest.raises(BadInput, match="is too short") as refused:
        quietly(A, ball(), iterations=2, exposure_limit=0.3 * whole, **given)
    least = float(str(refused.value).split("voxel of the part takes ")[1].split(" s")[0])
    for share in (0.3, 0.7):
        seconds = least + share * (whole - least)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", OpticsWarning)  # the window may be gone
            plan = quietly(A, ball(), iterations=25, exposure_limit=seconds, **given)
            again = quietly(A, ball(), iterations=27, exposure_limit=seconds, resume=plan, **given)
        assert 0.9 * seconds <= limit_of(plan, given) <= seconds * (1.0 + 1e-5)
        assert limit_of(again, given) <= seconds * (1.0 + 1e-5)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        plan = vam.optimize(A, ball(), iterations=25, exposure_limit=2.0 * whole, **given)
    assert np.array_equal(plan.sinogram.numpy(), free.sinogram.numpy())
    assert any("exposure limit" in str(each.message) for each in told) == (plan.window <= 0.0)


# ---- the step of the thresholds --------------------------------------------------------------------------------------
def test_a_part_that_allows_it_gets_a_wider_step(fast_device: Any) -> None:
    """Judged a pixel and more from the surface of a ball."""
    A, depth, found = projection(fast_device), ball_depth(GRID), list[float]()
    near = np.broadcast_to(GRID.cylinder()[:, :, None], GRID.shape)
    for method in (SurfaceRamp(steepest=1.0), SurfaceRamp()):
        plan = quietly(A, ball(), method, iterations=40)
        dose = plan.dose().numpy()
        inside, outside = dose[near & (depth >= PITCH)].min(), dose[near & (depth <= -PITCH)].max()
        found.append(float((inside - outside) / dose[near].max()))
    assert found[1] > found[0] + 0.04, found


# ---- runs ------------------------------------------------------------------------------------------------------------
def test_a_resumed_run_is_one_run(tmp_path: Any) -> None:
    A, once = projection(None), solved(7)
    first = quietly(A, ball(), iterations=3)
    before = first.sinogram.numpy().copy()
    kept = vam.load(first.save(tmp_path / "first.vam"), A.device)
    assert isinstance(kept, Plan) and kept.method == first.method and np.array_equal(kept.sinogram.numpy(), before)
    for begun in (first, kept):
        again = quietly(begun.operator, ball(), iterations=7, resume=begun)
        assert np.array_equal(again.sinogram.numpy(), once.sinogram.numpy())
        assert (again.window, again.evaluations) == (once.window, once.evaluations)
    assert np.array_equal(first.sinogram.numpy(), before)


def test_evaluations_are_those_that_are_made(fast_device: Any) -> None:
    """One to begin with, one for the loss of that, one a step, and no more than may be spent."""
    plan = quietly(projection(fast_device), ball(), evaluations=9.0)
    assert [step.evaluations for step in plan.history] == sorted(step.evaluations for step in plan.history)
    assert 8.0 <= plan.evaluations <= 9.0 and plan.history[-1].loss < plan.history[0].loss


def test_light_to_start_from() -> None:
    A = projection(None)
    with pytest.raises(NoLight, match="initial light is dark in all pixels whose rays meet the part"):
        fine: Any = as_fine_as_light(A)
        idle = 1.0 - lit_pixels(fine, across(ball(), GRID, fine, 1.0)).numpy()
        quietly(A, ball(), start=idle, iterations=1)
    first, second = solved(7), quietly(A, ball(), start=solved(12), iterations=2)
    assert second.history[0].loss <= first.history[-1].loss


def test_light_by_rings_ends_where_that_by_rays_does(processor: str) -> None:
    """Judged by rays; the same voxels, and rings that err by a little."""
    motion = vam.Turntable(90)
    A = projection(vam.open_device(processor), motion=motion)
    rays, rings = (
        quietly(each, ball(), iterations=25) for each in (A, vam.RingProjection(GRID, A.beam, motion, VIAL, A.device))
    )
    worth = window_of(*judged(np.asarray(A.T(rings.sinogram.numpy())), ball()))
    assert rings.window == pytest.approx(worth, abs=1e-5)
    assert worth == pytest.approx(rays.window, abs=0.003)


def test_devices_agree(fast_device: Any) -> None:
    wanted = quietly(projection("numpy"), ball(), iterations=5)
    got = quietly(projection(fast_device), ball(), iterations=5)
    scale = wanted.sinogram.numpy().max()
    np.testing.assert_allclose(got.sinogram.numpy() / scale, wanted.sinogram.numpy() / scale, atol=2e-3)
    assert got.window == pytest.approx(wanted.window, abs=2e-3)


def test_a_sheet_of_one_pixel_has_a_window_in_its_history() -> None:
    """No voxel of it lies a pixel deep."""
    sheet = np.zeros(GRID.shape, np.float32)
    sheet[6:14, 6:14, 5:6] = 1.0
    plan = quietly(projection(None, None), sheet, iterations=10)
    assert plan.history[-1].window > 0.0 and plan.window > -0.2


def test_light_is_kept_where_memory_does_not_do_to_judge_it(monkeypatch: pytest.MonkeyPatch) -> None:
    real, wanted, A = run.OptimizerState.window, solved(7), projection(None)

    def window(self: Any, dose: Any) -> tuple[float, float]:
        if dose.shape == GRID.shape:
            raise OutOfMemory("the volume of the target's voxels does not fit")
        return real(self, dose)

    monkeypatch.setattr(run.OptimizerState, "window", window)
    plan = quietly(A, ball(), iterations=7)
    assert np.array_equal(plan.sinogram.numpy(), wanted.sinogram.numpy())
    assert plan.window == plan.history[-1].window and "memory did not suffice" in plan.notes[-1]


# ---- windows below the voxel -----------------------------------------------------------------------------------------
def exposed(light: np.ndarray, poses: np.ndarray, beam: vam.Beam, points: list[np.ndarray], lit: float) -> np.ndarray:
    """Dose of parallel light in air at points (x, y, z axes), by the mean of each pixel's blurred square.

    Shares nothing with the library but the order of light: [angle, column, row].
    """
    x, y = (each.ravel() for each in np.meshgrid(points[0], points[1], indexing="ij"))

    def share(at: np.ndarray, pixels: int) -> np.ndarray:
        apart = at[:, None] / beam.pitch - (np.arange(pixels) - 0.5 * (pixels - 1))
        step = np.vectorize(lambda t: 0.5 * (1.0 + erf(t / (0.5 * sqrt(2.0)))))  # a spread of half a pixel
        return step(apart + 0.5) - step(apart - 0.5)

    rows = share(points[2], beam.pixels[1])
    table = np.linspace(-1.5 * beam.pixels[0], 1.5 * beam.pixels[0], 6001) * beam.pitch * 0.5
    columns, found = share(table, beam.pixels[0]), 0.0
    turned = (np.arange(4) - 1.5) / 4.0 * lit * 2.0 * np.pi / len(poses)
    for angle, frame in zip(poses, light, strict=True):
        for turn in angle + turned:
            r = y * np.cos(turn) - x * np.sin(turn)
            at = np.interp(r, table, np.arange(table.size))
            low = np.minimum(at.astype(int), table.size - 2)
            part = (at - low)[:, None]
            found = found + (columns[low] * (1.0 - part) + columns[low + 1] * part) @ frame
    return (found @ rows.T).reshape(len(points[0]), len(points[1]), len(points[2]))


def comb(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Depth below the surface of a comb with teeth three pixels wide, by the largest norm."""

    def block(at: float, beside: float, half: float, tall: float) -> np.ndarray:
        return -np.maximum(np.maximum(np.abs(x - at) - half, np.abs(y - beside) - tall), np.abs(z) - 0.3)

    teeth = [block(at, 0.0, 0.15, 1.0) for at in (-0.9, -0.45, 0.0, 0.45, 0.9)]
    return np.max([block(0.0, -0.9, 1.1, 0.2), *teeth], axis=0)


def comb_on(grid: vam.Grid) -> np.ndarray:
    """The filled part of each voxel, by 64 points."""
    offsets, found = (np.arange(4) - 1.5) / 4.0 * grid.pitch, np.zeros(grid.shape, np.float32)
    for offset in np.stack(np.meshgrid(offsets, offsets, offsets), axis=-1).reshape(-1, 3):
        found += comb(*np.meshgrid(*(axis + o for axis, o in zip(grid.axes(), offset, strict=True)), indexing="ij")) > 0
    return found / 64.0


@pytest.mark.slow
def test_windows_below_the_voxel_are_wider_than_by_two_thresholds(processor: str) -> None:
    """On the target's voxels and on the finer ones of the ramp, by quarters of a pixel, every frame at four places."""
    pitch = 0.1
    grid, beam, motion = vam.Grid((36, 36, 8), pitch), vam.Beam((38, 10), pitch), vam.Turntable(90)
    A = vam.Projection(grid, beam, motion, None, vam.open_device(processor))
    fine: Any = as_fine_as_light(A)
    plans = [
        quietly(A, comb_on(grid), evaluations=30.0),
        quietly(A, comb_on(grid), LBFGS(), evaluations=30.0),
        quietly(fine, comb_on(fine.grid), LBFGS(), evaluations=30.0),
    ]
    points = [np.arange(-1.3, 1.3, 0.025), np.arange(-1.3, 1.3, 0.025), np.arange(-0.38, 0.38, 0.05)]
    depth, windows = comb(*np.meshgrid(*points, indexing="ij")), []
    for plan in plans:
        dose = exposed(plan.sinogram.numpy(), motion.poses, beam, points, 1.0)
        windows.append([(dose[depth >= w].min() - dose[depth <= -w].max()) / dose.max() for w in (0.05, 0.1)])
    (half, whole), coarse, fine_ones = windows
    assert half > 0.0 and whole > 0.15
    assert half > coarse[0] + 0.1 and whole > coarse[1] + 0.1
    assert half > fine_ones[0] + 0.01 and whole > fine_ones[1] + 0.02


# ---- other operators and targets -------------------------------------------------------------------------------------
UNEVEN = np.sort(np.random.default_rng(0).uniform(0.0, 6.28, 24))
OTHERS: dict[str, Any] = {
    "uneven": lambda: projection(motion=vam.Turntable(UNEVEN)),
    "dwell": lambda: projection(motion=vam.Turntable(24, np.linspace(0.5, 1.5, 24))),
    "one angle": lambda: projection(motion=vam.Turntable(1)),
    "vat": lambda: projection(vessel=vam.Vat(4.0, absorption=0.3)),
    "misaligned": lambda: projection(vessel=vam.Misaligned(VIAL, offset=0.1)),
    "fan": lambda: projection(vessel=vam.Fan(VIAL, throw=300.0)),
    "bath": lambda: projection(vessel=vam.SquareBath(replace(VIAL, bath_index=1.45), width=6.0, wall=0.5,
                                                     wall_index=1.5)),
    "defocused": lambda: vam.Defocused(projection(), vam.Defocus(0.25, 5.0)),
}  # fmt: skip


@pytest.mark.parametrize("name", OTHERS)
def test_other_operators_take_it(name: str) -> None:
    A = OTHERS[name]()
    plan = quietly(A, ball(), iterations=3)
    assert plan.operator is A and isinstance(plan.method, SurfaceRamp) and plan.sinogram.shape == A.range.shape
    light = plan.sinogram.numpy()
    assert np.isfinite(light).all() and light.min() >= 0.0 < light.max()
    assert plan.history[-1].loss < plan.history[0].loss
    assert plan.window == pytest.approx(window_of(*judged(np.asarray(plan.dose().numpy()), ball())), abs=1e-4)
    assert plan.dose().numpy()[ball() > 0.99].mean() == pytest.approx(0.975, abs=0.35 if name == "one angle" else 0.15)


def test_bodies_with_limits_of_their_own_keep_the_targets_voxels() -> None:
    part = vam.Body(lambda x, y, z: np.sqrt(x**2 + y**2 + z**2) - 0.5, name="ball")
    kept = vam.Body(lambda x, y, z: np.sqrt((x - 0.75) ** 2 + y**2 + z**2) - 0.15, "keep out", dose=0.4)
    target = vam.Scene((part, kept)).target(pitch=PITCH, shape=GRID.shape, device="numpy")
    plan = quietly(projection(None, None), target, iterations=15)
    dose, body = plan.dose().numpy(), target.limits.body  # type: ignore[union-attr]
    free = quietly(projection(None, None), target.numpy(), iterations=15).dose().numpy()
    least = [each[body == 0].mean() for each in (dose, free)]
    assert dose[body == 1].max() / least[0] < 0.9 * free[body == 1].max() / least[1]


@pytest.mark.slow
def test_tolerances_are_met_on_voxels_as_fine_as_light_or_by_those_of_the_target(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    A, off = projection(None), vam.Tolerances(absorption=0.05)
    plan = quietly(A, ball(), iterations=2, tolerances=off)
    assert plan.method == SurfaceRamp() and plan.corners is not None
    assert plan.window == pytest.approx(off.doses(A, plan, ball()).window, abs=1e-5)
    again = quietly(A, ball(), iterations=3, tolerances=off, resume=plan)
    assert len(again.history) == 3
    assert quietly(A, ball(), SurfaceRamp(width=2.0), 1, tolerances=off).corners is not None
    monkeypatch.setattr(run.OptimizerState, "has_room", lambda *given: False)
    coarse = quietly(A, ball(), iterations=2, tolerances=off)
    assert "all corners on voxels as fine as needed" in coarse.notes[-1] and coarse.notes[:-1] == plan.notes
    assert coarse.window == pytest.approx(off.doses(A, coarse, ball()).window, abs=1e-5)
    assert abs(coarse.window - plan.window) > 1e-5


def test_it_is_the_default_by_every_name() -> None:
    assert METHODS["default"] is METHODS["ramp"] is SurfaceRamp
    with pytest.raises(BadInput, match="resume with the same method"):
        quietly(projection(None), ball(), "lbfgs", resume=solved(7))
