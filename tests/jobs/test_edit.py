"""Changing keys in the text of a job file."""

from __future__ import annotations

import pytest

from vamgpu.errors import JobError
from vamgpu.jobs.demo import JOB
from vamgpu.jobs.edit import edited
from vamgpu.storage.reading import parse_toml

TEXT = """\
# first
[target]  # the part
shape = "boat"   # bundled
height = "6 mm"

# its projector
[beam]
pixels = [
  36,  # columns
  30,
]

[vessel]
kind = "fan"
vessel = { kind = "vial", radius = "1 mm" }

[[body]]
role = "print"

[[body]]
role = "gray"
a.b = 1
"""


def test_a_value_changes_and_every_other_character_stays() -> None:
    assert edited(TEXT, {"target.height": "7 mm"}) == TEXT.replace('"6 mm"', '"7 mm"')
    assert edited(TEXT, {"target.shape": "vase"}) == TEXT.replace('"boat"   # b', '"vase"   # b')
    wide = TEXT.replace("[\n  36,  # columns\n  30,\n]", "[40, 30]")
    assert edited(TEXT, {"beam.pixels": [40, 30]}) == wide


def test_keys_come_after_the_last_one_of_their_table() -> None:
    assert edited(TEXT, {"target.pitch": "1 um"}) == TEXT.replace('"6 mm"\n', '"6 mm"\npitch = "1 um"\n')
    assert edited("[a]  # empty\n", {"a.b": True}) == "[a]  # empty\nb = true\n"
    assert edited(TEXT, {"vial.wall": 0.5}) == TEXT + "\n[vial]\nwall = 0.5\n"
    assert edited(TEXT, {"body.1.a.c": 2}) == TEXT + "a.c = 2\n"
    assert edited(TEXT, {"body.0.dose": 1.0}) == TEXT.replace('"print"\n', '"print"\ndose = 1.0\n')
    assert edited("", {"a": "é\n\"'"}) == 'a = "é\\n\\"\'"\n'


def test_nested_values_in_one_line_change() -> None:
    one = edited(TEXT, {"vessel.vessel.radius": "2 mm"})
    assert one == TEXT.replace('radius = "1 mm"', 'radius = "2 mm"')
    assert edited(TEXT, {}, ["vessel.vessel.radius"]) == TEXT.replace(', radius = "1 mm"', "")


def test_keys_and_whole_tables_go() -> None:
    assert edited(TEXT, {}, ["target.shape", "no.such"]) == TEXT.replace('shape = "boat"   # bundled\n', "")
    without = parse_toml(edited(TEXT, {}, ["beam"]))
    assert without == {key: value for key, value in parse_toml(TEXT).items() if key != "beam"}
    assert "# its projector" in edited(TEXT, {}, ["beam"])
    assert "body" not in parse_toml(edited(TEXT, {}, ["body"]))


@pytest.mark.parametrize(
    ("text", "key"), [("[a", "a.b"), ("a = 1", "a.b"), ("[[a]]\nb = 1", "a.5.b"), ("[[a]]\nb = 1", "a.x.b")]
)
def test_what_cannot_be_changed_is_named(text: str, key: str) -> None:
    with pytest.raises(JobError):
        edited(text, {key: 1})


def test_every_key_of_the_demo_can_be_set_and_removed() -> None:
    data = parse_toml(JOB)
    for table, keys in data.items():
        for key, value in keys.items():
            other = parse_toml(edited(JOB, {f"{table}.{key}": "new"}))
            assert other == data | {table: keys | {key: "new"}}
            gone = parse_toml(edited(JOB, {}, [f"{table}.{key}"]))
            assert gone == data | {table: {each: keys[each] for each in keys if each != key}}
            assert edited(JOB, {f"{table}.{key}": value}) == JOB


def test_the_number_after_the_last_body_adds_one() -> None:
    bodies = {"body.2.mesh": "pin.stl", "body.2.role": "keep out"}
    added = edited(TEXT, bodies)
    assert added == TEXT + '\n[[body]]\nmesh = "pin.stl"\nrole = "keep out"\n'
    with pytest.raises(JobError, match="no such table"):
        edited(TEXT, {"body.3.mesh": "pin.stl"})
    first = edited('[vial]\nradius = "8 mm"\n', {"body.0.shape": "boat", "body.1.shape": "vase"})
    assert parse_toml(first)["body"] == [{"shape": "boat"}, {"shape": "vase"}]
