"""A print gives the dose that was proved: what emulated machines showed, summed by rays of this test."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh

from vamgpu.cli import main
from vamgpu.cli.print import _begun as begun
from vamgpu.errors import BadInput, DoseWarning, StorageError
from vamgpu.hosts.records.proof import prove_run
from vamgpu.hosts.records.record import read_run
from vamgpu.hosts.records.state import PrintState
from vamgpu.hosts.rig import carry_out, may_go_on, plan, read_rig, rehearsal
from vamgpu.hosts.rigs.config import parse_rig
from vamgpu.hosts.rigs.rehearsal import Rehearsal
from vamgpu.jobs.read import read_job
from vamgpu.jobs.run import prove, solve
from vamgpu.printing.folder import load_frames
from vamgpu.printing.given_dose import GivenDose, ProvedDose
from vamgpu.printing.proof import Proof
from vamgpu.printing.verdict import Fault

PART = """
[target]
mesh = "part.stl"
height = "8 mm"
pitch = "1 mm"
[beam]
pitch = "1 mm"
spread = "1 um"
[vial]
radius = "12 mm"
wall = "1 mm"
resin_index = 1.0
wall_index = 1.0
bath_index = 1.0
absorption = "{absorption} 1/mm"
[turntable]
angles = {angles}
[solve]
method = "lbfgs"
iterations = 4
device = "cpu"
[frames]
bits = {bits}
[print]
irradiance = "{irradiance} mW/cm2"
critical_dose = "{dose} mJ/cm3"
"""
CABLE = """
[rig]
name = "cable"
machine = "vial"
[controller]
port = "/dev/does-not-exist"
[motion]
driver = "zaber"
port = "/dev/does-not-exist"
[display]
driver = "video"
[light]
driver = "controller"
power = 0.8
irradiance = "30 mW/cm2"
"""
STAGE = (Path(__file__).parents[2] / "docs" / "rigs" / "vialux_zaber.toml").read_text(encoding="utf-8")
PI = (Path(__file__).parents[2] / "docs" / "rigs" / "pi_video_stepper.toml").read_text(encoding="utf-8")
USUAL: dict[str, Any] = {
    "radius": 3.0, "absorption": 0.05, "angles": 36, "bits": 8, "irradiance": 65, "dose": 50,
}  # fmt: skip
JOBS: dict[str, tuple[dict[str, Any], str, tuple[str, ...]]] = {
    "cylinder": ({}, "emulated", ()),
    "one bit": ({"bits": 1, "absorption": 0.03}, "emulated", ("--speed", "60")),
    "shorter than a turn": ({"radius": 2.5, "dose": 5, "angles": 30}, "emulated", ()),
    "drive on a cable": ({"dose": 40}, CABLE, ("--speed", "40")),
    "stage, laser at 0.7": ({"irradiance": 40, "angles": 40}, STAGE.replace('"laser"', '"laser"\npower = 0.7'), ()),
}
"""What is printed, on which rig, with which words."""
RARE = ("cylinder", "shorter than a turn", "stage, laser at 0.7")


def solved(folder: Path, **other: Any) -> Path:
    file = folder / "part.toml"
    values = USUAL | other
    trimesh.creation.cylinder(values["radius"], 6.0).export(folder / "part.stl")
    file.write_text(PART.format(**values))
    return solve(read_job(file), file.with_suffix(".vam")).path


@pytest.fixture(scope="module")
def part(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The job of a cylinder."""
    return solved(tmp_path_factory.mktemp("job"))


@pytest.fixture(scope="module")
def proof(part: Path) -> Proof:
    """Of the cylinder."""
    return prove(part, "cpu").proof


