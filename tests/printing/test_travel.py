"""Prints of parts that travel: exposed by independent rays, solved, exported and refused."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from small_job import BOAT

import vamgpu as vam
from vamgpu.cli import main
from vamgpu.errors import BadInput, JobError
from vamgpu.hosts.rigs.jobs import print_job
from vamgpu.jobs.build import projection_of, target_of
from vamgpu.jobs.read import Job
from vamgpu.jobs.run import prove, solve
from vamgpu.operators.projection import Projection
from vamgpu.printing.exposure import expose
from vamgpu.printing.independent_exposure import IndependentExposure

PITCH = 0.1


def exposed(travel: vam.Travel | None, light: np.ndarray) -> np.ndarray:
    """Independent dose of light for a part on a path."""
    motion = vam.Turntable(light.shape[0], travel=travel)
    A = Projection(vam.Grid((12, 12, 10), PITCH), vam.Beam(light.shape[1:], PITCH), motion)  # type: ignore[arg-type]
    dose = A.device.empty(A.grid.shape)
    for _ in IndependentExposure(A).onto(A.device.upload(light), dose):
        pass
    return dose.numpy().astype(float)[A.grid.cylinder()]


def gaussian(up: float = 0.0, out: float = 0.0) -> np.ndarray:
    """Light of 60 angles: a Gaussian about a height and a column [pixels], the same at all angles."""
    z, r = np.arange(20) - 9.5 - up, np.arange(22) - 10.5 - out
    return np.exp(-0.5 * ((z / 2.5) ** 2 + (r[:, None] / 3.0) ** 2)) * np.ones((60, 1, 1))


@pytest.mark.parametrize("follow", [True, False])
def test_rays_expose_frames_where_they_fall(follow: bool) -> None:
    """A part that sinks by 1.3 pixels: frames follow by one pixel, or by none."""
    path = vam.Travel([[-1.3 * PITCH], [0.0]], follow=follow)
    left = 0.3 if follow else 1.3
    wanted = 0.5 * (exposed(None, gaussian(left)) + exposed(None, gaussian()))
    assert np.abs(exposed(path, gaussian()) - wanted).max() <= 1e-3 * wanted.max()
    assert np.abs(exposed(None, gaussian()) - wanted).max() > 0.03 * wanted.max()


def test_rays_expose_a_part_aside() -> None:
    """Light on the axis misses a part 2 pixels aside as light 2 pixels off the axis, at the angle it is seen from."""
    path = vam.Travel([[0.0]], x=2 * PITCH, y=-0.5 * PITCH, follow=False)
    angle = vam.Turntable(60).poses
    across = -0.5 * np.cos(angle) - 2.0 * np.sin(angle)
    wanted = exposed(None, np.concatenate([gaussian(out=-each)[:1] for each in across]))
    assert np.abs(exposed(path, gaussian()) - wanted).max() <= 2e-3 * wanted.max()


def printed(travel: vam.Travel | None, target: vam.Target, plan: vam.Plan | None = None) -> tuple[vam.Proof, vam.Plan]:
    """A proof, and the plan whose patterns it judges."""
    beam = vam.Beam((target.grid.shape[0] + 8, target.grid.shape[2] + 4), PITCH)
    A = Projection(target.grid, beam, vam.Turntable(48, travel=travel))
    light = None if plan is None else plan.sinogram
    plan = plan or vam.optimize(A, target, iterations=60, progress=False)
    frames = vam.pack(plan) if light is None else vam.pack(A, light.numpy())
    return vam.simulate(A, frames, target), plan


def blob() -> vam.Target:
    """A disc under a smaller one, which prints well."""
    x, y, z = np.meshgrid(*((np.arange(n) - 0.5 * (n - 1)) for n in (20, 20, 14)), indexing="ij")
    part = (np.hypot(x, y) <= np.where(z < 0, 6.0, 3.5)) & (np.abs(z) <= 4.0)
    return vam.Target.from_array(part.astype(np.float32), PITCH)


def test_a_part_that_sinks_by_four_voxels_prints_as_one_at_rest() -> None:
    target = blob()
    still, plan = printed(None, target)
    sunk = -4 * PITCH * np.linspace(0.0, 1.0, 6 * 48).reshape(6, 48)
    followed, _ = printed(vam.Travel(sunk), target)
    missed, _ = printed(vam.Travel(sunk, follow=False), target, plan)
    assert followed.independent and missed.independent
    assert followed.scores.window >= still.scores.window - 0.005
    assert missed.scores.window < still.scores.window - 0.2
    assert abs(followed.claimed.window - followed.scores.window) <= 0.01
    assert followed.light_efficiency == pytest.approx(still.light_efficiency, rel=0.05)


def test_a_part_three_images_tall_has_no_seam() -> None:
    target = blob()
    still, _ = printed(None, target)
    for rise, rows in ((3 * PITCH, 6), (0.37, 6)):
        path = vam.Travel.helix(48, rise, height=18 * PITCH, rows=rows, pitch=PITCH)
        screwed, _ = printed(path, target)
        assert screwed.independent and screwed.scores.window >= still.scores.window - 0.005


def timed(travel: vam.Travel) -> vam.Proof:
    """A proof of a disc with times, of even light over its height."""
    target, light = blob(), np.ones((24, 1, 1)) * (np.abs(np.arange(28) - 13.5) < 6.5)[:, None] * np.ones(18)
    motion = vam.Turntable(24, travel=travel)
    A = Projection(target.grid, vam.Beam((28, 18), PITCH), motion, device="numpy")
    frames = vam.pack(A, light)
    return vam.simulate(A, frames, target, coarse=True, irradiance=0.6, critical_dose=1.0, absorption=0.1)


def test_a_lamp_too_dim_for_the_turns_of_a_path_is_a_fault() -> None:
    """The lamp of 60 mW/cm² takes some seconds, whatever the turns; the turns must last at least as long."""
    up = PITCH * np.zeros((4, 1))
    free = timed(vam.Travel(up)).exposure
    assert free is not None and free.irradiance == 0.6 and free.enough_turns == 0
    assert free.turning == f"4 turns of {free.seconds / 4:.4g} s"
    dim = timed(vam.Travel(up, period=free.seconds / 8.6))
    said = " ".join(map(str, dim.verdict.faults))
    assert "takes 129 mW/cm² full-on in 4 turns of" in said and "more than the lamp has: use 9 turns or more" in said
    enough = timed(vam.Travel(PITCH * np.zeros((9, 1)), period=free.seconds / 8.6))
    assert enough.exposure is not None and enough.exposure.irradiance == pytest.approx(0.6 * 8.6 / 9)
    assert enough.exposure.enough_turns == 0 and "the lamp" not in " ".join(map(str, enough.verdict.faults))


def test_a_helix_states_its_turns_and_no_times_of_voxels() -> None:
    """Each voxel of a helix is lit in turns of its own, so that no first or last voxel follows from the dose."""
    path = vam.Travel.helix(24, 3 * PITCH, height=18 * PITCH, rows=6, pitch=PITCH)
    proof = timed(path)
    times = proof.exposure
    assert times is not None and path.turns == 7 and times.turning == f"7 turns of {times.seconds / 7:.4g} s"
    assert times.complete is None and times.overcure_onset is None
    said = {line.name: line.value for line in proof.lines()}
    assert said["part complete"] == said["first excess"] == "not computed"


JOB = (
    BOAT
    + """\
