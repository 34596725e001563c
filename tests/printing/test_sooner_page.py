"""What docs/sooner.md says of shorter prints holds for its own example."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "sooner.md"


@pytest.mark.slow
def test_a_limit_buys_time_with_window() -> None:
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.S)
    known: dict[str, Any] = {}
    exec(compile(code, str(PAGE), "exec"), known)
    plain, bright = known["proofs"]
    assert bright.seconds < 1.02 * 3.0 < 0.6 * plain.seconds
    assert bright.mean_brightness > 1.5 * plain.mean_brightness
    assert abs(bright.scores.window - plain.scores.window) < 0.01
