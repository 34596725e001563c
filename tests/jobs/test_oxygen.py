"""Jobs whose patterns follow oxygen: read, refused, solved, proved."""

from __future__ import annotations

from dataclasses import replace
from math import ceil, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_job import BOAT

import vamgpu as vam
from vamgpu.chemistry.oxygen import OxygenModel
from vamgpu.errors import BadInput, JobError
from vamgpu.jobs.build import medium_of, projection_of, target_of, with_diffusion
from vamgpu.jobs.read import Job
from vamgpu.jobs.run import prove, solve
from vamgpu.methods.dual import Colors
from vamgpu.methods.joint import Pair
from vamgpu.methods.lbfgs import LBFGS
from vamgpu.methods.plan_folder import operator_from
from vamgpu.metrics import score
from vamgpu.printing.folder import frames_of
from vamgpu.storage.folder import Folder

JOB = (
    BOAT
    + """\
[resin]
kinetics = "oxygen"
[resin.oxygen]
diffusivity = "1e-3 mm2/s"
turns = 3
period = "9 s"
runs = 4
air = ["z high"]
used = 0.1
[solve]
iterations = 3
[print]
irradiance = "60 mW/cm2"
critical_dose = "50 mJ/cm3"
"""
)


@pytest.mark.slow
def test_a_job_is_solved_and_proved(tmp_path: Path) -> None:
    job = Job.parse(JOB, name="boat")
    solve(job, tmp_path / "boat.vam")
    proven = prove(tmp_path / "boat.vam")
    proof, A = proven.proof, proven.proof.operator
    assert isinstance(A, OxygenModel) and "LBFGS(outside=0.85" in proven.plan.method
    assert proof.independent and proof.difference < 0.1
    assert proof.exposure is not None and proof.exposure.seconds == 27.0
    assert 0.0 < proof.exposure.irradiance <= 0.6 * 1.001
    light = proof.frames.irradiance(A.device)
    own = np.abs(A.T(light).numpy() - proof.dose.numpy())[A.grid.cylinder()].max()
    assert own == pytest.approx(proof.difference * proof.scores.peak, rel=1e-5)
    assert any("the latitude is that of the effective dose" in what for what in proof.verdict.not_judged)
    coarse = prove(tmp_path / "boat.vam", coarse=True).proof
    assert not coarse.independent and np.array_equal(coarse.dose.numpy(), A.T(light).numpy())
    # a full-on pixel at that irradiance gives in all turns what the patterns ask for
    unit = proof.exposure.irradiance * A.beam.pixel_area / A.grid.voxel_volume * 27.0 / 24 / 0.05
    assert unit == pytest.approx(proof.frames.scale, rel=1e-6)
    assert proof.verdict.prints == ("the effective dose may be" in proof.verdict.sentence)
    page = proven.report(tmp_path / "boat.html").read_text(encoding="utf-8")
    assert "oxygen left" in page and "effective dose latitude" in page and "After 3 turns of 9 s" in page
    with pytest.raises(BadInput, match="without --bound and --off"):
        prove(tmp_path / "boat.vam", evaluations=4)


def test_oxygen_that_is_missing_is_read_from_a_file(tmp_path: Path) -> None:
    device = vam.open_device()
    job = Job.parse(JOB.replace("used = 0.1", 'used = "used.npy"'), folder=tmp_path)
    target = target_of(job, device)
    A = projection_of(job.file, target, device)
    used = np.random.default_rng(0).uniform(0.0, 0.5, A.domain.shape).astype(np.float32)
    np.save(tmp_path / "used.npy", used)
    model = with_diffusion(job.file, A, tmp_path)
    assert np.array_equal(model.oxygen.used, used) and model.oxygen.air == ("z high",)
    assert model.T(np.zeros(A.range.shape)).max() < 0.5


def test_oxygen_comes_from_resin_above_and_below_the_part() -> None:
    """The grid has room for it on both sides; with air above, only below."""
    device = vam.open_device()
    plain, aired, between, both = (target_of(Job.parse(text), device) for text in (BOAT, JOB, *(
        JOB.replace('["z high"]', air) for air in ('["x low"]', '["z low", "z high"]'))))  # fmt: skip
    assert both.grid == plain.grid
    room = ceil(3.0 * sqrt(2.0 * 1e-3 * 27.0) / plain.grid.pitch)
    for found, above in ((aired, 0), (between, room)):
        assert found.grid.shape == (*plain.grid.shape[:2], plain.grid.shape[2] + room + above)
        assert np.array_equal(found.numpy()[:, :, room : room + plain.grid.shape[2]], plain.numpy())
        assert found.volume == plain.volume and found.numpy()[:, :, :room].max() == 0.0
    assert aired.solid is not None and np.allclose(aired.solid.bounds[:, 2], [-0.6 + 0.05 * room, 0.6 + 0.05 * room])


