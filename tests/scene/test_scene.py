"""Scenes: every role changes what is optimized and judged, priorities decide overlaps, inserts stand in the light."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.backend import open_device
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, EmptyMesh, OutOfMemory, ShapeMismatch, TargetTooLarge
from vamgpu.jobs.read import Job
from vamgpu.losses import Band, Loss
from vamgpu.methods import METHODS
from vamgpu.metrics import score
from vamgpu.printing.bodies import judged_parts
from vamgpu.printing.judgement import judged
from vamgpu.scene.scene import Scene
from vamgpu.targets.limits import NOWHERE, Limits
from vamgpu.targets.mesh import load_mesh
from vamgpu.targets.shapes import csg
from vamgpu.targets.solid import Solid

PITCH, SHAPE = 0.15, (32, 32, 4)
GRID = vam.Grid(SHAPE, PITCH)
BEAM, TURN = vam.Beam((32, 4), PITCH), vam.Turntable(48)


def rod(radius: float, x: float = 0.0, y: float = 0.0) -> Callable[..., Any]:
    """An upright rod without ends."""
    return lambda a, b, c: np.hypot(a - x, b - y) - radius + 0.0 * c


PART = vam.Body(rod(1.2), name="part")


def cylinder(radius: float, height: float) -> Solid:
    """An upright rod with ends, about the origin."""
    return csg.to_solid(csg.rod((0, 0, -0.5 * height), (0, 0, 0.5 * height), radius, segments=256), "rod")


def target_of(*bodies: vam.Body, **given: Any) -> vam.Target:
    return vam.Scene(bodies, **given).target(pitch=PITCH, shape=SHAPE, device="numpy")


def limits_of(target: vam.Target) -> Limits:
    assert target.limits is not None
    return target.limits


def voxels(radius: float, x: float = 0.0, y: float = 0.0) -> np.ndarray:
    """Columns of voxels whose center lies in a rod."""
    a, b, _ = GRID.axes()
    return np.hypot(a[:, None] - x, b[None, :] - y) < radius


# ---- where bodies lie --------------------------------------------------------------------------------------------
def middle(fraction: np.ndarray, pitch: float) -> np.ndarray:
    """Center of mass [mm]."""
    index = np.indices(fraction.shape).reshape(3, -1)
    return ((index * fraction.ravel()).sum(1) / fraction.sum() - 0.5 * (np.array(fraction.shape) - 1)) * pitch


@pytest.fixture
def drawn(tmp_path: Path) -> Path:
    """A rod of radius 0.8 drawn off the axis, from z = 3 to 5."""
    return cylinder(0.8, 2.0).translated((1.0, 0.5, 4.0)).save(tmp_path / "rod.stl")


def test_bodies_stay_where_they_were_drawn(drawn: Path) -> None:
    whole = vam.Scene([vam.Body(drawn)]).target(pitch=0.1, device="numpy")
    assert np.allclose(middle(whole.numpy(), 0.1), (1.0, 0.5, 0.0), atol=0.01)
    assert whole.height == pytest.approx(2.0) and whole.radius == pytest.approx(np.hypot(1.0, 0.5) + 0.8, rel=1e-3)
    moved = vam.Scene([vam.Body(drawn)], origin=(1.0, 0.0, 4.0), factor=0.5).target(pitch=0.1, device="numpy")
    assert np.allclose(middle(moved.numpy(), 0.1), (0.0, 0.25, 0.0), atol=0.01)
    turn = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    turned = vam.Scene([vam.Body(drawn)], orientation=turn).target(pitch=0.1, device="numpy")
    assert np.allclose(middle(turned.numpy(), 0.1), (-0.5, 1.0, 0.0), atol=0.01)


def test_a_solid_read_without_centering_is_not_centered_by_a_target(drawn: Path) -> None:
    given = {"factor": 1.0, "pitch": 0.1, "device": "numpy"}
    there = vam.Target.from_mesh(load_mesh(drawn, center=False), **given)
    assert np.allclose(middle(there.numpy(), 0.1), (1.0, 0.5, 0.0), atol=0.01)
    for source in (drawn, load_mesh(drawn)):
        assert np.allclose(middle(vam.Target.from_mesh(source, **given).numpy(), 0.1), 0.0, atol=0.01)


def test_one_body_is_a_target_from_a_mesh(drawn: Path) -> None:
    alone = vam.Target.from_mesh(load_mesh(drawn, center=False), factor=1.0, pitch=0.1, device="numpy")
    scene = vam.Scene([vam.Body(drawn)]).target(pitch=0.1, device="numpy")
    assert scene.grid == alone.grid and scene.limits is None and scene.solid is not None
    assert np.array_equal(scene.numpy(), alone.numpy())


def test_masks_functions_and_meshes_say_the_same(drawn: Path) -> None:
    import trimesh

    solid = load_mesh(drawn, center=False)
    fine = vam.Target.from_mesh(solid, factor=1.0, pitch=0.05, shape=(88, 88, 200), device="numpy").numpy()
    mesh = trimesh.Trimesh(solid.vertices, solid.faces)
    shape = lambda x, y, z: np.maximum(np.hypot(x - 1.0, y - 0.5) - 0.8, np.abs(z - 4.0) - 1.0)  # noqa: E731
    given = {"pitch": 0.1, "shape": (44, 44, 20), "device": "numpy"}
    wanted = vam.Scene([vam.Body(solid)]).target(**given).numpy()
    mask = vam.Body(fine, pitch=0.05)
    others = (vam.Body(mesh), None), (vam.Body(shape), (0, 0, 4)), (mask, (0, 0, 0))
    for body, origin in others:
        found = vam.Scene([body], origin=origin).target(**given).numpy()
        assert np.abs(found - wanted).max() < 0.2  # a function is looked at in 64 points of a voxel
        assert found.sum() == pytest.approx(wanted.sum(), rel=2e-3)


# ---- who has a voxel ---------------------------------------------------------------------------------------------
OVERLAP = {"print": {}, "gray": {"dose": 0.6}, "keep out": {"dose": 0.5}, "don't care": {}, "insert": {}}


@pytest.mark.parametrize(("role", "given"), OVERLAP.items())
def test_roles_have_priorities_and_a_body_may_have_another(role: str, given: dict[str, float]) -> None:
    both = voxels(0.4, 1.2) & voxels(1.1)
    for priority, wins in ((None, True), (-1.0, False)):
        other = vam.Body(rod(0.5, 1.2), role, name="other", priority=priority, **given)
        for bodies in ((PART, other), (other, PART)):
            if role == "print" and priority is None:
                wins = bodies[1] is other  # of two alike the later one
            limits = limits_of(target_of(*bodies, void=0.9))
            owner = np.array([body.name for body in limits.bodies])[limits.body[both]]
            assert (owner == ("other" if wins else "part")).all()


def test_an_insert_carves_what_is_printed_and_nothing_is_asked_of_it() -> None:
    target = target_of(PART, vam.Body(rod(0.5), "insert"))
    hole, ring = voxels(0.4), voxels(1.1) & ~voxels(0.6)
    limits = limits_of(target)
    assert not target.numpy()[hole].any() and (target.numpy()[ring] == 1.0).all()
    assert not limits.judged[hole].any() and limits.judged[ring].all()
    assert (limits.classes(target.numpy())[hole] == NOWHERE).all()


def test_limits_say_what_each_role_asks() -> None:
    target = target_of(
        PART,
        vam.Body(rod(0.4), "gray", dose=0.6, weight=3.0),
        vam.Body(rod(0.4, 1.8), "keep out", dose=0.3),
        vam.Body(rod(0.4, -1.8), "don't care"),
    )
    limits = limits_of(target)
    asked = {(): 0.6, (0.0, 0.0): 0.6, (0.8, 0.0): 1.0, (1.8, 0.0): 0.3, (-1.8, 0.0): 0.0}
    assert limits.void == 0.6 and (limits.dose[voxels(0.2, 0.0, 1.8)] == np.float32(asked.pop(()))).all()
    for place, dose in asked.items():
        assert (limits.dose[voxels(0.2, *place)] == np.float32(dose)).all(), place
    assert (limits.weight[voxels(0.2)] == 3.0).all() and limits.weighted
    assert not limits_of(target_of(PART, vam.Body(rod(0.4), "gray", dose=0.6))).weighted
    assert limits_of(target_of(PART, vam.Body(rod(0.4), "gray", dose=0.6), void=0.5)).void == 0.5


# ---- what is optimized -------------------------------------------------------------------------------------------
def solved(target: vam.Target, method: Any = "lbfgs", iterations: int = 15, device: Any = None) -> vam.Plan:
    A = vam.Projection(GRID, BEAM, TURN, None, device)
    return vam.optimize(A, target, method, iterations=iterations)


def doses(plan: vam.Plan, *place: float) -> np.ndarray:
    """Dose in a thin rod over the mean in the part."""
    dose = plan.dose().numpy()
    return dose[voxels(0.3, *place)] / dose[voxels(0.5, 0.0, -0.6)].mean()


NEAR = (1.75, 0.0)
KEPT = vam.Body(rod(0.4, *NEAR), "keep out", dose=0.35)


def test_a_keep_out_gets_less_than_a_void_would(device: Device) -> None:
    plain, kept = (solved(target_of(*bodies), device=device) for bodies in ((PART,), (PART, KEPT)))
    assert doses(plain, *NEAR).max() > 0.35 > doses(kept, *NEAR).max()


def test_a_gray_body_gets_its_own_dose() -> None:
    gray = vam.Body(rod(0.5, 0.0, 0.6), "gray", dose=0.6)
    plain, other = (solved(target_of(*bodies), iterations=30) for bodies in ((PART,), (PART, gray)))
    assert doses(plain, 0.0, 0.6).mean() > 0.9
    assert doses(other, 0.0, 0.6).mean() == pytest.approx(0.6, abs=0.08)


def test_what_nobody_cares_for_widens_the_window() -> None:
    ring = vam.Body(lambda x, y, z: np.abs(np.hypot(x, y) - 1.45) - 0.25 + 0 * z, "don't care")
    tight, free = (solved(target_of(*bodies)).window for bodies in ((PART,), (PART, ring)))
    assert free > tight + 0.05


def test_weights_move_what_a_loss_gives_up() -> None:
    square = vam.Body(lambda x, y, z: np.maximum(np.abs(x), np.abs(y)) - 1.0 + 0 * z, name="square")
    hole = rod(0.35)

    def leak(weight: float) -> float:
        target = target_of(square, vam.Body(hole, "keep out", dose=0.9, weight=weight))
        return float(solved(target, Band((0.0, 1.0), (0.3, 0.05)), 8).dose().numpy()[voxels(0.25)].mean())

    assert leak(30.0) < 0.85 * leak(1.0)


def test_weights_of_losses_are_products(device: Device) -> None:
    rng = np.random.default_rng(0)
    dose, target, first, second = (device.upload(rng.random(SHAPE).astype(np.float32)) for _ in range(4))
    both = device.upload(first.numpy() * second.numpy())
    out, same = device.empty(SHAPE), device.empty(SHAPE)
    band = Band((0.0, 1.0), (0.1, 0.1))
    for loss in (band, 2.0 * band, band + band**0.5):
        one = loss.weighted(first).weighted(second).value_and_gradient(dose, target, out)
        assert one == pytest.approx(loss.weighted(both).value_and_gradient(dose, target, same), rel=1e-5)
        assert np.allclose(out.numpy(), same.numpy(), rtol=1e-4, atol=1e-5)
        assert one != pytest.approx(loss.value_and_gradient(dose, target, same), rel=0.05)


@pytest.mark.parametrize("method", sorted(METHODS))
def test_every_method_takes_a_scene(method: str) -> None:
    target = target_of(PART, KEPT, vam.Body(rod(0.3, -0.5), "gray", dose=0.7), vam.Body(rod(0.4, -1.8), "don't care"))
    A = vam.Projection(GRID, BEAM, TURN, None, "numpy")
    plan = vam.optimize(A, target, method, iterations=3)
    parts = judged_parts(plan.dose(), target.on(A.device), target.limits)
    assert plan.operator is A
    assert plan.window == pytest.approx(score(parts.dose, parts.target).window, abs=1e-5)


def test_a_scene_goes_on_where_it_was_interrupted() -> None:
    target = target_of(PART, KEPT)
    A = vam.Projection(GRID, BEAM, TURN, None, "numpy")
    once = vam.optimize(A, target, "lbfgs", iterations=6)
    again = vam.optimize(A, target, "lbfgs", iterations=6, resume=vam.optimize(A, target, "lbfgs", iterations=3))
    assert np.array_equal(once.sinogram.numpy(), again.sinogram.numpy())


# ---- what is judged ----------------------------------------------------------------------------------------------
def proven(target: vam.Target, judge: vam.Target | None = None, iterations: int = 15) -> vam.Proof:
    plan = solved(target, iterations=iterations, device=open_device())
    return vam.simulate(plan.operator, vam.pack(plan), judge or target)  # type: ignore[arg-type]


def test_a_proof_judges_keep_outs_by_their_own_limit() -> None:
    plain, kept = target_of(PART), target_of(PART, KEPT)
    careless, careful = proven(plain, kept), proven(kept)
    for proof, wrong in ((careless, True), (careful, False)):
        body = {found.role: found for found in proof.bodies}["keep out"]
        held = proof.dose.numpy()[(limits_of(kept).body == 1) & GRID.cylinder()[:, :, None]]
        assert body.voxels == held.size and (body.wrong > 0) == wrong
        assert body.wrong == (held >= np.float32(0.35) * proof.scores.threshold).sum()
        assert "keep out" in str(body) and any("keep out" in line.name for line in proof.lines())
    assert careless.scores.excess >= 1 and careful.scores.window > careless.scores.window
    assert careful.independent


def test_a_proof_judges_gray_doses() -> None:
    gray = target_of(PART, vam.Body(rod(0.5, 0.0, 0.6), "gray", name="soft", dose=0.6, tolerance=0.25))
    careless, careful = proven(target_of(PART), gray), proven(gray, iterations=30)
    wrong = [{body.role: body.wrong / body.voxels for body in proof.bodies}["gray"] for proof in (careless, careful)]
    assert wrong[0] > 0.95 and wrong[1] < 0.3
    assert "'soft' gets the wrong dose" in str(careless.verdict) and not careless.all_correct


def test_what_a_print_bears_is_judged_by_the_same_limits(tmp_path: Path) -> None:
    proof = proven(target_of(PART, KEPT, vam.Body(rod(0.4, -1.8), "don't care")))
    found = judged(proof)
    assert found.table.nominal.window == pytest.approx(proof.scores.window, abs=1e-6)
    assert found.table.nominal.wrong == proof.scores.missing + proof.scores.excess
    assert found.over_tolerance.at(0.0) <= proof.scores.window + 0.1
    page = proof.report(tmp_path / "page.html", judgement=found).read_text(encoding="utf-8")
    assert "keep out" in page


# ---- inserts -----------------------------------------------------------------------------------------------------
def test_a_part_that_overlaps_its_insert_reaches_a_window() -> None:
    scene = vam.Scene([PART, vam.Body(rod(0.4), "insert")])
    target = scene.target(pitch=PITCH, shape=SHAPE, device="numpy")
    A: Any = scene.operator(target, BEAM, TURN)
    plan = vam.optimize(A, target, "lbfgs", iterations=15)
    proof = vam.simulate(A, vam.pack(plan), target)
    assert proof.scores.window > 0.05
    assert not proof.dose.numpy()[voxels(0.3)].any()
    whole = vam.simulate(A, vam.pack(plan), replace(target, fraction=target_of(PART).fraction, limits=None))
    assert whole.scores.window < -0.5  # as it was without carving


VIAL = vam.Vial(3.5, 0.4, 1.48, 1.50, 1.0, 0.15)


def test_a_clear_insert_like_the_resin_changes_nothing_in_a_vial() -> None:
    scene = vam.Scene([PART, vam.Body(rod(0.4, 0.5), "insert", index=1.48, absorption=0.15)])
    target = scene.target(pitch=PITCH, shape=SHAPE, device="numpy")
    wide = {"pixels": (60, 4), "pitch": PITCH}
    through = scene.operator(target, vam.Beam(**wide), TURN, VIAL)
    plain = vam.Projection(GRID, vam.Beam(**wide, spread=0.0), TURN, VIAL)
    light = np.ones(plain.range.shape, np.float32)
    got, wanted = (A.T(A.device.upload(light)).numpy()[voxels(1.8)] for A in (through, plain))
    assert (got / wanted).mean() == pytest.approx(1.0, abs=1e-3) and (got / wanted).std() < 0.01


def test_an_insert_that_absorbs_more_leaves_less_behind_it() -> None:
    one = vam.Turntable([0.0])

    def dose(body: vam.Body) -> np.ndarray:
        scene = vam.Scene([PART, body])
        target = scene.target(pitch=PITCH, shape=SHAPE, device="numpy")
        A = scene.operator(target, vam.Beam((60, 4), PITCH), one, VIAL, device="numpy")
        return A.T(A.device.upload(np.ones(A.range.shape, np.float32))).numpy()

    alike, dark = (dose(vam.Body(rod(0.8), "insert", absorption=value)) for value in (0.15, 0.65))
    behind, before = voxels(0.1, -1.4), voxels(0.1, 1.4)  # light comes from +x at the angle 0
    assert dark[before] == pytest.approx(alike[before], rel=1e-3)
    assert (dark[behind] / alike[behind]).mean() == pytest.approx(np.exp(-0.8), rel=0.03)


def test_rows_wider_than_voxels_light_all_of_them_beside_an_insert(opencl_device: Device) -> None:
    below = vam.Body(lambda x, y, z: np.hypot(x, y) - 0.6 + np.maximum(z + 1.0, 0.0), "insert")
    scene = vam.Scene([vam.Body(rod(0.4, 0.8)), below])
    target = scene.target(pitch=0.2, shape=(16, 16, 12), device="numpy")
    A = scene.operator(target, vam.Beam((6, 4), 0.6), vam.Turntable(4), device=opencl_device)
    assert getattr(A, "entries", None) == 0  # rays are marched
    dose = np.asarray(A.T(np.ones(A.range.shape, np.float32)))[8, 8, 5:11]
    np.testing.assert_allclose(dose, dose[0], rtol=1e-4)


def test_an_insert_that_changes_along_z_is_traced_in_three_dimensions() -> None:
    half = vam.Body(lambda x, y, z: np.maximum(np.hypot(x, y) - 0.4, z), "insert")
    scene = vam.Scene([PART, half])
    target = scene.target(pitch=PITCH, shape=SHAPE, device="numpy")
    medium = scene.medium(target.grid)
    assert medium.opaque is not None and medium.opaque.shape == SHAPE
    assert medium.opaque[:, :, :2].any() and not medium.opaque[:, :, 2:].any()
    assert (target.numpy()[voxels(0.3)][:, 2:] == 1.0).all()


# ---- what cannot be meant ----------------------------------------------------------------------------------------
BAD: dict[str, tuple[Callable[[], Any], type[Exception], str]] = {
    "role": (lambda: vam.Body(rod(1.0), "prnt"), BadInput, "no role 'prnt'"),
    "kind": (lambda: vam.Body(3), BadInput, "got a int as body"),  # type: ignore[arg-type]
    "no pitch": (lambda: vam.Body(np.ones(SHAPE)), BadInput, "mask without pitch"),
    "pitch": (lambda: vam.Body(rod(1.0), pitch=0.1), BadInput, "expected it only for masks"),
    "empty mask": (lambda: vam.Body(np.zeros(SHAPE), pitch=0.1), EmptyMesh, "every voxel of the array is 0"),
    "no dose": (lambda: vam.Body(rod(1.0), "keep out"), BadInput, "without a dose"),
    "dose": (lambda: vam.Body(rod(1.0), "print", dose=0.4), BadInput, "got dose=0.4"),
    "negative dose": (lambda: vam.Body(rod(1.0), "gray", dose=-1.0), BadInput, "dose of body 'gray'"),
    "weight": (lambda: vam.Body(rod(1.0), weight=0.0), BadInput, "weight of body"),
    "priority": (lambda: vam.Body(rod(1.0), priority=float("nan")), BadInput, "priority of body"),
    "index": (lambda: vam.Body(rod(1.0), "insert", index=0.9), BadInput, "refractive index of at least 1"),
    "index of a part": (lambda: vam.Body(rod(1.0), index=1.5), BadInput, "got index=1.5"),
    "no body": (lambda: vam.Scene([]), BadInput, "none of 0 bodies is to be printed"),
    "nothing printed": (lambda: vam.Scene([KEPT]), BadInput, "none of 1 bodies is to be printed"),
    "no bodies": (lambda: vam.Scene([rod(1.0)]), BadInput, "got a function among the bodies"),  # type: ignore[list-item]
    "origin": (lambda: vam.Scene([PART], origin=(0, 0, np.nan)), BadInput, "three finite lengths"),
    "keep out of more than prints": (lambda: vam.Body(rod(1.0), "keep out", dose=70), BadInput, "70 % of it is 0.7"),
    "gray in percent": (lambda: vam.Body(rod(1.0), "gray", dose=60), BadInput, "10 at most"),
    "inches": (
        lambda: vam.Scene([vam.Body(cylinder(0.08, 0.16))]).target(pitch=0.5, device="numpy"),
        EmptyMesh,
        r"drawn at x -0\.08..0\.08.* in inches it needs the factor 25\.4, in metres 1000",
    ),
    "outside": (lambda: target_of(PART, vam.Body(rod(0.3, 9.0), "keep out", dose=0.5)), EmptyMesh, "fills no voxel"),
    "thin": (lambda: target_of(PART, vam.Body(rod(0.06, 1.9))), EmptyMesh, "fills no voxel by half"),
    "carved away": (
        lambda: target_of(PART, vam.Body(rod(1.5), "insert", name="bolt")),
        EmptyMesh,
        "carved away by 'bolt'",
    ),
    "unknown reach": (lambda: vam.Scene([PART]).target(pitch=PITCH), BadInput, "whose extent is unknown"),
    "limits": (
        lambda: Limits(np.ones(SHAPE), np.ones(SHAPE), np.zeros((2, 2, 2), int), ()),
        ShapeMismatch,
        "one shape",
    ),
    "bodies": (lambda: Limits(np.ones(SHAPE), np.ones(SHAPE), np.zeros(SHAPE, int), ()), BadInput, "there are 0"),
    "no index": (
        lambda: vam.Scene([PART, vam.Body(rod(0.4), "insert", index=1.6)]).medium(GRID, device="numpy"),
        BadInput,
        "the resin has none",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_what_cannot_be_meant_is_refused(case: str) -> None:
    make, kind, said = BAD[case]
    with pytest.raises(kind, match=said) as caught:
        make()
    assert type(caught.value) is kind


def test_what_does_not_fit_is_told_by_how_much() -> None:
    far = vam.Body(cylinder(1.0, 2.0).translated((2.0, 0.0, 0.0)))
    with pytest.raises(TargetTooLarge, match=r"reaches 3 mm from the axis.*use shape \(45, 45, 14\)"):
        vam.Scene([far]).target(pitch=PITCH, shape=SHAPE, device="numpy")
    scene: Scene = vam.Scene([far, vam.Body(rod(0.3), "insert")])
    target = scene.target(pitch=PITCH, shape=(48, 48, 16), device="numpy")
    with pytest.raises(TargetTooLarge, match="printable radius"):
        scene.operator(target, BEAM, TURN, vam.Vial(2.9, 0.4, 1.48, 1.5, 1.0), device="numpy")


def test_bodies_on_more_voxels_than_memory_holds_say_which_pitch_does(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VAMGPU_MEMORY", "2 MB")
    scene = vam.Scene([PART, vam.Body(rod(0.4), "insert")])
    with pytest.raises(
        OutOfMemory, match=r"2 bodies on 40 × 40 × 40 voxels of 0.1 mm take 8.32 MB .* pitch of 0.16 mm"
    ):
        scene.target(pitch=0.1, shape=(40, 40, 40), device="numpy")
    assert scene.target(pitch=0.17, shape=(24, 24, 24), device="numpy").grid.pitch == 0.17


def test_a_loss_without_weights_says_so() -> None:
    class Own(Loss):
        """Of one's own, without weights."""

        def value_and_gradient(self, dose: Any, target: Any, out: Any, reach: float = 1e18) -> float:
            return 0.0

    target = target_of(vam.Body(rod(1.2), weight=2.0), KEPT)
    with pytest.raises(BadInput, match="Own does not support voxel weights"):
        solved(target, Own(), 1)


def test_methods_of_one_limit_refuse_bodies() -> None:
    A = vam.Projection(GRID, BEAM, TURN, VIAL, "numpy")
    with pytest.raises(BadInput, match="limits of their own"):
        vam.superpose(vam.Colors(A, A), target_of(PART, KEPT))


# ---- what the documents say --------------------------------------------------------------------------------------
TASKS = Path(__file__).resolve().parents[2] / "docs" / "tasks.md"


@pytest.mark.slow
def test_the_page_on_tasks_runs_as_it_is_written(capsys: pytest.CaptureFixture[str]) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", TASKS.read_text("utf-8"), re.S)
    exec(compile(code, str(TASKS), "exec"), {})
    said = capsys.readouterr().out
    assert "grip (print)" in said and "channel (keep out)" in said


def test_the_job_on_the_page_on_tasks_is_one() -> None:
    (text,) = re.findall(r"```toml\n(.*?)```", TASKS.read_text("utf-8"), re.S)
    job = Job.parse(text + '\n[beam]\npitch = "0.1 mm"\n')
    assert [body.role for body in job.file.body] == ["print", "insert", "keep out"]
