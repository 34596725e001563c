"""Light of the turns that remain: proved by rays that the replanner does not know."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import vamgpu
from vamgpu.errors import BadInput
from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.live import Estimator, Prior, Replanner
from vamgpu.live.border import Border
from vamgpu.losses.response import GeneralizedLogistic
from vamgpu.methods.run import optimize
from vamgpu.metrics import score
from vamgpu.operators.projection import Projection
from vamgpu.optics.vial import Vial
from vamgpu.printing.independent_exposure import IndependentExposure
from vamgpu.printing.scenarios import clouded, displaced

TURNS, SHOWN, NOISE = 6, 3, 0.02


@cache
def setup() -> tuple[Projection, np.ndarray, np.ndarray, Replanner]:
    """Operator, part, light of one turn, and a replanner."""
    grid = Grid((40, 40, 20), 0.1)
    vial = Vial(8.0, 0.5, 1.5, 1.5, 1.0, absorption=0.1)
    A = Projection(grid, Beam((80, 20), 0.1), Turntable(90), vial, device=vamgpu.open_device())
    x, y, z = np.meshgrid(*grid.axes(), indexing="ij")
    r = np.hypot(x, y)
    part = ((r < 1.6) & (r > 0.7) & (np.abs(z) < 0.85) & ~((np.abs(x) < 0.25) & (y > 0))).astype(np.float32)
    light = np.asarray(optimize(A, part, iterations=20).sinogram) / TURNS
    return A, part, light, Replanner(part, most=2.0 * float(light.max()))


def overlap(dose: np.ndarray) -> float:
    A, part, _, _ = setup()
    return float(score(A.device.upload(dose), A.device.upload(part), threshold=0.865).iou)


@pytest.mark.parametrize(("everything", "rings"), [
    *(pytest.param(*case, marks=pytest.mark.slow) for case in ((False, False), (True, False))), (True, True),
])  # fmt: skip
def test_a_print_that_drifts_is_saved(everything: bool, rings: bool) -> None:
    A, _, light, replanner = setup()
    estimator = Estimator(A, GeneralizedLogistic(steepness=8.0, middle=0.7), rings=rings)
    off = displaced(clouded(A, 0.15), 0.5) if everything else A
    gain = estimator.gain(np.array([0.8, 1.0, 0.0, 0.0, 0.05 if everything else 0.0, 0.0, 0.0])).numpy()
    exposure = IndependentExposure(off)

    def proved(images: np.ndarray) -> np.ndarray:
        return np.asarray(exposure.averaged(A.device.upload(images))[0], float) * gain

    delivered = proved(SHOWN * light)
    seen = estimator.conversion(delivered) + NOISE * np.random.default_rng(1).standard_normal(delivered.shape)
    found = estimator.estimate(SHOWN * light, seen, NOISE, Prior.of())
    plan = replanner.replan(
        estimator.nearly(found.values, SHOWN * light, found.lit), found.dose, light, TURNS - SHOWN, range(TURNS),
        evaluations=20, deviation=found.deviation,
    )  # fmt: skip
    assert overlap(delivered + proved((TURNS - SHOWN) * light)) < 0.995
    now = overlap(delivered + proved(plan.expected.turns * np.asarray(plan.light)))
    assert now >= 0.995 and plan.expected.iou == pytest.approx(now, abs=0.005)
    assert plan.kept.iou < 0.995 and plan.evaluations <= 20
    assert np.asarray(plan.light).min() >= 0.0 and np.asarray(plan.light).max() <= replanner.most * (1.0 + 1e-5)


def test_rings_give_the_dose_of_light_that_is_like_what_was_known() -> None:
    A, part, light, _ = setup()
    estimator = Estimator(A, GeneralizedLogistic(steepness=8.0, middle=0.7), rings=True)
    values = np.array([0.8, 1.15, 0.03, 0.02, 0.05, -0.03, 0.1])
    exact = estimator.calibrated(values)
    nearly = estimator.nearly(values, light, np.asarray(exact.T(light)))
    assert estimator.quick is not None and nearly.dot_test() < 1e-6
    rng, wide = np.random.default_rng(0), A.grid.cylinder()[:, :, None]
    for other, off in ((light, 0.004), (light * rng.uniform(0.5, 1.5, (len(light), 1, 1)), 0.008)):
        got, dose = (np.asarray(each.T(other), float) * wide for each in (nearly, exact))
        assert np.sqrt(np.mean((got - dose)[part > 0] ** 2)) < off * dose.max()
    planned = np.asarray(estimator.quick.T(light)) * wide
    assert np.abs(planned - np.asarray(exact.T(light)) * wide).max() > 0.1 * dose.max(), "else this tests nothing"


def test_the_best_light_within_what_may_be_spent_is_the_same_each_time() -> None:
    A, _, light, replanner = setup()
    given = 0.8 * np.asarray(A.T(SHOWN * light))
    plans = [replanner.replan(A, given, light, 3, range(6), evaluations=pairs) for pairs in (4, 4, 12)]
    np.testing.assert_array_equal(np.asarray(plans[0].light), np.asarray(plans[1].light))
    assert [plan.evaluations for plan in plans] == [4, 4, 12]
    assert plans[2].expected.iou >= plans[0].expected.iou > plans[0].kept.iou


def test_a_print_that_has_its_dose_is_stopped() -> None:
    A, part, light, replanner = setup()
    whole = np.asarray(A.T(TURNS * light))
    whole *= Border(part, replanner.threshold or 0.0).share(0.0 * whole, whole)
    plan = replanner.replan(A, whole, light, 2, range(4), evaluations=4)
    assert plan.expected.turns == 0 and not np.asarray(plan.light).any()
    assert plan.expected.iou > 0.99 > plan.kept.iou
    assert replanner.replan(A, 0.8 * whole, light, 2, range(4), evaluations=4).expected.turns > 0
    ended = replanner.replan(A, 0.8 * whole, light, 2, range(4), evaluations=4, stopped=whole).expected
    assert ended.turns == 0 and ended.iou == plan.expected.iou, "a part that sinks does so only while it is printed"


def test_the_least_overlap_is_within_independent_errors_of_threshold_and_dose() -> None:
    A, part, light, replanner = setup()
    solid, whole = replanner.threshold or 0.0, np.asarray(A.T(TURNS * light))

    def least(error: float, *thresholds: float) -> float:
        levels = [solid * each for each in thresholds]
        return replanner.replan(A, whole, light, 0, [0], evaluations=1, error=error, thresholds=levels).kept.least

    inside = part > 0.5
    for low, high in ((0.96, 1.03), (1.0, 1.04), (0.95, 1.0)):
        ends = 1.0 - np.hypot(1.0 - low, 0.03), 1.0 + np.hypot(high - 1.0, 0.03)
        solids = [whole >= solid * each for each in (1.0, *ends)]
        expected = min((each & inside).sum() / (each | inside).sum() for each in solids)
        assert least(0.03, low, high) == pytest.approx(expected, abs=2e-3) and expected < least(0.0)


@pytest.mark.slow
def test_the_rest_is_as_much_as_brings_the_surface_home() -> None:
    """The surface that rays prove of 5.4 turns' light by a machine whose gain falls along z."""
    A, part, light, replanner = setup()
    border, lean = (
        Border(part, replanner.threshold or 0.0),
        Estimator(A, GeneralizedLogistic(steepness=8.0, middle=0.7)),
    )
    gain = lean.gain(np.array([1.0, 1.0, 0.0, 0.0, 0.05, 0.0, 0.0])).numpy()
    exposure = IndependentExposure(A)

    def proved(images: np.ndarray) -> np.ndarray:
        return np.asarray(exposure.averaged(A.device.upload(images))[0], float) * gain

    calibrated, delivered = lean.calibrated(np.array([1.0, 1.0, 0.0, 0.0, 0.05, 0.0, 0.0])), proved(SHOWN * light)
    given, wanted = np.asarray(calibrated.T(SHOWN * light)), np.asarray(A.T(TURNS * light))
    off = []
    for aim in (None, wanted):
        plan = replanner.replan(calibrated, given, light, 3, range(6), evaluations=8, expected_dose=aim)
        off.append(border.off(delivered + proved(plan.expected.turns * np.asarray(plan.light))))
        assert plan.evaluations <= 8
    best = min(border.off(delivered + share * proved(light)) for share in np.arange(2.0, 4.0, 0.1))
    assert off[1] < 0.8 * best and off[0] < 1.1 * best


