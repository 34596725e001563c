"""Each method does what its paper prints: runs against the printed equations, written once more with a dense matrix."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from points import PointProjection

from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.losses import Band, cross_entropy
from vamgpu.methods import BCLP, LBFGS, OSMO, GradientDescent, Linear, PenaltyMinimization, Recipe
from vamgpu.methods import optimize as run
from vamgpu.methods.dual import Colors, Tolerant, superpose
from vamgpu.methods.exposure import DoseObjective
from vamgpu.methods.minimize import Channel, StepRule, minimize
from vamgpu.methods.ramp import capped_ramp, identity
from vamgpu.methods.state import OptimizerState
from vamgpu.operators.projection import Projection

SIZE, ANGLES, PITCH = 14, 20, 0.3


@cache
def slice_operator() -> Projection:
    return Projection(
        Grid((SIZE, SIZE, 1), PITCH), Beam((SIZE, 1), PITCH, spread=0.0), Turntable(ANGLES), device="numpy"
    )


@cache
def matrix() -> np.ndarray:
    """A, (light, dose)."""
    return slice_operator().dense()


def target() -> np.ndarray:
    """A bar and a dot, none near the edge."""
    part = np.zeros((SIZE, SIZE, 1))
    part[4:10, 4:6] = 1.0
    part[8:10, 8:10] = 1.0
    return part


F, DISC = target().ravel(), slice_operator().grid.cylinder().ravel()


def ramp(model: np.ndarray) -> np.ndarray:
    """The band-limited ramp (Ramachandran & Lakshminarayanan) of a model's projection, for pixels as wide as voxels."""
    projected = (matrix() @ model).reshape(ANGLES, SIZE)
    n = np.arange(SIZE)[:, None] - np.arange(SIZE)[None, :]
    taps = np.where(n == 0, 0.25, np.where(n % 2, -1.0 / (np.pi * np.maximum(abs(n), 1)) ** 2, 0.0))
    return np.maximum(0.0, projected @ taps * np.pi / ANGLES / PITCH**2).ravel()


def first_light(model: np.ndarray = F) -> np.ndarray:
    """Filtered, clipped projection whose dose in the part is 1 on average."""
    light = ramp(model)
    return light / ((light @ matrix() @ F) / (F @ F))


def logistic(dose: np.ndarray, steepness: float = 10.0) -> np.ndarray:
    return 1.0 / (1.0 + np.exp(-steepness * (dose - 0.5)))


def descend(slope, share: float, growth: float, momentum: float, steps: int) -> list[np.ndarray]:
    """Light before and after each step of g ← max(0, g − η·A slope(Aᵀg)), looking ahead by a constant momentum."""
    light = first_light()
    ahead, lights, step = light.copy(), [light], 0.0
    for k in range(steps):
        gradient = matrix() @ (slope(ahead @ matrix()) * DISC)
        gradient[(ahead <= 0) & (gradient > 0)] = 0.0
        step = step * growth if k else share * np.linalg.norm(light) / np.linalg.norm(gradient)
        new = np.maximum(0.0, ahead - step * gradient)
        ahead = new + (momentum if k else 0.0) * (new - light)
        light = new
        lights.append(light)
    return lights


def light_of(method: object, iterations: int) -> tuple[np.ndarray, list[float]]:
    """Last light of a run, and its losses."""
    plan = run(slice_operator(), target(), method, iterations)  # type: ignore[arg-type]
    return plan.state["light"].numpy().ravel(), [step.loss for step in plan.history]


# ---- band constraint Lp norm ------------------------------------------------------------------------------------
def printed_loss(dose: np.ndarray) -> np.ndarray:
    """(S1) of the roll-to-roll paper, corrected, voxel by voxel, with the parameters it prints."""
    response = logistic(dose, steepness=10.0)
    outside = np.maximum(0.0, np.abs(response - F) - np.where(F > 0.5, 0.01, 0.05))
    return DISC * (outside**3 + 0.04 * response**2)


def test_bclp_has_the_loss_that_the_paper_prints() -> None:
    light, losses = light_of(BCLP.paper_002(), 1)
    assert losses[0] == pytest.approx(printed_loss(first_light() @ matrix()).sum(), rel=1e-4)


