"""Job files: what is right is read, what is wrong is named with its line and a remedy."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from vamgpu.errors import JobError
from vamgpu.jobs.curethrough import parse_curethrough
from vamgpu.jobs.demo import JOB
from vamgpu.jobs.lines import key_lines, line_of
from vamgpu.jobs.read import parse_job, read_job, toml_value


def test_the_demo_reads_in_mm_and_mj() -> None:
    wanted = parse_job(JOB).wanted
    assert wanted.target.pitch == pytest.approx(0.09)
    assert wanted.vial is not None and wanted.vial.radius == 12.4
    assert wanted.print is not None and wanted.print.irradiance == pytest.approx(0.65)
    assert wanted.print.critical_dose == pytest.approx(0.05)


def test_lines_are_found_through_comments_tables_and_long_values() -> None:
    text = (
        '# a = 1\n[one]\nx = """\n[no]\ny = 2\n"""  # z = 3\n\n'
        '[one.two]  # here\n"q" = [\n  1,\n  2,\n]\nr.s = { t = 1 }\n'
    )
    lines = key_lines(text)
    two = ("one", "two")
    assert lines == {("one",): 2, ("one", "x"): 3, two: 8, (*two, "q"): 9, (*two, "r", "s"): 13}
    assert line_of(lines, ("one", "two", "r", "s", "t")) == 13
    assert line_of(lines, ("three",)) is None


def line_with(text: str, words: str) -> int:
    return next(number for number, line in enumerate(text.splitlines(), 1) if words in line)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"12.4 mm"', '"12.4 s"', "vial.radius: got '12.4 s'; unit 's'; wanted a length"),
        ('"12.4 mm"', "12.4", "vial.radius: got 12.4; wanted a length with its unit in quotes"),
        ('radius = "12.4 mm"', 'raduis = "12.4 mm"', "vial.raduis: unknown key; did you mean 'radius'?"),
        ("[frames]", "[framse]", "framse: unknown key; did you mean 'frames'?"),
        ("bits = 8", "bits = 7", "frames.bits: got 7; wanted 1 or 8"),
        ("bits = 8", "flip_r = 1", "frames.flip_r: got 1; wanted a valid boolean"),
        ("iterations = 40", "iterations = 0", "solve.iterations: got 0; wanted greater than or equal to 1"),
        ("iterations = 40", "iterations = 4.5", "solve.iterations: got 4.5; wanted a valid integer"),
        ("angles = 360", 'angles = "many"', "turntable.angles: got 'many'; wanted a whole number of angles ≥ 1, or"),
        ("angles = 360", "angles = true", "turntable.angles: got True; wanted a whole number of angles ≥ 1"),
        ("angles = 360", 'range = "361 deg"', "turntable.range: got 6.30064 rad; wanted 360 deg at most"),
        ("resin_index = 1.49962", "resin_index = nan", "vial.resin_index: got nan"),
        ("bath_index = 1.0", 'polarization = "x"', "vial.polarization: got 'x'; wanted 'none', 's' or 'p'"),
        ("resin_index = 1.49962", "resin_index = 0.9", "vial.resin_index: got 0.9"),
    ],
)
def test_a_wrong_value_is_named_with_its_line(old: str, new: str, said: str) -> None:
    text = JOB.replace(old, new, 1)
    with pytest.raises(JobError) as caught:
        parse_job(text, source="boat.toml")
    assert f"boat.toml, line {line_with(text, new)}: {said}" in str(caught.value)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("fill = 1.2", "beam.fill: got 1.2; wanted less than or equal to 1"),
        ("fill = 0", "beam.fill: got 0; wanted greater than 0"),
        ("spread = 0.025", "beam.spread: got 0.025; wanted a length with its unit in quotes"),
        ('spread = "25"', "beam.spread: got '25'; no unit; wanted a length in mm"),
        ('spread = "-1 um"', 'wanted a length ≥ 0: write it like "12.4 mm"; or the path of a calibration: spread = "'),
        ('footprint = "area"', "beam.footprint: got 'area'; wanted 'exact' or 'joseph'"),
    ],
)
def test_a_wrong_optic_of_the_beam_is_named_with_its_line(line: str, said: str) -> None:
    text = JOB.replace("[beam]", "[beam]\n" + line)
    with pytest.raises(JobError) as caught:
        parse_job(text, source="boat.toml")
    assert f"boat.toml, line {line_with(text, line)}: beam." in str(caught.value) and said in str(caught.value)


def test_every_wrong_value_is_named_at_once() -> None:
    text = JOB.replace('"90 um"', "90").replace("bits = 8", "bits = 3")
    with pytest.raises(JobError, match=r"(?s)target\.pitch.*frames\.bits"):
        parse_job(text)


def test_a_missing_key_and_a_double_choice_say_what_to_write() -> None:
    with pytest.raises(JobError, match=r"target\.pitch is missing; add pitch = … to \[target\]"):
        parse_job(JOB.replace('pitch = "90 um"\n', "", 1))
    with pytest.raises(JobError, match=r"exactly one of mesh"):
        parse_job(JOB.replace('shape = "boat"', 'shape = "boat"\nmesh = "a.stl"'))
    with pytest.raises(JobError, match=r"both \[vial\] and \[vat\]"):
        parse_job(JOB + '\n[vat]\nwidth = "20 mm"\n')


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("false", False),
        ("true", True),
        ("3", 3),
        ("0.5", 0.5),
        ('"a"', "a"),
        ("12 mm", "12 mm"),
        ("[1, 2]", [1, 2]),
        ("a\nb = 1", "a\nb = 1"),
    ],
)
def test_settings_are_toml_values_else_text(text: str, value: object) -> None:
    assert toml_value(text) == value
    assert type(toml_value(text)) is type(value)


def test_settings_replace_what_the_file_says() -> None:
    job = parse_job(JOB, ["frames.flip_r=false", "frames.flip_z=true", "target.height=9 mm", "solve.iterations = 3"])
    assert job.wanted.frames.flip_r is False and job.wanted.frames.flip_z is True
    assert (job.wanted.target.height, job.wanted.solve.iterations) == (9.0, 3)
    with pytest.raises(JobError, match=r"--set: solve\.iterations: got False"):
        parse_job(JOB, ["solve.iterations=false"])
    with pytest.raises(JobError, match=r"--set: solve\.itrations: unknown key; did you mean 'iterations'"):
        parse_job(JOB, ["solve.itrations=3"])
    with pytest.raises(JobError, match="wanted key=value"):
        parse_job(JOB, ["iterations"])
    with pytest.raises(JobError, match="no table"):
        parse_job(JOB, ["frames.bits.x=1"])


def test_what_is_no_job_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(JobError, match=r"missing\.toml.*check the path"):
        read_job(tmp_path / "missing.toml")
    with pytest.raises(JobError, match=r"not valid TOML.*line 1"):
        parse_job("target = ]")
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(JobError, match="cannot read"):
        read_job(tmp_path / "bytes.toml")


def test_the_readme_shows_a_job_that_reads() -> None:
    readme = Path(__file__).resolve().parents[2] / "README.md"
    vial, slices = re.findall(r"```toml\n(.*?)```", readme.read_text(encoding="utf-8"), re.DOTALL)
    assert parse_job(vial, source="README.md").wanted.vial is not None
    assert parse_curethrough(slices, source="README.md").given["slices"] == {"path": "slices"}
