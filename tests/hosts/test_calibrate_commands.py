"""Calibrations from the command line, and the patterns that they show."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from vamgpu.cli import main
from vamgpu.errors import BadInput
from vamgpu.hosts.calibrate import patterns
from vamgpu.hosts.rigs.config import EMULATED


def test_patterns_are_what_they_are_called() -> None:
    shape = (8, 64)
    grating = patterns.grating(shape, 10)
    assert grating[0].tolist() == [bool(column // 10 % 2 == 0) for column in range(64)]
    assert patterns.line(shape, 5).sum(axis=0).tolist() == [8 * (column == 5) for column in range(64)]
    edge = patterns.slanted((64, 64), 5.0)
    assert edge.mean() == pytest.approx(0.5) and edge[0].sum() - edge[-1].sum() == round(63 * np.tan(np.radians(5.0)))
    assert (patterns.flat(shape, 200) == 200).all()
    for pattern, value in ((patterns.grating, 40), (patterns.line, 64), (patterns.flat, 256), (patterns.slanted, 0)):
        with pytest.raises(BadInput, match="expected"):
            pattern(shape, value)


@pytest.mark.parametrize(
    "words",
    [
        ["focus", "--reach", "1", "--powers", "17", "--low=-0.2", "--high", "0.2"],
        ["axis", "--every", "2"],
        ["gray", "--every", "51"],
        ["mtf", "--at=-6", "--at", "6", "--repeats", "1"],
    ],
)
def test_the_commands_measure_and_tell(words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / words[0]
    assert main(["calibrate", *words, "--rig", "emulated", "--out", str(out)]) == 0
    told = capsys.readouterr().out
    assert "emulated" in told and str(out) in told
    result = tomllib.loads((out / "result.toml").read_text())
    assert result["calibration"] == words[0] and result["emulated"] and result["measured"]
    assert main(["calibrate", *words, "--rig", "emulated", "--out", str(out)]) == 1
    assert "exists" in capsys.readouterr().err


def test_the_commands_tell_what_is_missing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = tmp_path / "lab.toml"
    rig.write_text(EMULATED.replace('[[feedback]]\ndriver = "emulated photodiode"\n', ""))
    assert main(["calibrate", "axis", "--rig", str(rig), "--out", str(tmp_path / "axis")]) == 1
    assert "photodiode" in capsys.readouterr().err and not (tmp_path / "axis").exists()
