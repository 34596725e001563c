"""Light of two colors: the rules of passes and least squares."""

from __future__ import annotations

import numpy as np
import pytest
from points import PointProjection

from profiling.color_contrast import Contrast
from vamgpu import Beam, Grid, Projection, Turntable, Vat, open_device
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, EmptyMesh, ShapeMismatch
from vamgpu.methods.dual import METHODS, Colors, DualColor, LeastSquares, Tolerant, superpose
from vamgpu.methods.dual.passes import DualState

N = 32


def letter(n: int = N) -> np.ndarray:
    """A ring with an opening, [x, y, 1]."""
    place = np.arange(n) - 0.5 * (n - 1)
    x, y = place[:, None] / n, place[None, :] / n
    ring = (np.hypot(x, y) < 0.38) & (np.hypot(x, y) > 0.2) & ~((np.abs(y) < 0.07) & (x > 0))
    return ring.astype(np.float32)[:, :, None]


def points(width: float = 1.0, angles: int = 90, uv: float = 0.5) -> Colors:
    grid, motion = Grid((N, N, 1), 1.0), Turntable(angles)
    radius = N / np.sqrt(2.0)
    made = [PointProjection(grid, motion, width, mu / radius) for mu in (1.0, uv, 0.0)]
    return Colors(made[0], made[1], made[2], whole=True)


def device_colors(place: Device, nz: int = 1) -> Colors:
    grid, radius = Grid((N, N, nz), 1.0), N / np.sqrt(2.0) + 0.1
    beam, motion = Beam((48, nz), 1.0), Turntable(60)
    vats = (Vat(50.0, radius=radius, absorption=mu / radius) for mu in (1.0, 0.5))
    visible, uv = (Projection(grid, beam, motion, vat, place) for vat in vats)
    return Colors(visible, uv, whole=True)


# ---- points and bins ----------------------------------------------------------------------------------------------
@pytest.mark.parametrize("width", [1.0, 0.3])
def test_points_have_an_exact_transpose(width: float) -> None:
    A = PointProjection(Grid((9, 12, 1), 0.5), Turntable(14), width, 0.1)
    assert A.dot_test() < 1e-12


def test_a_point_falls_into_one_bin_and_fades() -> None:
    A = PointProjection(Grid((8, 8, 1), 1.0), Turntable(4), 1.0, 0.2)
    design = np.zeros((8, 8, 1))
    design[1, 5] = 1.0  # x = −2.5, y = 1.5
    light = A(design)[:, :, 0]
    assert (np.count_nonzero(light, axis=1) == 1).all()
    path = np.sqrt(A.radius**2 - 1.5**2) + 2.5  # light from +x
    assert light[0].max() == pytest.approx(np.exp(-0.2 * path))
    r = A.beam.columns()[light[0].argmax()]
    assert abs(r - 1.5) <= 0.5


def test_empty_bins_between_points() -> None:
    A = PointProjection(Grid((8, 8, 1), 1.0), Turntable(1), 0.25)
    light = A(np.ones((8, 8, 1)))[0, :, 0]
    assert np.count_nonzero(light) == 8 and light.max() == 8


# ---- rules ----------------------------------------------------------------------------------------------------------
@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_light_is_never_negative_and_the_dose_is_the_plans(method: str) -> None:
    colors, design = points(), letter()
    plan = superpose(colors, design, method)
    assert plan.visible.numpy().min() >= 0
    dose = colors.visible.T(plan.visible.numpy())
    if plan.uv is not None:
        assert plan.uv.numpy().min() >= 0
        dose = dose - colors.uv.T(plan.uv.numpy())
    np.testing.assert_allclose(plan.dose().numpy(), dose, atol=1e-10)
    assert plan.papers and plan.seconds > 0


def test_one_color_is_the_design_projected() -> None:
    colors, design = points(), letter()
    plan = superpose(colors, design, "sc")
    assert colors.projector is not None
    light = colors.projector(design)
    np.testing.assert_allclose(plan.visible.numpy() / plan.visible.numpy().max(), light / light.max(), rtol=1e-12)
    assert plan.dose().numpy().max() == pytest.approx(1.0) and plan.uv is None


def test_tolerance_bounds_what_is_out_of_the_part() -> None:
    colors, design = points(0.25), letter()
    plan = superpose(colors, design, Tolerant(passes=60))
    plain, better = (Contrast.of(superpose(colors, design, m).dose(), design) for m in ("sc", Tolerant(passes=60)))
    assert better.window > plain.window
    assert plan.dose().numpy()[design < 0.5].max() < 0.75 + 0.05


def test_the_rule_of_the_text_trades_under_for_oversupply() -> None:
    plan = superpose(points(0.25), letter(), DualColor(recompute=True))
    assert len(plan.history) == 23 and plan.history[-1].evaluations == 47
    assert plan.history[-1].undersupply < 0.2 * plan.history[0].undersupply
    assert plan.history[-1].oversupply > plan.history[0].oversupply
    assert plan.dose().numpy().max() == pytest.approx(1.0)


def test_the_first_pass_of_the_text_by_hand() -> None:
    colors, design = points(), letter()
    plan = superpose(colors, design, DualColor(passes=1))
    assert colors.projector is not None
    light = colors.projector(design)
    dose = colors.visible.T(light)
    uv = colors.projector(np.maximum(0.0, dose / dose.max() - design))
    uv *= min(1.0, dose.max() / colors.uv.T(colors.projector(np.ones_like(design))).max())
    buildup = dose - colors.uv.T(uv)
    np.testing.assert_allclose(plan.dose().numpy(), buildup / buildup.max(), atol=1e-12)
    gap = buildup / buildup.max() - design
    assert plan.history[0].undersupply == pytest.approx(np.sqrt(np.mean(np.minimum(gap, 0) ** 2)))
    assert plan.history[0].oversupply == pytest.approx(np.sqrt(np.mean(np.maximum(gap, 0) ** 2)))


