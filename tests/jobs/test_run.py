"""The main job from its file to its report, on every device, and what stops it on the way."""

from __future__ import annotations

import json
from pathlib import Path
from shutil import copytree

import numpy as np
import pytest

from vamgpu.backend import open_device
from vamgpu.errors import BadInput, Cancelled, JobError, OpticsWarning, StorageError, TargetTooLarge
from vamgpu.geometry import Beam
from vamgpu.jobs.build import projection_of, target_of
from vamgpu.jobs.demo import JOB, Demo, demo
from vamgpu.jobs.read import Job
from vamgpu.jobs.run import is_interrupted, prove, solve
from vamgpu.methods.plan_folder import describe, projection_from
from vamgpu.printing.folder import load_frames
from vamgpu.storage.folder import Folder

SMALL = ["target.pitch=500 um", "beam.pitch=700 um", "turntable.angles=24", "solve.iterations=9"]


def test_a_job_is_solved_written_and_proven(tmp_path: Path) -> None:
    progress: list[str] = []
    job = Job.parse(JOB, [*SMALL, "solve.device=cpu"])
    folder = solve(job, tmp_path / "boat.vam", progress=lambda stage, share: progress.append(stage))
    assert list(dict.fromkeys(progress)) == ["voxels", "light", "frames", "folder"]
    assert folder.manifest.inputs["job"]["vial"]["radius"] == "12.4 mm"
    proven = prove(tmp_path / "boat.vam", "cpu")
    assert proven.proof.scores.in_voxels > 100
    drawn, known = target_of(job, open_device("numpy")).solid, proven.proof.solid  # depths and walls are the mesh's
    assert drawn and known and np.array_equal(known.vertices[known.faces], drawn.vertices[drawn.faces])
    assert abs(proven.proof.claimed.window - proven.plan.window) <= 1 / 255  # what eight bits may cost
    assert proven.proof.seconds is not None and proven.proof.seconds > 0
    losses = [step["loss"] for step in proven.plan.history]
    assert len(losses) == 9 and losses[-1] < losses[0]
    assert proven.plan.papers


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Demo:
    """The demo, made once for the tests that look at it."""
    return demo(tmp_path_factory.mktemp("run") / "demo", SMALL)


@pytest.mark.slow
def test_a_demo_leaves_a_job_frames_and_a_report(done: Demo) -> None:
    page = done.report.read_text(encoding="utf-8")
    assert "boat" in page and page.rstrip().endswith("</html>")
    Folder.open(done.folder).verify()
    place = done.folder.parent
    again = demo(place, SMALL)
    assert again.proven.proof.scores == done.proven.proof.scores
    assert sorted(path.name for path in place.iterdir()) == ["boat.toml", "boat.vam", "report.html"]


def test_a_geometry_reads_back_from_its_description() -> None:
    for vessel in ("", '\n[vat]\nwidth = "30 mm"\nabsorption = "0.1 1/mm"\n'):
        text = JOB if not vessel else JOB.replace("[vial]", "[nothing]").split("[nothing]")[0] + vessel
        job = Job.parse(text, SMALL[:3])
        device = open_device("numpy")
        A = projection_of(job.file, target_of(job, device), device)
        B = projection_from(describe(A), device)
        assert (A.grid, A.beam, A.motion, A.vessel) == (B.grid, B.beam, B.motion, B.vessel)


@pytest.mark.slow
def test_a_beam_s_optics_go_into_the_job_folder_and_come_back(tmp_path: Path) -> None:
    (tmp_path / "result.toml").write_text(
        'calibration = "mtf"\n[measured]\npositions_mm = [0.0]\nblur_mm = [0.5]\npixel_mm = 0.01\n', encoding="utf-8"
    )
    optics = ["beam.fill=0.92", "beam.spread=25 um"]
    cases = (
        ([], Beam((4, 4), 0.6)),
        (optics, Beam((4, 4), 0.6, 0.92, 0.025)),
        (["beam.spread=0 mm"], Beam((4, 4), 0.6, 1.0, 0.0)),
        (["beam.spread=result.toml"], Beam((4, 4), 0.6, 1.0, (0.25 - (0.36 + 1e-4) / 12) ** 0.5)),
    )
    device = open_device("numpy")
    for settings, beam in cases:
        job = Job.parse(JOB, [*SMALL[:3], "beam.pitch=0.6 mm", "beam.pixels=[4, 4]", *settings], folder=tmp_path)
        A = projection_of(job.file, target_of(job, device), device, job.folder)
        assert A.beam.fill == beam.fill
        assert A.beam.spread == (None if beam.spread is None else pytest.approx(beam.spread, rel=1e-12))
        described = json.loads(json.dumps(describe(A)))
        B = projection_from(described, device)
        assert B.beam == A.beam and described["beam"]["fill"] == beam.fill


@pytest.mark.slow
def test_a_folder_from_before_the_optics_is_read_as_it_was_meant(done: Demo, tmp_path: Path) -> None:
    folder = copytree(done.folder, tmp_path / "boat.vam")
    file = folder / "manifest.json"
    data = json.loads(file.read_text(encoding="utf-8"))
    for name in ("fill", "spread"):
        del data["inputs"]["geometry"]["beam"][name]
    del data["inputs"]["geometry"]["vessel"]["polarization"]
    file.write_text(json.dumps(data), encoding="utf-8")
    with pytest.warns(OpticsWarning, match="fill 1, spread 0.*solve it again"):
        proof = prove(folder).proof
    A = proof.operator
    assert (A.beam.fill, A.beam.spread) == (1.0, 0.0)
    assert A.vessel == done.proven.proof.operator.vessel


