"""``vam curethrough``: what it reads, writes, says and refuses."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest

from vamgpu.cli import main
from vamgpu.curethrough.images import encode
from vamgpu.curethrough.output import RECORD
from vamgpu.curethrough.stack import open_stack
from vamgpu.jobs.curethrough import EXAMPLE, CurethroughJob
from vamgpu.jobs.progress import events_path


def part() -> np.ndarray:
    """Two plates and a beam, 70 slices of 12 × 16 pixels."""
    stack = np.zeros((70, 12, 16), np.uint8)
    stack[:8, 1:11, 1:15] = stack[40:64, 1:11, 1:9] = stack[50:60, 3:6, 9:15] = 255
    return stack


@pytest.fixture
def job(tmp_path: Path) -> Path:
    (tmp_path / "slices").mkdir()
    for k, picture in enumerate(part()):
        (tmp_path / "slices" / f"slice{k}.png").write_bytes(encode(picture, ".png"))
    (tmp_path / "part.toml").write_text(EXAMPLE, encoding="utf-8")
    return tmp_path / "part.toml"


def test_correct_writes_slices_beside_the_originals(job: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = {file.name: file.read_bytes() for file in (job.parent / "slices").iterdir()}
    assert main(["curethrough", "correct", str(job)]) == 0
    said = capsys.readouterr().out
    out, page = job.parent / "slices-corrected", job.parent / "slices-corrected.html"
    assert "error ratio" in said and str(page) in said and "4 added after the last" in said
    with open_stack(out) as stack:
        assert stack.shape == (74, 12, 16) and stack.names[69:71] == ("slice69.png", "slice70.png")
        levels = stack[0:74]
    assert (levels[64:67, 1:11, 1:9].min(axis=(1, 2)) > 0).all(), "light in the void behind the last feature"
    assert (levels[20:34] == 0).all()
    record = json.loads((out / RECORD).read_text())
    assert record["job"]["printer"]["speed"] == "1000 mm/h" and record["added slices"] == 4
    assert {file.name: file.read_bytes() for file in (job.parent / "slices").iterdir()} == before
    html = page.read_text()
    assert html.count("data:image/webp") >= 12 and "<svg" in html and "The correction leaves" in html
    assert main(["curethrough", "correct", str(job)]) == 1
    assert "exists; choose another path" in capsys.readouterr().err
    assert main(["curethrough", "correct", str(job), "--overwrite"]) == 0
    assert main(["curethrough", "correct", str(job), "--out", str(job.parent / "slices"), "--overwrite"]) == 1
    assert "would overwrite the originals" in capsys.readouterr().err


def test_model_writes_doses_and_a_report(job: Path, capsys: pytest.CaptureFixture[str]) -> None:
    doses = job.parent / "doses.zip"
    assert main(["curethrough", "model", str(job), "--doses", str(doses)]) == 0
    said = capsys.readouterr().out
    assert "excess height, uncorrected" in said and "corrected, corrected" not in said
    assert "print incorrectly" in (job.parent / "part-model.html").read_text()
    from vamgpu.curethrough.dose import column_doses

    machine = CurethroughJob.parse(EXAMPLE).machine
    wanted = np.minimum(np.rint(51 * column_doses(machine, part())[:-1]), 255)
    with open_stack(doses) as stack:
        assert np.abs(stack[0:70].astype(int) - wanted).max() <= 1


def test_zips_meshes_and_layers(job: Path) -> None:
    archive = job.parent / "print.sl1"
    with zipfile.ZipFile(archive, "w") as file:
        file.writestr("config.ini", "layerHeight = 0.1\nnumFast = 70\n")
        for k, picture in enumerate(part()):
            file.writestr(f"print{k:05d}.png", encode(picture, ".png"))
    words = ["curethrough", "correct", str(job), "--slices", str(archive)]
    layers = job.parent / "layers.toml"
    layers.write_text(EXAMPLE.replace('speed = "1000 mm/h"', 'exposure = "0.9 s"').replace("2 mm", "110 um"))
    assert main([*words[:2], str(layers), *words[3:]]) == 0
    with open_stack(job.parent / "print-corrected.sl1") as stack:
        assert stack.shape == (70, 12, 16), "layer by layer nothing is added"
    mesh = job.parent / "mesh.toml"
    text = EXAMPLE.replace('path = "slices"', 'mesh = "cube.obj"\npitch = "250 um"\nheight = "3 mm"')
    mesh.write_text(text)
    corners = [f"v {x} {y} {z}" for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    faces = ("1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4")
    (job.parent / "cube.obj").write_text("\n".join([*corners, *(f"f {face}" for face in faces)]) + "\n")
    assert main(["curethrough", "correct", str(mesh)]) == 0
    with open_stack(job.parent / "mesh-corrected") as stack:
        assert stack.shape == (64, 16, 16) and stack.names[0] == "slice_0000.png"


def test_an_sl1_of_other_layers_is_warned_of(job: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with zipfile.ZipFile(job.parent / "a.sl1", "w") as file:
        file.writestr("config.ini", "layerHeight = 0.1\n")
        file.writestr("a00000.png", encode(part()[0], ".png"))
    assert main(["curethrough", "model", str(job), "--slices", str(job.parent / "a.sl1")]) == 0
    assert "has layers of 100 µm, but the job has 50 µm, which is used" in capsys.readouterr().err


def test_where_nothing_can_stay_uncured(job: Path, capsys: pytest.CaptureFixture[str]) -> None:
    dark = ["--set", "printer.dark=20 mW/cm2"]
    assert main(["curethrough", "correct", str(job), *dark]) == 1
    assert "720 mJ/cm³" in (said := capsys.readouterr().err) and "576" in said and "print faster than" in said
    assert not (job.parent / "slices-corrected").exists()
    assert main(["curethrough", "model", str(job), *dark]) == 0
    assert "even level 0 leaves 1.25 critical doses" in capsys.readouterr().err
    assert main(["curethrough", "correct", str(job), "--set", "printer.light=10 mW/cm2"]) == 1
    assert "print slower than" in capsys.readouterr().err


def test_slices_without_a_job_are_told_what_they_need(job: Path, capsys: pytest.CaptureFixture[str]) -> None:
    slices = job.with_name("x.ctb")
    slices.write_bytes(b"\x86\xff" * 900)
    assert main(["curethrough", str(slices)]) == 1
    assert f"vam curethrough correct job.toml --slices {slices}" in capsys.readouterr().err
    assert main(["curethrough", "correct", str(slices)]) == 1
    assert "a job file names a mesh in [target], or slices in [slices]" in capsys.readouterr().err
    assert main(["curethrough"]) == 0 and "Commands" in capsys.readouterr().out


def test_bad_jobs_and_bad_slices_are_one_clear_text(job: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (job.parent / "slices" / "slice7.png").unlink()
    assert main(["curethrough", "correct", str(job)]) == 1
    said = capsys.readouterr().err
    assert "69 slices numbered 0 to 69: missing 7" in said and "Traceback" not in said
    assert main(["curethrough", "model", str(job), "--set", "printer.speed=5", "--set", "printer.colour=1"]) == 1
    said = capsys.readouterr().err
    assert "printer.speed: got 5; expected a speed" in said and "printer.colour: unknown key" in said
    both = [word for setting in ("printer.exposure=2 s",) for word in ("--set", setting)]
    assert main(["curethrough", "model", str(job), *both]) == 1
    assert "exactly one of speed" in capsys.readouterr().err


def test_fit_finds_the_curves_that_measurements_were_made_with(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(4)
    exposures = np.repeat([40.0, 80.0, 160.0, 320.0, 640.0], 4)  # mJ/cm²; h_a 0.2 cm, D_gel 115.2 mJ/cm³
    heights = 2.0 * np.log10(exposures * np.log(10) / (115.2 * 0.2)) + rng.normal(0, 0.01, 20)
    rows = [f"{z:.4f},{x / 20:.5f}" for z, x in zip(heights, exposures, strict=True)]
    (tmp_path / "plugs.csv").write_text("\n".join(["height_mm,time_s", *rows]) + "\n")
    levels = np.arange(0, 256, 15)
    light = 1.0 + 99.0 * (levels / 255) ** 2
    readings = [f"{a},{b:.4f}" for a, b in zip(levels, light, strict=True)]
    (tmp_path / "gray.csv").write_text("\n".join(["level,intensity_mW_cm2", *readings]) + "\n")
    command = ["curethrough", "fit", str(tmp_path / "plugs.csv"), "--irradiance", "20 mW/cm2"]
    command += ["--gray", str(tmp_path / "gray.csv"), "--out", str(tmp_path / "fit.toml")]
    assert main(command) == 0
    said = capsys.readouterr().out
    assert "with 95 %" in said and "contrast 100 : 1" in said and "5 gel doses" in said
    import tomllib

    fitted = tomllib.loads((tmp_path / "fit.toml").read_text())
    assert float(fitted["printer"]["absorption_height"].split()[0]) == pytest.approx(2000, rel=0.02)
    assert float(fitted["printer"]["critical_dose"].split()[0]) == pytest.approx(576, rel=0.03)
    text = EXAMPLE.replace('dark = "1 mW/cm2"', 'gray = "fit.toml"')
    machine = CurethroughJob.parse(text, folder=tmp_path).machine
    np.testing.assert_allclose(np.array(machine.light)[levels] * 100, light, rtol=1e-3)
    assert main(command) == 1
    assert "exists" in capsys.readouterr().err
    assert main(["curethrough", "fit"]) == 1
    assert "nothing to fit" in capsys.readouterr().err
    assert main([*command[:3], "--irradiance", "20"]) == 1
    assert "expected an irradiance" in capsys.readouterr().err


def test_reports_never_replace_slices_or_jobs(job: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for wrong in (job, job.parent / "slices" / "slice3.png"):
        before = wrong.read_bytes()
        for command in ("model", "correct"):
            assert main(["curethrough", command, str(job), "--report", str(wrong)]) == 1
            assert "expected a path ending in .html" in capsys.readouterr().err
        assert wrong.read_bytes() == before
    assert not (job.parent / "slices-corrected").exists()


def test_fit_never_replaces_measurements(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plugs = tmp_path / "plugs.csv"
    plugs.write_text("exposure_mJ_cm2,height_mm\n10,0.5\n20,1.1\n40,1.7\n", encoding="utf-8")
    before = plugs.read_bytes()
    assert main(["curethrough", "fit", str(plugs), "--out", str(plugs), "--overwrite"]) == 1
    assert "holds the measurements" in capsys.readouterr().err and plugs.read_bytes() == before


def test_darkness_above_full_light_is_told(job: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["curethrough", "model", str(job), "--set", 'printer.dark="200 mW/cm2"']) == 1
    assert "2 mW/mm² at level 0 (dark) and 1 at 255" in capsys.readouterr().err


@pytest.mark.parametrize(("command", "option"), [("model", "--doses"), ("correct", "--out")])
def test_a_refused_command_leaves_the_record_of_the_one_before(job: Path, command: str, option: str) -> None:
    page = job.parent / "made.html"
    words = ["curethrough", command, str(job), option, str(job.parent / "made"), "--report", str(page)]
    assert main(words) == 0
    before = events_path(page).read_bytes()
    assert main(words) == 1 and main([*words[:4], str(job.parent / "slices" / "in"), *words[5:]]) == 1
    assert events_path(page).read_bytes() == before and b'"verdict"' in before


@pytest.mark.parametrize("command", ["model", "correct", "fit"])
def test_help_says_what_parameters_are(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    main(["curethrough", command, "--help"])
    said = capsys.readouterr().out
    assert ("the TOML file" if command != "fit" else "CSV file with columns height_mm") in said


@pytest.mark.slow
@pytest.mark.parametrize("ending", ["", ".zip"])
def test_a_run_killed_between_slices_and_report_is_completed(
    job: Path, ending: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out = job.parent / f"better{ending}"
    words = ["curethrough", "correct", str(job), "--out", str(out)]
    assert main(words) == 0
    page = job.parent / "better.html"
    report = page.read_bytes()
    page.unlink()
    assert main(words) == 0 and page.stat().st_size > 0.9 * len(report)
    assert main(words) == 1 and "exists; choose another path" in capsys.readouterr().err
    page.unlink()
    other = [*words, "--set", "correct.tail=9"]
    assert main(other) == 1, "slices of another job are not replaced"
    assert "exists; choose another path" in capsys.readouterr().err

    doses = [*words[:1], "model", str(job), "--doses", str(job.parent / f"doses{ending}")]
    assert main(doses) == 0
    (job.parent / "part-model.html").unlink()
    assert main(doses) == 0 and main(doses) == 1


def test_a_fit_without_an_irradiance_names_the_option(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "plugs.csv").write_text("height_mm,time_s\n0.5,5\n1.1,10\n1.7,20\n", encoding="utf-8")
    assert main(["curethrough", "fit", str(tmp_path / "plugs.csv")]) == 1
    assert '--irradiance "10 mW/cm2"' in capsys.readouterr().err
