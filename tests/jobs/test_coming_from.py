"""What docs/coming-from.md says of a configuration of Dr.TVAM works as it says it, from its JSON to a proof."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.cli import main
from vamgpu.jobs.run import prove

PAGE = Path(__file__).parents[2] / "docs" / "coming-from.md"


@pytest.mark.slow
def test_a_configuration_is_solved_proven_sent_back_and_judged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```(python|json|sh)\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)
    assert [kind for kind, _ in blocks] == ["python", "json", "sh", "sh"]
    exec(compile(blocks[0][1], str(PAGE), "exec"), {})
    (tmp_path / "config.json").write_text(blocks[1][1], encoding="utf-8")
    for line in (blocks[2][1] + blocks[3][1]).splitlines():
        words = shlex.split(line, comments=True)
        strict = ["--set", "solve.method=lbfgs"] if words[1] == "solve" else []  # whose strict window is asserted below
        assert words[0] == "vam" and main([*words[1:], *strict]) == 0, capsys.readouterr().err
    ours, theirs = (prove(tmp_path / name).proof for name in ("boat.vam", "theirs.vam"))
    assert ours.scores.window > 0.1 and ours.independent
    assert theirs.operator.grid == ours.operator.grid  # resin near the wall counts in both, or windows differ by 0.03
    assert theirs.scores.window == pytest.approx(ours.scores.window, abs=0.02)
    frames: Any = vam.load(tmp_path / "boat.vam")
    x, y, _ = np.nonzero(frames.plan.target.numpy() > 0.5)
    pitch = 8.8 / 44
    assert 8.0 - 2 * pitch <= (max(np.ptp(x), np.ptp(y)) + 1) * pitch <= 8.0 + 2 * pitch
