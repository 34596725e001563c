"""Limits of a web machine: every number of the paper's machine, what binds, and its TOML file."""

from __future__ import annotations

from dataclasses import replace
from math import asin, inf, isfinite, log, pi, radians
from pathlib import Path

import numpy as np
import pytest
from web_machine import MACHINE

from vamgpu.cli import main
from vamgpu.errors import BadInput, JobError
from vamgpu.jobs.limits import parse_limits
from vamgpu.optics.film import Film
from vamgpu.optics.lens import TunableLens
from vamgpu.optics.roller import Roller
from vamgpu.units import Pa_s, kg_m3, minute
from vamgpu.webs.display import Display
from vamgpu.webs.limits import WebLimits
from vamgpu.webs.limits_table import lines

FILM = Film(3.0, 1.49, 1.33, 0.22)
ROLLER = Roller(7.5, FILM, radians(0.5), legs=pi * (7.5 + 10.5) / 4)
PAPER = WebLimits(ROLLER, TunableLens(index=1.33))


def test_rates_at_the_papers_speed() -> None:
    assert PAPER.speed * minute == pytest.approx(48.0)
    assert PAPER.pose_rate == pytest.approx(10.2, abs=0.05)
    assert PAPER.frame_rate == pytest.approx(30.6, abs=0.05)
    assert 1e3 * PAPER.slot == pytest.approx(32.7, abs=0.05)
    assert PAPER.data_rate / 1e6 == pytest.approx(63.0, abs=0.5)
    assert int(PAPER.poses) == 7639 and int(PAPER.frames) == 22918
    assert 78.0 < 1e3 * PAPER.advance < 79.0
    assert PAPER.length / PAPER.speed == pytest.approx(750.0)


def test_tangential_sampling() -> None:
    assert int(PAPER.sampling_limit(1.0)) == 66
    assert PAPER.tangential_sampling == pytest.approx(1.0 / (radians(0.5) * 9.0))
    lens = next(limit for limit in PAPER.speeds if limit.name == "lens")
    assert PAPER.sampling_limit(lens.speed) == pytest.approx(PAPER.tangential_sampling)
    assert replace(PAPER, lens=TunableLens(bins=1)).sampling_limit(1.0) == inf


def test_speeds_and_what_binds() -> None:
    speed = {limit.name: limit.speed * minute for limit in PAPER.speeds}
    way = radians(0.5) * 9.0 * minute
    assert speed["mirrors"] == pytest.approx(way * 266 / 3)
    assert speed["lens"] == pytest.approx(way * 200 / 3) and round(speed["lens"]) == 314
    assert speed["serial line"] == pytest.approx(way * 38400 / 100 / 3)
    assert speed["data link"] == inf
    assert speed["all in turn"] == pytest.approx(way / 3 / (1 / 266 + 5e-3 + 100 / 38400))
    assert speed["all in turn"] == pytest.approx(138.2, abs=0.1)
    assert PAPER.limiting.name == "all in turn" and "44 % of them for the lens" in PAPER.limiting.reason
    turning = replace(PAPER, display=Display(turning=True))
    assert turning.limiting.speed * minute == pytest.approx(178.0, abs=0.5)
    slow = replace(PAPER, display=Display(link=80e6))
    assert slow.limiting.name == "data link"
    assert slow.limiting.speed == pytest.approx(0.8 * 80e6 / PAPER.data_rate)
    still = replace(PAPER, lens=TunableLens(bins=1), depth_of_focus=30.0)
    assert still.limiting.speed * minute == pytest.approx(way * 266) and still.limiting.name == "mirrors"


def test_at_the_greatest_speed_light_is_on_for_the_pictures_alone() -> None:
    fastest = replace(PAPER, speed=PAPER.limiting.speed)
    assert fastest.duty * fastest.slot == pytest.approx(1 / 266)
    assert not fastest.broken
    assert "above" in replace(PAPER, speed=PAPER.limiting.speed * 1.001).broken[0]


def test_window_and_angles() -> None:
    assert PAPER.window == pytest.approx(-log(0.05) / 0.22) and round(PAPER.window, 1) == 13.6
    assert PAPER.coverage == pytest.approx(2 * asin(1.33 / 1.49)) and round(PAPER.coverage, 1) == 2.2
    picture = PAPER.k_space(801)
    disc = np.hypot(*np.meshgrid(np.arange(801) - 400, np.arange(801) - 400)) <= 400
    assert picture[disc].mean() == pytest.approx(PAPER.covered_share, abs=2e-3)
    assert picture[700, 400] and not picture[400, 700]
    matched = replace(PAPER, roller=replace(ROLLER, film=replace(FILM, bath_index=1.49)))
    assert matched.covered_share == 1.0


