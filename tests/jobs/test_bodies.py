"""Jobs of several bodies: read, solved, written and proven by what they ask for."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

import vamgpu as vam
from vamgpu.errors import JobError, StorageError
from vamgpu.jobs.build import scene_of, target_of
from vamgpu.jobs.read import Job
from vamgpu.jobs.run import prove, solve
from vamgpu.methods.plan_folder import limits_described, limits_from
from vamgpu.operators.traced_projection import TracedProjection
from vamgpu.targets.limits import Limits
from vamgpu.targets.shapes import csg
from vamgpu.targets.solid import Solid

TEXT = """
[target]
pitch = "0.2 mm"
shape_of_grid = [24, 24, 4]
[[body]]
mesh = "part.stl"
[[body]]
mesh = "pin.stl"
role = "insert"
priority = 50.0
[[body]]
mesh = "beside.stl"
role = "keep out"
name = "channel"
dose = 0.6
weight = 2.0
[beam]
pitch = "0.2 mm"
pixels = [32, 4]
[turntable]
angles = 24
[vial]
radius = "3.6 mm"
wall = "0.4 mm"
resin_index = 1.48
wall_index = 1.5
absorption = "0.1 /mm"
[solve]
method = "lbfgs"
iterations = 8
device = "cpu"
"""


def bar(radius: float, height: float, x: float = 0.0) -> Solid:
    return csg.to_solid(csg.rod((x, 0, 5 - height / 2), (x, 0, 5 + height / 2), radius), "bar")


@pytest.fixture
def job(tmp_path: Path) -> Path:
    """A job file with its meshes, drawn about z = 5."""
    bar(1.2, 0.8).save(tmp_path / "part.stl")
    bar(0.4, 9.0).save(tmp_path / "pin.stl")
    bar(0.4, 9.0, 1.8).save(tmp_path / "beside.stl")
    (tmp_path / "task.toml").write_text(TEXT, encoding="utf-8")
    return tmp_path / "task.toml"


def test_a_folder_is_proven_by_what_its_bodies_ask_for(job: Path, tmp_path: Path) -> None:
    read = Job.read(job)
    solve(read, tmp_path / "task.vam")
    proof, target = prove(tmp_path / "task.vam").proof, target_of(read, vam.open_device("numpy"))
    assert isinstance(proof.operator, TracedProjection) and proof.operator.medium.opaque is not None
    assert proof.limits is not None and target.limits is not None
    for name in ("dose", "weight", "body"):
        assert np.array_equal(getattr(proof.limits, name), getattr(target.limits, name))
    assert proof.limits.bodies == target.limits.bodies and proof.limits.void == target.limits.void
    assert [(body.name, body.role) for body in proof.bodies] == [("part", "print"), ("channel", "keep out")]
    again = vam.simulate(proof.operator, proof.frames, target)
    assert again.scores == proof.scores
    assert not (target.limits.dose[12, 12] > 0).any() and (target.limits.weight == 2.0).any()


def test_tables_are_the_bodies_of_a_scene(job: Path) -> None:
    read = Job.read(job, ["target.void=0.8", "target.origin=[0, 0, 5.4]", "target.factor=0.5"])
    scene = scene_of(read.file, read.folder)
    assert scene is not None and (scene.void, scene.factor, scene.origin) == (0.8, 0.5, (0, 0, 5.4))
    assert [body.role for body in scene.bodies] == ["print", "insert", "keep out"]
    assert [body.priority for body in scene.bodies] == [0.0, 50.0, 30.0]


def test_names_of_a_3mf_file_are_the_same_bodies(job: Path) -> None:
    """Objects of one file in place of three files, for which a job asks."""
    names = {"part": "part", "pin": "insert pin", "beside": "zero_dose channel"}
    whole = trimesh.Scene({name: trimesh.load_mesh(job.with_name(f"{file}.stl")) for file, name in names.items()})
    whole.units = "millimeter"
    whole.export(job.with_name("all.3mf"))
    head, beam = TEXT[: TEXT.index("[[body]]")], TEXT[TEXT.index("[beam]") :]
    text = f'{head}[[body]]\nmesh = "all.3mf"\nroles = "names"\ndose = 0.6\n{beam}'
    asked, plain = (target_of(Job.parse(each, folder=job.parent), vam.open_device("numpy"))
                    for each in (text, TEXT.replace("weight = 2.0\n", "")))  # fmt: skip
    assert asked.limits is not None and plain.limits is not None
    assert np.array_equal(asked.limits.dose, plain.limits.dose) and asked.limits.body.max() == 2
    assert [(body.name, body.role) for body in asked.limits.bodies] == [
        ("part", "print"), ("insert pin", "insert"), ("zero_dose channel", "keep out")]  # fmt: skip
    for more in ('[wobble]\nradius = "0.1 mm"\n', '[scattering]\ncoefficient = "0.1 /mm"\n',
                 '[travel]\nrise = "0.1 mm"\nrows = 3\n'):  # fmt: skip
        with pytest.raises(JobError, match=rf"an insert with {re.escape(more.split()[0])}"):
            target_of(Job.parse(text + more, folder=job.parent), vam.open_device("numpy"))


PART = '[target]\npitch = "0.2 mm"\n[beam]\npitch = "0.2 mm"\n'
WRONG = {
    "role": ('[[body]]\nshape = "boat"\nrole = "ornament"\n', "[[body]] 1, role"),
    "both": ('[[body]]\nshape = "boat"\nmesh = "a.stl"\n', "expected exactly one of mesh"),
    "no dose": (
        '[[body]]\nshape = "boat"\n[[body]]\nshape = "boat"\nrole = "gray"\n',
        "expected dose = 0.7, say, for gray",
    ),
    "a dose": ('[[body]]\nshape = "boat"\ndose = 0.4\n', "no dose for other roles"),
    "index": ('[[body]]\nshape = "boat"\nindex = 1.5\n', "expected index and absorption only for inserts"),
    "nothing printed": ('[[body]]\nshape = "boat"\nrole = "insert"\n', "got no [[body]] that prints"),
    "key": ('[[body]]\nshape = "boat"\nroll = "print"\n', "did you mean 'role'"),
    "colors": ('[[body]]\nshape = "boat"\n[colors]\nabsorption = "0.1 /mm"\n', "[[body]] with [colors]"),
    "one pair of brackets": ('[body]\nshape = "boat"\n', "write [[body]] in place of [body]"),
    "none": ("", 'expected exactly one of mesh = "part.stl"'),
    "roles of an STL": (
        '[[body]]\nmesh = "a.stl"\nroles = "names"\n',
        "got roles with a.stl; expected the mesh of a 3MF",
    ),
    "roles and a role": (
        '[[body]]\nmesh = "a.3mf"\nroles = "names"\nrole = "insert"\npart = 1\n',
        "roles with part, role",
    ),
    "guessed roles": ('[[body]]\nmesh = "a.3mf"\nroles = "guess"\n', "[[body]] 1, roles"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_bodies_are_named(case: str) -> None:
    text, said = WRONG[case]
    with pytest.raises(JobError) as caught:
        Job.parse(PART + text)
    assert said in str(caught.value)


@pytest.mark.parametrize("wrong", ['role = "gray"', 'weight = "much"', "roll = 3"])
def test_the_line_is_that_of_the_body_that_is_meant(wrong: str) -> None:
    text = PART + '[[body]]\nshape = "boat"\nweight = 2.0\n[[body]]\nshape = "nut"\n' + wrong + "\n"
    line = text[: text.rindex("[[body]]" if "gray" in wrong else wrong)].count("\n") + 1
    with pytest.raises(JobError, match=rf"line {line}: \[\[body\]\] 2"):
        Job.parse(text)


def test_keys_of_one_part_and_of_bodies_are_not_mixed() -> None:
    for setting, said in (("target.mesh=a.stl", "got mesh with [[body]]"), ("target.height=3 mm", "got height")):
        with pytest.raises(JobError) as caught:
            Job.parse(PART + '[[body]]\nshape = "boat"\n', [setting])
        assert said in str(caught.value)
    with pytest.raises(JobError, match="got void without a"):
        Job.parse(PART, ['target.shape="boat"', "target.factor=1.0", "target.void=0.5"])
    with pytest.raises(JobError, match=r"\[\[body\]\] 1, shape: got 'bote'"):
        target_of(Job.parse(PART + '[[body]]\nshape = "bote"\n'), vam.open_device("numpy"))


def test_garbled_bodies_of_a_manifest_are_refused(job: Path) -> None:
    target = target_of(Job.read(job), vam.open_device("numpy"))
    limits, said = target.limits, limits_described(target)
    assert limits is not None and said is not None and limits_described(replace(target, limits=None)) is None
    array = {f"target_{name}": getattr(limits, name) for name in ("dose", "weight", "body")}.__getitem__
    back = limits_from(said, array, limits.dose.shape)
    assert isinstance(back, Limits) and back.bodies == limits.bodies
    assert limits_from(None, array, limits.dose.shape) is None
    for wrong in (3, {}, said | {"void": "x"}, said | {"bodies": []}, said | {"bodies": [{"nme": "a"}]}):
        with pytest.raises(StorageError, match="has malformed bodies"):
            limits_from(wrong, array, limits.dose.shape)
    with pytest.raises(StorageError, match="has malformed bodies"):
        limits_from(said, array, (1, 2, 3))