class Recorder:
    """Keeps what emulated mirrors showed: seconds of full drive of each pixel at each angle."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.seconds: dict[int, np.ndarray] = {}
        monkeypatch.setattr("vamgpu.hosts.process.order.rehearsal", self._rehearsed)

    def _rehearsed(self, *planned: Any, **options: Any) -> Rehearsal:
        stand = rehearsal(*planned, **options)
        recorder = stand.emulated.recorder

        def heard(mirrors: np.ndarray, begin: int, end: int) -> None:
            angle = int(recorder.pose((begin + end) // 2)) % planned[0].schedule.frames
            shone = np.asarray(mirrors, float)[: recorder.mirrors[0]] * (end - begin) * 1e-9
            self.seconds[angle] = self.seconds.get(angle, 0.0) + shone

        recorder.listeners.append(heard)
        return stand

    def light(self, shape: tuple[int, ...]) -> np.ndarray:
        """Seconds [angle, row, column] of the pixels of frames, which are in the middle of the mirrors."""
        images, rows, columns = shape
        whole = np.stack([self.seconds[angle] for angle in range(images)])
        top, left = (whole.shape[1] - rows) // 2, (whole.shape[2] - columns) // 2
        return whole[:, top : top + rows, left : left + columns]


def levels(job: Path) -> np.ndarray:
    """Of a job's frames, 0 to 1, decoded here."""
    frames = load_frames(job, "cpu")
    images = frames.images.numpy()
    return images / 255.0 if frames.bits == 8 else np.unpackbits(images, axis=2)[:, :, : frames.columns].astype(float)


def exposed(light: np.ndarray, irradiance: float, absorption: float, proof: Proof) -> float:
    """Mean dose of the part [mJ/mm³], by straight rays through 27 points of each voxel.

    light: seconds of each pixel [angle, row, column].  irradiance: [mW/mm²].
    """
    grid, beam = proof.operator.grid, proof.operator.beam
    inside = proof.target.numpy() >= 0.5
    middles = np.stack([axis[inside] for axis in np.meshgrid(*grid.axes(), indexing="ij")], axis=1)
    parts = (np.stack(np.meshgrid(*3 * [range(3)]), axis=-1).reshape(-1, 1, 3) - 1.0) / 3 * grid.pitch
    x, y, z = np.moveaxis(middles + parts, -1, 0)
    total, (columns, rows) = np.zeros(x.shape), beam.pixels
    for angle, part in product(range(len(light)), (-1 / 3, 0, 1 / 3)):  # the vial turns while a frame is lit
        image, theta = light[angle] / 3, 2 * np.pi * (angle + part) / len(light)
        r, towards = y * np.cos(theta) - x * np.sin(theta), x * np.cos(theta) + y * np.sin(theta)
        depth = np.sqrt(11.0**2 - r**2) - towards
        column, row = np.rint(r / beam.pitch + (columns - 1) / 2), np.rint((rows - 1) / 2 - z / beam.pitch)
        shone = image[row.astype(int), column.astype(int)]
        total += shone * irradiance * absorption * np.exp(-absorption * depth)
    return float(total.mean())


