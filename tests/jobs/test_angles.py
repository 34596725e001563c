"""Angles of job files: a range, or a table of measured ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.errors import JobError
from vamgpu.geometry import Turntable
from vamgpu.jobs.build import motion_of, projection_of, read_angles, target_of
from vamgpu.jobs.demo import JOB
from vamgpu.jobs.read import Job
from vamgpu.jobs.run import prove, solve
from vamgpu.storage.turntable import described, turntable_from
from vamgpu.units import deg

SMALL = ["target.pitch=900 um", "beam.pitch=1200 um", "solve.iterations=2", "solve.device=cpu"]


def job_of(*settings: str, folder: Path = Path()):  # noqa: ANN201
    return Job.parse(JOB, settings, folder=folder)


def test_a_range_and_a_file_become_turntables(tmp_path: Path) -> None:
    assert motion_of(job_of("turntable.angles=24").file.turntable, tmp_path) == Turntable(24)
    half = job_of("turntable.angles=24", "turntable.range=180 deg").file.turntable
    assert motion_of(half, tmp_path) == Turntable.arc(24, np.pi)
    whole = job_of("turntable.angles=24", "turntable.range=360 deg").file.turntable
    assert motion_of(whole, tmp_path) == Turntable(24)
    (tmp_path / "scan.csv").write_text("angle_deg,dwell\n0,1\n10.5,1\n21.25,2\n", encoding="utf-8")
    measured = motion_of(job_of("turntable.angles=scan.csv").file.turntable, tmp_path)
    assert measured == Turntable(np.array([0, 10.5, 21.25]) * deg, dwell=[1, 1, 2])
    (tmp_path / "rad.csv").write_text("angle_rad\n0.5\n0.25\n", encoding="utf-8")
    assert read_angles(tmp_path / "rad.csv") == Turntable([0.5, 0.25])


def test_a_job_says_how_the_vial_moves_while_it_is_lit(tmp_path: Path) -> None:
    (tmp_path / "rad.csv").write_text("angle_rad\n0.5\n0.25\n", encoding="utf-8")
    shares = [
        motion_of(job_of(*given).file.turntable, tmp_path).lit_share
        for given in (["turntable.range=90 deg"], ["turntable.lit_share=0.5"], ["turntable.angles=rad.csv"],
                      ["turntable.angles=rad.csv", "turntable.lit_share=1"])
    ]  # fmt: skip
    assert shares == [1.0, 0.5, 0.0, 1.0]
    with pytest.raises(JobError, match=r"turntable\.lit_share: got 1\.5; expected"):
        job_of("turntable.lit_share=1.5")


@pytest.mark.parametrize("motion", [Turntable(6), Turntable([0.0, 1.0], lit_share=0.3)])
def test_manifests_keep_how_the_vial_moves_and_older_ones_were_at_rest(motion: Turntable) -> None:
    said = described(motion)
    assert turntable_from(said) == motion
    assert turntable_from({name: value for name, value in said.items() if name != "lit_share"}) == motion.stepped


@pytest.mark.slow
@pytest.mark.parametrize("scan", ["turntable.angles=scan.csv", "turntable.range=180 deg"])
def test_a_job_keeps_its_angles_to_the_proof(tmp_path: Path, scan: str) -> None:
    theta = np.linspace(1.0, 350.0, 15)
    rows = "".join(f"{angle:.6f},{1 + k % 2}\n" for k, angle in enumerate(theta))
    (tmp_path / "scan.csv").write_text("angle_deg,dwell\n" + rows, encoding="utf-8")
    job = job_of(*SMALL, "turntable.angles=20", scan, folder=tmp_path)
    folder = solve(job, tmp_path / "part.vam")
    proof = prove(tmp_path / "part.vam").proof
    motion = motion_of(job.file.turntable, tmp_path)
    assert proof.operator.motion == motion and motion.theta is not None
    assert folder.manifest.inputs["geometry"]["turntable"]["theta"] == list(motion.theta)
    assert abs(proof.scores.window - prove(tmp_path / "part.vam").plan.window) <= 1 / 255


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("angle\n1\n", "columns angle; expected angle_deg or angle_rad"),
        ("angle_deg,time\n1,2\n", "columns angle_deg, time; expected"),
        ("angle_deg\n1\nmany\n", "line 3.*many"),
        ("angle_deg\n", "1 lines; expected a header and numbers"),
        ("angle_rad\n0\n90\n", "from 0 to 90 rad; expected one turn"),
        ("angle_deg,dwell\n0,1\n9,0\n", "one above 0 for each angle"),
    ],
)
def test_a_wrong_table_is_told(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "scan.csv").write_text(text, encoding="utf-8")
    with pytest.raises(JobError, match=rf"(?s)turntable\.angles: .*{said}"):
        read_angles(tmp_path / "scan.csv")


def test_a_missing_table_and_a_double_choice_are_told(tmp_path: Path) -> None:
    with pytest.raises(JobError, match=r"turntable\.angles: cannot read .*none\.csv"):
        read_angles(tmp_path / "none.csv")
    with pytest.raises(JobError, match=r"turntable:? .*got a range and the file 'scan\.csv'.*remove one"):
        job_of("turntable.angles=scan.csv", "turntable.range=180 deg")


def test_a_job_may_leave_out_what_its_pixels_ask_for() -> None:
    """Voxels of a pixel in the resin, and angles from one to the next of which no point of the part moves farther."""
    bare = JOB.replace("[turntable]\nangles = 360\n", "")
    device = vam.open_device("numpy")
    for settings, most in (((), 240), (("turntable.most=100",), 100), (("turntable.range=180 deg",), 120)):
        job = Job.parse(bare, ["beam.pitch=1200 um", *settings])
        target = target_of(job, device)
        A = projection_of(job.file, target, device)
        width = vam.resin_pixel(A.beam, A.vessel)[0]
        assert target.grid.pitch == pytest.approx(width) == pytest.approx(1.2 / 1.49962, rel=1e-4)
        whole = vam.enough_angles(A.beam, A.vessel, target.radius)
        assert whole >= 2.0 * np.pi * target.radius / width > whole - 60
        assert A.motion.angles == min(most, whole) if "range" not in str(settings) else -(-whole // 2)
    with pytest.raises(JobError, match="turntable.most: got 100 with angles = 24; remove one"):
        job_of("turntable.angles=24", "turntable.most=100")