def test_bclp_steps_as_printed_with_momentum_one_half() -> None:
    method, small = BCLP.paper_002(), 1e-6

    def slope(dose: np.ndarray) -> np.ndarray:
        return (printed_loss(dose + small) - printed_loss(dose - small)) / (2 * small)

    wanted = descend(slope, method.share, method.growth, 0.5, 4)
    light, losses = light_of(method, 4)
    assert np.abs(light - wanted[-1]).max() <= 2e-3 * wanted[-1].max()
    assert losses == pytest.approx([printed_loss(g @ matrix()).sum() for g in wanted[:-1]], rel=1e-3)


def test_no_voxel_within_its_band_is_pushed() -> None:
    """With the printed ||M − f| − ε|^p it would be."""
    state = OptimizerState(slice_operator(), slice_operator().device.upload(target()), {})
    dose = state.device.upload(np.where(target() > 0.5, 0.995, 0.04))
    assert state.loss(dose, Band((0.0, 1.0), BCLP().slack, power=3.0)) == 0.0
    assert not dose.numpy().any()


# ---- computed axial lithography ---------------------------------------------------------------------------------
def test_cal_projects_the_error_of_its_sigmoid() -> None:
    method = GradientDescent()
    wanted = descend(lambda dose: logistic(dose) - F, method.share, method.growth, 0.0, 5)
    light, losses = light_of(method, 5)
    assert np.abs(light - wanted[-1]).max() <= 5e-3 * wanted[-1].max()
    assert losses == sorted(losses, reverse=True)


def test_what_cal_descends_is_the_cross_entropy() -> None:
    state = OptimizerState(slice_operator(), slice_operator().device.upload(target()), {})
    dose = np.random.default_rng(3).random(F.size) * 1.2
    field = state.device.upload(dose.reshape(target().shape))
    loss = state.loss(field, cross_entropy(GradientDescent().response))
    chance = np.where(F > 0.5, logistic(dose), 1.0 - logistic(dose))
    dark = np.where(F > 0.5, 1.0, 1.0 - logistic(np.zeros(F.size)))  # out of the part nothing is wrong in darkness
    assert loss == pytest.approx(float((DISC * np.log(dark / chance)).sum()) / 10.0, rel=1e-3)
    assert np.abs(field.numpy().ravel() - DISC * (logistic(dose) - F)).max() <= 5e-3


def test_cal_of_a_linear_response_is_least_squares() -> None:
    state = OptimizerState(slice_operator(), slice_operator().device.upload(target()), {})
    dose = np.random.default_rng(4).random(F.size)
    loss = state.loss(state.device.upload(dose.reshape(target().shape)), cross_entropy(Linear()))
    assert loss == pytest.approx(0.5 * float((DISC * (dose - F) ** 2).sum()), rel=1e-3)


# ---- penalty minimization ---------------------------------------------------------------------------------------
def test_penalty_minimization_pays_for_wrong_voxels_alone() -> None:
    method = PenaltyMinimization(0.3, 0.95, penalty=(1.0, 2.0))

    def slope(dose: np.ndarray) -> np.ndarray:
        return np.where(F > 0.5, -2.0 * (dose < method.inside), 1.0 * (dose > method.outside))

    def loss(dose: np.ndarray) -> float:
        wrong = np.where(F > 0.5, 2.0 * (method.inside - dose), dose - method.outside)
        return float((DISC * np.maximum(0.0, wrong)).sum())

    wanted = descend(slope, method.share, method.growth, 0.0, 4)
    light, losses = light_of(method, 4)
    assert np.abs(light - wanted[-1]).max() <= 1e-6 * wanted[-1].max()
    assert losses == pytest.approx([loss(g @ matrix()) for g in wanted[:-1]], rel=1e-6)


# ---- object space -----------------------------------------------------------------------------------------------
@pytest.mark.filterwarnings("ignore::vamgpu.errors.DivergenceWarning")
def test_osmo_corrects_its_model_by_what_is_wrong() -> None:
    method = OSMO(outside=0.25)

    def dose_of(model: np.ndarray) -> np.ndarray:
        dose = ramp(model) @ matrix()
        return dose / dose[DISC].max()

    model = F * DISC
    dose = dose_of(model)
    for _ in range(2):
        model = model - (F < 0.5) * DISC * np.maximum(0.0, dose - 0.25)
        dose = dose_of(model)
        model = model + (F >= 0.5) * DISC * np.maximum(0.0, 0.85 - dose)
        dose = dose_of(model)
    light, _ = light_of(method, 2)
    got = light @ matrix()
    assert np.abs(got - dose).max() <= 1e-9
    assert got[DISC].max() == pytest.approx(1.0)


