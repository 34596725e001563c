"""What docs/files.md says works as it says it."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import pytest

from vamgpu.cli import main

PAGE = Path(__file__).parents[2] / "docs" / "files.md"
SMALL = ["target.pitch=1.6 mm", "beam.pitch=1.6 mm", "turntable.angles=12", "solve.iterations=2"]
"""The page's boat, small: words count here, not the print."""


@pytest.mark.slow
def test_the_page_s_commands_and_programs_run_one_after_the_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    known: dict[str, Any] = {}
    blocks = re.findall(r"```(sh|python)\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)
    assert [kind for kind, _ in blocks] == ["sh", "python", "python", "sh", "sh", "sh"]
    for kind, text in blocks:
        if kind == "python":
            exec(compile(text, str(PAGE), "exec"), known)
            continue
        for line in text.splitlines():
            words = shlex.split(line, comments=True)
            small = (
                [part for setting in SMALL for part in ("--set", setting)]
                if words[1] == "solve" or "--job" in words
                else []
            )
            assert words[0] == "vam" and main([*words[1:], *small]) == 0, capsys.readouterr().err
    assert known["job"].file.target.shape == "boat" and known["projector"].gray.intensity[128] < 0.3
    made = {"boat.html", "theirs.vam", "stack.vam", "film.vam", "projector.mp4", "boat.npz", "boat_9rpm.mp4"}
    assert made | {"boat-tvam.npz"} <= {path.name for path in tmp_path.iterdir()}
