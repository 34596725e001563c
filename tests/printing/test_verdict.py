"""The verdict on a print, against a dose of its own and against faults that are made."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rich.console import Console
from scipy.ndimage import binary_dilation, binary_erosion, generate_binary_structure, label
from scipy.special import erf

import vamgpu as vam
from vamgpu.backend import open_device
from vamgpu.cli.show import show_verdict
from vamgpu.geometry import centers
from vamgpu.methods.certificate import Bound
from vamgpu.methods.surface import SurfaceRamp
from vamgpu.metrics.body_changes import BodyChanges
from vamgpu.printing import judgement as judging
from vamgpu.printing.causes import BOUNDED, CONVERGED, EVALUATIONS, NARROW, THIN
from vamgpu.printing.given_dose import GivenDose, ProvedDose
from vamgpu.printing.judgement import Judgement
from vamgpu.printing.proof import Proof
from vamgpu.printing.verdict import Verdict, verdict_of

PITCH, N, NZ, ANGLES = 0.1, 40, 16, 60
GRID, BEAM, TURN = vam.Grid((N, N, NZ), PITCH), vam.Beam((56, NZ), PITCH), vam.Turntable(ANGLES)
PARTS = ("ring", "two", "thin")


def solid(name: str, finer: int = 1) -> np.ndarray:
    """A thick ring, two blocks that stand 0.6 mm apart, or a block beside a wall of one voxel; [x, y, z]."""
    pitch = PITCH / finer
    x, y, z = (pitch * (np.arange(n * finer) - 0.5 * (n * finer - 1)) for n in (N, N, NZ))
    x, y, z = x[:, None, None], y[None, :, None], z[None, None, :]
    r, tall = np.hypot(x, y), np.abs(z) < 0.5
    return (
        tall
        & {
            "ring": (r < 1.6) & (r > 0.7),
            "two": (np.abs(np.abs(x) - 0.8) < 0.5) & (np.abs(y) < 0.7),
            "thin": (np.abs(y) < 0.8) & ((np.abs(x + 0.5) < 0.5) | (np.abs(x - 0.95) < 0.05)),
        }[name]
    )


@cache
def plan(name: str, method: str) -> Any:
    A = vam.Projection(GRID, BEAM, TURN, None, open_device())
    target = solid(name).astype(np.float32)
    if method == "fbp":
        return vam.optimize(A, target, "fbp"), target
    return vam.optimize(A, target, method, iterations=40), target


LAMP: dict[str, Any] = {"irradiance": 5.0, "critical_dose": 1.0, "absorption": 0.1}


@cache
def proved(name: str, method: str) -> Proof:
    found, target = plan(name, method)
    return vam.simulate(found.operator, vam.pack(found), target, **LAMP)


def own_dose(light: np.ndarray, finer: int = 2, places: int = 5) -> np.ndarray:
    """Dose of light in air on finer voxels, each frame at some places of its arc, by the profile of each pixel."""
    n, width, sigma = finer * N, PITCH / finer, BEAM.sigma * PITCH
    x = width * (np.arange(n) - 0.5 * (n - 1))
    edges = lambda count, at: (at[:, None] - PITCH * (np.arange(count + 1) - 0.5 * count)) / (np.sqrt(2.0) * sigma)  # noqa: E731
    z = width * (np.arange(finer * NZ) - 0.5 * (finer * NZ - 1))
    rows = -0.5 * np.diff(erf(edges(NZ, z)), axis=1)
    dose, step = np.zeros((n * n, z.size)), 2.0 * np.pi / ANGLES
    bins = np.arange(-0.75 * N * PITCH, 0.75 * N * PITCH, PITCH / 40)
    columns = -0.5 * np.diff(erf(edges(BEAM.pixels[0], bins)), axis=1)
    for number, frame in enumerate(light):
        lit = columns @ (frame @ rows.T)
        for k in range(places):
            angle = TURN.poses[number] + step * ((k + 0.5) / places - 0.5)
            r = (x[None, :] * np.cos(angle) - x[:, None] * np.sin(angle)).ravel()
            place = (r - bins[0]) * 40 / PITCH
            low = place.astype(int)
            beyond = (place - low)[:, None] / places
            dose += (1 / places - beyond) * lit[low] + beyond * lit[low + 1]
    return dose.reshape(n, n, -1)


def own_verdict(name: str, dose: np.ndarray, threshold: float) -> dict[str, bool]:
    """What is right, on voxels half as wide: number of bodies, and all that lies two pixels from the surface."""
    part = solid(name, 2)
    whole = generate_binary_structure(3, 3)
    printed = dose >= threshold
    inner, outer = (
        np.asarray(each, bool) for each in (binary_erosion(part, whole, 4), binary_dilation(part, whole, 4))
    )
    n = len(dose)
    x = np.arange(n) - 0.5 * (n - 1)
    middle = x[:, None] ** 2 + x**2 <= 0.25 * n**2
    wrong = (inner & ~printed) | (~outer & printed & middle[:, :, None])
    bodies: list[Any] = [label(each) for each in (printed, part)]
    return {"bodies": bodies[0][1] == bodies[1][1], "deep": not wrong.any()}


@pytest.mark.parametrize(("name", "method"), [
    ("ring", "ramp"), ("two", "fbp"),
    *(pytest.param(*case, marks=pytest.mark.slow)
      for case in (("two", "ramp"), ("thin", "ramp"), ("ring", "fbp"), ("thin", "fbp"))),
    *(pytest.param(name, "osmo", marks=pytest.mark.slow) for name in PARTS),
])  # fmt: skip
def test_it_agrees_with_a_dose_of_its_own(name: str, method: str) -> None:
    proof, disc = proved(name, method), GRID.cylinder()
    dose = own_dose(proof.frames.irradiance(proof.operator.device).numpy())
    scale = dose.reshape(N, 2, N, 2, NZ, 2).mean(axis=(1, 3, 5))[disc].mean() / proof.dose.numpy()[disc].mean()
    wanted, changes = own_verdict(name, dose, scale * proof.scores.threshold), proof.judgement.surface.changes
    same = not (changes.bodies_lost or changes.bodies_merged or changes.bodies_broken or changes.bodies_extra)
    assert same == wanted["bodies"], changes
    deep = [fault for fault in proof.verdict.faults if "from the surface prints incorrectly" in fault.said]
    assert (not deep) == wanted["deep"], proof.verdict
    if not all(wanted.values()):
        assert not proof.verdict and not proof.all_correct and proof.verdict.remedies


def test_light_that_prints_is_told_with_its_latitude_and_time() -> None:
    proof = proved("ring", "ramp")
    verdict, found, deep = proof.verdict, proof.judgement.over_tolerance, proof.judgement.deep
    assert verdict and proof.all_correct and deep == pytest.approx(2 * PITCH, rel=1e-6)
    low, high = verdict.latitude
    for exposure, right in ((0.99 * low, False), (1.01 * low, True), (0.99 * high, True), (1.01 * high, False)):
        at = proof.scores.threshold / exposure
        least, greatest = found.limits(deep)
        assert (least >= at > max(greatest, proof.outer.dose if proof.outer else 0.0)) == right
    times = proof.exposure
    assert times is not None
    assert str(verdict).startswith("Prints: 1 body and 1 hole as in the part, 95 % of the surface within ")
    assert str(verdict).endswith(f"{times.seconds:.3g} s, {times.seconds / 9:.3g} turns at 40 deg/s.")


def test_a_part_thinner_than_four_pixels_bears_as_much_less_as_the_middle_of_its_walls() -> None:
    n = np.hypot(*np.meshgrid(np.arange(N) - 19.5, np.arange(N) - 19.5))
    tube = np.repeat(((n > 11.0) & (n < 14.0))[:, :, None], NZ, 2).astype(np.float32)
    tube[:, :, [0, 1, 2, -3, -2, -1]] = 0.0
    A = vam.Projection(GRID, BEAM, TURN, None, open_device())
    light = vam.optimize(A, tube, "ramp", iterations=20)
    proof = vam.simulate(A, vam.pack(light), tube, irradiance=5.0, critical_dose=1.0, absorption=0.1)
    low, found = proof.verdict.latitude[0], proof.judgement.over_tolerance
    assert proof.verdict and found.judged_at(proof.judgement.deep) == 0.0
    middle = proof.dose.numpy()[np.abs(n - 12.5) < 0.5][:, 3:-3]
    assert low == pytest.approx(proof.scores.threshold / np.quantile(middle, 0.05), abs=0.02) and low < 0.95
    known = ProvedDose.of(proof)
    assert known.least == low and not GivenDose(known, 0.9 * low, 1, 9.0).keeps
    over = verdict_of(replace(proof, scores=replace(proof.scores, threshold=0.3 * proof.scores.threshold)),
                      proof.judgement)  # fmt: skip
    assert not over and not [remedy for remedy in over.remedies if "expose 0 " in remedy]
    dim = verdict_of(replace(proof, scores=replace(proof.scores, threshold=1.1 * middle.max())), proof.judgement)
    assert dim.latitude[0] >= 1.0 and "prints incorrectly" not in dim.sentence  # nothing of it lies two pixels deep


def test_a_gap_of_four_pixels_bears_as_much_more_as_its_middle() -> None:
    x = np.abs(np.arange(N) - 19.5)
    part = np.zeros(GRID.shape, np.float32)
    part[np.ix_((x > 1.6) & (x < 9.0), x < 9.0, np.arange(4, NZ - 4))] = 1.0
    A = vam.Projection(GRID, BEAM, TURN, None, open_device())
    plan = vam.optimize(A, part, SurfaceRamp(steepest=1), iterations=40)
    proof = vam.simulate(A, vam.pack(plan), part, absorption=0.1)
    high, (_, far) = proof.verdict.latitude[1], proof.judgement.over_tolerance.limits(proof.judgement.deep)
    fine = np.concatenate([np.asarray(slab.dose) for slab in proof.fine(GRID.inscribed_radius)], axis=2)
    bridge = fine[N - 4 : N + 4, 22:-22, 8:-8].min(axis=0).max()  # the darkest voxel on the brightest line across
    assert proof.verdict and far < 0.9 * bridge, "nothing that is two pixels from the surface says so"
    assert high == pytest.approx(proof.scores.threshold / bridge, abs=0.015) and high > 1.05


def changed(proof: Proof, **changes: int) -> Judgement:
    """The judgement of a proof, but for bodies."""
    return with_surface(proof.judgement, changes=replace(proof.judgement.surface.changes, **changes))


def with_surface(judgement: Judgement, **changes: Any) -> Judgement:
    surface = replace(judgement.surface, **changes)
    return replace(judgement, compared=lambda: surface)


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("bodies_lost", "2 bodies of the part do not print"), ("bodies_merged", "2 bodies join another one"),
        ("bodies_broken", "2 bodies are broken"), ("bodies_extra", "2 loose bodies print beside the part"),
        ("holes_closed", "2 holes of the part are closed"), ("holes_opened", "2 holes open that are not in the part"),
        ("cavities_filled", "2 cavities are filled"), ("cavities_extra", "2 voids are left in the part"),
    ],
)  # fmt: skip
def test_every_change_of_bodies_is_a_fault(kind: str, said: str) -> None:
    proof = proved("ring", "ramp")
    assert kind in BodyChanges.__annotations__
    verdict = verdict_of(proof, changed(proof, **{kind: 2}))
    assert not verdict and verdict.sentence == f"Does not print: {said}." and len(verdict.remedies) == 1
    assert verdict_of(proof, changed(proof, **{kind: 1})).sentence.startswith("Does not print: 1 ")


def test_what_else_is_wrong_is_said_with_its_remedy() -> None:
    proof = proved("ring", "ramp")
    scores, judgement = proof.scores, proof.judgement
    assert proof.outer is not None
    flooded = replace(proof, outer=replace(proof.outer, dose=1.2 * scores.threshold))
    assert "1.20 of the threshold" in verdict_of(flooded, judgement).sentence
    assert verdict_of(flooded, judgement).latitude[1] == pytest.approx(1 / 1.2, rel=1e-3)
    dim = verdict_of(replace(proof, scores=replace(scores, threshold=1.3 * scores.threshold)), judgement)
    assert "more than 200 µm from the surface prints incorrectly" in dim.sentence
    low, high = dim.latitude
    assert f"expose {np.sqrt(low * high):.3g} times as long" in dim.remedies and 1.0 < low < high
    wrong = with_surface(judgement, thresholds=None)
    assert verdict_of(proof, wrong).latitude == (np.inf, 0.0), "not measured where a body is wrong"
    rough = with_surface(judgement, distances=np.full(20, 1.1 * judgement.pixel))
    assert "5 % of the surface deviates by more than 110 µm" in verdict_of(proof, rough).sentence
    empty = with_surface(judgement, distances=np.zeros(0))
    assert verdict_of(flooded, empty).sentence.startswith("Does not print: nothing prints; resin beyond")
    spiked = proof.target.numpy().copy()
    spiked[30:34, 30:34, 1] = 0.4
    thin = verdict_of(replace(proof, target=proof.target.device.upload(spiked)), judgement)
    assert "not fill half of any 100 µm voxel" in thin.sentence and "thicker walls" in str(thin)


def test_a_coarse_verdict_is_that_of_the_proof_and_says_that_nothing_is_proved() -> None:
    for name, method in (("ring", "ramp"), ("two", "fbp")):
        found, target = plan(name, method)
        coarse = vam.simulate(found.operator, vam.pack(found), target, coarse=True)
        assert coarse.operator.grid.pitch <= PITCH and not coarse.independent and not coarse.all_correct
        assert coarse.verdict.prints == proved(name, method).verdict.prints, coarse.verdict
        assert "according to the solver's own dose" in coarse.verdict.opening


def test_a_coarse_verdict_knows_resin_beyond_the_grid() -> None:
    found, target = plan("ring", "ramp")
    light = found.sinogram.numpy().copy()
    light[:, :6] = light.max()
    frames = vam.pack(replace(found, sinogram=found.operator.device.upload(light)))
    coarse = vam.simulate(found.operator, frames, target, coarse=True)
    assert coarse.outer is not None and coarse.outer.distance > GRID.inscribed_radius
    assert coarse.outer_share >= 1.0 and "resin beyond the judged cylinder also prints" in coarse.verdict.sentence


def test_a_remedy_follows_from_a_cause_that_was_checked() -> None:
    """A wall of one pixel is thin and a gap of one is narrow; all else is light, which has few angles or few steps."""
    thick, thin = proved("ring", "ramp"), proved("thin", "fbp")
    for kind in BodyChanges.__annotations__:
        if kind.startswith(("bodies_", "holes_", "cavities_")):
            assert verdict_of(thick, changed(thick, **{kind: 1})).remedies == (EVALUATIONS,)
    one, two = (verdict_of(thin, only(thin, bodies_lost=n)).faults for n in (1, 2))
    assert one[0].remedy == THIN and two[0].remedy == f"{EVALUATIONS}; {THIN}"
    slit = np.zeros((N, N, NZ), bool)
    slit[16:26, 14:26, 3:13], slit[20] = True, False
    narrow = replace(thick, target=thick.target.device.upload(slit.astype(np.float32)))
    assert verdict_of(narrow, changed(thick, bodies_merged=1)).faults[0].remedy == NARROW
    A = vam.Projection(GRID, BEAM, vam.Turntable(20), None, open_device())
    few = verdict_of(replace(thick, operator=A), changed(thick, cavities_extra=1))
    assert few.remedies == ("use 60 angles", EVALUATIONS)
    one_bit: Any = replace(thick, frames=SimpleNamespace(bits=1))  # type: ignore[arg-type]
    assert verdict_of(one_bit, changed(thick, bodies_extra=1)).remedies == ("use 8-bit frames", EVALUATIONS)
    window = thick.claimed.window
    for most, remedy in ((1.01 * window, BOUNDED), (1.2 * window, EVALUATIONS)):
        bounded = replace(thick, bound=Bound(most, thick.dose, 1.0))
        assert verdict_of(bounded, changed(thick, bodies_extra=1)).remedies == (remedy,)
    for last, remedy in ((0.2, EVALUATIONS), (0.499, CONVERGED)):
        run = replace(thick, history=[{"loss": loss} for loss in (1.0, 0.7, 0.5, last)])
        assert verdict_of(run, changed(thick, bodies_extra=1)).remedies == (remedy,)


def only(proof: Proof, **changes: int) -> Judgement:
    """The judgement of a proof with no changes of bodies but these."""
    none = {kind: 0 for kind in BodyChanges.__annotations__ if "_" in kind}
    return changed(proof, **{**none, **changes})


@pytest.mark.parametrize("shape", [(20, 20, 8), (21, 23, 9)])
def test_a_coarse_verdict_on_wide_voxels_exposes_as_the_proof_does(shape: tuple[int, int, int]) -> None:
    """Voxels of two pixels: the exposure is that of the part's own voxels, coarse or proved."""
    grid = vam.Grid(shape, 2 * PITCH)
    x, y, z = (axis[tuple(None if k != at else slice(None) for k in range(3))] for at, axis in enumerate(grid.axes()))
    target = ((np.hypot(x, y) < 1.45) & (np.hypot(x, y) > 0.55) & (np.abs(z) < 0.5)).astype(np.float32)
    A = vam.Projection(grid, BEAM, TURN, None, open_device())
    frames = vam.pack(vam.optimize(A, target, "fbp"))
    coarse, proof = (vam.simulate(A, frames, target, coarse=coarse, **LAMP) for coarse in (True, False))
    assert coarse.operator.grid.pitch < PITCH and proof.operator.grid.pitch == 2 * PITCH
    assert coarse.exposure is not None and proof.exposure is not None
    assert coarse.exposure.seconds == pytest.approx(proof.exposure.seconds, rel=0.01)
    given = vam.simulate(A, frames, target, coarse=True, threshold=1.1 * proof.scores.threshold, **LAMP)
    assert given.exposure is not None
    assert given.exposure.seconds == pytest.approx(proof.exposure.seconds / 1.1, rel=1e-6)


