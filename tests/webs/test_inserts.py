"""Things that a web carries in its film: what they shade, the transpose, and scenes on webs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from slanted import Slanted

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, EmptyMesh, ShapeMismatch
from vamgpu.operators.web import WebProjection
from vamgpu.operators.web_insert import WebInsertProjection
from vamgpu.optics.film import Film
from vamgpu.optics.roller import Roller
from vamgpu.scene import Body, Scene
from vamgpu.targets.solid import Solid
from vamgpu.web import WebGrid

EDGE = 0.1
ALPHA = 0.5
STEP = EDGE / 1.4  # one column a pose


def roller(**given: Any) -> Roller:
    return Roller(1.1, Film(0.6, 1.49, 1.33, ALPHA), **{"step": STEP, "legs": 0.25, "rays": 4} | given)


PIXEL = 0.3
GRID = WebGrid((24, 6, 3), (EDGE, EDGE, PIXEL))


def beam(rows: int = 3) -> vam.Beam:
    return vam.Beam((8, rows), PIXEL)


def standing(slices: slice = slice(0, 2)) -> np.ndarray:
    opaque = np.zeros(GRID.shape, bool)
    opaque[10:14, 2:4, slices] = True
    return opaque


def operator(device: Device | str, machine: Roller | None = None, **given: Any) -> WebInsertProjection:
    given = {"poses": 9, "start": -16.0} | given
    return WebInsertProjection(GRID, beam(given.pop("rows", 3)), machine or roller(), device=device, **given)


CASES: dict[str, dict[str, Any]] = {
    "opaque in some slices": {"opaque": standing()},
    "opaque in all": {"opaque": standing(slice(None))},
    "absorbs": {"extinction": np.where(standing(), 2.0, ALPHA)},
    "clearer": {"extinction": np.where(standing(), 0.0, ALPHA)},
    "both, between columns": {
        "opaque": standing(),
        "extinction": np.where(np.roll(standing(), 5, 0), 1.5, ALPHA),
        "machine": roller(step=1.3 * STEP),
    },
    "reflected": {"opaque": standing(), "machine": roller(reflectivity=0.5)},
    "more rows": {"opaque": standing(), "rows": 5},
    "a segment": {"opaque": standing(), "poses": 4, "start": -13.5},
}
every_case = pytest.mark.parametrize("case", CASES)


@every_case
def test_the_transpose_is_exact(device: Device, case: str) -> None:
    A = operator(device, **CASES[case])
    assert A.dot_test() < (1e-12 if device.name == "numpy" else 1e-5)


def test_the_transpose_is_exact_entry_by_entry(device: Device) -> None:
    grid, machine = WebGrid((8, 3, 2), (0.2, 0.2, 0.3)), roller()
    A = WebInsertProjection(
        grid, vam.Beam((4, 2), 0.6), machine, np.indices(grid.shape).sum(0) == 5, None, device, 3, -8.0
    )
    matrix, transpose = A.dense(), A.T.dense()
    assert np.abs(matrix).max() > 0
    assert np.abs(matrix - transpose.T).max() <= 3e-6 * np.abs(matrix).max()


@every_case
def test_devices_agree_with_the_reference(device: Device, case: str) -> None:
    rng, A, reference = np.random.default_rng(1), operator(device, **CASES[case]), operator("numpy", **CASES[case])
    x, y = rng.random(A.domain.shape), rng.random(A.range.shape)
    for got, wanted in ((A(x), reference(x)), (A.T(y), reference.T(y))):
        assert np.abs(got - wanted).max() <= 1e-5 * np.abs(wanted).max()


@pytest.mark.parametrize("step", [1.0, 0.7])
def test_a_film_with_nothing_in_it_is_the_plain_projection(step: float) -> None:
    machine = roller(step=step * STEP, reflectivity=0.3)
    plain = WebProjection(GRID, beam(), machine, "numpy", 9, -16.0)
    rng = np.random.default_rng(0)
    x, y = rng.random(plain.domain.shape), rng.random(plain.range.shape)
    # an insert like the resin is traced ray by ray all the same
    alike = np.where(standing(), ALPHA * (1.0 + 1e-9), ALPHA)
    for given in ({}, {"opaque": np.zeros(GRID.shape, bool)}, {"extinction": alike}):
        A = operator("numpy", machine, **given)
        assert A.motion == plain.motion and (A.entries > 0) == ("extinction" in given)
        for got, wanted in ((A(x), plain(x)), (A.T(y), plain.T(y))):
            assert np.abs(got - wanted).max() <= 1e-8 * np.abs(wanted).max()


@pytest.mark.parametrize("reflectivity", [0.0, 0.4])
@pytest.mark.parametrize("extinction", [None, 3.0])
def test_dose_is_what_points_along_the_rays_leave(reflectivity: float, extinction: float | None) -> None:
    """By summing short steps along each ray as it was traced on the bent film, asking at each what is there."""
    machine = roller(reflectivity=reflectivity, rays=3, lit_share=0.0)
    inserted = standing(slice(None))
    fields = {"opaque": inserted} if extinction is None else {"extinction": np.where(inserted, extinction, ALPHA)}
    pose, steps = 14, 6000
    start = -26.0
    A = operator("numpy", machine, poses=pose + 1, start=start, **fields)
    light = np.zeros(A.range.shape)
    light[pose] = 1.0
    dose = A.T(light)[:, :, 0]
    map, columns = machine.map(GRID), A.beam.columns()
    offsets, leans = machine._bundle(A.beam.pitch)
    rays = machine.trace(columns[:, None] + offsets, leans[0], map.leg).segments
    wanted = np.zeros(GRID.shape[:2])
    for ray in np.unique(rays.ray):
        pieces = np.flatnonzero(rays.ray == ray)
        depth = 0.0
        for k in pieces[np.argsort(rays.before[pieces])]:
            t = (np.arange(steps) + 0.5) / steps * rays.length[k]
            x, y = rays.x[k] + t * rays.dx[k], rays.y[k] + t * rays.dy[k]
            if rays.side[k] == 0:
                rho, l = np.hypot(x, y) - map.inner, np.arctan2(x, -y) * map.neutral + map.middle  # noqa: E741
            else:
                rho = rays.side[k] * x - map.inner
                l = map.middle + rays.side[k] * (0.5 * map.arc + y)  # noqa: E741
            i = np.floor(l / EDGE + start + pose).astype(int)
            j = np.clip(np.floor(rho / EDGE).astype(int), 0, GRID.shape[1] - 1)
            on = (i >= 0) & (i < GRID.shape[0])
            there = np.zeros(steps, bool)
            there[on] = inserted[i[on], j[on], 0]
            more = np.where(there, 1e6 if extinction is None else extinction, ALPHA) * rays.length[k] / steps
            passed = depth + np.cumsum(more) - 0.5 * more
            left = rays.power[k] * ALPHA * np.exp(-passed) * rays.length[k] / steps / (offsets.size * leans.size)
            np.add.at(wanted, (i[on], j[on]), left[on])
            depth = passed[-1] + 0.5 * more[-1]
    dark = inserted[:, :, 0]
    assert np.abs(dose - wanted).max() <= 1.5e-3 * wanted.max()
    assert dose.sum() == pytest.approx(wanted.sum(), rel=3e-4)
    plain = WebProjection(GRID, A.beam, machine, "numpy", poses=pose + 1, start=start).T(light)[:, :, 0]
    assert (plain - dose).max() > 0.1 * plain.max()  # it stands in the light
    assert extinction is not None or not dose[dark].any()


# ---- scenes ------------------------------------------------------------------------------------------------------
def strip(low: float = 0.4, high: float = 2.0) -> Body:
    return Body(lambda x, y, z: np.maximum(np.abs(x - 0.5 * (low + high)) - 0.5 * (high - low), np.abs(y - 0.3) - 0.2)
                + 0 * z, name="strip")  # fmt: skip


def chip(**given: Any) -> Body:
    return Body(lambda x, y, z: np.hypot(x - 1.2, y - 0.3) - 0.13 + 0 * z, "insert", name="chip", **given)


def test_a_scene_is_solved_on_a_web_past_its_insert(device: Device) -> None:
    machine = roller()
    scene = Scene([strip(), chip()])
    part = scene.web_part(GRID, device=device)
    A: Any = scene.web_operator(GRID, beam(), machine, device=device)
    plan = vam.optimize(A, part, "lbfgs", iterations=12)
    knows = plan.window
    plain = WebProjection(GRID, beam(), machine, device)
    careless = A.T(vam.optimize(plain, scene.web_part(GRID), "lbfgs", iterations=12).sinogram).numpy()
    inside, judged = part.numpy() >= 0.5, part.limits.judged if part.limits else np.ones(GRID.shape, bool)
    assert not judged[part.numpy() == 0.0].all()
    outside = judged & ~inside
    assert knows > (careless[inside].min() - careless[outside].max()) / careless[outside].max()
    assert not plan.dose().numpy()[~judged].any()


def test_bodies_lie_in_the_film_as_they_were_drawn() -> None:
    box = np.array([[0.4, 0.1, -0.1], [2.0, 0.5, 0.1]])
    corners = np.array([[box[i, 0], box[j, 1], box[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    import trimesh

    hull = trimesh.convex.convex_hull(corners)
    solid = Solid(hull.vertices, hull.faces, "box")
    filled = lambda x, y, z: np.maximum(np.maximum(np.abs(x - 1.2) - 0.8, np.abs(y - 0.3) - 0.2), np.abs(z) - 0.1)  # noqa: E731
    mask = np.zeros((40, 20, 6))
    mask[24:, 11:15, 2:4] = 1.0  # about the origin of the CAD frame, 0.1 mm a voxel
    found = [Scene([body]).web_part(WebGrid((24, 6, 4), EDGE), device="numpy").numpy()
             for body in (Body(solid), Body(filled), Body(mask, pitch=EDGE))]  # fmt: skip
    wanted = np.zeros((24, 6, 4))
    wanted[4:20, 1:5, 1:3] = 1.0
    assert np.allclose(found[0], wanted, atol=1e-3) and np.allclose(found[1], wanted, atol=1e-3)
    assert np.allclose(found[2][4:20], wanted[4:20], atol=1e-3)
    moved = Scene([Body(filled)], origin=(-0.3, 0.0, 0.0)).web_part(WebGrid((24, 6, 4), EDGE), device="numpy")
    assert np.allclose(moved.numpy(), np.roll(wanted, 3, 0), atol=1e-3)


def test_an_insert_that_absorbs_takes_the_place_of_resin() -> None:
    machine = roller()
    A: Any = Scene([strip(), chip(absorption=2.0)]).web_operator(GRID, beam(), machine, device="numpy")
    plain: Any = Scene([strip(), chip(absorption=ALPHA)]).web_operator(GRID, beam(), machine, device="numpy")
    opaque: Any = Scene([strip(), chip()]).web_operator(GRID, beam(), machine, device="numpy")
    light = np.ones(A.range.shape)
    doses = [operator.T(light)[11:13, 0].mean() for operator in (opaque, A, plain)]  # at the roller's side, behind it
    assert doses[0] < doses[1] < 0.98 * doses[2]
    without: Any = Scene([strip()]).web_operator(GRID, beam(), machine, device="numpy")
    assert isinstance(without, WebProjection)
    assert doses[2] == pytest.approx(without.T(light)[11:13, 0].mean(), rel=1e-5)


def test_what_a_web_cannot_carry_is_refused() -> None:
    machine = roller()
    bends = Scene([strip(), chip(index=1.6)])
    with pytest.raises(BadInput, match=r"'chip' has the index 1.6 on a web, whose rays are traced once"):
        bends.web_operator(GRID, beam(), machine, device="numpy")
    with pytest.raises(BadInput, match=r"ray by ray, such as a Roller"):
        WebInsertProjection(WebGrid((24, 6, 4), EDGE), vam.Beam((14, 4), EDGE), Slanted(), device="numpy")
    with pytest.raises(ShapeMismatch, match=r"opaque has shape \(2, 2, 2\); expected \(24, 6, 3\)"):
        operator("numpy", opaque=np.zeros((2, 2, 2), bool))
    with pytest.raises(BadInput, match="opaque holds float64"):
        operator("numpy", opaque=np.zeros(GRID.shape))
    for wrong in (np.full(GRID.shape, np.nan), np.full(GRID.shape, -1.0), np.full(GRID.shape, "a")):
        with pytest.raises(BadInput, match="extinction"):
            operator("numpy", extinction=wrong)
    with pytest.raises(BadInput, match="expected a WebGrid"):
        Scene([strip()]).web_part(vam.Grid((8, 8, 8), 0.1))  # type: ignore[arg-type]
    with pytest.raises(EmptyMesh, match="'chip' fills no voxel"):
        Scene([strip(), chip()]).web_part(WebGrid((6, 6, 3), EDGE), device="numpy")
    mask = Body(np.ones((3, 3, 3)), pitch=0.1, name="mask")
    with pytest.raises(BadInput, match=r"'mask' is a mask, and the voxels of the web are 0.1 × 0.2 × 0.1 mm"):
        Scene([mask]).web_part(WebGrid((6, 6, 3), (0.1, 0.2, 0.1)), device="numpy")
