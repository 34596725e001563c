"""Jobs whose light may last so long, and what shorter exposures cost, from the file to the report."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from vamgpu.cli import main
from vamgpu.errors import JobError
from vamgpu.jobs.demo import JOB
from vamgpu.jobs.read import Job

SETTINGS = {
    "target.shape": "gear_base", "target.height": "4 mm", "target.pitch": "600 um", "beam.pitch": "800 um",
    "turntable.angles": "24", "solve.evaluations": "30",
}  # fmt: skip


@pytest.mark.slow
def test_a_limit_and_shorter_exposures_reach_the_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "part.toml").write_text(JOB, encoding="utf-8")
    words = [word for key, value in SETTINGS.items() for word in ("--set", f"{key}={value}")]
    assert main(["solve", str(tmp_path / "part.toml"), *words, "--pareto"]) == 0
    assert "dose outside" in capsys.readouterr().out
    place = tmp_path / "part.vam"
    points = json.loads((place / "manifest.json").read_text(encoding="utf-8"))["inputs"]["pareto"]
    assert len(points) >= 2 and points[1]["seconds"] <= 0.76 * points[0]["seconds"]
    assert main(["prove", str(place)]) == 0
    assert "Window against time" in (tmp_path / "part.html").read_text(encoding="utf-8")
    limit = 0.5 * points[0]["seconds"]
    settings = [*words, "--set", f"solve.exposure_limit={limit} s", "--out", str(tmp_path / "soon.vam")]
    assert main(["solve", str(tmp_path / "part.toml"), *settings]) == 0
    capsys.readouterr()
    assert main(["prove", str(tmp_path / "soon.vam")]) == 0
    page = (tmp_path / "soon.html").read_text(encoding="utf-8")
    assert "until resin at the threshold is solid" in page and "Window against time" not in page


def test_a_limit_needs_a_lamp_and_one_color() -> None:
    alone = JOB[: JOB.index("[print]")]
    with pytest.raises(JobError, match=r"solve\.exposure_limit: got a time without \[print\]"):
        Job.parse(alone, ["solve.exposure_limit=60 s"])
    with pytest.raises(JobError, match="exposure_limit: got a time and"):
        Job.parse(JOB, ["solve.exposure_limit=60 s", "colors.absorption=0.1 1/mm"])
    assert Job.parse(JOB, ["solve.exposure_limit=1 min"]).file.solve.exposure_limit == 60.0