def test_resin_opposite_to_air_does_not_end_with_the_part() -> None:
    """The dose of the part is that on a grid that goes on farther; without this room it is another one."""
    device, text = vam.open_device(), JOB.replace("150 um", "100 um")
    job, extra, room = Job.parse(text), 24, 7
    target = target_of(job, device)
    A = projection_of(job.file, target, device)
    light = np.random.default_rng(0).random(A.range.shape)
    light *= 1.6 / np.asarray(A.T(light)).max()
    oxygen = with_diffusion(job.file, A).oxygen
    own, near = np.asarray(OxygenModel(A, oxygen).T(light))[:, :, room:], target.grid.cylinder()

    def other(slices: int) -> np.ndarray:
        """The dose of these slices, with others added or removed below."""
        grid, beam = (replace(each, **{key: (*getattr(each, key)[:-1], getattr(each, key)[-1] + slices)})
                      for each, key in ((A.grid, "shape"), (A.beam, "pixels")))  # fmt: skip
        B = vam.Projection(grid, beam, A.motion, A.vessel, device)
        shown = np.pad(light[:, :, max(-slices, 0) :], ((0, 0), (0, 0), (max(slices, 0), 0)))
        return np.asarray(OxygenModel(B, oxygen).T(shown))[:, :, slices + room :]

    assert np.abs(own - other(extra))[near].max() <= 1e-4
    assert np.abs(own - other(-room))[near].max() > 0.005
    with pytest.raises(JobError, match="rows; expected at least 20: the part is 0.35 mm from the middle"):
        projection_of(Job.parse(text.replace("[turn", "pixels = [26, 19]\n[turn")).file, target, device)
    assert projection_of(
        Job.parse(text.replace("[turn", "pixels = [26, 20]\n[turn")).file, target, device
    ).beam.pixels == (26, 20)


def test_bodies_and_arrays_are_raised_with_the_part(tmp_path: Path) -> None:
    device = vam.open_device("numpy")
    bodies = JOB.replace('shape = "boat"\nheight = "1.2 mm"\n', "factor = 0.05\n") + '[[body]]\nshape = "boat"\n'
    plain, raised = (target_of(Job.parse(bodies.replace('["z high"]', air)), device)
                     for air in ('["z low", "z high"]', '["z high"]'))  # fmt: skip
    assert raised.grid.shape[2] > plain.grid.shape[2] and plain.solid is not None and raised.solid is not None
    assert np.allclose(raised.solid.bounds, plain.solid.bounds + [0.0, 0.0, 0.35])
    np.save(tmp_path / "mu.npy", np.zeros((4, 4, 4), np.float32))
    medium = Job.parse(JOB + '[medium]\nabsorption = "mu.npy"\npitch = "0.5 mm"\n', folder=tmp_path).file
    assert medium.medium is not None
    assert medium_of(medium.medium, tmp_path, 0.35).center == (0.0, 0.0, 0.35)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('kinetics = "oxygen"', "", "line 18: resin.oxygen.*kinetics"),
        ('kinetics = "oxygen"', 'kinetics = "argon"', "oxygen"),
        ("used = 0.1", "used = 1.4", "used"),
        ("used = 0.1", 'used = "none.npy"', "none.npy"),
        ("turns = 3", "turns = 0", "turns"),
        ('air = ["z high"]', 'air = ["top"]', "z high"),
        ('kinetics = "oxygen"', 'kinetics = "oxygen"\ndiffusion = {diffusivity = "1e-3 mm2/s", seconds = "9 s"}',
         "oxygen alone"),
        ("iterations = 3", 'iterations = 3\nexposure_limit = "20 s"', "whose exposure is its turns"),
    ],
)  # fmt: skip
def test_wrong_keys_are_refused(old: str, new: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "job.toml").write_text(JOB.replace(old, new), encoding="utf-8")
    with pytest.raises((JobError, BadInput), match=said):
        Job.read(tmp_path / "job.toml")


def test_other_methods_are_refused(tmp_path: Path) -> None:
    job = Job.parse(JOB.replace("iterations = 3", 'iterations = 3\nmethod = "osmo"'), name="boat")
    with pytest.raises(BadInput, match="not linear"):
        solve(job, tmp_path / "boat.vam")
    own = Job.parse(JOB + "[method]\nkind = 'lbfgs'\ninside = 1.3\nmost = 1.4\noutside = 0.9\n", name="boat")
    assert own.file.method == LBFGS(0.9, 1.3, 1.4)


def test_two_colors_follow_the_kinetics(tmp_path: Path) -> None:
    """The patterns, the record and the proof of a job are those of the rule and of `KineticModel`."""
    colors = """
[colors]
absorption = "0.1 /mm"
[colors.rule]
kind = "kinetics"
k_a = 0.033
k_b = 0.0071
k_c = 0.033
k_2 = 0.43
supply = 5.0
turns = 2
period = "10 s"
runs = 4
diffusivity_a = "1e-3 mm2/s"
iterations = 3
"""
    text = JOB[: JOB.index("[resin]")] + "[frames]\ndither = 'round'\n" + colors
    solve(Job.parse(text, name="boat"), tmp_path / "boat.vam")
    proof = prove(tmp_path / "boat.vam").proof
    colors_given: Any = Job.parse(text).file.colors
    rule = colors_given.rule
    second = Folder.open(tmp_path / "boat-uv.vam")
    device = proof.operator.device
    other, frames = operator_from(second, device), frames_of(second, device)
    model = rule.model(proof.operator, other)
    light = Pair(proof.frames.irradiance(device), frames.irradiance(device))
    assert proof.claimed == score(model.expose(light), proof.target)
    finer = rule.model(proof.operator, other, finer=True)
    assert np.array_equal(proof.dose.numpy(), finer.expose(light).numpy())
    assert (len(finer.runs[0]), finer.steps, finer.resin.floor) == (24, 4, 0.1 * model.resin.floor)
    assert model.diffusivities == (1e-3, 0.0, 0.0) and proof.dose.numpy().max() > 0.5
    plain = Colors(proof.operator, other).dose(*light).numpy()
    assert np.abs(plain - proof.dose.numpy()).max() > 0.1