@pytest.mark.parametrize(
    ("stage", "share", "left"),
    [
        ("light", 0.1, ["boat.toml", "boat.vam"]),
        ("frames", 0.0, ["boat.toml", "boat.vam"]),
        ("voxels", 0.0, ["boat.toml"]),
    ],
)
def test_an_interrupted_job_leaves_the_plan_it_had_or_nothing(
    stage: str, share: float, left: list[str], tmp_path: Path
) -> None:
    def stop(now: str, done: float) -> None:
        if now == stage and done >= share:
            raise KeyboardInterrupt

    with pytest.raises((KeyboardInterrupt, Cancelled)):
        demo(tmp_path, SMALL, progress=stop)
    assert sorted(path.name for path in tmp_path.iterdir()) == left
    assert is_interrupted(tmp_path / "boat.vam") == ("boat.vam" in left)


@pytest.mark.parametrize(
    ("setting", "error", "said"),
    [
        ("solve.method=osmoo", JobError, "did you mean 'osmo'"),
        ("target.shape=ship", JobError, "target.shape: got 'ship'"),
        ("frames.gray=missing.toml", StorageError, "missing.toml"),
        ("target.height=30 mm", TargetTooLarge, "radius"),
        ("target.pitch=20 mm", BadInput, "pitch is 20 mm, and the part is .* check the unit"),
    ],
)
def test_what_cannot_be_done_is_refused(setting: str, error: type[BadInput], said: str, tmp_path: Path) -> None:
    with pytest.raises(error, match=said):
        solve(Job.parse(JOB, [*SMALL, setting]), tmp_path / "boat.vam")
    assert not list(tmp_path.iterdir())


def test_a_place_that_is_taken_is_refused_before_the_work(tmp_path: Path) -> None:
    (tmp_path / "boat.vam").mkdir()
    progress: list[str] = []
    with pytest.raises(StorageError, match="overwrit"):
        solve(Job.parse(JOB, SMALL), tmp_path / "boat.vam", progress=lambda stage, share: progress.append(stage))
    for place, overwrite, said in (
        ("boat.vam", True, "exists and is not a job folder"),
        ("slip/of/the/keys.vam", False, "of/the' does not exist; make it"),
        ("slip/keys.vam", True, "slip' does not exist; make it"),
    ):
        with pytest.raises(StorageError, match=said):
            solve(Job.parse(JOB, SMALL), tmp_path / place, overwrite=overwrite,
                  progress=lambda stage, share: progress.append(stage))  # fmt: skip
    assert not progress and [each.name for each in tmp_path.iterdir()] == ["boat.vam"]


def test_bits_of_a_job_are_chosen_by_their_dose(tmp_path: Path) -> None:
    """Of one color; of two nobody knows the dose of both, and errors are carried on."""
    colors = 'colors.absorption="0.1 1/mm"'
    for name, settings, dither in (("one", (), "fit"), ("two", (colors,), "error-diffusion")):
        solve(
            Job.parse(JOB, [*SMALL, "target.pitch=900 um", "beam.pitch=1200 um", "frames.bits=1", *settings]),
            tmp_path / f"{name}.vam",
        )
        frames = load_frames(tmp_path / f"{name}.vam", "numpy")
        assert (frames.bits, frames.settings.dither) == (1, dither)


def test_a_folder_without_a_job_is_refused(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="not a finished job"):
        prove(tmp_path)


@pytest.mark.slow
def test_a_proof_tells_how_wide_a_window_any_light_can_have(tmp_path: Path) -> None:
    coarse = ["target.pitch=900 um", "beam.pitch=900 um", "turntable.angles=12", "solve.device=cpu"]
    coarse += ["target.shape=nut", "target.height=6 mm"]
    solve(Job.parse(JOB, [*coarse, "solve.method=lbfgs", "solve.iterations=20"]), tmp_path / "boat.vam")
    assert prove(tmp_path / "boat.vam", "cpu").proof.bound is None
    proven = prove(tmp_path / "boat.vam", "cpu", evaluations=120)
    bound = proven.proof.bound
    assert bound is not None and proven.proof.claimed.window < bound.value < 1.0
    lines = {line.name: line for line in proven.proof.lines()}
    assert lines["process window, at most"].value == f"{bound.value:+.4f}"
    where = f"{proven.proof.operator.grid}, turning while lit for 1 of each step"
    assert "voxels of 900 µm" in where and bound.on == where
    assert f" on {where}; this one has" in lines["process window, at most"].meaning
    some = prove(tmp_path / "boat.vam", "cpu", evaluations=120, slices=(2, 4)).proof.bound
    assert (
        some is not None
        and some.prices.shape[2] == 2
        and " × 2 voxels of 900 µm" in some.on
        and proven.proof.claimed.window < some.value
    )
    page = proven.report(tmp_path / "boat.html").read_text(encoding="utf-8")
    assert "process window, at most" in page and f"{bound.value:+.4f}" in page


@pytest.mark.slow
def test_a_proof_at_corners_tells_how_wide_a_window_is_at_all_of_them(tmp_path: Path) -> None:
    coarse = ["target.pitch=1200 um", "beam.pitch=1200 um", "turntable.angles=12", "solve.device=cpu"]
    off = ["tolerances.axis=300 um", "solve.iterations=20"]
    solve(Job.parse(JOB, [*coarse, *off]), tmp_path / "boat.vam")
    proven = prove(tmp_path / "boat.vam", "cpu", evaluations=70, tolerances=True, slices=(2, 4)).proof
    assert proven.bound is not None and proven.bound.prices.shape[2] == 2 * 3
    assert proven.corners is not None and proven.corners.window < proven.bound.value
    (line,) = (line for line in proven.lines() if line.name == "process window, at most")
    assert f"{proven.corners.window:+.4f} at all corners" in line.meaning
