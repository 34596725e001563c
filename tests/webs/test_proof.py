"""Webs proven from their frames, and jobs of webs from TOML to the report."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from trimesh.creation import box

from vamgpu.cli import main
from vamgpu.errors import JobError, StorageError
from vamgpu.jobs.demo import WEB_JOB as JOB
from vamgpu.jobs.limits import parse_limits
from vamgpu.jobs.web import WebJob, contrasts, solve_web, stream_of
from vamgpu.operators.web import WebProjection
from vamgpu.printing.frames import Frames
from vamgpu.studio.films import described
from vamgpu.web import WebGrid
from vamgpu.webs import proof
from vamgpu.webs.proof import prove_web
from vamgpu.webs.store import WebFolder
from vamgpu.webs.tiles import Columns

SMALL = (
    "web.length=60 mm", "beam.pitch=300 um", "beam.height=1.2 mm", "roller.step=2 deg", "solve.iterations=10",
)  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> WebFolder:
    return solve_web(WebJob.parse(JOB, SMALL), tmp_path_factory.mktemp("web") / "web.vam")


def test_the_proof_is_the_dose_of_the_bytes(folder: WebFolder) -> None:
    job = stream_of(WebJob.parse(JOB, SMALL))
    assert job.light.shape[2] == job.layout.window and len(folder.segments) == 3
    grid = WebGrid((folder.columns, *job.grid.shape[1:]), job.grid.pitch)
    planes = len(folder.details["frames"]["focus"]["planes"])
    wrap = replace(job.wrap, lit_share=job.wrap.lit_share / planes)  # type: ignore[type-var]  # each for its share
    A = WebProjection(
        grid, job.beam, wrap, job.device, poses=folder.frames, start=float(-job.layout.lead * job.layout.step)
    )
    images = folder.read("frames", 0, folder.frames)
    scale = folder.details["frames"]["scale"]
    light = Frames.from_bytes(
        images, job.device, bits=8, gray=job.gray, scale=scale, columns=job.beam.pixels[0]
    ).irradiance()
    dose = A.T(light).numpy()
    target = folder.read("target", 0, folder.columns) >= 128
    proof = prove_web(folder)
    for piece in proof.pieces():
        here = slice(*piece.columns)
        assert np.abs(piece.dose - dose[here]).max() < 1e-5 * dose.max()
        assert np.array_equal(piece.target, target[here])
    printed = dose >= proof.threshold
    assert proof.iou == pytest.approx((printed & target).sum() / (printed | target).sum(), abs=1e-3)
    assert proof.segments[-1].columns[1] == folder.columns
    for score in proof.segments:
        d, t = dose[slice(*score.columns)], target[slice(*score.columns)]
        assert score.window == pytest.approx((d[t].min() - d[~t].max()) / d.max(), abs=1e-5)
    assert proof.iou > 0.7


def test_what_is_printed_so_far_can_be_proven(folder: WebFolder) -> None:
    part = WebFolder(folder.path, folder.details, folder.segments[:1])
    proof = prove_web(part)
    whole = prove_web(folder)
    first, again = next(whole.pieces()), next(proof.pieces())
    assert 0 < again.columns[1] < folder.columns
    assert np.array_equal(again.dose, first.dose[: len(again.dose)])


def test_a_malformed_folder_is_refused(folder: WebFolder) -> None:
    for key in ("wrap", "layout", "frames"):
        with pytest.raises(StorageError, match="malformed"):
            prove_web(WebFolder(folder.path, {**folder.details, key: {}}, folder.segments) if key != "wrap" else
                      WebFolder(folder.path, {k: v for k, v in folder.details.items() if k != key}))  # fmt: skip
    empty = {**folder.details, "grid": {**folder.details["grid"], "pitch": []}}
    with pytest.raises(StorageError, match="malformed"):
        described(WebFolder(folder.path, empty, folder.segments))


@pytest.mark.slow
def test_the_commands_solve_prove_and_draw(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "gyroid.toml"
    file.write_text(JOB, encoding="utf-8")
    options = [part for setting in SMALL for part in ("--set", setting)]
    assert main(["solve", str(file), *options]) == 0
    assert main(["solve", str(file), *options]) == 0  # complete: nothing is left to do
    assert main(["prove", str(tmp_path / "gyroid.vam"), "--report", str(tmp_path / "web.html")]) == 0
    assert "overlap (IoU)" in capsys.readouterr().out
    page = (tmp_path / "web.html").read_text(encoding="utf-8")
    assert "Light about the roller" in page and "focused at" in page and "http://" not in page.split("</style>")[0]
    assert main(["solve", str(file), *options, "--set", "target.cell=5 mm"]) == 1
    assert "holds another web" in capsys.readouterr().err
    assert main(["export", str(tmp_path / "gyroid.vam"), "--png", str(tmp_path / "png")]) == 1
    assert "is a web" in capsys.readouterr().err


@pytest.mark.slow
def test_the_demo_shows_contrast(tmp_path: Path) -> None:
    settings = [part for setting in SMALL for part in ("--set", setting)]
    assert main(["demo", "web", "--out", str(tmp_path), *settings]) == 0
    page = (tmp_path / "web.html").read_text(encoding="utf-8")
    assert "Contrast against the index ratio" in page and "A gyroid film" in page


def test_contrast_falls_with_the_index_ratio() -> None:
    shares = [share for _, share in contrasts((1.0, 0.84, 0.67), voxels=20)]
    assert shares == sorted(shares, reverse=True)


def test_the_limits_are_told_from_the_same_file() -> None:
    assert parse_limits(JOB).length == 80.0


def test_a_mesh_stays_where_it_is(tmp_path: Path) -> None:
    block = box((2.0, 1.0, 0.6))
    block.apply_translation((1.5, 2.0, 0.0))
    block.export(tmp_path / "block.stl")
    text = JOB.replace('lattice = "SheetGyroid"', 'mesh = "block.stl"').replace('cell = "6 mm"', 'period = "5 mm"')
    job = stream_of(WebJob.parse(text, SMALL, folder=tmp_path))
    columns = Columns(job.tiles, job.grid, job.length).take(0, round(5.0 / job.grid.edges[0]))
    _, rho, z = job.grid.axes()
    filled = columns.sum(axis=0)
    assert np.average(rho, weights=filled.sum(axis=1)) == pytest.approx(2.0, abs=0.02)
    assert np.average(z, weights=filled.sum(axis=0)) == pytest.approx(0.0, abs=0.02)
    assert columns.sum() * job.grid.voxel_volume == pytest.approx(1.2, rel=0.01)


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("target.lattice=cheese", "expected one of .*SheetGyroid"),
        ("target.strut=1 mm", "SheetGyroid has other parameters, cell, level: remove strut"),
        ("target.mesh=part.stl", "exactly one of lattice"),
        ("film.thickness=3", "expected a length with its unit"),
        ("solve.core=0", "greater than 0"),
        ("solve.cores=2", "did you mean 'core'"),
    ],
)
def test_wrong_values_are_named(setting: str, said: str) -> None:
    with pytest.raises(JobError, match=said):
        stream_of(WebJob.parse(JOB, (*SMALL, setting)))


def test_doses_are_counted_as_a_histogram_counts_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(proof, "CHUNK", 50)
    rng = np.random.default_rng(5)
    target = rng.random((23, 4, 5)) > 0.4
    dose = ((rng.integers(-20, 3 * proof.BINS, target.shape) + 0.5) * proof.REACH / proof.BINS).astype(np.float32)
    edges = np.linspace(0.0, proof.REACH, proof.BINS + 1)
    kept = np.clip(dose, 0.0, proof.REACH)
    expected = [np.histogram(kept[target == part], edges)[0] for part in (False, True)]
    assert np.array_equal(proof._counted(dose, target), expected)