def test_light_that_cannot_suffice_is_given_all_the_same() -> None:
    A, part, light, _ = setup()
    weak = Replanner(part, most=0.3 * float(light.max()))
    wanted = np.asarray(A.T(TURNS * light))
    plan = weak.replan(A, 0.0 * part, 0.3 * light, 6, range(7), evaluations=1, expected_dose=wanted)
    assert plan.expected.turns == 6 and plan.evaluations <= 1
    assert np.asarray(plan.light).max() <= weak.most * (1.0 + 1e-5)


def test_voxels_over_their_limit_have_no_weight() -> None:
    A, part, _, replanner = setup()
    delivered = np.where(part > 0, 0.5, 0.3)
    outside, inside = np.argwhere(part == 0)[0], np.argwhere(part > 0)[0]
    delivered[tuple(outside)], delivered[tuple(inside)] = 1.0, 1.1
    given, target = (A.device.upload(each.astype(np.float32)) for each in (delivered, part))
    weight = np.asarray(replanner._loss(given, target, 0.01).weight)
    assert {tuple(where) for where in np.argwhere(weight == 0)} == {tuple(outside), tuple(inside)}
    assert replanner._loss(given, target, 0.2).weight is None  # over, but not surely


def test_nonsense_is_refused() -> None:
    A, part, light, replanner = setup()
    with pytest.raises(BadInput, match="NaN"):
        replanner.replan(A, np.full(part.shape, np.nan), light, 3, range(4), evaluations=4)
    with pytest.raises(BadInput, match="whole numbers"):
        replanner.replan(A, part, light, 3, [], evaluations=4)


def test_no_pixel_is_brighter_than_the_projector() -> None:
    A, part, light, _ = setup()
    bound = float(light.max())
    given = 0.6 * np.asarray(A.T(SHOWN * light))
    plan = Replanner(part, most=bound).replan(A, given, light, 3, range(1, 4), evaluations=6)
    assert plan.expected.turns == 3 and plan.expected is not plan.kept
    assert np.asarray(plan.light).max() == pytest.approx(bound, rel=1e-5)
