"""Jobs that are solved on rings."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import vamgpu as vam
from vamgpu.backend import open_device
from vamgpu.errors import JobError, OutOfMemory
from vamgpu.jobs.read import read_job
from vamgpu.jobs.run import prove, solve
from vamgpu.operators.ring_projection import prefers_rings

JOB = """
[target]
shape = "nut"
height = "2 mm"
pitch = "500 um"

[vial]
radius = "4.2 mm"
wall = "0.4 mm"
resin_index = 1.49962
wall_index = 1.473

[beam]
pitch = "700 um"

[turntable]
angles = 48

[solve]
operator = "rings"
iterations = 2
device = "cpu"
"""


def job(tmp_path: Path, text: str = JOB) -> Any:
    path = tmp_path / "job.toml"
    path.write_text(text)
    return read_job(path)


def test_a_job_is_solved_on_rings_and_proven_by_rays(tmp_path: Path) -> None:
    solve(job(tmp_path), tmp_path / "boat.vam")
    frames: Any = vam.load(tmp_path / "boat.vam", device="numpy")
    assert isinstance(frames.plan.operator, vam.RingProjection)
    proven = prove(tmp_path / "boat.vam")
    assert proven.plan.ran == f"RingProjection on {open_device('cpu').name}"
    assert isinstance(proven.proof.operator, vam.Projection) and proven.proof.independent
    page = proven.report(tmp_path / "boat.html").read_text()
    assert proven.plan.ran in page


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("angles = 48", 'angles = 48\nrange = "180 deg"'), "even over a full turn"),
        (("[solve]", "[wobble]\nradius = 0.1\n[solve]".replace("0.1", '"0.1 mm"')), "Wobbled"),
        (("[solve]", '[resin.diffusion]\ndiffusivity = "1e-2 mm2/s"\nseconds = "10 s"\n[solve]'), "diffuses"),
    ],
)
def test_what_rings_do_not_take_is_told_with_the_way_out(tmp_path: Path, change: tuple[str, str], said: str) -> None:
    with pytest.raises(JobError, match=f'(?s)"rings".*{said}.*"voxels"'):
        solve(job(tmp_path, JOB.replace(*change)), tmp_path / "boat.vam")


def test_a_resin_that_scatters_is_solved_and_proven_with_scattered_light(tmp_path: Path) -> None:
    """From the folder, the operator is the same to the last bit, as its photons are."""
    turbid = JOB + '[scattering]\ncoefficient = "0.4 /mm"\nphotons = 60000\ntolerance = 0.1\n'
    solve(job(tmp_path, turbid), tmp_path / "boat.vam")
    proven = prove(tmp_path / "boat.vam")
    A: Any = proven.proof.operator
    assert isinstance(A, vam.ScatteringRings) and A.scattering == vam.Scattering(0.4)
    assert (A.photons, A.tolerance) == (60000, 0.1)
    assert proven.proof.independent
    claimed, found = proven.proof.claimed, proven.proof.scores
    assert found.total_in == pytest.approx(claimed.total_in, rel=0.02)
    clear = vam.simulate(A.operator, proven.proof.frames, proven.proof.target)
    assert found.total_in < 0.97 * clear.scores.total_in  # light leaves the part


@pytest.mark.parametrize("other", ['[wobble]\nradius = "0.1 mm"\n', '[colors]\nabsorption = "0.1 /mm"\n'])
def test_scattering_beside_what_it_does_not_know_is_refused(tmp_path: Path, other: str) -> None:
    with pytest.raises(JobError, match=r"scattering: got \[scattering\] and \["):
        job(tmp_path, JOB + '[scattering]\ncoefficient = "0.4 /mm"\n' + other)


@pytest.mark.parametrize(("key", "said"), [
    ('anisotropy = "0.9"', "scattering.anisotropy: got '0.9'; expected a number without quotes: remove them"),
    ("anisotropy = 1", r"line \d+: scattering: .* −0.98 to 0.98"),
    ('anisotropy = "mie"', r"line \d+: scattering.anisotropy: got 'mie'; expected 'rayleigh'; correct the value$"),
    ('phase = [["0 deg", 1], ["170 deg", 1]]', r"line \d+: scattering: .* from 0° to 170°; .* to 180°"),
    ('anisotropy = 0.5\nphase = [["0 deg", 1], ["180 deg", 1]]', r"line \d+: scattering.phase: .*; remove one$"),
])  # fmt: skip
def test_wrong_scattering_is_named_with_its_line(tmp_path: Path, key: str, said: str) -> None:
    with pytest.raises(JobError, match=said):
        job(tmp_path, f'{JOB}[scattering]\ncoefficient = "0.4 /mm"\n{key}\n')


def test_light_out_of_focus_is_solved_on_rings_and_proven_by_rays(tmp_path: Path) -> None:
    blurred = JOB + '[defocus]\nfwhm = "1 mm"\ndepth_of_focus = "3 mm"\n'
    solve(job(tmp_path, blurred), tmp_path / "boat.vam")
    proven = prove(tmp_path / "boat.vam")
    frames: Any = vam.load(tmp_path / "boat.vam", device="numpy")
    solved, judged = frames.plan.operator, proven.proof.operator
    assert isinstance(solved, vam.Defocused) and isinstance(solved.operator, vam.RingProjection)
    assert proven.plan.ran == f"Defocused RingProjection on {open_device('cpu').name}"
    assert isinstance(judged, vam.Defocused) and isinstance(judged.operator, vam.Projection)
    assert solved.defocus == judged.defocus and solved.tolerance == judged.tolerance


def test_auto_takes_rings_only_where_they_pay(tmp_path: Path) -> None:
    solve(job(tmp_path, JOB.replace('"rings"', '"auto"')), tmp_path / "boat.vam")
    assert prove(tmp_path / "boat.vam").plan.ran == f"Projection on {open_device('cpu').name}"


def test_auto_keeps_to_voxels_where_the_table_is_too_large(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: Any, shape: tuple[int, ...]) -> Any:
        raise OutOfMemory(f"no room for {shape}")

    monkeypatch.setattr(type(open_device("cpu")), "reserve", full)
    monkeypatch.setattr("vamgpu.operators.projector.prefers_rings", lambda _: True)
    auto = JOB.replace('"rings"', '"auto"\nmethod = "lbfgs"')  # the default has tables of the resin beside the part
    solve(job(tmp_path, auto), tmp_path / "boat.vam")
    assert prove(tmp_path / "boat.vam").plan.ran == f"Projection on {open_device('cpu').name}"
    with pytest.raises(OutOfMemory, match="no room"):
        solve(job(tmp_path), tmp_path / "other.vam")


def test_where_rings_pay(opencl_device: Any) -> None:
    beam = vam.Beam((96, 2), 0.1)
    for across, pays in ((40, False), (96, not opencl_device.is_gpu), (128, True)):
        grid = vam.Grid((across, across, 2), 0.1)
        assert prefers_rings(vam.Projection(grid, beam, vam.Turntable(180), device=opencl_device)) == pays
    prime = vam.Projection(grid, beam, vam.Turntable(367), device=opencl_device)
    assert not prefers_rings(prime)