[solve]
iterations = 3
[print]
irradiance = "60 mW/cm2"
critical_dose = "50 mJ/cm3"
[travel]
"""
)
STOKES = """turns = 4
period = "6 s"
density_difference = "20 kg/m3"
viscosity = "1 Pa s"
diameter = "1 mm"
start = "2 s"
"""
MEASURED = 'turns = 2\nperiod = "6 s"\nheights = "heights.csv"\n'


def read(text: str, folder: Path = Path()) -> vam.Travel:
    job = Job.parse(JOB + text, folder=folder)
    device = vam.open_device("numpy")
    travel = projection_of(job.file, target_of(job, device), device, job.folder).motion.travel
    assert travel is not None
    return travel


def test_a_job_states_the_path(tmp_path: Path) -> None:
    (tmp_path / "heights.csv").write_text("time_s,height_um\n0,0\n12,-240\n")
    assert np.allclose(read(MEASURED, tmp_path).up, -0.02 * 6.0 * np.arange(48).reshape(2, 24) / 24)
    stokes = read(STOKES)
    assert stokes.turns == 4 and np.allclose(stokes.up[-1][-1], -0.010896 * (24.0 - 0.25 - 2.0), rtol=1e-3)
    helix = read('rise = "0.3 mm"\nrows = 5\n')
    assert helix.rows == 5 and np.allclose(np.diff(np.ravel(helix.up)), 0.3 / 24)
    (tmp_path / "heights.csv").write_text("0,0\n12,-240\n")
    with pytest.raises(JobError, match="begins with the numbers 0, 0; expected a header above them"):
        read(MEASURED, tmp_path)
    (tmp_path / "heights.csv").write_text("time_s,speed\n0,0\n12,-240\n")
    with pytest.raises(JobError, match="travel.*heights.*height_um"):
        read(MEASURED, tmp_path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('turns = 2\nperiod = "6 s"\n', "no path; expected one of heights"),
        ('rise = "0.3 mm"\n', "expected rows"),
        ('rise = "0.3 mm"\nrows = 5\nperiod = "6 s"\nturns = 2\n', "travel.period.*with rise.*remove"),
        ('rise = "0.3 mm"\nrows = 5\nviscosity = "1 Pa s"\n', "travel.viscosity.*with rise"),
        (STOKES + "rows = 5\n", "travel.rows.*with density_difference"),
        ('x = "0.1 mm"\nstart = "2 s"\n', "travel.start.*with x and y"),
        (STOKES + "[tiles]\nrows = 6\n", r"line 21: travel: got it with \[tiles\]"),
        (STOKES + '[medium]\nindex = "scan.npy"\npitch = "1 mm"\n', r"medium: got \[medium\] and \[travel\]; "),
        (STOKES.replace('viscosity = "1 Pa s"\n', ""), "expected viscosity"),
        (STOKES + 'rise = "1 mm"\nrows = 4\n', "rise and density_difference"),
        ('rise = "0.3 mm"\nrows = 4\nfollow = false\n', "expected follow=True"),
        (STOKES + '[scattering]\ncoefficient = "0.1 /mm"\nanisotropy = 0.9\n', r"scattering.*does not follow"),
        (
            STOKES
            + '[resin]\nkinetics = "oxygen"\n[resin.oxygen]\ndiffusivity = "1e-3 mm2/s"\nturns = 5\nperiod = "9 s"\n',
            "line 21: travel: got it with kinetics = .oxygen., which does not follow",
        ),
        ('rise = "0 mm"\nrows = 4\n', "line 22: travel.rise: .*rise.* is 0"),
        ('rise = "0.3 mm"\nrows = 30\n', "image of 30 rows is 4.5 mm high, and patterns 1.8"),
        (STOKES.replace('"2 s"', '"30 s"'), "start is 30 s.*24 s of all turns"),
        (STOKES.replace("turns = 4", "turns = 1000000000"), "24,000,000,000 frames; expected at most 1,000,000"),
        (STOKES.replace("1 Pa s", "1 mPa s").replace("turns = 4", "turns = 200"), "at most 300 mm, within a vial"),
        (STOKES.replace("1 Pa s", "1 mPa s"), "237 mm along z; expected less than the beam lights, 2.7 and 1.8 mm"),
    ],
)
def test_a_job_without_a_path_is_refused(text: str, message: str) -> None:
    with pytest.raises((JobError, BadInput), match=message):
        read(text)


def test_rows_beyond_the_beam_and_rings_are_refused_with_their_line() -> None:
    with pytest.raises(
        JobError, match="line 21: travel: .*operator = .rings., which does not follow a part that moves"
    ):
        Job.parse(JOB + STOKES, ["solve.operator=rings"])
    with pytest.raises(JobError, match="line 23: travel.rows: .*is 30, and the beam has 20 rows"):
        Job.parse(JOB + 'rise = "0.3 mm"\nrows = 30\n', ["beam.pixels=[60, 20]"])


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("0,0\n# warm\n18,-100\n9,-300", "line 5 has 9 s after 18 s"),
        ("0,0\n0,-100\n18,-200", "line 3 has 0 s after 0 s"),
        ("0,0", "heights are from 0 to 0 s; expected 0 to 11.75 s"),
        ("0,0\n11,-1", "heights are from 0 to 11 s"),
        ("1,0\n12,-1", "from 1 to 12 s"),
    ],
)
def test_heights_that_do_not_cover_the_print_are_refused(rows: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "heights.csv").write_text(f"time_s,height_um\n{rows}\n")
    with pytest.raises(JobError, match=rf"\[travel\] heights = .heights.csv.: .*{message}"):
        read(MEASURED, tmp_path)


def sunk(folder: Path, deep: float, lit: float) -> Path:
    """A job folder of a part that sinks by ``deep`` pixels in 2 turns of 6 s; rows ``lit`` from the middle are lit."""
    path = vam.Travel([[0.0], [-deep * PITCH]], period=6.0)
    A = Projection(vam.Grid((8, 8, 8), PITCH), vam.Beam((12, 10), PITCH), vam.Turntable(24, travel=path), None, "numpy")
    light = np.ones((24, 12, 1)) * (np.abs(np.arange(10) - 4.5) < lit)
    return vam.pack(A, light).save(folder)


def test_exported_frames_are_no_taller_than_their_light(tmp_path: Path) -> None:
    for lit, rows in ((3.0, 10), (4.0, 12)):  # 6 and 8 rows, 2 pixels lower in the second turn
        main(["export", str(sunk(tmp_path / f"{rows}.vam", 2.0, lit)), "--npz", str(tmp_path / f"{rows}.npz")])
        images = np.load(tmp_path / f"{rows}.npz")["images"]
        assert images.shape == (48, rows, 12)
        first, second = (np.flatnonzero(images[at].any(axis=1)) for at in (0, 24))
        middle = 0.5 * (rows - 1)
        assert np.array_equal(first, second - 2) and first.mean() == middle and len(first) == 2 * lit


def test_videos_of_a_path_are_as_fast_as_its_turns(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    av = pytest.importorskip("av")
    job, film = sunk(tmp_path / "job.vam", 2.0, 4.0), tmp_path / "film.mp4"
    for given in ([], ["--rpm", "10", "--overwrite"]):
        assert main(["export", str(job), "--mp4", str(film), *given]) == 0
        with av.open(str(film)) as video:
            assert video.streams.video[0].average_rate == 4
    for given, message in (
        (["--fps", "30"], "got --fps 30, .*6 s; expected --fps 4 or --rpm 10"),
        (["--rpm", "9"], "got --rpm 9, .*6 s; expected --fps 4 or --rpm 10"),
        (["--repeats", "2"], "--repeats is 2.*expected 1"),
        (["--canvas", "12x10"], "canvas lacks 2 rows: along .travel., light falls on 12 rows"),
    ):
        capsys.readouterr()
        assert main(["export", str(job), "--mp4", str(tmp_path / "other.mp4"), *given]) == 1
        assert re.search(message, " ".join(capsys.readouterr().err.split())), given
    assert not (tmp_path / "other.mp4").exists()


@pytest.mark.slow
def test_a_job_is_solved_proved_and_exported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, out = tmp_path / "boat.vam", tmp_path / "frames"
    solve(Job.parse(JOB + STOKES, name="boat"), folder)
    proof = prove(folder).proof
    assert proof.independent and proof.operator.motion.travel == read(STOKES)
    times = proof.exposure
    assert times is not None and times.seconds == 24.0 and times.turning == "4 turns of 6 s"
    A = proof.operator
    still = Projection(A.grid, A.beam, vam.Turntable(24), A.vessel)
    free = expose(still, proof.scores, 1.0, proof.frames.scale, irradiance=0.6, critical_dose=0.05)
    assert times.irradiance * 24.0 == pytest.approx(0.6 * free.seconds)
    assert times.complete is not None and free.complete is not None
    assert times.complete / times.seconds == pytest.approx(free.complete / free.seconds)
    main(["export", str(folder), "--png", str(out), "--npz", str(tmp_path / "all.npz")])
    assert len(list(out.glob("frame_*.png"))) == 4 * 24
    images = np.load(tmp_path / "all.npz")["images"]
    sent = proof.frames.followed(proof.operator.beam).images.numpy()
    assert np.array_equal(images, sent) and images.any()
    for machine in (["--for", "opencal", "--out", str(out), "--rpm", "9"], ["--drtvam", str(out)]):
        capsys.readouterr()
        assert main(["export", str(folder), *machine]) == 1
        assert "repeats one turn" in (said := capsys.readouterr().err) and "--mp4 or --png" in said
    assert np.array_equal(print_job(folder).frames.images.numpy(), sent)  # type: ignore[union-attr]
