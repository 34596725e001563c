"""Images that do not agree with the light that was shown are not used."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from small_print import PLANNED, overlap, printer, setup

from vamgpu.live import Decision
from vamgpu.live.estimate import alike
from vamgpu.live.printer import CuringResin, Truth, VirtualPrinter
from vamgpu.live.prior import NAMES
from vamgpu.live.record import LiveRecord
from vamgpu.live.report import page
from vamgpu.live.trust import Trust, darkening, mean_level, share_of, some
from vamgpu.reports import chart

OLD = Truth(inhibitor=0.7)
TURNS = (1, PLANNED, PLANNED + 1)
"""Numbers of turns whose images are lost."""
SEEN = 8
"""Turns after which resin has cured in any of the prints of the test of deviations."""
Images = Callable[[np.ndarray], np.ndarray]


def watched(seen: Images) -> tuple[list[Decision], float]:
    """The decisions of a print in used resin, by images that ``seen`` makes of the true ones, and its overlap."""
    made, part, light = setup()
    loop, live = made.loop(part, light), printer(OLD)
    state, decisions = loop.start(), list[Decision]()
    while not decisions or (decisions[-1].action != "stop" and live.turns < 2 * PLANNED):
        live.turn(live.dose(np.asarray(state.light)))
        state, decision = loop.decide(state, seen(live.through()))
        decisions.append(decision)
    return decisions, overlap(live.printed())


@cache
def unwatched() -> float:
    _, _, light = setup()
    live = printer(OLD)
    dose = live.dose(light)
    for _ in range(PLANNED):
        live.turn(dose)
    return overlap(live.printed())


@pytest.mark.parametrize(
    ("seen", "why"),
    [
        pytest.param(
            lambda images: np.rint(1.19 * images), "open field", id="another open field", marks=pytest.mark.slow
        ),
        pytest.param(lambda images: np.roll(images, 5, axis=2), "place of the camera", id="beside the axis"),
    ],
)
def test_a_print_goes_on_by_its_plan_where_images_are_wrong(seen: Images, why: str) -> None:
    decisions, found = watched(seen)
    last, (_, _, light) = decisions[-1], setup()
    assert why in last.doubt and last.doubt in last.reason and last.entry["doubt"] == last.doubt
    assert len(decisions) <= PLANNED and last.iou == 0.0 and not last.parameters
    assert all(np.array_equal(each.light, light) for each in decisions if each.doubt)
    beyond = [each.turn for each in decisions if any(value > limit for value, limit in each.checks.values())]
    assert beyond == [each.turn for each in decisions if each.doubt][:1], "what was checked tells why"
    assert found > 0.97 > unwatched()


def test_images_as_described_decide_to_the_end() -> None:
    decisions, found = watched(lambda images: images)
    assert not any(each.doubt for each in decisions) and any(each.action == "swap" for each in decisions)
    assert found > 0.98 and all(each.misfit < Trust().misfit for each in decisions)
    assert all(each.checks["images"][0] == each.misfit for each in decisions)
    estimated = [each.checks for each in decisions if each.parameters]
    assert estimated and all(0 < value < limit for checks in estimated for value, limit in checks.values())


@pytest.mark.slow
def test_a_camera_that_repeats_its_images_decides_no_more() -> None:
    kept: list[np.ndarray] = []

    def frozen(images: np.ndarray) -> np.ndarray:
        kept.append(images)
        return kept[min(len(kept), 3) - 1]

    decisions, _ = watched(frozen)
    assert [each.turn for each in decisions if "repeats" in each.doubt][0] == 4
    assert len(decisions) == PLANNED, "the plan's dose is the most that is given"


def test_conversion_that_the_light_does_not_explain_is_doubted() -> None:
    found: Any = SimpleNamespace(unexplained=0.5)
    assert "50 %" in Trust().of_estimate(found) and not Trust(conversion=0.6).of_estimate(found)
    made, part, light = setup()
    loop, live = made.loop(part, light), printer(OLD)
    loop = replace(loop, trust=Trust(conversion=1e-6))
    state = loop.start()
    for _ in range(PLANNED):
        live.turn(live.dose(np.asarray(state.light)))
        state, decision = loop.decide(state, live.through())
        if decision.doubt:
            break
    assert decision.checks["conversion"][0] > 1e-6 == decision.checks["conversion"][1]
    assert "does not explain" in decision.doubt and np.array_equal(decision.light, light)


def test_a_claim_carries_the_errors_of_gel_point_and_turbidity() -> None:
    made, part, light = setup()
    live, seen, claims = printer(Truth()), [], []
    dose = live.dose(light)
    for _ in range(PLANNED):
        live.turn(dose)
        seen.append(live.through())
    for error, turbid in ((0.0, 0.0), (0.15, 0.0), (0.15, 0.1), (0.2, 0.0)):
        resin, turbidity = replace(made.resin, gel_error=error), replace(made.turbidity, error=turbid)
        told = replace(made, resin=resin, turbidity=turbidity, every=PLANNED)
        loop = told.loop(part, light)
        state, decision = loop.start(), None
        for images in seen:
            state, decision = loop.decide(state, images)
        assert decision is not None and decision.parameters
        claims.append(decision.iou)
    assert claims[0] > claims[1] > claims[2] > claims[3] > 0.2, "0.15 and 0.1 are 0.18 together"
    low, high = CuringResin().solid_doses
    gel = CuringResin().gel
    assert CuringResin().conversion(low) == pytest.approx(0.9 * gel) and low < CuringResin().solid < high


def test_few_images_tell_the_mean() -> None:
    images = np.random.default_rng(1).uniform(200.0, 800.0, (360, 4, 6))
    assert 32 <= len(some(images)) <= 64 and len(some(images[:20])) == 20
    level = mean_level(images, images.shape)
    assert level is not None and np.allclose(level, np.log(images).mean(axis=0), atol=0.2)


def test_an_estimate_tells_what_it_leaves_unexplained() -> None:
    made, part, light = setup()
    loop, live = made.loop(part, light), printer(Truth())
    for _ in range(PLANNED):
        live.turn(live.dose(light))
    told = loop.tomograph.measure(live.through())
    seen = loop.tomograph.see(told, iterations=30)
    A = loop.estimator.operator
    shown = A.device.field((PLANNED * light).astype(np.float32))
    right = loop.estimator.estimate(shown, seen.conversion, 0.1, loop.prior)
    wrong = loop.estimator.estimate(shown, np.roll(seen.conversion, 2, axis=0), 0.1, loop.prior)
    assert right.unexplained < 0.1 < Trust().conversion < wrong.unexplained


def test_a_share_of_darkening_knows_neither_gain_nor_orientation() -> None:
    random = np.random.default_rng(3)
    wanted = np.pad(random.random((12, 20)), 6) ** 2
    clear = np.exp(5.0 + 0.1 * random.random((4, 24, 32)))
    images = clear * np.exp(-0.6 * wanted)

    def share(clear: np.ndarray, images: np.ndarray) -> float:
        before, after = mean_level(clear, clear.shape), mean_level(images, clear.shape)
        assert before is not None and after is not None
        return share_of(darkening(before - after), darkening(wanted))

    assert share(clear, images) == pytest.approx(0.6, rel=1e-6)
    assert share(clear, 1.2 * images) == pytest.approx(0.6, rel=1e-6)
    assert share(clear[:, ::-1], images[:, ::-1]) == pytest.approx(0.6, rel=1e-6)
    assert share(clear[:, :, ::-1], images[:, :, ::-1]) == pytest.approx(0.6, rel=1e-6)
    bubble = images.copy()
    bubble[:, 8:11, 8:12] *= 0.3
    assert share(clear, bubble) == pytest.approx(0.6, rel=0.1)


@pytest.mark.parametrize(("shares", "cured"), [
    ((0.05, 0.05, 0.05, 0.55), 0.5), ((0.05, 0.09, 0.3, 0.55), 0.55), ((0.01, 0.02, 0.03, 0.53), 0.5),
    ((0.3, 0.31, 0.31, 0.55), 0.55),
])  # fmt: skip
def test_what_stays_as_dark_as_it_came_before_anything_cured_is_no_cure(
    shares: tuple[float, ...], cured: float
) -> None:
    """A bubble stays, and a camera may drift a little; resin that cures darkens on, and may pause later."""
    made, part, light = setup()
    loop = made.loop(part, light)
    state, depth = loop.start(), loop._darkening.depth
    clear = np.random.default_rng(2).uniform(500.0, 800.0, depth.shape)
    for share in (0.0, *shares):
        at = loop._after(state, np.broadcast_to(clear * np.exp(-share * depth), made.camera().shape))
        state = replace(state, clear=at.state.clear, level=at.state.level)
    assert at.cured == pytest.approx(cured, abs=0.01)


def test_lost_frames_do_not_count_in_a_level() -> None:
    images = np.full((3, 2, 2), 100.0)
    images[1] = np.nan
    level = mean_level(images, (3, 2, 2))
    assert level is not None and np.allclose(level, np.log(100.0))
    assert mean_level(np.full_like(images, np.nan), (3, 2, 2)) is None and mean_level(images, (3, 2, 3)) is None


@pytest.mark.slow
@pytest.mark.parametrize("lost", TURNS)
def test_a_lost_turn_costs_one_decision_and_no_more(lost: int) -> None:
    """A lamp of 80 % needs three turns more than planned."""
    made, part, light = setup()
    loop, live = made.loop(part, light), printer(Truth(lamp=0.8))
    state, action = loop.start(), "keep"
    while action != "stop":
        live.turn(live.dose(np.asarray(state.light)))
        images = live.through()
        state, decision = loop.decide(state, np.full(images.shape, np.nan) if live.turns == lost else images)
        action = decision.action
        assert (decision.reason[:7] == "refused") == (live.turns == lost) and not decision.doubt
    assert live.turns > PLANNED + 1 and overlap(live.printed()) > 0.98


def test_the_first_turn_s_images_may_be_lost() -> None:
    first = iter([True])

    def seen(images: np.ndarray) -> np.ndarray:
        return np.full(images.shape, np.nan) if next(first, False) else np.rint(1.19 * images)

    decisions, found = watched(seen)
    assert decisions[-1].doubt and len(decisions) < PLANNED and found > 0.97


@pytest.mark.parametrize("shape", [(40, 12, 47), (12, 48)])
def test_images_of_another_shape_are_refused(shape: tuple[int, ...]) -> None:
    made, part, light = setup()
    loop = made.loop(part, light)
    _, decision = loop.decide(loop.start(), np.ones(shape))
    assert decision.reason.startswith("refused: the images have shape")


def test_the_report_says_that_images_were_doubted(tmp_path: Path) -> None:
    made, part, light = setup()
    record = LiveRecord(tmp_path / "part.run" / "live")
    loop, live = record.begin(made, part, light), printer(OLD)
    live.turn(live.dose(light))
    images = np.rint(1.19 * live.through())
    _, decision = loop.decide(loop.start(), images)
    record.add(images, decision)
    text = page(record).html()
    assert "the images were not used" in text and "open field" in text and f"{decision.misfit:.3g} (at most" in text
    shown = re.findall(r"<svg.*?</svg>", text, re.DOTALL)
    assert len(shown) == 1 and chart.WARN in shown[0], "the line is red"
    assert [each["doubt"] for each in record.decided()] == [decision.doubt]
    ((_, differs),) = record.replay()
    assert not differs


@pytest.mark.slow
def test_deviations_are_true_in_forty_prints() -> None:
    """Of the parameters of each print, which differ from the plan's at random, 93 % lie within two deviations."""
    made, _, light = setup()
    unsure = replace(made.turbidity, error=0.15)
    loop = replace(made, every=SEEN, evaluations=1.5, iterations=60, turbidity=unsure).loop(*setup()[1:])
    usual, within = np.sqrt(np.diag(loop.prior.covariance)), []
    for seed in range(40):
        z = np.clip(np.random.default_rng(seed).standard_normal(6), -2.0, 2.0)
        truth = Truth(
            inhibitor=1.0 - 0.15 * abs(z[4]), lamp=1.0 + 0.1 * z[0], absorption=usual[1] * z[1],
            across=usual[2] * z[2] / made.pixel, along_z=0.05 * z[3],
        )  # fmt: skip
        turbidity = replace(unsure, extinction=[(1.0 + unsure.error * z[5]) * each for each in unsure.extinction])
        live = VirtualPrinter(made.projection(made.vial), made.camera(), made.resin, turbidity, truth, seed)
        state, dose = loop.start(), live.dose(light)
        decision = None
        for _ in range(SEEN):
            live.turn(dose)
            state, decision = loop.decide(state, live.through())
        assert decision is not None and decision.parameters and not decision.doubt
        used = made.resin.induction * (1.0 - truth.inhibitor)
        true = (truth.lamp, 1.0 + truth.absorption, truth.across * made.pixel, 0.0, truth.along_z, 0.0, used,
                1.0 + unsure.error * z[5])  # fmt: skip
        found = np.array([decision.parameters[name] for name in (*NAMES, "turbidity")])
        within.append(np.abs(found[:, 0] - true) < 2.0 * found[:, 1])
    assert np.mean(within) >= 0.93 and np.mean(within, axis=0).min() >= 0.85


def test_neighbors_that_err_alike_count_as_one() -> None:
    voxels = np.indices((24, 24, 16)).reshape(3, -1)
    white = np.random.default_rng(5).standard_normal((24, 24, 16))
    smooth = gaussian_filter(white, 1.0)
    assert alike(voxels, white.ravel()) == pytest.approx(1.0, abs=0.5)
    assert 15.0 < alike(voxels, smooth.ravel()) < 50.0, "(4π)^1.5 = 45 in the whole space, fewer in blocks"
