"""Plans, frames and proofs come back from their folders, and go on."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
import trimesh

import vamgpu as vam
from vamgpu.errors import BadInput, Cancelled, MeshWarning, StorageError, VamError
from vamgpu.jobs.demo import JOB
from vamgpu.jobs.read import Job
from vamgpu.jobs.run import is_interrupted, prove, solve
from vamgpu.losses.voxel_loss import VoxelLoss
from vamgpu.methods.plan_folder import load_plan
from vamgpu.methods.tolerances import Corner
from vamgpu.printing.folder import load_frames, save_frames
from vamgpu.printing.gray import GrayCurve
from vamgpu.printing.pack import repack
from vamgpu.storage.folder import Folder
from vamgpu.targets import shapes

SMALL = ["target.pitch=1.6 mm", "beam.pitch=1.6 mm", "turntable.angles=8", "solve.iterations=4", "solve.device=cpu"]


@cache
def projection(device: Any = "cpu") -> tuple[vam.Projection, vam.Target]:
    target = vam.Target.from_mesh(shapes.build("boat"), height=6.0, pitch=1.0, device=device)
    vial = vam.Vial(radius=12.4, wall=1.0, resin_index=1.5, wall_index=1.47, bath_index=1.0, absorption=0.05)
    return vam.Projection(target.grid, vam.Beam((16, 9), 1.0), vam.Turntable(8), vial, device), target


def same(one: Any, other: Any) -> bool:
    return np.array_equal(one.numpy(), other.numpy())


@pytest.mark.parametrize("method", [
    "ramp", "osmo", "bclp", "lbfgs",
    *(pytest.param(name, marks=pytest.mark.slow) for name in ("recipe", "penalty", "cal")),
])  # fmt: skip
def test_a_plan_comes_back_and_goes_on_bit_by_bit(method: str, tmp_path: Path) -> None:
    A, target = projection()
    plan = vam.optimize(A, target, method, iterations=2)
    assert plan.save(tmp_path / "a.vam") == tmp_path / "a.vam"
    back: Any = vam.load(tmp_path / "a.vam", "cpu")
    assert same(back.sinogram, plan.sinogram) and back.method == plan.method and back.history == plan.history
    assert (back.window, back.evaluations, back.papers) == (plan.window, plan.evaluations, plan.papers)
    assert back.target.name == "boat" and back.target.solid is not None and same(back.target, target)
    further = vam.optimize(back.operator, back.target, iterations=4, resume=back)
    assert same(further.sinogram, vam.optimize(A, target, iterations=4, resume=plan).sinogram)
    assert len(further.history) == 4


def test_a_plan_is_proven_and_packed_from_its_folder(device: Any, tmp_path: Path) -> None:
    A, target = projection(device)
    plan = vam.optimize(A, target, iterations=2)
    plan.save(tmp_path / "a.vam", state=False)
    back: Any = vam.load(tmp_path / "a.vam", device)
    assert not back.state and back.target.solid is not None
    found = vam.simulate(back.operator, load_frames(tmp_path / "a.vam", device), back.target)
    assert found.scores == vam.simulate(A, vam.pack(plan), target).scores


@pytest.mark.parametrize("method", ["default", vam.SurfaceRamp(width=1.5), "osmo", VoxelLoss(np.square, np.cos)])
def test_a_plan_of_frames_has_its_method_and_cannot_be_resumed(method: Any, tmp_path: Path) -> None:
    A, target = projection()
    plan = vam.optimize(A, target, method, iterations=2)
    vam.pack(plan, dither="round").save(tmp_path / "a.vam")
    back = load_plan(tmp_path / "a.vam", "cpu")
    name = type(plan.method).__name__
    assert same(back.sinogram, plan.sinogram) and name in back._repr_html_() and "Recorded" not in back._repr_html_()
    told = (back.evaluations, back.best_iteration, back.target_name)
    assert told == (plan.evaluations, plan.best_iteration, plan.target_name)
    assert isinstance(method, VoxelLoss) or back.method == plan.method
    with pytest.raises(BadInput, match="saved without its state"):
        vam.optimize(A, target, iterations=4, resume=back)


def test_a_loss_of_one_s_own_is_saved_without_its_method(tmp_path: Path) -> None:
    A, target = projection()
    plan = vam.optimize(A, target, VoxelLoss(lambda d: d**2, lambda d: (d - 1) ** 2), iterations=2)
    plan.save(tmp_path / "a.vam")
    back: Any = vam.load(tmp_path / "a.vam", "cpu")
    assert same(back.sinogram, plan.sinogram) and "Descent" in back.method.text
    with pytest.raises(BadInput, match="its folder stores only the name"):
        vam.optimize(A, target, iterations=4, resume=back)


def test_frames_are_kept_as_plain_light_for_any_machine(tmp_path: Path) -> None:
    """What one machine made of light is not what the next one starts from."""
    A, target = projection()
    plan = vam.optimize(A, target, iterations=2)
    projector = GrayCurve.gamma(2.2, black=0.01)
    frames = vam.pack(plan, gray=projector, flip_r=True, shift=(0.5, 0.0))
    frames.save(tmp_path / "a.vam")
    kept = Folder.open(tmp_path / "a.vam").array("frames")
    light = plan.sinogram.numpy()
    assert kept.dtype.kind == "f" and np.array_equal(kept[:, ::-1].transpose(0, 2, 1), light)
    back: Any = vam.load(tmp_path / "a.vam", "cpu")
    assert same(back.images, frames.images) and back.settings == frames.settings and back.motion == A.motion
    assert same(back.plan.sinogram, plan.sinogram) and back.plan.target.name == "boat"
    again = repack(back, gray=GrayCurve.linear(), shift=(0.0, 0.0))
    assert same(again.images, vam.pack(plan, flip_r=True, scale=frames.scale).images)
    save_frames(tmp_path / "b.vam", replace(frames, packed=None))
    assert not same(repack(load_frames(tmp_path / "b.vam", "cpu"), gray=GrayCurve.linear(), shift=(0.0, 0.0)).images,
                    again.images)  # fmt: skip


def test_frames_whose_bytes_were_changed_are_kept_as_bytes(tmp_path: Path) -> None:
    A, target = projection()
    frames = vam.pack(vam.optimize(A, target, iterations=1))
    changed = replace(frames, images=frames.device.upload(255 - frames.images.numpy(), table=True))
    assert changed.plan is None and frames.plan is not None
    changed.save(tmp_path / "a.vam")
    assert same(load_frames(tmp_path / "a.vam", "cpu").images, changed.images)
    with pytest.raises(StorageError, match="has no geometry"):
        prove(tmp_path / "a.vam", "cpu")


def test_a_proof_comes_back_without_a_simulation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    A, target = projection()
    frames = vam.pack(vam.optimize(A, target, iterations=2))
    proof = vam.simulate(A, frames, target, irradiance="65 mW/cm2", critical_dose="50 mJ/cm3")
    proof = replace(proof, off=Corner(axis=0.02, spread=0.03, dose=-0.05))
    assert proof.lines()[0].value == "axis +20 µm, spread 30 µm, dose -5 %"
    proof.save(tmp_path / "a.vam")
    monkeypatch.setattr("vamgpu.printing.independent_exposure.IndependentExposure.averaged", None)
    back: Any = vam.load(tmp_path / "a.vam", "cpu")
    assert back.off == proof.off
    assert back.scores == proof.scores and back.claimed == proof.claimed and back.outer == proof.outer
    assert back.exposure == proof.exposure and same(back.dose, proof.dose)
    assert same(back.frames.images, frames.images) and back.solid is not None
    for name in ("window", "iou", "missing"):
        np.testing.assert_array_equal(getattr(back.slices, name), getattr(proof.slices, name))


def stopped(job: Any, place: Path, after: float) -> None:
    """Solve, and press Ctrl-C."""

    def stop(stage: str, share: float) -> None:
        if stage == "light" and share >= after:
            raise KeyboardInterrupt

    with pytest.raises(Cancelled):
        solve(job, place, progress=stop)


def test_an_interrupted_job_goes_on_where_it_stopped(tmp_path: Path) -> None:
    place, job = tmp_path / "boat.vam", Job.parse(JOB, SMALL)
    stopped(job, place, 0.5)
    assert is_interrupted(place) and prove(place, "cpu").proof.scores.window < 1
    seen: list[float] = []
    solve(job, place, progress=lambda stage, share: seen.append(share) if stage == "light" else None)
    assert not is_interrupted(place) and seen == [0.0, 0.75, 1.0]
    solve(job, tmp_path / "whole.vam")
    first, second = (Folder.open(tmp_path / name).array("frames") for name in ("boat.vam", "whole.vam"))
    assert np.array_equal(first, second)


def test_an_interrupt_never_costs_a_finished_job(tmp_path: Path) -> None:
    place, job = tmp_path / "boat.vam", Job.parse(JOB, SMALL)
    solve(job, place)
    before = Folder.open(place).array("frames")

    def stop(stage: str, share: float) -> None:
        if stage == "light" and share >= 0.5:
            raise KeyboardInterrupt

    with pytest.raises(Cancelled):
        solve(job, place, overwrite=True, progress=stop)
    assert np.array_equal(Folder.open(place).array("frames"), before)


def test_jobs_are_loaded_and_what_is_none_is_told(tmp_path: Path) -> None:
    (tmp_path / "boat.toml").write_text(JOB, encoding="utf-8")
    job: Any = vam.load(tmp_path / "boat.toml")
    assert job.file.turntable.angles == 360
    with pytest.raises(StorageError, match="not a finished job"):
        vam.load(tmp_path)


def test_a_mended_mesh_is_told_at_the_proof_too(tmp_path: Path) -> None:
    box = trimesh.creation.box((4, 4, 4))
    box.faces = box.faces[:-1]
    box.export(tmp_path / "hole.stl")
    settings = [*SMALL, f"target.mesh={json.dumps(str(tmp_path / 'hole.stl'))}"]
    job = Job.parse(JOB.replace('shape = "boat"\n', ""), settings)
    with pytest.warns(MeshWarning, match="1 hole closed"):
        solve(job, tmp_path / "a.vam")
    with pytest.warns(MeshWarning, match="repaired before solving: 1 hole closed"):
        prove(tmp_path / "a.vam", "cpu")


@pytest.mark.parametrize(
    ("setting", "how"),
    [("solve.iterations=4", "resume"), ("vial.absorption=0.2 1/mm", "start"), ("target.height=9 mm", "start"),
     ("solve.method=osmo", "start")],
)  # fmt: skip
def test_old_light_meets_new_conditions(
    setting: str, how: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run goes on where all is the same; else its light is the first guess of another one."""
    pixels = ["beam.pixels=[20, 10]", "target.margin=6"]
    stopped(Job.parse(JOB, [*SMALL, *pixels]), tmp_path / "old.vam", 0.5)
    plan: Any = vam.load(tmp_path / "old.vam", "cpu")
    seen: dict[str, Any] = {}

    def optimize(*given: Any, **how: Any) -> Any:
        seen.update(how)
        raise Cancelled("seen")

    monkeypatch.setattr("vamgpu.jobs.run.optimize", optimize)
    with pytest.raises(Cancelled, match="seen"):
        solve(Job.parse(JOB, [*SMALL, *pixels, setting]), tmp_path / "new.vam", start=tmp_path / "old.vam")
    assert {"resume", "start"} & set(seen) == {how}
    assert same(seen["start"] if how == "start" else seen["resume"].sinogram, plan.sinogram)
    with pytest.raises(StorageError, match="not a finished job"):
        solve(Job.parse(JOB, SMALL), tmp_path / "new.vam", start=tmp_path / "none.vam")