# ---- automatic exposure -----------------------------------------------------------------------------------------
def test_the_recipe_begins_with_a_background_of_60_percent() -> None:
    """Target over the background, ramp, clip; then the target times what was asked over what came."""
    asked = 0.6 + 0.4 * F
    light, _ = light_of(Recipe(), 1)
    wanted = first_light(asked * DISC)
    assert np.abs(light - wanted).max() <= 1e-9
    dose = wanted @ matrix()
    again = first_light(asked * DISC * np.minimum(10.0, asked / np.maximum(dose, asked / 10.0)))
    assert np.abs(light_of(Recipe(), 2)[0] - again).max() <= 1e-9
    start = run(slice_operator(), target(), Recipe(), 1)
    assert np.abs(start.state["light"].numpy().ravel() - wanted).max() <= 1e-9


@pytest.mark.slow
# ---- accelerated descent ----------------------------------------------------------------------------------------
def test_momentum_is_dropped_where_the_loss_rises() -> None:
    """Adaptive restart by function values: after a rise the point ahead is the light itself."""
    state = OptimizerState(slice_operator(), slice_operator().device.upload(target()), {})
    state.memory["light"] = state.device.upload(first_light().reshape(state.operator.range.shape))
    rule = StepRule(share=0.15, soon=1.0)
    exposure = DoseObjective(state, Band((0.0, 1.0), (0.0, 0.0), (0.5, 0.5)), rule)
    steps = minimize(exposure, (Channel(state, identity(state.operator)),), rule)
    losses, restarts = [], 0
    for (loss, _), _ in zip(steps, range(150), strict=False):
        apart = np.abs(state.buffer("ahead").numpy() - state.buffer("light").numpy()).max()
        if losses and loss > losses[-1]:
            restarts += 1
            assert apart == 0.0
        elif restarts and len(losses) > 2 and losses[-1] > losses[-2]:
            assert apart > 0.0 and state.number("run") == 2.0
        losses.append(loss)
    assert restarts >= 2


def test_the_capped_ramp_is_a_ramp_up_to_its_cap() -> None:
    """Gain at a frequency is the frequency itself below the cap and the cap above, over that of the plain ramp."""
    taps = capped_ramp(slice_operator(), 0.25).table.numpy() / (np.pi / ANGLES / PITCH**2)
    for cycles in (0.1, 0.2, 0.3, 0.45):
        gain = taps[0] + 2 * (taps[1:] * np.cos(2 * np.pi * cycles * np.arange(1, len(taps)))).sum()
        assert gain == pytest.approx(min(cycles, 0.25), abs=0.01)


# ---- limited memory ---------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("efficiency", "power"), [(0.3, 4.0), (3.0, 1.0)])
def test_a_line_search_lowers_the_whole_loss(efficiency: float, power: float) -> None:
    """That of doses and that of bright light together, at every iteration."""
    method = LBFGS(efficiency=efficiency, power=power)
    first = first_light()
    weight = efficiency * (F @ F) / (first**power).sum()

    def whole(light: np.ndarray) -> float:
        dose = light @ matrix()
        wrong = np.where(F > 0.5, np.maximum(0.95 - dose, 0) + np.maximum(dose - 1.0, 0), np.maximum(dose - 0.8, 0))
        return 0.5 * float((DISC * wrong**2).sum()) + weight * float((light**power).sum())

    light, losses = light_of(method, 10)
    assert losses[-1] == pytest.approx(whole(light), rel=1e-9)
    assert losses == sorted(losses, reverse=True) and losses[-1] < 0.9 * whole(first)


# ---- two colors -------------------------------------------------------------------------------------------------
def test_sc2_overlooks_gray_below_75_percent() -> None:
    """One-sided: nothing up to three quarters of the design's greatest value is too much, anywhere."""
    n = 12
    A = PointProjection(Grid((n, n, 1), 1.0), Turntable(30), 0.5)
    design = np.zeros((n, n, 1))
    design[3:6, 3:9], design[7:9, 4:8] = 1.0, 0.4
    plan = superpose(Colors(A, A, whole=True), design, Tolerant(passes=1))
    dose = A.T(A(design))
    dose /= dose.max()
    over = np.maximum(0.0, dose - np.maximum(design, 0.75))
    assert plan.history[0].oversupply == pytest.approx(np.sqrt(np.mean(over**2)), rel=1e-9)
    assert over[design == 0.4].size > 0 and ((dose > 0.4) & (dose < 0.75) & (design < 0.75)).any()
    under = np.maximum(0.0, design - dose)
    assert plan.history[0].undersupply == pytest.approx(np.sqrt(np.mean(under**2)), rel=1e-9)
