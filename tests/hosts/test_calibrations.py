"""Calibrations that live with their rig: kept beside its file, never replaced, and applied to every print."""

from __future__ import annotations

import json
import shutil
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from vamgpu.cli import main
from vamgpu.errors import BadInput, JobError
from vamgpu.hosts.calibrate import flat as flat_run
from vamgpu.hosts.calibrate import gray as gray_run
from vamgpu.hosts.calibrate.connection import rehearsal
from vamgpu.hosts.calibrate.report import CalibrationResult, keep
from vamgpu.hosts.emulators.calibration import Optics
from vamgpu.hosts.rig import plan
from vamgpu.hosts.rigs.calibrations import KINDS, calibration_of, in_force, taken_of
from vamgpu.hosts.rigs.config import EMULATED, RigConfig, read_rig
from vamgpu.printing.folder import save_frames
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve

DAY = datetime(2026, 11, 20, 9, 30)
TRUTH = Optics(radius=0.0, leak=0.01, turn=6.0, tilt=0.05, falloff=0.2)
"""Mirrors that leak and turn slowly, before optics that dim the corners; nothing stands in the light."""


@pytest.fixture
def rig(tmp_path: Path) -> RigConfig:
    """A rig's file, without calibrations yet."""
    file = tmp_path / "lab.toml"
    file.write_text(EMULATED)
    return read_rig(file)


def measured(rig: RigConfig, kind: str, when: datetime | None = None, every: int = 85) -> str:
    """Measure a rig and keep the result; its name."""
    machines, _ = rehearsal(rig, ("photodiode",), TRUTH)
    try:
        found = flat_run.flat(machines) if kind == "flat" else gray_run.gray(machines, gray_run.levels(every))
    finally:
        machines.close()
    return keep(found, rig, when).name


def smooth_job(place: Path, gray: GrayCurve | None = None) -> tuple[Path, np.ndarray]:
    """A vial's job as large as the emulated mirrors, and the light it is for [frame, row, column]."""
    rows, columns = TRUTH.mirrors
    down, across = np.meshgrid(np.linspace(0.0, 3.0, rows), np.linspace(0.0, 5.0, columns), indexing="ij")
    light = 0.5 + 0.45 * np.stack([np.sin(down + k) * np.cos(across - k) for k in range(6)])
    curve = gray or GrayCurve.linear()
    frames = Frames.from_bytes(curve.inverse(light), "numpy", bits=8, gray=curve, scale=1.0, columns=columns)
    return save_frames(place, frames).path, curve(curve.inverse(light))


def shown(planned_frames: np.ndarray) -> np.ndarray:
    """Light that the true projector makes of levels [frame, row, column]."""
    worth = np.array([TRUTH.gray(level, 3760) for level in range(256)])
    return worth[planned_frames] * TRUTH.flat()


def unevenness(light: np.ndarray, wanted: np.ndarray) -> float:
    """Greatest error of light, up to a factor, over the brightest that is wanted."""
    factor = float((light * wanted).sum() / (light**2).sum())
    return float(np.abs(factor * light - wanted).max() / wanted.max())


def test_what_was_measured_is_applied_to_every_print(rig: RigConfig, tmp_path: Path) -> None:
    """Jobs of light, and those that were packed for another machine."""
    jobs = [smooth_job(tmp_path / "light.vam"), smooth_job(tmp_path / "other.vam", GrayCurve.gamma(1.8))]
    before = [plan(job, rig, turns=1).sources()[0].levels(np.arange(6)) for job, _ in jobs]  # type: ignore[attr-defined]
    names = [measured(rig, kind, every=5) for kind in ("gray", "flat")]
    for (job, wanted), uncorrected in zip(jobs, before, strict=True):
        planned = plan(job, rig, turns=1)
        after = planned.sources()[0].levels(np.arange(6))  # type: ignore[attr-defined]
        assert unevenness(shown(uncorrected), wanted) > 0.08
        assert unevenness(shown(after), wanted) < 0.015, "levels between measured ones are off by a plane that turns"
        assert dict(planned.calibration.used) == dict(zip(("gray", "flat"), names, strict=True))
        assert ("calibrations", ", ".join(names)) in planned.lines()
        frames = planned.jobs[0].frames
        assert frames is not None
        np.testing.assert_allclose(frames.irradiance().numpy(), np.swapaxes(wanted[:, ::-1], 1, 2), atol=0.012)


def test_none_is_replaced_and_the_newest_is_in_force(rig: RigConfig, tmp_path: Path) -> None:
    assert taken_of(rig) == () and not calibration_of(rig)
    old, same, new = (measured(rig, "gray", DAY + timedelta(days=days)) for days in (0, 0, 1))
    assert [each.name for each in taken_of(rig)] == [new, same, old] == [
        "gray-2026-11-21T093000", "gray-2026-11-20T093000-2", "gray-2026-11-20T093000",
    ]  # fmt: skip
    assert in_force(rig)["gray"].name == new and in_force(rig)["gray"].tables()["taken"] == DAY + timedelta(days=1)
    file = str(rig.source)
    assert in_force(read_rig(file, ['calibration.gray="2026-11-20T093000"']))["gray"].name == same
    assert in_force(read_rig(file, ['calibration.gray="none"'])) == {}
    with pytest.raises(JobError, match="vam calibrate list"):
        in_force(read_rig(file, ['calibration.gray="2025"']))
    for wrong in ("yesterday", "none at all", "2026-11-20 in the morning"):
        with pytest.raises(JobError, match=r"calibration.gray: got .*expected the date of one"):
            read_rig(file, [f'calibration.gray="{wrong}"'])
    (note,) = calibration_of(rig, DAY + timedelta(days=101)).notes
    assert "100 days old" in note and calibration_of(rig, DAY + timedelta(days=80)).notes == ()


