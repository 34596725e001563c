"""The bench script: on the emulated controller, on the compiled sketch, and on recordings that are wrong."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from typing import Any

import pytest

from vamgpu import hosts
from vamgpu.errors import BadInput

FILE = Path(hosts.__file__).parent / "firmware" / "bench" / "bench.py"


@pytest.fixture(scope="module")
def bench() -> Any:
    import sys

    spec = importlib.util.spec_from_file_location("bench", FILE)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["bench"] = module  # its dataclass looks there
    spec.loader.exec_module(module)
    return module


def _capture(path: Path, edges: Any, slow: float = 1.0) -> Path:
    """A recording of changes, as an analyzer writes them; volts for the photodiode."""
    changes = [(at, 0, level) for t in edges.triggers for at, level in ((t, 1.0), (t + 2e-5, 0.0))]
    changes += [(at, 1, level) for on, off in edges.lights for at, level in ((on, 3.1), (on + slow * (off - on), 0.2))]
    changes += [(at, 2, level) for t in edges.lens for k in range(10)
                for at, level in ((t + 2.6e-4 * k, 0.0), (t + 2.6e-4 * k + 1e-4, 1.0))]  # fmt: skip
    levels = [0.0, 0.2, 1.0]
    lines = ["Time [s],trigger,diode,lens", "0,0,0.2,1"]
    for at, place, level in sorted(changes):
        levels[place] = level
        lines.append(",".join(map(str, [at, *levels])))
    path.write_text("\n".join(lines) + "\n")
    return path


def test_the_emulator_agrees_with_itself(bench: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "bench.json"
    assert bench.main(["--emulated", "--json", str(out)]) == 0
    table = {row["what"]: row for row in json.loads(out.read_text())}
    assert table["trigger period"]["board"] == pytest.approx(20e-3, abs=1e-9)
    assert table["light on-time"]["board"] == pytest.approx(5e-3, abs=1e-9)
    assert table["lens command to trigger"]["board"] == pytest.approx(8e-3, abs=1e-9)
    assert 0.19 < table["light until the lease ends"]["board"] <= 0.2
    assert capsys.readouterr().out.count("as emulated") == 5


def test_the_sketch_agrees_with_the_emulator(bench: Any, new_board: Any, conversation_with: Any) -> None:
    board = new_board()
    talk = conversation_with(board)
    bench.play(talk.driver, talk.clock)
    on, off = board.lights[::2], board.lights[1::2]
    lit = [(a * 1e-9, b * 1e-9) for (_, a), (_, b) in zip(on, off, strict=True)]
    edges = bench.Edges([at * 1e-9 for at in board.triggers], lit, [at * 1e-9 - 2.6e-4 for at, _ in board.frames])
    assert all(row["good"] for row in bench.compared(edges, bench.emulated()))


def test_a_recording_is_read_and_a_slow_light_is_seen(bench: Any, tmp_path: Path) -> None:
    model = bench.emulated()
    found = bench.recorded(_capture(tmp_path / "good.csv", model))
    assert all(row["good"] for row in bench.compared(found, model))
    slow = bench.recorded(_capture(tmp_path / "slow.csv", model, 1.03))
    wrong = [row["what"] for row in bench.compared(slow, model) if not row["good"]]
    assert wrong == ["light on-time", "light until the lease ends"]


def test_recordings_that_miss_something_are_told(bench: Any, tmp_path: Path) -> None:
    model = bench.emulated()
    model.triggers.pop()
    with pytest.raises(BadInput, match="39, 41, 40.*expected 40, 41"):
        bench.compared(bench.recorded(_capture(tmp_path / "short.csv", model)), model)
    with pytest.raises(BadInput, match="photodiode does not change"):
        bench.recorded(_capture(tmp_path / "dark.csv", bench.Edges(model.triggers, [], model.lens)))
    with pytest.raises(BadInput, match="expected a recording"):
        bench.recorded(tmp_path / "short.csv", (1, 2, 9))


def test_what_cannot_be_measured_is_told(bench: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = tmp_path / "bench.json"
    assert bench.main([str(tmp_path / "none"), "--capture", str(tmp_path / "x.csv"), "--json", str(table)]) == 2
    assert capsys.readouterr().err.startswith("error: ") and not table.exists()
    assert bench.main(["--emulated", "--json", str(tmp_path / "no" / "bench.json")]) == 2
