"""Runout on an emulated rig: measured with a pin, kept with the rig, and made up for by prints that know the angle."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from vamgpu.cli import main
from vamgpu.errors import BadInput, StorageError
from vamgpu.hosts.calibrate import runout as runout_run
from vamgpu.hosts.calibrate.connection import rehearsal
from vamgpu.hosts.calibrate.report import CalibrationResult, keep
from vamgpu.hosts.emulators.calibration import Optics
from vamgpu.hosts.rig import plan
from vamgpu.hosts.rigs.calibrations import calibration_of
from vamgpu.hosts.rigs.config import EMULATED, RigConfig, parse_rig, read_rig
from vamgpu.printing.folder import save_frames
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve

TRUTH = Optics(radius=0.0, pin=9.0, seed=2)
STAGE = EMULATED.replace("[lens]\n", "[clock]\n").replace('[clock]\ndriver = "emulated"', '[clock]\ndriver = "stage"')


@cache
def found_on(text: str) -> CalibrationResult:
    """What emulated machines of a rig measure, once for all tests."""
    machines, _ = rehearsal(parse_rig(text), runout_run.TABLES, TRUTH)
    try:
        found = runout_run.runout(machines, poses=16, repeats=1)
        assert machines.controller is not None and not machines.controller.status().light
    finally:
        machines.close()
    return found


def measured(rig: RigConfig, text: str = STAGE) -> dict:
    keep(found_on(text), rig)
    return dict(found_on(text).numbers)


def rig_at(folder: Path, text: str = STAGE) -> RigConfig:
    file = folder / "lab.toml"
    file.write_text(text)
    return read_rig(file)


def rods(frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Place of a lit column in each frame at the middle row, and its slope."""
    rows = np.arange(frames.shape[1]) - 0.5 * (frames.shape[1] - 1)
    center = (frames * np.arange(frames.shape[2])).sum(axis=2) / frames.sum(axis=2)
    return center.mean(axis=1), (center * rows).sum(axis=1) / (rows**2).sum()


@pytest.mark.slow
def test_the_pin_is_apart_from_the_axis(tmp_path: Path) -> None:
    found = measured(rig_at(tmp_path))
    for name, error, truth in (
        ("column", "error_columns", TRUTH.axis), ("lean", "lean_error", TRUTH.lean),
        ("across", "across_error", TRUTH.across), ("tilt", "tilt_error", TRUTH.wobble),
    ):  # fmt: skip
        off = np.abs(np.array(found[name]) - truth)
        assert off.max() < 4 * found[error], name
    assert found["left"] < 0.002 and found["error_columns"] < 0.002


@pytest.mark.slow
@pytest.mark.parametrize("flip_r,flip_z", [(False, False), (True, True)])
def test_a_print_follows_the_vial(tmp_path: Path, flip_r: bool, flip_z: bool) -> None:
    """A rod on the axis of a job: before, it stands still at the middle; after, it goes with the pin."""
    rows, columns = TRUTH.mirrors
    images = np.zeros((8, rows, columns), np.uint8)
    images[:, :, columns // 2 - 4 : columns // 2 + 4] = 200
    frames = Frames.from_bytes(images, "numpy", bits=8, gray=GrayCurve.linear(), scale=1.0, columns=columns)
    frames = replace(frames, settings=replace(frames.settings, flip_r=flip_r, flip_z=flip_z))
    job, rig = save_frames(tmp_path / "rod.vam", frames).path, rig_at(tmp_path)
    before = rods(plan(job, rig, turns=1).sources()[0].levels(np.arange(8)).astype(float))  # type: ignore[attr-defined]
    measured(rig)
    planned = plan(job, rig, turns=1)
    after = rods(planned.sources()[0].levels(np.arange(8)).astype(float))  # type: ignore[attr-defined]
    angle = 2.0 * np.pi * np.arange(8) / 8
    wave = np.stack([np.cos(angle), np.sin(angle)])
    truth = TRUTH.axis + TRUTH.across @ wave, TRUTH.lean + TRUTH.wobble @ wave
    assert np.abs(before[0] - truth[0]).max() > 3.0 and np.abs(before[1] - truth[1]).max() > 0.015
    assert np.abs(after[0] - truth[0]).max() < 0.05 and np.abs(after[1] - truth[1]).max() < 0.001
    assert not planned.calibration.notes and "runout" in planned.calibration.used


@pytest.mark.slow
def test_prints_that_do_not_know_the_angle_say_so(tmp_path: Path) -> None:
    rig = rig_at(tmp_path, EMULATED)
    measured(rig, EMULATED)
    found = calibration_of(rig)
    (note,) = found.notes
    assert "center the vial" in note and "2.7 columns" in note
    assert found.runout is not None and not found.turning
    frames = Frames.from_bytes(np.full((4, 96, 192), 9, np.uint8), "numpy", bits=8, gray=GrayCurve.linear(), scale=1.0,
                               columns=192)  # fmt: skip
    moves = found.runout.moves(frames, found.turning)
    assert np.ptp(moves, axis=0).max() == 0 and np.ptp(moves) == pytest.approx(95 * TRUTH.lean, rel=0.1)
    assert found.frames(frames, 1) is frames and found.frames(frames, vial=False) is frames


@pytest.mark.slow
def test_no_pin_or_too_few_poses_are_told(tmp_path: Path) -> None:
    rig = rig_at(tmp_path)
    for truth, poses, why in (
        (replace(TRUTH, pin=0.0), 8, "angle .*put a pin on the turntable"),
        (TRUTH, 7, "8 angles or more"),
        (replace(TRUTH, electrons=0.0), 8, "sees 0 of 24 lit columns"),
    ):
        machines, _ = rehearsal(rig, runout_run.TABLES, truth)
        with pytest.raises(BadInput, match=why):
            runout_run.runout(machines, repeats=1, poses=poses)
        assert machines.controller is not None and not machines.controller.status().light
        machines.close()
    measured(rig)
    (place,) = (tmp_path / "lab.calibration").iterdir()
    result = place / "result.toml"
    result.write_text(result.read_text().replace("across = [", "across = [1.0, "))
    with pytest.raises(StorageError, match="measure the runout again"):
        calibration_of(rig)


def test_the_command_measures_and_tells(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "runout"
    assert main(["calibrate", "runout", "--rig", "emulated", "--out", str(out), "--angles", "8", "--repeats", "1"]) == 0
    assert "eccentricity" in capsys.readouterr().out
    result = tomllib.loads((out / "result.toml").read_text())
    assert result["emulated"]["column"] == pytest.approx(result["measured"]["column"], abs=0.1)
