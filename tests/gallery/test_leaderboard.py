"""The page of the comparison, the iterations for a time, and the record that stands behind the page."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from profiling.leaderboard import entries, entry, page
from profiling.leaderboard.__main__ import Judged, _limited
from profiling.leaderboard.entries import ENTRIES, RESULT, Entry
from profiling.leaderboard.page import SCORES

ROOT = Path(__file__).resolve().parents[2]
RECORD = json.loads((ROOT / "profiling" / "records" / "leaderboard-cpu.json").read_text(encoding="utf-8"))


def record(ours: dict[str, Any], peer: dict[str, Any]) -> dict[str, Any]:
    case = {"frames": [8, 6, 4], "pixel_mm": 0.1, "counts": {"bodies": 1, "holes": 2, "cavities": 0},
            "entries": {"ours": {"0": ours}, "leap": {"0": peer}}}  # fmt: skip
    return {"size": 24.0, "angles": 8, "cases": {"boat, air": case}}


def test_the_page_says_where_the_default_is_behind(tmp_path: Path) -> None:
    ours, peer = {"rms_um": 12.0, "W1": 0.1, "stray": 0.0}, {"rms_um": 15.0, "W1": 0.2, "stray": 0.0}
    page.write(tmp_path, record(ours, peer), tmp_path)
    text = (tmp_path / "compared.md").read_text(encoding="utf-8")
    assert "| vamgpu, default, 1 case | ahead |" in text
    assert "| RMS [µm] | 1 | 0 | 0 |  |" in text and "| stray [%] | 0 | 1 | 0 |  |" in text
    assert "| W(1) | 0 | 0 | 1 | boat, air: LEAP, VAM.py +0.200, ours +0.100 |" in text
    assert "| LEAP, VAM.py | 15 | **+0.200** | **0.00** |" in text


def test_the_page_names_the_case_that_is_farthest_behind(tmp_path: Path) -> None:
    both = record({"rms_um": 12.0}, {"rms_um": 11.0})
    both["cases"]["gear, air"] = record({"rms_um": 12.0}, {"rms_um": 9.0})["cases"]["boat, air"]
    page.write(tmp_path, both, tmp_path)
    text = (tmp_path / "compared.md").read_text(encoding="utf-8")
    assert "| RMS [µm] | 0 | 0 | 2 | gear, air: LEAP, VAM.py 9, ours 12 |" in text


def test_the_head_says_where_the_default_is_ahead_and_behind(tmp_path: Path) -> None:
    each = record({"rms_um": 12.0, "W1": 0.1}, {"rms_um": 15.0, "W1": 0.2})["cases"]["boat, air"]
    both = record({"rms_um": 9.0, "W1": 0.1, "seconds": 4.0}, {"rms_um": 8.0, "W1": 0.2, "seconds": 3.0})
    both["cases"] |= {"gear, air": each, "text, air": each, "text, square": each}
    page.write(tmp_path, both, tmp_path)
    text = (tmp_path / "compared.md").read_text(encoding="utf-8")
    assert "most accurate surface (RMS)\nin 3 of 4 cases" in text and "| in air | 3 | 9 to 12 | 8 to 15 |" in text
    assert "(W(1), below): boat, gear and text in air; text in a square vial\n" in text
    assert "(latitude): nowhere\n" in text


def test_a_picture_stays_while_an_entry_has_no_slice(tmp_path: Path) -> None:
    drawn, slab = tmp_path / "compared-boat-air.png", np.full((4, 4), 0.5, np.float32)
    drawn.write_bytes(b"old")
    for name, kept in (("ours", True), ("leap", False)):
        place = tmp_path / "boat-air" / name
        place.mkdir(parents=True)
        np.savez(place / "worst.npz", dose=slab, depth=slab - np.eye(4), place=np.zeros(3, int), deepest=0.5)
        page.write(tmp_path, record({"rms_um": 12.0}, {"rms_um": 15.0}), tmp_path)
        assert (drawn.read_bytes() == b"old") is kept


def test_ours_is_solved_again_until_it_is_as_soon_as_the_fastest_program() -> None:
    aims: list[float] = []

    def solved(entry: str, place: str, options: tuple[str, ...]) -> dict[str, Any]:
        assert entry == "ours-limited" and options[0] == "--longest" and place.endswith(f"-{options[1]}")
        aims.append(float(options[1]))
        return {"seconds": 1.1 * aims[-1]}

    case = {"entries": {"ours": {"0": {"seconds": 6.0}}, "drtvam": {"1": {"seconds": 1.0}},
                        "leap": {"0": {"seconds": 5.0}}, "vamtoolbox-pm": {"0": {"seconds": 8.0}}}}  # fmt: skip
    assert _limited(SimpleNamespace(solved=solved), case)["seconds"] <= 5.0  # type: ignore[arg-type]
    assert aims == pytest.approx([5.0, 4.5], rel=1e-3)
    case["entries"]["ours"]["0"]["seconds"] = 4.9
    assert _limited(SimpleNamespace(), case) == {"seconds": 4.9}  # type: ignore[arg-type]


@pytest.mark.parametrize("again", [False, True])
def test_an_entry_solves_once_unless_it_is_asked_again(tmp_path: Path, again: bool) -> None:
    for place in ("leap", "drtvam"):
        (tmp_path / place).mkdir()
        (tmp_path / place / RESULT).write_text('{"missing": "kept"}')
    judged = SimpleNamespace(folder=tmp_path, again=again)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(entries, "PEERS", tmp_path / "none")
        found = Judged.solved(judged, "leap", "leap")  # type: ignore[arg-type]
    assert (found["missing"] == "kept") is not again
    assert (tmp_path / "drtvam" / RESULT).exists()


def test_an_entry_that_cannot_run_says_why(tmp_path: Path) -> None:
    lacks = Entry("none", "leap_frames.py", "VAM", "no-such-environment").run(tmp_path, tmp_path / "out")
    assert "No such file" in lacks["missing"] and "leaderboard.sh" in lacks["missing"]
    page.write(tmp_path, record({"rms_um": 12.0}, lacks), tmp_path)
    assert "| LEAP, VAM.py | no result: " in (tmp_path / "compared.md").read_text(encoding="utf-8")


def test_iterations_fill_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [0.0]
    monkeypatch.setattr(entry.time, "process_time", lambda: clock[0])

    def run(count: int) -> None:
        clock[0] += 3.0 + 0.5 * count + (20.0 if clock[0] == 0.0 else 0.0)  # the first run compiles

    assert entry._fitting(run, 10.0) == 14


def test_memory_is_that_of_the_process_alone() -> None:
    held = np.ones(50_000_000)  # 0.4 GB, of the process that starts the entry
    script = (
        "from profiling.leaderboard.entry import _memory_gb as m; a = m(); b = [1.0] * 25_000_000; print(a, m() - a)"
    )
    child = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True)
    began, added = map(float, child.stdout.split())
    assert began < 1e-9 * held.nbytes and added == pytest.approx(0.2, abs=0.02)


def test_the_page_is_that_of_the_record(tmp_path: Path) -> None:
    page.write(tmp_path, RECORD, tmp_path)
    text, kept = ((folder / "compared.md").read_text(encoding="utf-8") for folder in (tmp_path, ROOT / "docs"))
    assert text == "\n".join(line for line in kept.split("\n") if not line.startswith("![")).replace("\n\n\n", "\n\n")


def test_the_record_is_of_known_entries_and_scores() -> None:
    for name, case in RECORD["cases"].items():
        assert set(case["entries"]) <= set(ENTRIES) and "ours" in case["entries"], name
        for each in case["entries"].values():
            for found in each.values():
                assert "missing" in found or set(SCORES) - {"processor_s", "memory_gb"} <= set(found)
                assert "missing" in found or np.isfinite(found["rms_um"])
