"""What a terminal shows while a job runs."""

from __future__ import annotations

from io import StringIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import Progress

import vamgpu as vam
from vamgpu.cli.progress import STAGES, _Left, shown
from vamgpu.jobs.run import prove


def test_the_time_left_is_told_from_the_share_that_is_done() -> None:
    clock = SimpleNamespace(now=0.0)
    bar = Progress(_Left(), get_time=lambda: clock.now, console=Console(file=StringIO()))
    bar.add_task("light", total=None)
    (task,) = bar.tasks
    assert _Left().render(task).plain == ""
    for share in (0.1, 0.2, 0.3):
        clock.now += 4.0
        bar.update(task.id, total=1.0, completed=share)
    assert _Left().render(task).plain == "0:00:28 left"


def test_stages_that_are_over_stay_as_lines() -> None:
    text = StringIO()
    with shown(Console(file=text, force_terminal=True, width=100)) as progress:
        progress("voxels", 0.0)
        progress("light", 0.5)
    assert "voxelizing the part" in text.getvalue() and "optimizing the patterns" in text.getvalue()
    assert text.getvalue().count("✓") == 2


def test_no_stage_is_shown_where_nobody_looks() -> None:
    text = StringIO()
    with shown(Console(file=text, force_terminal=False)) as progress:
        progress("light", 0.5)
    assert text.getvalue().count("\n") == 1 and "━" not in text.getvalue()


def test_a_proof_tells_its_stages_and_the_share_of_its_slabs(tmp_path: Path, monkeypatch: Any) -> None:
    small = (1, None, None)  # slabs
    monkeypatch.setattr("vamgpu.printing.independent_exposure.IndependentExposure.__init__.__defaults__", small)
    part = np.zeros((12, 12, 10))
    part[4:8, 4:8, 2:8] = 1.0
    target = vam.Target.from_array(part, pitch=0.25, name="block")
    A = vam.Projection(target.grid, vam.Beam((16, 10), 0.25), vam.Turntable(12), device="numpy")
    vam.pack(vam.optimize(A, target, iterations=2)).save(tmp_path / "block.vam")
    told: list[tuple[str, float]] = []
    prove(tmp_path / "block.vam", "numpy", evaluations=80, progress=lambda *what: told.append(what))
    stages = list(dict.fromkeys(stage for stage, _ in told))
    assert stages == ["read", "frames", "proof", "bound"] and set(stages) <= set(STAGES)
    for stage in ("proof", "bound"):
        shares = [share for name, share in told if name == stage]
        assert len(shares) > 3 and shares == sorted(shares) and shares[0] == 0.0 and 0.9 < shares[-1] <= 1.0
