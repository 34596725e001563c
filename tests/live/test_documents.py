"""The examples of the documents on live printing run as they stand."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from vamgpu.webs.proof import prove_web

DOCS = Path(__file__).parents[2] / "docs"


@pytest.mark.slow
def test_webs_and_two_colors_are_replanned_as_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    text, names = (DOCS / "live-webs.md").read_text(encoding="utf-8"), dict[str, Any]()
    for number, block in enumerate(re.findall(r"```python\n(.*?)```", text, re.DOTALL)):
        exec(compile(block, f"live-webs.md, block {number}", "exec"), names)
    kept, frames = names["plan"], 3 * names["frames"]
    assert names["replanned"].read("frames", 0, frames).tobytes() == kept.read("frames", 0, frames).tobytes()
    assert min(each.iou for each in names["unchanged"].segments) < 0.99
    assert min(each.iou for each in names["mended"].segments) > 0.9
    assert prove_web(kept).window > 0.05
    assert names["rest"].expected.iou > 0.99 > names["rest"].kept.iou