def printed(job: Path, rig: str, run: Path, *words: str) -> int:
    """Rehearse a job on a rig, or on the text of its file."""
    if rig != "emulated":
        file = run.with_suffix(".toml")
        file.write_text(rig)
        return main(["print", str(job), "--rig", str(file), "--dry-run", "--out", str(run), *words])
    return main(["print", str(job), "--rig", rig, "--out", str(run), *words])


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * (name in RARE)) for name in JOBS])
def test_the_dose_is_the_one_that_was_proved(
    name: str, part: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (other, rig, words), record = JOBS[name], Recorder(monkeypatch)
    values, job = USUAL | other, solved(tmp_path, **other) if other else part
    monkeypatch.setattr("vamgpu.cli.print._report", lambda *_: None)
    capsys.readouterr()
    assert printed(job, rig, tmp_path / "run", *words) == 0
    told, proof = capsys.readouterr().out, prove(job, "cpu").proof
    assert proof.exposure is not None
    full = 0.8 * 0.3 / 0.8 if rig == CABLE else values["irradiance"] / 100  # the drive is in what was recorded
    given = exposed(record.light(levels(job).shape), full, values["absorption"], proof)
    angles, job_light = values["angles"], values["irradiance"] / 100
    wanted = exposed(levels(job) * proof.exposure.seconds / angles, job_light, values["absorption"], proof)
    critical = values["dose"] / 1000 * proof.scores.total_in / proof.scores.in_voxels / proof.scores.threshold
    assert wanted == pytest.approx(critical, rel=0.02), "the proof's seconds give its threshold the critical dose"
    assert given == pytest.approx(wanted, rel=2e-3)
    dose = GivenDose.read(read_run(tmp_path / "run").asked["dose"])
    assert dose is not None and dose.share == pytest.approx(given / wanted, rel=2e-3)
    turns = len(read_run(tmp_path / "run").shown) // angles
    assert dose.turns == turns and not dose.asked and dose.keeps
    assert f"{turns} turn{'s' * (turns > 1)} in {dose.seconds:.2f} s" in told and "1.000 times the proved dose" in told
    assert ("dimmed" in told) == (dose.lit < 1.0)


@pytest.mark.parametrize(("turns", "status"), [(1, 3), pytest.param(6, 0, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_another_dose_is_told_and_never_green(
    part: Path, turns: int, status: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    record, run, proofs = Recorder(monkeypatch), tmp_path / "run", []
    for place in ("vamgpu.hosts.rigs.turns.prove", "vamgpu.jobs.run.prove"):
        monkeypatch.setattr(place, lambda *given: proofs.append(given) or prove(*given))
    capsys.readouterr()
    assert printed(part, "emulated", run, "--turns", str(turns), "--speed", "120") == status
    assert len(proofs) == 1, "planning proves the job, and the report takes that proof"
    said, (found,) = capsys.readouterr(), prove_run(run, "cpu")
    proof, kept = found.planned.proof, found.least.given
    assert proof.exposure is not None and not proof.scores.missing + proof.scores.excess and kept is not None
    wanted = exposed(levels(part) * proof.exposure.seconds / 36, 0.65, 0.05, proof)
    share = exposed(record.light(levels(part).shape), 0.65, 0.05, proof) / wanted
    assert kept.share == pytest.approx(share, rel=2e-3) and (share < 0.9 or share > 1.5)
    assert f"warning: {turns} turn" in said.err and ("incomplete: " in said.out) == (share < 1)
    assert found.light.complete == (share > 1) and "times the proved dose: " in str(found.least.verdict)
    page = (run / "report.html").read_text(encoding="utf-8")
    assert "dose given over proved" in page
    for text in (said.err, said.out, str(found.least.verdict), page):
        assert (told := re.search(r"×(\d+\.\d+)|(\d+\.\d+) times the proved dose", text))
        assert float(told[1] or told[2]) == pytest.approx(share, rel=5e-3)
    solid = found.least.dose.numpy() * kept.share / (found.least.scores.total_in / proof.scores.total_in)
    missing = (solid < proof.scores.threshold) & (proof.target.numpy() >= 0.5)
    assert found.least.scores.missing == missing.sum(), "what is missing is what that dose leaves liquid"


def test_a_dose_that_whole_turns_cannot_give_is_refused_with_the_speed_that_can(part: Path, proof: Proof) -> None:
    rig, proved = parse_rig(PI), replace(ProvedDose.of(proof), seconds=12.0)
    refused = r"1\.333 turns of 9 s.*expected 0.* print with --speed ([\d.]+)$"
    with pytest.raises(BadInput, match=refused) as told:
        plan(part, rig, speed=40, rehearsed=True, exposure=proved)
    advice = re.search(refused, str(told.value))
    followed = plan(part, rig, speed=float(advice[1]), rehearsed=True, exposure=proved).dose if advice else None
    assert followed is not None and followed.keeps and followed.turns == 1
    with pytest.warns(DoseWarning, match=r"1 turn of light: the dose is 0\.750"):
        asked = plan(part, rig, rehearsed=True, turns=1, speed=40, exposure=proved).dose
    assert asked is not None and asked.asked and asked.lit == 1.0 and not asked.whole
    for speed in (30, None):
        slower = plan(part, rig, speed=speed, rehearsed=True, exposure=proved)
        assert slower.dose is not None and slower.dose.turns == 1 and slower.dose.keeps
        assert float(slower.schedule.speed) <= 33, "of its own accord, a rig turns as slowly as the dose needs"


def test_whole_turns_that_come_close_are_not_dimmed(part: Path, proof: Proof) -> None:
    proved = ProvedDose.of(proof)
    on = plan(part, read_rig("emulated"), turns=1, exposure=False).schedule.on
    for turns in (1, 3):
        known = replace(proved, seconds=turns * float(on.sum()) * 1e-9 * 1.0005)
        made = plan(part, read_rig("emulated"), exposure=known)
        assert made.dose is not None and made.dose.lit == 1.0 and (made.schedule.on == on[0]).all()
        assert made.dose.turns == turns and made.dose.share == pytest.approx(1 / 1.0005, rel=1e-4)
    shorter = replace(proved, seconds=36 / 266 / 3)
    with pytest.raises(BadInput, match=r"1 turn the dose is 3\.00.*be shorter, so set power = 0\.333 in .light"):
        plan(part, read_rig("emulated"), exposure=shorter)
    lower = plan(part, read_rig("emulated", ["light.power=0.333"]), exposure=shorter).dose
    assert lower is not None and lower.share == pytest.approx(1.0, rel=5e-3)


def test_what_no_proof_knows_wants_turns(part: Path, proof: Proof, job: Path) -> None:
    rig = read_rig("emulated")
    with pytest.raises(BadInput, match=r"has no \[print\].*give --turns"):
        plan(job, rig)
    assert plan(job, rig, turns=2).dose is None
    assert dict(plan(job, rig, turns=2).lines())["dose"].startswith("not known")
    with pytest.raises(BadInput, match="2 projectors share the dose"):
        plan((part, part), rig)
    with pytest.raises(BadInput, match="dose was left out"):
        plan(part, rig, exposure=False)
    years = replace(ProvedDose.of(proof), seconds=1e12)
    with pytest.raises(BadInput, match=r"exposure takes 1e\+12 s of full light; expected at most 10000000 frames"):
        plan(part, rig, exposure=years)


def test_oxygen_is_known_for_the_turns_of_its_job_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    oxygen = '[resin]\nkinetics = "oxygen"\n[resin.oxygen]\ndiffusivity = "1e-3 mm2/s"\nturns = 5\nperiod = "9 s"\n'
    monkeypatch.setitem(globals(), "PART", PART + oxygen)
    job, rig = solved(tmp_path), read_rig("emulated")
    cases: list[tuple[int | None, float | None, str]] = [
        (None, None, "no --turns"), (3, 40, "3 turns of 9 s"), (5, 30, "5 turns of 12 s"),
    ]  # fmt: skip
    for turns, speed, seen in cases:
        with pytest.raises(BadInput, match=f"5 turns of 9 s, and this print has {seen}.*--turns 5 --speed 40.*again"):
            plan(job, rig, turns=turns, speed=speed)
    assert plan(job, rig, turns=3, speed=40, exposure=False).dose is None
    found = plan(job, rig, turns=5, speed=40)
    assert found.dose is not None and found.dose.turns == 5 and found.proven is not None
    times = found.proven.proof.exposure
    assert times is not None and (times.seconds, times.turning) == (45.0, "5 turns of 9 s")


def test_the_latitude_is_that_of_the_verdict_and_none_where_it_does_not_print(proof: Proof) -> None:
    least, most = proof.verdict.latitude
    known = ProvedDose.of(proof)
    assert proof.verdict.prints and known.right and (known.least, known.most) == (least, most)
    assert least < 1.0 < most
    dim = replace(proof, scores=replace(proof.scores, threshold=1.01 * proof.scores.threshold / least))
    bad = ProvedDose.of(dim)
    assert not bad.right and (bad.least, bad.most) == (0.99, 1.01)
    assert not known.faults and bad.faults and f"Does not print: {bad.faults}." == dim.verdict.sentence


def test_a_part_that_does_not_print_is_printed_only_on_purpose(
    part: Path, proof: Proof, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = replace(ProvedDose.of(proof), right=False, faults="1 hole of the part is closed")
    planned = {right: plan(part, read_rig("emulated"), exposure=replace(bad, right=right)) for right in (False, True)}
    shown = {right: dict(made.lines()) for right, made in planned.items()}
    assert shown[False]["proof"] == "does not print: 1 hole of the part is closed" and "proof" not in shown[True]
    prints: list[Any] = []
    asked: list[str] = []
    monkeypatch.setattr("vamgpu.cli.print._printed", lambda *given: prints.append(given) or 0)

    def status(*words: str, answer: str | None = None, right: bool = False, emulated: bool = False) -> int:
        made = replace(planned[right], rehearsed=emulated)
        monkeypatch.setattr("vamgpu.hosts.rig.plan", lambda *_, **__: made)
        monkeypatch.setattr("sys.stdin", SimpleNamespace(isatty=lambda: answer is not None))
        monkeypatch.setattr("builtins.input", lambda text: asked.append(text) or answer)
        return main(["print", str(part), "--rig", "emulated", "--out", str(tmp_path / "run"), *words])

    assert status() == status(answer="n") == 1 and not prints, "nobody agreed"
    said = capsys.readouterr().err
    assert "does not print in the simulation: 1 hole of the part is closed" in said and f"vam prove {part}" in said
    assert status(answer="y") == 0 and len(prints) == 1 and len(asked) == 2
    assert "1 hole of the part is closed" in asked[0] and "[y/N]" in asked[0]
    assert status("--anyway") == status(right=True) == status(emulated=True) == 0
    assert len(prints) == 4 and len(asked) == 2, "only a real print of a part that fails asks"


def test_a_job_without_an_exposure_is_proved_before_a_real_print(
    part: Path, job: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    prints: list[Any] = []
    monkeypatch.setattr("vamgpu.hosts.rigs.planning.proved", lambda *_: "it has no [print]")
    monkeypatch.setattr("vamgpu.cli.print._printed", lambda *given: prints.append(given) or 0)
    monkeypatch.setattr("sys.stdin", SimpleNamespace(isatty=lambda: False))
    file = tmp_path / "pi.toml"
    file.write_text(PI)

    def status(folder: Path, *words: str) -> int:
        return main(["print", str(folder), "--rig", str(file), "--turns", "1", "--out", str(tmp_path / "run"), *words])

    assert status(part) == status(job) == 0 and len(prints) == 2, "it prints; frames without a part have no proof"
    verdict = SimpleNamespace(faults=(Fault("1 hole of the part is closed", "use finer voxels"),))
    wrong = SimpleNamespace(proof=SimpleNamespace(verdict=verdict))
    monkeypatch.setattr("vamgpu.hosts.rigs.planning.prove", lambda path: wrong)
    assert status(part) == 1 and len(prints) == 2
    assert f"{str(part)!r} does not print in the simulation: 1 hole of the part is closed; " in capsys.readouterr().err
    assert status(part, "--anyway") == 0 and len(prints) == 3


def test_a_run_keeps_its_dose_and_the_rest_gets_the_same_light(part: Path, proof: Proof, tmp_path: Path) -> None:
    run, made = tmp_path / "run", plan(part, read_rig("emulated"), exposure=ProvedDose.of(proof))
    assert made.dose is not None and carry_out(made, rehearsal(made).machines, run)[0] is PrintState.COMPLETE
    with pytest.raises(BadInput, match="is complete; only interrupted prints"):
        may_go_on(made, run)
    assert begun(run, None) == (None, made.dose.proved) and begun(run, 3) == (3, made.dose.proved)
    with pytest.raises(BadInput, match="another print, with views"):
        may_go_on(plan(part, read_rig("emulated"), turns=made.dose.turns, exposure=made.dose.proved), run)
    asked = json.loads((run / "run.json").read_text())
    assert GivenDose.read(asked["dose"]) == made.dose
    for wrong in ({"share": -1}, {"proved": None}, {"proved": {"seconds": 1}}):
        (run / "run.json").write_text(json.dumps(asked | {"dose": asked["dose"] | wrong}))
        with pytest.raises(StorageError, match="malformed"):
            prove_run(run, "cpu")
