"""The command line: what it says and what it returns."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
import trimesh

import vamgpu
from vamgpu.cli import main
from vamgpu.cli.doctor import Finding, _ask, examine

SMALL = {
    "target.pitch": "1 mm",
    "beam.pitch": "1.4 mm",
    "turntable.angles": "24",
    "solve.iterations": "3",
    "frames.flip_r": "false",
}
BALL = """[target]
mesh = "ball.stl"
height = "2 mm"
pitch = "100 um"

[beam]
pitch = "100 um"

[turntable]
angles = 60

[solve]
iterations = 30
"""
"""A small part in air that prints."""
SETTINGS = [word for key, value in SMALL.items() for word in ("--set", f"{key}={value}")]


def test_a_command_that_computes_nothing_loads_no_arrays() -> None:
    code = "import sys; from vamgpu.cli import main; main(['--version']); print('numpy' in sys.modules)"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert said.split() == [vamgpu.__version__, "False"]


@pytest.mark.slow
def test_demo_prove_and_export(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--out", str(tmp_path / "demo"), *SETTINGS]) == 0
    assert str(tmp_path / "demo" / "report.html") in capsys.readouterr().out
    job = str(tmp_path / "demo" / "boat.vam")
    assert main(["prove", job]) == 0
    said = capsys.readouterr().out
    assert "Does not print: " in said and "→ " in said and said.index("Does not print") < said.index("judged by")
    assert main(["prove", job, "--check"]) == 3
    nominal = (tmp_path / "demo" / "boat.html").read_bytes()
    capsys.readouterr()
    assert main(["prove", job, "--off", "axis=600 um", "--off", "dose=-30 %"]) == 0
    assert "axis +600 µm, dose -30 %" in capsys.readouterr().out
    assert "errors: axis +600 µm, dose -30 %" in (tmp_path / "demo" / "boat-off.html").read_text(encoding="utf-8")
    assert (tmp_path / "demo" / "boat.html").read_bytes() == nominal
    assert main(["prove", job, "--report", str(tmp_path / "boat.stl")]) == 1
    assert "expected a path ending in .html" in capsys.readouterr().err
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken.tif").touch()
    assert main(["export", job, "--tiff", str(tmp_path / "taken.tif")]) == 1
    assert "--overwrite" in capsys.readouterr().err
    for flag in ("--png", "--drtvam"):
        assert main(["export", job, flag, str(tmp_path / "taken")]) == 1
        assert "is a folder, which is never replaced" in capsys.readouterr().err
    formats = {"--png": "frames", "--tiff": "frames.tif", "--npz": "frames.npz", "--mp4": "frames.mp4"}
    words = [word for flag, name in formats.items() for word in (flag, str(tmp_path / name))]
    assert main(["export", job, *words]) == 0
    assert len(list((tmp_path / "frames").glob("*.png"))) == 24
    assert all((tmp_path / name).stat().st_size > 0 for name in formats.values())


@pytest.mark.slow
def test_a_job_that_prints_says_so_and_checks_with_0(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    trimesh.creation.icosphere(3, 1.0).export(tmp_path / "ball.stl")
    (tmp_path / "ball.toml").write_text(BALL, encoding="utf-8")
    assert main(["solve", str(tmp_path / "ball.toml")]) == 0
    assert "Not proved; according to the solver's own dose it prints: 1 body as in the part" in " ".join(
        capsys.readouterr().out.split()
    )
    assert main(["prove", str(tmp_path / "ball.vam"), "--check"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "Prints: 1 body as in the part, 95 % of the surface within" in said
    page = (tmp_path / "ball.html").read_text(encoding="utf-8")
    assert 'class="verdict good">Prints: 1 body as in the part' in page


def test_solve_writes_beside_the_file_and_overwrites_only_when_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from vamgpu.jobs.demo import JOB

    (tmp_path / "part.toml").write_text(JOB, encoding="utf-8")
    command = ["solve", str(tmp_path / "part.toml"), *SETTINGS]
    command += ["--set", "target.shape=gear_base", "--set", "target.height=6 mm"]
    assert main(command) == 0
    manifest = json.loads((tmp_path / "part.vam" / "manifest.json").read_text(encoding="utf-8"))
    assert manifest["inputs"]["job"]["frames"]["flip_r"] is False
    assert main(command) == 1
    assert "--overwrite" in capsys.readouterr().err
    assert main([*command, "--overwrite"]) == 0


@pytest.mark.slow
def test_memory_is_told_the_device_and_leaves_out_what_is_larger(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from vamgpu.jobs.demo import JOB

    if not any(name.startswith("opencl") for name in vamgpu.devices()):
        pytest.skip("fields in files need a processor through OpenCL")
    (tmp_path / "part.toml").write_text(JOB, encoding="utf-8")
    given = {key: value for key, value in SMALL.items() if key != "solve.device"}
    settings = [word for key, value in given.items() for word in ("--set", f"{key}={value}")]
    solve = ["solve", str(tmp_path / "part.toml"), *settings, "--memory", "1.5GB"]
    with monkeypatch.context() as larger:
        larger.setattr("vamgpu.printing.report.BYTES_A_VOXEL", 10**9)
        assert main(solve) == 0
    said = capsys.readouterr().out
    assert "no verdict" in said and "according to the solver's own dose" not in said
    assert main([*solve, "--overwrite"]) == 0 and "according to the solver's own dose" in capsys.readouterr().out
    manifest = json.loads((tmp_path / "part.vam" / "manifest.json").read_text(encoding="utf-8"))
    assert manifest["inputs"]["job"]["solve"]["device"].endswith("@500000000B")
    prove = ["prove", str(tmp_path / "part.vam"), "--memory", "1.5GB"]
    monkeypatch.setattr("vamgpu.printing.report.BYTES_A_VOXEL", 10**9)
    assert main(prove) == 0
    assert "no report" in capsys.readouterr().out and not (tmp_path / "part.html").exists()
    monkeypatch.undo()
    assert main(prove) == 0 and (tmp_path / "part.html").exists()
    assert main([*prove[:2], "--memory", "much"]) == 1
    assert "expected more than 1 GB" in capsys.readouterr().err


def test_errors_are_one_clear_text(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "part.toml").write_text('[target]\npitch = 3\nshape = "boat"\nheight = "9 mm"\n', encoding="utf-8")
    assert main(["solve", str(tmp_path / "part.toml")]) == 1
    said = capsys.readouterr().err
    assert "part.toml, line 2: target.pitch: got 3" in said and "Traceback" not in said
    assert "beam is missing; add the table [beam]" in said
    assert main(["prove", str(tmp_path)]) == 1
    assert main(["prove", str(tmp_path), "--report", str(tmp_path / "none" / "a.html")]) == 1
    assert "none' does not exist; make it" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["prove", str(tmp_path), "--off", "axis=1 mm", "dose=5 %"])
    assert "repeat it for each: --set a=1 --set b=2" in capsys.readouterr().err
    assert main(["export", str(tmp_path)]) == 1
    assert "--png" in capsys.readouterr().err


def test_an_interrupt_is_no_traceback(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("vamgpu.jobs.demo.demo", stop)
    assert main(["demo"]) == 130
    assert capsys.readouterr().err == "\nStopped.\n"


@pytest.mark.parametrize(
    ("kept", "more", "said"),
    [
        (False, [], "Stopped."),
        (True, [], "Stopped. Run the same command to continue."),
        (True, ["--overwrite"], "Stopped. Run the same command without --overwrite to continue."),
        (
            True,
            ["--overwrite", "--start", "other.vam"],
            "Stopped. Run the same command without --overwrite and --start to continue.",
        ),
    ],
)
def test_a_stopped_command_tells_how_it_continues(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], kept: bool, more: list[str],
    said: str,
) -> None:  # fmt: skip
    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    (tmp_path / "ball.toml").write_text(BALL, encoding="utf-8")
    trimesh.creation.icosphere(2, 1.0).export(tmp_path / "ball.stl")
    monkeypatch.setattr("vamgpu.jobs.run.solve", stop)
    monkeypatch.setattr("vamgpu.jobs.run.is_interrupted", lambda place: kept and place == tmp_path / "ball.vam")
    assert main(["solve", str(tmp_path / "ball.toml"), *more]) == 130
    assert capsys.readouterr().err == f"\n{said}\n"


def test_a_job_file_is_not_proven_but_solved(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "ball.toml").write_text(BALL, encoding="utf-8")
    assert main(["prove", str(tmp_path / "ball.toml")]) == 1
    said = capsys.readouterr().err
    assert "is a job file" in said and f"vam prove {tmp_path / 'ball.vam'}" in said


def test_the_page_of_a_run_stands_beside_that_of_its_job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pages: list[Path] = []
    (tmp_path / "ball.run").mkdir()
    (tmp_path / "ball.run" / "run.json").write_text("{}", encoding="utf-8")
    monkeypatch.setattr("vamgpu.cli.prove._prove_run", lambda run, page, *_: pages.append(page) or True)
    assert main(["prove", str(tmp_path / "ball.run")]) == 0
    assert pages == [tmp_path / "ball.run.html"]


def test_devices_are_listed_best_first(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["devices"]) == 0
    assert tuple(capsys.readouterr().out.split()) == vamgpu.devices()


@pytest.mark.slow
def test_the_doctor_finds_every_working_device() -> None:
    found = examine()
    assert {finding.name for finding in found if finding.works} == set(vamgpu.devices())
    assert all(finding.remedy for finding in found if not finding.works)


def test_the_doctor_survives_a_driver_that_hangs_or_dies(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert "no answer within" in _ask(["list"], 0.01)["error"]
    fake = tmp_path / "python"
    fake.write_text("#!/bin/sh\nkill -SEGV $$\n", encoding="utf-8")
    fake.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(fake))
    assert _ask(["probe", "opencl:bad:0"], 10.0)["error"] == "the driver ended its process with signal 11"
    assert examine() == [
        Finding(
            "all devices", "the driver ended its process with signal 11", False,
            "a driver crashes its process; remove it or update it",
        )
    ]  # fmt: skip


def test_bench_keeps_a_record(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["bench", "--size", "8", "--angles", "6", "--repeats", "1", "--device", "numpy"]
    assert main([*words, "--record", str(tmp_path / "bench.json")]) == 0
    assert "straight" in capsys.readouterr().out
    record = json.loads((tmp_path / "bench.json").read_text(encoding="utf-8"))
    assert {row["operator"] for row in record["timings"]} == {"straight", "vial"}


def test_used_up_memory_is_an_error_without_a_traceback(capsys, monkeypatch):
    import vamgpu.cli.commands as commands

    def full(*_, **__):
        raise MemoryError("Unable to allocate 880 GiB")

    monkeypatch.setattr(commands, "app", full)
    assert main(["bench"]) == 1
    assert "memory is used up: Unable to allocate 880 GiB; use larger pitches" in capsys.readouterr().err


@pytest.mark.slow
def test_bench_tells_the_stages_of_a_job(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from vamgpu.jobs.demo import JOB

    (tmp_path / "job.toml").write_text(JOB, encoding="utf-8")
    small = ["target.shape=gear_base", "target.height=6 mm", "target.pitch=1 mm", "beam.pitch=1 mm"]
    small += ["turntable.angles=20", "solve.iterations=2"]
    assert main(["bench", "--job", str(tmp_path / "job.toml"), *(f"--set={each}" for each in small)]) == 0
    said = capsys.readouterr().out
    told = {line.split("│")[1].strip(): line.split("│")[2:] for line in said.splitlines() if line.count("│") > 3}
    assert list(told)[1:5] == ["voxelizing the part", "tracing rays", "optimizing the patterns", "packing the frames"]
    shares = [float(cells[1].strip().rstrip("%")) for cells in told.values()]
    assert abs(sum(shares) - 100.0) <= len(shares) and told["optimizing the patterns"][2].strip().endswith(" s")
    assert [path.name for path in tmp_path.iterdir()] == ["job.toml"]


@pytest.mark.parametrize("wrong", [["--size", "0"], ["--repeats", "0"], ["--angles", "-1"]])
def test_bench_refuses_counts_below_one(wrong, capsys):
    assert main(["bench", *wrong]) == 1
    assert "expected at least 1" in capsys.readouterr().err


def test_a_device_that_is_neither_name_nor_device_is_refused():
    from vamgpu.backend import open_device
    from vamgpu.errors import DeviceError

    with pytest.raises(DeviceError, match="got 0 for a device; expected a name"):
        open_device(0)  # type: ignore[arg-type]