NUMBERS = {
    "turn": {"ratio": 1.009, "error": 1e-5},
    "axis": {"shift_columns": 1.5},
    "focus": {"axis_dpt": 0.1, "slope_mm_dpt": -40.0},
    "mtf": {"positions_mm": [0.0], "blur_mm": [0.04], "pixel_mm": 0.0078},
    "runout": {
        "column": 95.0, "error_columns": 0.01, "lean": 0.0, "lean_error": 0.0, "across": [0.0, 0.0],
        "across_error": 0.01, "tilt": [0.0, 0.0], "tilt_error": 0.0, "left": 0.02, "rows": 96, "columns": 192,
        "projector": 0,
    },
}  # fmt: skip


def written(rig: RigConfig, kind: str, when: datetime | None = None) -> str:
    """Keep a result of a kind without a measurement; its name."""
    readings = {"flat_0": np.ones(TRUTH.mirrors)} if kind == "flat" else {}
    tables = {"gray": GrayCurve.linear().describe()} if kind == "gray" else {}
    return keep(CalibrationResult(kind, NUMBERS.get(kind, {}), readings, (), lambda axes: None, tables), rig, when).name


@pytest.mark.parametrize("kind", KINDS)
def test_one_of_each_kind_that_is_old_is_told_before_a_print(kind: str, rig: RigConfig, tmp_path: Path) -> None:
    job, _ = smooth_job(tmp_path / "light.vam")
    name = written(rig, kind, datetime.now() - timedelta(days=91))
    notes = [text for what, text in plan(job, rig, turns=1).lines() if what == "note" and "days old" in text]
    assert len(notes) == 1 and name in notes[0] and "91 days old; expected at most 90: measure again" in notes[0]
    fresh = written(rig, kind)
    planned = plan(job, rig, turns=1)
    assert planned.calibration.used[kind] == fresh and not any("days old" in note for note in planned.calibration.notes)
    written(rig, kind, datetime.now() - timedelta(days=400))
    assert not any("days old" in note for note in calibration_of(rig).notes), "the newest counts"


@pytest.mark.slow
def test_light_is_sought_with_the_point_spread_of_its_rig(
    rig: RigConfig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from vamgpu.jobs.demo import JOB

    part, small = tmp_path / "part.toml", {
        "target.shape": "gear_base",
        "target.pitch": "200 um", "beam.pitch": "100 um", "turntable.angles": "12", "solve.iterations": "1",
        "solve.device": "cpu", "target.height": "1 mm", "vial.radius": "3 mm", "vial.wall": "0.3 mm",
    }  # fmt: skip
    part.write_text("".join(line for line in JOB.splitlines(keepends=True) if not line.startswith("spread")))
    words = ["solve", str(part), "--rig", str(rig.source), "--overwrite"]
    words += [word for key, value in small.items() for word in ("--set", f"{key}={value}")]

    def spread(*more: str) -> tuple[float, str]:
        assert main([*words, *more]) == 0
        geometry = json.loads((tmp_path / "part.vam" / "manifest.json").read_text())["inputs"]["geometry"]
        return geometry["beam"]["spread"], " ".join(capsys.readouterr().out.split())

    assert "the rig has no calibration mtf" in spread()[1]
    name, runs = written(rig, "mtf"), written(rig, "runout")
    found, said = spread()
    assert found == pytest.approx(np.sqrt(0.04**2 - (0.1**2 + 0.0078**2) / 12)) and f"measured by {name}" in said
    assert f"runout 0.02, from {runs}" in said
    found, said = spread("--set", 'beam.spread="70 um"')
    assert found == pytest.approx(0.07) and "as the job sets it" in said


def test_they_move_with_the_rig(rig: RigConfig, tmp_path: Path) -> None:
    name = measured(rig, "gray")
    other = tmp_path / "elsewhere"
    other.mkdir()
    for entry in ("lab.toml", "lab.calibration"):
        shutil.move(tmp_path / entry, other / entry)
    assert in_force(read_rig(other / "lab.toml"))["gray"].name == name and taken_of(rig) == ()


def test_a_field_of_smaller_mirrors_is_told(rig: RigConfig, tmp_path: Path) -> None:
    measured(rig, "flat")
    images = np.zeros((6, 200, 8), np.uint8)
    frames = Frames.from_bytes(images, "numpy", bits=8, gray=GrayCurve.linear(), scale=1.0, columns=8)
    with pytest.raises(BadInput, match="measure it on this projector again"):
        plan(save_frames(tmp_path / "tall.vam", frames).path, rig, turns=1)


def test_the_command_keeps_results_by_the_rig(
    rig: RigConfig, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["calibrate", "list", "--rig", "emulated"]) == 1 and "give such a file" in capsys.readouterr().err
    assert main(["calibrate", "list", "--rig", "lab.toml"]) == 0 and "no calibrations" in capsys.readouterr().out
    assert main(["calibrate", "gray", "--rig", "lab.toml", "--every", "51"]) == 0
    assert main(["calibrate", "flat", "--rig", "lab.toml", "--blocks", "6", "6", "--repeats", "2"]) == 0
    capsys.readouterr()
    assert main(["calibrate", "list", "--rig", "lab.toml"]) == 0
    told = capsys.readouterr().out
    assert told.count("applied") == 2 and [each.kind for each in taken_of(rig)] in (["flat", "gray"], ["gray", "flat"])
