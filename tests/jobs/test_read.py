"""Job files: what is right is read, what is wrong is named with its line and a remedy."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

from vamgpu import SquareBath
from vamgpu.cli import main
from vamgpu.errors import BadInput, JobError
from vamgpu.hosts.rig import read_rig
from vamgpu.hosts.rigs.config import parse_rig
from vamgpu.jobs.build import pitch_of
from vamgpu.jobs.curethrough import CurethroughJob
from vamgpu.jobs.demo import JOB
from vamgpu.jobs.keys import EXAMPLES, FILES, commented, explained, keys_of
from vamgpu.jobs.lines import key_lines, line_of
from vamgpu.jobs.read import Job, read_job, toml_value
from vamgpu.jobs.web import WebJob
from vamgpu.schema.explain import keys
from vamgpu.schema.read import model_in


def test_the_demo_reads_in_mm_and_mj() -> None:
    wanted = Job.parse(JOB).file
    assert wanted.target.pitch is None and pitch_of(wanted) == pytest.approx(0.08, rel=1e-3)
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
        ('"12.4 mm"', '"12.4 s"', "vial.radius: got '12.4 s'; expected a length"),
        (
            '"12.4 mm"',
            '"12400 mm"',
            "vial.radius: got '12400 mm'; is 12400 mm; expected 0.05 to 1000 mm: check the unit; "
            'was "12400 um" meant?',
        ),
        ('"12.4 mm"', "12.4", "vial.radius: got 12.4; expected a length with its unit in quotes"),
        ('radius = "12.4 mm"', 'raduis = "12.4 mm"', "vial.raduis: unknown key; did you mean 'radius'?"),
        ("[frames]", "[framse]", "framse: unknown key; did you mean 'frames'?"),
        ("bits = 8", "bits = 7", "frames.bits: got 7; expected 1 or 8"),
        ("bits = 8", "shift = 3", "frames.shift: got 3; expected a list in brackets"),
        ("bits = 8", 'shift = "3"', "frames.shift: got '3'; expected a list in brackets: [\"3\"]; correct the value"),
        ("bits = 8", "shift = [3]", "frames.shift: got [3]; expected a list of at least 2 values"),
        ("bits = 8", "shift = [3, 1, 2]", "frames.shift: got [3, 1, 2]; expected a list of at most 2 values"),
        ("angles = 360", "angles = 60000000", "turntable.angles: got 60000000; expected at most 1,000,000 angles"),
        (
            'height = "11.5 mm"',
            'height = "0.5 in"',
            "target.height: got '0.5 in'; expected a length in mm, um, µm, cm, m, not 'in' (0.5 ×",
        ),
        ("bits = 8", "flip_r = 1", "frames.flip_r: got 1; expected true or false"),
        ("iterations = 40", "iterations = 0", "solve.iterations: got 0; expected greater than or equal to 1"),
        ("iterations = 40", "iterations = 4.5", "solve.iterations: got 4.5; expected a whole number without quotes"),
        ("angles = 360", 'angles = "many"', "turntable.angles: got 'many'; expected a whole number of angles ≥ 1, or"),
        ("angles = 360", "angles = true", "turntable.angles: got True; expected a whole number of angles ≥ 1"),
        ("angles = 360", 'range = "361 deg"', "turntable.range: got 6.30064 rad; expected at most 360 deg"),
        ("resin_index = 1.49962", "resin_index = nan", "vial.resin_index: got nan"),
        ("bath_index = 1.0", 'polarization = "x"', "vial.polarization: got 'x'; expected 'none', 's' or 'p'"),
        ("resin_index = 1.49962", "resin_index = 0.9", "vial.resin_index: got 0.9"),
    ],
)
def test_a_wrong_value_is_named_with_its_line(old: str, new: str, said: str) -> None:
    text = JOB.replace(old, new, 1)
    with pytest.raises(JobError) as caught:
        Job.parse(text, source="boat.toml")
    assert f"boat.toml, line {line_with(text, new)}: {said}" in str(caught.value)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("fill = 1.2", "beam.fill: got 1.2; expected less than or equal to 1"),
        ("fill = 0", "beam.fill: got 0; expected greater than 0"),
        ("spread = 0", 'beam.spread: got 0; expected a length with its unit in quotes: write it like "0 um"'),
        ("spread = 25", 'write it like "25 um"'),
        ("spread = 0.025", "beam.spread: got 0.025; expected a length with its unit in quotes"),
        ('spread = "25"', "beam.spread: got '25'; expected a length in mm"),
        (
            'spread = "-1 um"',
            'expected a length ≥ 0: write it like "25 um"; or the path of a calibration: spread = "',
        ),
    ],
)
def test_a_wrong_optic_of_the_beam_is_named_with_its_line(line: str, said: str) -> None:
    text = JOB.replace("[beam]", "[beam]\n" + line)
    with pytest.raises(JobError) as caught:
        Job.parse(text, source="boat.toml")
    assert f"boat.toml, line {line_with(text, line)}: beam." in str(caught.value) and said in str(caught.value)


@pytest.mark.parametrize(("given", "hint"), [("67", "67 um"), ("0.067", "0.067 mm"), ('"67"', "67 um")])
def test_a_pitch_without_a_unit_is_shown_with_a_likely_one(given: str, hint: str) -> None:
    with pytest.raises(JobError, match=f'beam.pitch: got .*write it like "{hint}"'):
        Job.parse(JOB, [f"beam.pitch={given}"])


def test_a_rig_or_a_mesh_is_not_read_as_a_job_nor_a_job_as_a_rig(tmp_path: Path) -> None:
    with pytest.raises(JobError, match=r"lab.toml is the file of a rig, with a table \[rig\]; expected .*\[target\]"):
        Job.parse('[rig]\nname = "lab"\n', source="lab.toml")
    with pytest.raises(JobError, match=r"job.toml is the file of a job, with a table \[target\]; expected .*\[rig\]"):
        parse_rig(JOB, source="job.toml")
    mesh = tmp_path / "part.stl"
    for data in (b"solid part\n facet normal 0 0 1\n", bytes(range(256))):
        mesh.write_bytes(data)
        for read in (Job.read, read_rig):
            with pytest.raises(JobError, match=r"part.stl.*not.*expected a TOML file"):
                read(mesh)
    for command in (["prove"], ["print", "--rig", "emulated"]):
        assert main([*command, str(mesh)]) == 1


def test_a_setting_without_a_value_removes_its_key() -> None:
    assert Job.parse(JOB.replace("[beam]", "[beam]\nfill = 0.5", 1), ["beam.fill="]).file.beam.fill == 1.0
    assert Job.parse(JOB.replace("[beam]", "[beam]\nfill = 0.5", 1)).file.beam.fill == 0.5
    assert Job.parse(f'{JOB}\n[resin]\nwavelength = "405 nm"\n', ["resin="]).file.resin.wavelength is None
    with pytest.raises(JobError, match=r"--set: beam.pitch is missing; add pitch = … to \[beam\]"):
        Job.parse(JOB, ["beam.pitch="])
    assert Job.parse(JOB, ["solve.evaluations=", "wobble=", "wobble.across="]).given == Job.parse(JOB).given
    for wrong in ("beam.fil=", "wobbel.across=", "bodies="):
        with pytest.raises(JobError, match=f"--set {wrong}: removes a key that no such file has"):
            Job.parse(JOB, [wrong])


def test_a_removed_key_is_refused_on_its_own_line() -> None:
    text = JOB.replace("[solve]", "[solve]\n# in all\npairs = 0")
    with pytest.raises(JobError, match="pairs") as told:
        Job.parse(text)
    assert f"line {line_with(text, 'pairs = 0')}: solve.pairs" in str(told.value)


def test_the_old_name_of_a_job_s_file_warns() -> None:
    job = Job.parse(JOB)
    with pytest.warns(DeprecationWarning, match="Job.wanted is called file"):
        assert job.wanted is job.file


def test_a_misspelled_table_is_not_told_to_be_missing_as_well() -> None:
    with pytest.raises(JobError) as caught:
        Job.parse(JOB.replace("[beam]", "[bean]", 1), source="boat.toml")
    line = line_with(JOB, "[beam]")
    assert str(caught.value) == f"boat.toml, line {line}: bean: unknown key; did you mean 'beam'?"
    with pytest.raises(JobError, match=r"(?s)beam is missing; add the table \[beam\].*optics: unknown key"):
        Job.parse(JOB.replace("[beam]", "[optics]", 1))


def test_every_wrong_value_is_named_at_once() -> None:
    text = JOB.replace('"11.5 mm"', "11.5").replace("bits = 8", "bits = 3")
    with pytest.raises(JobError, match=r"(?s)target\.height.*frames\.bits"):
        Job.parse(text)


def test_a_missing_key_and_a_double_choice_say_what_to_write() -> None:
    with pytest.raises(JobError, match=r"beam\.pitch is missing; add pitch = … to \[beam\]"):
        Job.parse(JOB.replace('[beam]\npitch = "120 um"\n', "[beam]\n", 1))
    with pytest.raises(JobError, match=r"exactly one of mesh"):
        Job.parse(JOB.replace('shape = "boat"', 'shape = "boat"\nmesh = "a.stl"'))
    with pytest.raises(JobError, match=r"both \[vial\] and \[vat\]"):
        Job.parse(JOB + '\n[vat]\nwidth = "20 mm"\n')


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
    job = Job.parse(JOB, ["frames.flip_r=false", "frames.flip_z=true", "target.height=9 mm", "solve.iterations = 3"])
    assert job.file.frames.flip_r is False and job.file.frames.flip_z is True
    assert (job.file.target.height, job.file.solve.iterations) == (9.0, 3)
    with pytest.raises(JobError, match=r"--set: solve\.iterations: got False"):
        Job.parse(JOB, ["solve.iterations=false"])
    with pytest.raises(JobError, match=r"--set: solve\.itrations: unknown key; did you mean 'iterations'"):
        Job.parse(JOB, ["solve.itrations=3"])
    with pytest.raises(JobError, match="expected key=value"):
        Job.parse(JOB, ["iterations"])
    with pytest.raises(JobError, match="not a table"):
        Job.parse(JOB, ["frames.bits.x=1"])


def test_files_that_are_not_there_are_named_with_their_lines(tmp_path: Path) -> None:
    text = JOB.replace('shape = "boat"', 'mesh = "boat.stl"').replace("angles = 360", 'angles = "a.csv"')
    text = text.replace("bits = 8", 'gray = "gray.toml"')
    (tmp_path / "a.csv").write_text("angle_deg\n0\n90\n", encoding="utf-8")
    (tmp_path / "boat.toml").write_text(text, encoding="utf-8")
    with pytest.raises(JobError) as refused:
        read_job(tmp_path / "boat.toml", ["beam.spread=mtf/result.toml"])
    for line, name in enumerate(("boat.stl", "mtf/result.toml", "gray.toml")):
        key = ("target.mesh", "beam.spread", "frames.gray")[line]
        place = "--set" if name.startswith("mtf") else f"line {line_with(text, name)}"
        assert f"{place}: {key}: got {name!r}; there is no file {str(tmp_path / name)!r}" in str(refused.value)
    assert "a.csv" not in str(refused.value) and str(refused.value).count("\n") == 2


def test_what_is_no_job_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(JobError, match=r"missing\.toml.*check the path"):
        read_job(tmp_path / "missing.toml")
    with pytest.raises(JobError, match=r"not valid TOML.*line 1"):
        Job.parse("target = ]")
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(JobError, match="cannot read"):
        read_job(tmp_path / "bytes.toml")


def shown(page: str) -> list[str]:
    """The job files on a page."""
    return re.findall(r"```toml\n(.*?)```", (Path(__file__).resolve().parents[2] / page).read_text("utf-8"), re.DOTALL)


def test_the_pages_show_jobs_that_read() -> None:
    (first,), (vial, bath, rings), (slices,) = map(shown, ("README.md", "docs/jobs.md", "docs/curethrough.md"))
    assert first == vial and Job.parse(vial, source="README.md").file.vial is not None
    bathed = re.sub(r"\[vial\]\n.*?(?=\[beam\])", bath, vial, flags=re.DOTALL)
    assert isinstance(Job.parse(bathed, source="jobs.md").file.vessel, SquareBath)
    assert Job.parse(vial + rings, source="jobs.md").file.solve.operator == "rings"
    assert CurethroughJob.parse(slices, source="curethrough.md").given["slices"] == {"path": "slices"}


@pytest.mark.parametrize(
    ("what", "read"), [("vial", Job.parse), ("web", WebJob.parse), ("slices", CurethroughJob.parse), ("machine", None)]
)
def test_a_file_to_begin_with_is_sound_and_names_every_key(what: str, read: Any) -> None:
    text = commented(what)
    given = tomllib.loads(text)
    assert given == {
        key: part for key, part in tomllib.loads(EXAMPLES[what]).items() if key in FILES[what].model_fields
    }
    if read is not None:
        assert read(text).given == given
    for table, field in FILES[what].model_fields.items():
        assert f"[{table}]" in text
        model = model_in(field.annotation, field.metadata, given.get(table, {}))
        for key in () if model is None else keys(model):
            assert re.search(rf"^(# )?{key.name} = ", text, re.M), (table, key.name)
    assert max(map(len, text.splitlines())) <= 140
    assert ("# [[body]]" in text, "# [body]" in text) == (what == "vial", False)


def test_kinds_and_single_keys_are_explained() -> None:
    with pytest.raises(BadInput, match="no key 'nope' in beam; expected one of pitch, "):
        explained("beam.nope")
    assert "vessel.fan" in [key.name for key in explained("vessel")] and explained("any vessel") == explained("vessel")
    assert [key.name for key in explained("target.pitch")] == ["pitch"] and explained("beam") == keys_of("beam")
    with pytest.raises(BadInput, match="no table 'a.b'"):
        explained("a.b")