def test_flow_with_the_density_of_the_paper_and_of_a_resin() -> None:
    assert 1e3 * PAPER.tolerable_flow == pytest.approx(1.1, abs=0.05)
    assert replace(PAPER, density=1.1 * kg_m3).viscosity_needed / Pa_s == pytest.approx(43.7, abs=0.05)
    assert PAPER.viscosity_needed / Pa_s == pytest.approx(4.4e4, rel=0.01)
    thick = replace(PAPER, viscosity=PAPER.viscosity_needed)
    assert thick.slowest == pytest.approx(PAPER.speed) and not replace(thick, speed=0.81).broken
    assert "flows off" in replace(thick, speed=0.79).broken[0]
    assert PAPER.slowest == 0.0


def test_focus() -> None:
    assert PAPER.defocus <= 1.9 and PAPER.bins_needed == 3
    two = replace(PAPER, lens=TunableLens(bins=2))
    assert "2 depth bins leave 2.2" in two.broken[0] and "use 3 bins" in two.broken[0]
    coarse = replace(PAPER, lens=TunableLens(index=1.33, quantum=0.005))
    assert coarse.defocus - PAPER.defocus == pytest.approx(0.0025 * 53.2)
    assert replace(PAPER, lens=TunableLens(index=1.33, quantum=0.02)).bins_needed == 4
    with pytest.raises(BadInput, match="the lens reaches 5 to 5.1 dpt"):
        replace(PAPER, lens=TunableLens(powers=(5.0, 5.1)))


def test_every_line_of_the_report_says_something() -> None:
    report = lines(PAPER)
    text = {line.name: line.value for line in report}
    assert len(text) == len(report) >= 18
    assert text["greatest speed"] == "138.2 mm/min" and text["sampling at 1 mm/s"] == "66.7 /mm"
    assert text["window"] == "13.62 mm" and text["slot"] == "32.7 ms" and text["data"] == "63.4 MB/s"
    assert all(line.meaning for line in report)
    clear = replace(PAPER, roller=replace(ROLLER, film=replace(FILM, absorption=0.0)))
    assert {line.name: line.value for line in lines(clear)}["window"] == "∞"


def test_the_machines_file_is_the_papers_machine() -> None:
    found = parse_limits(MACHINE)
    assert replace(found.roller.film, absorption=0.22) == FILM
    assert found.roller.film.absorption == pytest.approx(0.22)
    for name in ("pose_rate", "data_rate", "coverage", "window", "defocus"):
        assert getattr(found, name) == pytest.approx(getattr(PAPER, name))
    assert found.limiting.speed == pytest.approx(PAPER.limiting.speed)
    assert found.viscosity_needed == pytest.approx(PAPER.viscosity_needed, rel=1e-3)
    fine = parse_limits(MACHINE, ['lens.quantum="0.005 dpt"', 'resin.viscosity="30000 Pa s"', 'display.link="80 MB/s"'])
    assert fine.lens.quantum == pytest.approx(0.005) and fine.limiting.name == "data link"
    assert isfinite(fine.slowest) and fine.slowest > 0


def test_a_file_of_a_web_job_will_do() -> None:
    assert parse_limits(MACHINE + '\n[target]\nshape = "gyroid"\n') == parse_limits(MACHINE)


def test_wrong_files_are_told_by_line() -> None:
    with pytest.raises(JobError, match=r"machine, line 10: roller.radius: got 7.5; expected a length"):
        parse_limits(MACHINE.replace('radius = "7.5 mm"', "radius = 7.5"))
    with pytest.raises(JobError, match=r"did you mean \[lens\]"):
        parse_limits(MACHINE.replace("[lens]", "[lense]"))
    with pytest.raises(JobError, match="did you mean 'settle'"):
        parse_limits(MACHINE.replace("settle =", "setle ="))
    with pytest.raises(JobError, match="bins: got 0"):
        parse_limits(MACHINE, ["lens.bins=0"])
    with pytest.raises(BadInput, match="thinner film"):
        parse_limits(MACHINE, ['film.thickness="14 mm"'])
    with pytest.raises(BadInput, match="bins is 5000, but"):
        parse_limits(MACHINE, ["lens.bins=5000"])
    with pytest.raises(BadInput, match="link"):
        Display(link=0.0)
    with pytest.raises(BadInput, match="speed"):
        replace(PAPER, speed=0.0)


def test_the_command_prints_a_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "web.toml"
    file.write_text(MACHINE, encoding="utf-8")
    assert main(["limits", str(file)]) == 0
    said = capsys.readouterr().out
    assert "138.2 mm/min" in said and "limited by all in turn" in said and "cannot" not in said
    assert main(["limits", str(file), "--set", "web.speed=200 mm/min"]) == 0
    assert "cannot 3.333 mm/s is above 2.304 mm/s" in capsys.readouterr().out
    assert main(["limits", str(tmp_path / "none.toml")]) == 1
    assert "cannot read job file" in capsys.readouterr().err
