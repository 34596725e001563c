"""A vessel, a loss and a lens from another package: known in Python, job files, manifests and the list of keys."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.errors import BadInput, JobError
from vamgpu.jobs.build import projection_of, target_of
from vamgpu.jobs.demo import JOB
from vamgpu.jobs.keys import keys_of, reference, schema_of
from vamgpu.jobs.read import Job
from vamgpu.jobs.run import prove, solve
from vamgpu.methods.plan_folder import describe, projection_from
from vamgpu.schema import register, write
from vamgpu.schema import registry as names
from vamgpu.schema.read import read

TOYS = '''"""Toys."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vamgpu.geometry import Chords
from vamgpu.methods import OSMO
from vamgpu.schema import check
from vamgpu.schema.quantities import Length, Positive, Share


@dataclass(frozen=True)
class Veil:
    """A veil in front of the resin.

    Args:
        radius: within which there is light [mm].
        share: of the light that it lets through.
    """

    radius: Length
    share: Share = 0.5
    absorption = 0.0

    def __post_init__(self) -> None:
        check(self)

    @property
    def lit_radius(self) -> float:
        return self.radius

    def chords(self, u: np.ndarray) -> Chords:
        half = np.sqrt(np.maximum(self.radius**2 - u**2, 0.0))
        lit = np.where(np.abs(u) < self.radius, self.share, 0.0)
        return Chords(u, np.zeros_like(u), np.zeros_like(u), lit, 2.0 * half)

    def illuminate(self, across: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return across, np.where(np.hypot(across, along) < self.radius, self.share, 0.0)


@dataclass(frozen=True)
class Regret:
    """How sorry one is.

    weight: of what is too much.
    """

    weight: Positive = 2.0


@dataclass(frozen=True)
class Sorry(OSMO):
    """A method that regrets.

    loss: what it regrets.
    """

    loss: Regret = Regret()


@dataclass(frozen=True)
class Eyeglass:
    """A lens in front of an eye.

    focal: its focal length [mm].
    """

    focal: Length

    def __post_init__(self) -> None:
        check(self)
'''
ENTRIES = """[vamgpu.nouns]
vessel.veil = toys_of_vamgpu:Veil
loss.regret = toys_of_vamgpu:Regret
lens.eyeglass = toys_of_vamgpu:Eyeglass
method.sorry = toys_of_vamgpu:Sorry
"""
SMALL = ["target.pitch=600 um", "beam.pitch=600 um", "turntable.angles=12", "solve.iterations=2", "solve.device=cpu"]
ABSORBED = "print.absorption=0.05 1/mm"


@pytest.fixture(autouse=True)
def toys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The toys, installed as a package would be."""
    site = tmp_path / "site"
    info = site / "toys_of_vamgpu-1.0.dist-info"
    info.mkdir(parents=True)
    (site / "toys_of_vamgpu.py").write_text(TOYS, encoding="utf-8")
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: toys-of-vamgpu\nVersion: 1.0\n", encoding="utf-8")
    (info / "entry_points.txt").write_text(ENTRIES, encoding="utf-8")
    monkeypatch.syspath_prepend(str(site))
    before = {name: dict(one.nouns) for name, one in names.FAMILIES.items()}
    names.installed.cache_clear()
    yield
    for name, nouns in before.items():
        names.FAMILIES[name].nouns.clear()
        names.FAMILIES[name].nouns.update(nouns)
    sys.modules.pop("toys_of_vamgpu", None)


def job(*settings: str) -> str:
    vial = JOB[JOB.index("[vial]") : JOB.index("[solve]")]
    return JOB.replace(vial, '[vessel]\nkind = "veil"\nradius = "12 mm"\nshare = 0.25\n\n' + "\n".join(settings))


def test_a_vessel_from_outside_is_solved_written_and_proven(tmp_path: Path) -> None:
    solve(Job.parse(job(), [*SMALL, ABSORBED]), tmp_path / "boat.vam")
    A = prove(tmp_path / "boat.vam").proof.operator
    assert type(A.vessel).__name__ == "Veil" and (A.vessel.radius, A.vessel.share) == (12.0, 0.25)  # type: ignore[union-attr]


def test_a_vessel_from_outside_stands_inside_another() -> None:
    inside = 'kind = "occluded"\nacross = "2 mm"\n[vessel.vessel]\nkind = "veil"'
    wanted = Job.parse(job().replace('kind = "veil"', inside), SMALL)
    device = vam.open_device("numpy")
    A = projection_of(wanted.file, target_of(wanted, device), device)
    B = projection_from(json.loads(json.dumps(describe(A))), device)
    y = np.random.default_rng(0).random(A.range.shape)
    assert np.array_equal(A.T(y), B.T(y)) and A.vessel == B.vessel


def test_wrong_fields_are_named_by_line() -> None:
    text = job().replace('"12 mm"', '"-2 mm"').replace("share", "shaer")
    with pytest.raises(JobError, match=r"(?s)line \d+: vessel\.radius: got '-2 mm'.*shaer: .*did you mean 'share'"):
        Job.parse(text)
    with pytest.raises(JobError, match=r"--set: vessel\.share: got 2; expected less than or equal to 1"):
        Job.parse(job(), ["vessel.share=2"])


def test_a_loss_and_a_lens_from_outside_are_read_and_written() -> None:
    wanted = Job.parse(job('[method]\nkind = "sorry"\ngain = 0.5\n[method.loss]\nweight = 3.0\n')).file
    method: Any = wanted.method
    assert type(method).__name__ == "Sorry" and (method.gain, method.loss.weight) == (0.5, 3.0)
    table = write(method)
    assert table["kind"] == "sorry" and table["loss"] == {"kind": "regret", "weight": 3.0}
    assert read("method", json.loads(json.dumps(table)), units=False) == method
    lens = read("lens", {"kind": "eyeglass", "focal": "25 cm"})
    assert write(lens, units=True) == {"kind": "eyeglass", "focal": "250.0 mm"}
    assert read("lens", write(lens), units=False) == lens
    assert read("lens", {}) == vam.TunableLens()  # the usual one stays it


def test_keys_and_schema_know_them() -> None:
    assert [(key.name, key.what, key.default, key.doc) for key in keys_of("vessel.veil")] == [
        ("radius", "a length > 0 mm", "", "within which there is light [mm]"),
        ("share", "a number ≥ 0, ≤ 1", "0.5", "of the light that it lets through"),
    ]
    page = reference()
    assert all(f"### {name}" in page for name in ("vessel.veil", "loss.regret", "lens.eyeglass", "method.sorry"))
    schema = schema_of("vial")
    assert schema["$defs"]["vessel.veil"]["required"] == ["radius"]
    assert {"$ref": "#/$defs/vessel.veil"} in [part["allOf"][0] for part in schema["properties"]["vessel"]["anyOf"]]


def test_one_line_registers_and_names_are_unique() -> None:
    register("vessel", "curtain", "toys_of_vamgpu:Veil")
    assert read("vessel", {"kind": "curtain", "radius": "3 mm"}).radius == 3.0
    with pytest.raises(BadInput, match="expected another name"):
        register("vessel", "vial", "toys_of_vamgpu:Veil")