@pytest.mark.slow
def test_two_colors_beat_one() -> None:
    colors, design = points(0.25), letter()
    window = {m: Contrast.of(superpose(colors, design, m).dose(), design).window for m in METHODS}
    assert window["dc kept"] > window["sc2"] > window["sc"]
    assert window["least squares"] > window["dc kept"]


@pytest.mark.slow
# ---- least squares on devices -------------------------------------------------------------------------------------
def test_devices_agree(fast_device: Device) -> None:
    reference = superpose(device_colors(open_device("numpy")), letter(), LeastSquares(6)).dose().numpy()
    dose = superpose(device_colors(fast_device), letter(), LeastSquares(6)).dose().numpy()
    np.testing.assert_allclose(dose, reference, atol=2e-4 * np.abs(reference).max())


def test_least_squares_falls_and_stays_on_the_device(fast_device: Device) -> None:
    colors, device = device_colors(fast_device, 5), fast_device
    design = np.repeat(letter(), 5, 2)
    design[:, :, 4] = design[::-1, :, 0]
    field = device.upload(design)
    method, state = LeastSquares(30), DualState(colors, field)
    steps = method.steps(state)
    history = [next(steps)]
    with device.no_transfers():
        history.extend(steps)
    errors = [record.error for record in history]
    assert errors[-1] < 0.25 * errors[0]
    assert Contrast.of(colors.dose(state.light, state.uv), design).window > 0


@pytest.mark.slow
def test_least_squares_reaches_the_bounded_minimum() -> None:
    """Against scipy's solver of bounded least squares on the dense matrices of both colors."""
    from scipy.optimize import lsq_linear  # nnls misses the minimum of so few independent columns on some processors

    n, angles = 8, 2
    grid, motion = Grid((n, n, 1), 1.0), Turntable(angles)
    A, B = (PointProjection(grid, motion, 1.0, mu) for mu in (0.15, 0.05))
    design = np.zeros((n, n, 1))
    design[2:5, 3:7] = 1.0
    design[3, 4] = 0.0
    both = np.hstack([A.dense().T, -2.0 * B.dense().T])
    least = lsq_linear(both, design.ravel(), bounds=(0.0, np.inf), tol=1e-14, max_iter=5000)
    plan = superpose(Colors(A, B, strength=2.0, whole=True), design, LeastSquares(3000))
    loss = 0.5 * float(((plan.dose().numpy() - design) ** 2).sum())
    assert loss == pytest.approx(least.cost, rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("count", [3, 7, 12, 25])
def test_least_squares_returns_the_best_light_it_looked_at(count: int) -> None:
    design = letter()
    plan = superpose(points(), design, LeastSquares(count))
    error = float(np.sqrt(np.mean((plan.dose().numpy() - design) ** 2)))
    assert error == pytest.approx(min(record.error for record in plan.history), rel=1e-9)


@pytest.mark.slow
def test_a_cost_of_light_saves_light() -> None:
    colors, design = points(), letter()
    free, dear = (superpose(colors, design, LeastSquares(40, cost=cost)) for cost in (0.0, 0.3))
    assert dear.uv is not None and free.uv is not None
    assert dear.uv.numpy().sum() < free.uv.numpy().sum()


# ---- contrast and bad input ---------------------------------------------------------------------------------------
def test_contrast_by_hand() -> None:
    design = np.array([[[1.0], [1.0]], [[0.0], [0.0]]])
    found = Contrast.of(np.array([[[2.0], [1.2]], [[1.1], [-0.4]]]), design)
    assert (found.in_least, found.in_mean, found.out_most, found.out_least) == pytest.approx((0.6, 0.8, 0.55, -0.2))
    assert found.window == pytest.approx(0.05) and found.mean == pytest.approx(0.8 - 0.175)
    assert (found.half, found.three_quarters) == pytest.approx((2 / 3, 0.5))
    assert found.undersupply == pytest.approx(np.sqrt((0.4**2 + 0.2**2) / 4))
    assert found.oversupply == pytest.approx(0.55 / 2)


def test_bad_input() -> None:
    colors = points()
    with pytest.raises(BadInput, match="no rule"):
        superpose(colors, letter(), "magic")
    with pytest.raises(BadInput, match="gray values"):
        superpose(colors, letter() * 2, "sc")
    with pytest.raises(EmptyMesh):
        superpose(colors, letter() * 0, "sc")
    with pytest.raises(ShapeMismatch):
        Colors(colors.visible, PointProjection(Grid((N, N, 1), 1.0), Turntable(7)))
    with pytest.raises(BadInput, match="tolerance"):
        Tolerant(1.0)
    with pytest.raises(BadInput, match="iterations"):
        LeastSquares(0)
    with pytest.raises(BadInput, match="strength"):
        Colors(colors.visible, colors.uv, strength=0.0)
    with pytest.raises(EmptyMesh):
        Contrast.of(np.ones((2, 2, 1)), np.ones((2, 2, 1)))


def test_a_run_can_be_stopped() -> None:
    plan = superpose(points(), letter(), LeastSquares(50), cancel=lambda: True)
    assert len(plan.history) == 1