def test_a_proof_that_an_older_release_wrote_keeps_its_numbers(tmp_path: Path) -> None:
    """The share of the part is the light efficiency now, and what was called so the mean brightness."""
    A, target = projection()
    proof = vam.simulate(A, vam.pack(vam.optimize(A, target, iterations=1)), target)
    proof.save(tmp_path / "a.vam")
    file = tmp_path / "a.vam" / "manifest.json"
    data = json.loads(file.read_text(encoding="utf-8"))
    said = data["details"]["proof"]
    said |= {"part_share": said["light_efficiency"], "light_efficiency": said.pop("mean_brightness")}
    file.write_text(json.dumps(data), encoding="utf-8")
    old = vam.load(tmp_path / "a.vam", "cpu")
    assert isinstance(old, vam.Proof)
    assert (old.light_efficiency, old.mean_brightness) == (proof.light_efficiency, proof.mean_brightness)


ODD = [None, -1, 0, 1e300, "x", [], {}, [1], {"array": "state_0"}, {"array": "none"}, {"tuple": 3}, True, 10**15,
       {"list": [1], "dtype": "zz"}, {"of": "Nope"}]  # fmt: skip


def leaves(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Where values are in nested tables and the first places of lists."""
    yield path
    inner = value.items() if isinstance(value, dict) else enumerate(value[:3]) if isinstance(value, list) else ()
    for key, part in inner:
        yield from leaves(part, (*path, key))


@pytest.mark.parametrize("kind", ["plan", "frames", "proof"])
def test_spoiled_manifests_load_or_are_refused(kind: str, tmp_path: Path) -> None:
    A, target = projection()
    plan = vam.optimize(A, target, iterations=1)
    frames = vam.pack(plan)
    saved: Any = {"plan": plan, "frames": frames, "proof": None}[kind] or vam.simulate(A, frames, target)
    saved.save(tmp_path / "a.vam")
    file = tmp_path / "a.vam" / "manifest.json"
    sound = file.read_text(encoding="utf-8")
    places = [path for path in leaves(json.loads(sound)) if path and path[0] in ("inputs", "details", "arrays")]
    chance, refused = Random(0), 0
    for _ in range(30):
        data = part = json.loads(sound)
        *most, last = chance.choice(places)
        for key in most:
            part = part[key]
        part[last] = chance.choice(ODD)
        file.write_text(json.dumps(data), encoding="utf-8")
        try:
            vam.load(tmp_path / "a.vam", "cpu")
        except VamError as error:
            refused += 1
            assert len(str(error)) > 20
    assert refused > 10
