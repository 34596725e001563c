"""Light of two colors: the rules of passes and least squares."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from points import PointProjection
from scipy import sparse
from scipy.optimize import linprog
from widest import entries_of, widest

from profiling.color_contrast import Contrast
from vamgpu import Beam, Grid, Projection, Turntable, Vat, Vial, open_device
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, EmptyMesh, ShapeMismatch
from vamgpu.methods.dual import METHODS, Colors, DualColor, LeastSquares, Tolerant, WidestWindow, bound, superpose
from vamgpu.methods.dual.passes import DualState
from vamgpu.methods.dual.window import BothColors, WindowLoss

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


# ---- the widest window ----------------------------------------------------------------------------------------------
def vial_colors(device: Device | str | None) -> Colors:
    """Two colors in a vial, for slices of 14 × 14 voxels."""
    grid, beam, motion = Grid((14, 14, 1), 0.2), Beam((18, 1), 0.2), Turntable(24)
    vials = (Vial(2.2, 0.1, 1.49, 1.49, bath_index=1.49, absorption=mu) for mu in (0.05, 0.1))
    visible, uv = (Projection(grid, beam, motion, vial, device) for vial in vials)
    return Colors(visible, uv)


def slice_of(part: str) -> np.ndarray:
    at = np.arange(14) - 6.5
    x, y = at[:, None], at[None, :]
    r = np.hypot(x, y)
    found = {
        "ring": (r < 4.7) & (r > 2.4),
        "cross": ((abs(x) < 1.2) | (abs(y) < 1.2)) & (r < 5.5),
        "bars": (r < 5.5) & (abs(y % 4 - 2) < 1),
        "plate": (r < 5.5) & (np.hypot(x - 1.8, y) > 1.2) & (np.hypot(x + 2.4, y - 1.2) > 0.8),
    }
    return found[part].astype(np.float32)[:, :, None]


def window_of(dose: np.ndarray, part: np.ndarray, near: np.ndarray) -> float:
    """Strict window of a dose, of which negative values count as 0."""
    some, inside = np.maximum(dose, 0.0)[near], part[near] > 0.5
    return float((some[inside].min() - some[~inside].max()) / some.max())


def test_light_of_both_colors_is_their_difference_and_its_transpose_exact(fast_device: Device) -> None:
    colors = vial_colors(fast_device)
    both = BothColors(colors.visible, colors)
    assert both.dot_test() < 1e-6
    light = np.random.default_rng(1).random(both.range.shape, dtype=np.float32)
    wanted = colors.visible.T(light[:24]) - colors.uv.T(light[24:])
    np.testing.assert_allclose(both.T(light), wanted, atol=2e-6 * np.abs(wanted).max())


SHARES = {"ring": 0.99, "bars": 0.99, "cross": 0.99, "plate": 0.9}
"""Least share of the optimum after 400 evaluations of both colors."""


@pytest.mark.parametrize("part", ["ring", *(pytest.param(name, marks=pytest.mark.slow) for name in [*SHARES][1:])])
def test_the_window_of_two_colors_is_near_the_optimum_and_never_beyond(part: str) -> None:
    exact, given = vial_colors("numpy"), slice_of(part)
    near = np.broadcast_to(exact.visible.grid.cylinder()[:, :, None], given.shape)  # type: ignore[attr-defined]
    inside, outside = ((given > 0.5) & near).ravel(), ((given < 0.5) & near).ravel()
    entries: Any = sparse.hstack([entries_of(exact.visible), -entries_of(exact.uv)]).tocsr()
    optimum, alone = widest(entries[inside], entries[outside]), entries[:, : entries.shape[1] // 2]
    plan = superpose(vial_colors(None), given, "window")
    found = window_of(plan.dose().numpy(), given, near)
    assert SHARES[part] * optimum < found <= optimum + 1e-5
    assert found > 2.0 * widest(alone[inside], alone[outside])
    assert plan.uv is not None and plan.uv.numpy().min() >= 0.0 <= plan.visible.numpy().min()
    assert plan.history[-1].evaluations <= 800.0
    colors = (plan.colors.visible.T(plan.visible), plan.colors.uv.T(plan.uv))
    rounding = (
        2 * np.finfo(np.float32).eps * max(color.numpy().max() for color in colors)
    )  # of doses that are subtracted
    np.testing.assert_allclose(plan.dose().numpy().max(), 1.0, rtol=0.0, atol=rounding)


def test_the_loss_of_a_window_is_least_at_the_best_levels() -> None:
    """By a search over both levels in float64, and its gradient by differences; voxels off the axis do not count."""
    device, rng, lack = open_device("numpy"), np.random.default_rng(2), 0.7
    dose, part = rng.normal(0.5, 0.5, (9, 9, 3)), rng.random((9, 9, 3)) < 0.4
    near = np.broadcast_to((np.hypot(*np.mgrid[-4:5, -4:5]) <= 3.0)[:, :, None], dose.shape)
    a, b = np.meshgrid(np.linspace(-2.0, 1.0, 3001), np.linspace(0.0, 2.0, 3001), indexing="ij", sparse=True)

    def least(dose: np.ndarray) -> float:
        inside, outside = dose[near & part], dose[near & ~part]
        low = sum(np.maximum(a - d, 0.0) ** 2 + max(d - 1.0, 0.0) ** 2 for d in inside) / (2.0 * lack) - a
        return float(low.min() + (sum(np.maximum(d - b, 0.0) ** 2 for d in outside) / (2.0 * lack) + b).min())

    loss, field, slope = WindowLoss(lack), device.upload(dose), device.empty(dose.shape)
    value = loss.value_and_gradient(field, device.upload(part.astype(float)), slope, 3.0)
    assert value == pytest.approx(least(dose), abs=1e-5)
    way = rng.normal(size=dose.shape)
    rise = (least(dose + 0.01 * way) - least(dose - 0.01 * way)) / 0.02
    assert np.vdot(slope.numpy(), way) == pytest.approx(rise, rel=5e-3)
    assert not slope.numpy()[~near].any()


@pytest.mark.slow
def test_a_bound_of_limited_light_is_above_the_optimum_and_near_it() -> None:
    """By linear programming with the same limit, of eight angles, which do not suffice for a window of 1."""
    grid, beam, motion = Grid((14, 14, 1), 0.2), Beam((18, 1), 0.2), Turntable(8)
    vials = [Vial(2.2, 0.1, 1.49, 1.49, bath_index=1.49, absorption=mu) for mu in (0.05, 0.1)]
    visible, uv = (Projection(grid, beam, motion, vial) for vial in vials)
    colors, given = Colors(visible, uv), slice_of("plate")
    plan = superpose(colors, given, WidestWindow(200))
    brightest = max(light.numpy().max() for light in (plan.visible, plan.uv))  # type: ignore[union-attr]
    found, near = bound(plan, given, 1000, brighter=1.0), grid.cylinder()[:, :, None] & np.ones(given.shape, bool)
    A, B = (Projection(grid, beam, motion, vial, "numpy") for vial in vials)
    entries: Any = sparse.hstack([entries_of(A), -entries_of(B)]).tocsr()
    part, void = entries[((given > 0.5) & near).ravel()], entries[((given < 0.5) & near).ravel()]
    ones, zeros = (lambda m: np.ones((m.shape[0], 1))), (lambda m: sparse.csr_matrix((m.shape[0], 1)))
    rows = [[-part, ones(part), zeros(part)], [void, zeros(void), -ones(void)], [part, zeros(part), zeros(part)]]
    most = np.r_[np.zeros(part.shape[0] + void.shape[0]), np.ones(part.shape[0])]
    limits = [(0.0, brightest)] * entries.shape[1] + [(None, None), (0.0, None)]
    cost = np.r_[np.zeros(entries.shape[1]), -1.0, 1.0]
    optimum = -linprog(cost, sparse.vstack([sparse.hstack(row) for row in rows]), most, bounds=limits).fun
    window = window_of(plan.dose().numpy(), given, near)
    assert window <= optimum < found.value < optimum + 0.15 and found.value < 0.95
    assert "times the greatest dose" in found.statement(window)


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


def test_a_part_that_fills_no_voxel_to_half_has_no_window() -> None:
    with pytest.raises(EmptyMesh, match="filled to half"):
        superpose(vial_colors(None), np.full((14, 14, 1), 0.3), "window")


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
