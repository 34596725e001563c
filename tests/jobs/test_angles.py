"""Angles of job files: a range, or a table of measured ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vamgpu.errors import JobError
from vamgpu.geometry import Turntable
from vamgpu.jobs.build import motion_of, read_angles
from vamgpu.jobs.demo import JOB
from vamgpu.jobs.read import parse_job
from vamgpu.jobs.run import prove, solve
from vamgpu.units import deg

SMALL = ["target.pitch=900 um", "beam.pitch=1200 um", "solve.iterations=2", "solve.device=numpy"]


def job_of(*settings: str, folder: Path = Path()):  # noqa: ANN201
    return parse_job(JOB, settings, folder=folder)


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


@pytest.mark.slow
@pytest.mark.parametrize("scan", ["turntable.angles=scan.csv", "turntable.range=180 deg"])
def test_a_job_keeps_its_angles_to_the_proof(tmp_path: Path, scan: str) -> None:
    theta = np.linspace(1.0, 350.0, 15)
    rows = "".join(f"{angle:.6f},{1 + k % 2}\n" for k, angle in enumerate(theta))
    (tmp_path / "scan.csv").write_text("angle_deg,dwell\n" + rows, encoding="utf-8")
    job = job_of(*SMALL, "turntable.angles=20", scan, folder=tmp_path)
    folder = solve(job, tmp_path / "part.vam")
    proof = prove(tmp_path / "part.vam", "numpy").proof
    motion = motion_of(job.file.turntable, tmp_path)
    assert proof.operator.motion == motion and motion.theta is not None
    assert folder.manifest.inputs["geometry"]["turntable"]["theta"] == list(motion.theta)
    assert abs(proof.scores.window - prove(tmp_path / "part.vam", "numpy").plan.window) <= 1 / 255


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