def test_a_dose_on_finer_voxels_is_where_it_was() -> None:
    """A linear dose on axes that round unlike stays linear up to half a voxel from the ends."""
    shape, pitch, width = (5, 6, 7), 0.3, 0.2
    old = [centers(size, pitch) for size in shape]
    dose = old[0][:, None, None] + 2.0 * old[1][:, None] + 3.0 * old[2]
    found, voxel = judging.refined(dose, pitch, width)
    assert found.shape == (8, 9, 11) and voxel == width
    new = [np.clip(centers(size, width), axis[0], axis[-1]) for size, axis in zip(found.shape, old, strict=True)]
    np.testing.assert_allclose(found, new[0][:, None, None] + 2.0 * new[1][:, None] + 3.0 * new[2], atol=1e-6)


def test_a_surface_on_the_parts_own_voxels_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    proof = replace(proved("ring", "ramp"))
    assert "not computed yet: read .verdict" in proof._repr_html_()
    assert not proof.verdict.not_judged and proof.verdict.sentence in proof._repr_html_()
    monkeypatch.setattr(judging, "WHOLE", 1000)
    told = replace(proof).verdict
    assert told.prints and "\nNot judged: the surface at a finer scale than the part's voxels" in str(told)


def test_the_judge_of_the_records_compares_pieces_one_for_one() -> None:
    """As many bodies do not do where they are others; a void that moved is another one, too."""
    verdicts = pytest.importorskip("profiling.verdicts", exc_type=ImportError)
    part, judged = np.zeros((20, 20, 20), bool), np.ones((20, 20, 20), bool)
    part[2:6, 2:18, 2:18] = part[10:16, 2:18, 2:18] = True
    part[12, 8:11, 8:11] = False
    other = part.copy()
    other[2:6], other[18] = False, True
    moved = part.copy()
    moved[12, 8:11, 8:11], moved[14, 8:11, 8:11] = True, False
    bridge, thinner = part.copy(), part & np.roll(part, 1, 1)
    bridge[6:10, 5, 5] = True
    bodies = np.where(np.arange(20)[:, None, None] < 8, 1, 2) * part
    assert verdicts.same_pieces(thinner, bodies, judged)
    assert not any(verdicts.same_pieces(one, bodies, judged) for one in (other, moved, bridge))
    assert verdicts.same_pieces(bridge, part.astype(int), judged)  # one body of the mesh, which voxels broke
    judged[:, :, 10:] = False  # its end cuts a hole, which is a void only where the mouth prints closed
    hole, closed = (np.zeros((20, 20, 20), int) for _ in range(2))
    hole[2:18, 2:18, :10] = closed[2:18, 2:18, :10] = 1
    hole[8:12, 8:12, 4:] = 0
    closed[8:12, 8:12, 4:9] = 0
    assert verdicts.same_pieces(hole > 0, hole, judged) and not verdicts.same_pieces(closed > 0, hole, judged)


def test_the_terminal_says_what_was_not_judged(capsys: pytest.CaptureFixture[str]) -> None:
    verdict = Verdict((), "1 body", (0.9, 1.1), True, ("other exposures",))
    show_verdict(Console(), verdict)
    assert "not judged: other exposures" in capsys.readouterr().out
