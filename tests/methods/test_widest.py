"""The widest window, against the optimum that linear programming finds and certifies."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import sparse
from scipy.optimize import linprog

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, OutOfMemory
from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.methods import METHODS, WidestWindow, bound, optimize, split
from vamgpu.operators.projection import Projection

SIZE, PITCH = 20, 0.2
PARTS = ("ring", "cross", "bars")


def operator(device: Device | str) -> Projection:
    return Projection(Grid((SIZE, SIZE, 1), PITCH), Beam((30, 1), PITCH), Turntable(30), device=device)


def part(name: str) -> np.ndarray:
    x, y = np.meshgrid(*2 * [np.arange(SIZE) - 0.5 * (SIZE - 1)], indexing="ij")
    r = np.hypot(x, y)
    return {
        "ring": (r < 7) & (r > 4), "cross": ((abs(x) < 2) | (abs(y) < 2)) & (r < 8),
        "bars": (abs(x) < 6.5) & (abs(y) < 6.5) & (np.mod(x + 6.5, 5) < 2.6),
    }[name]  # fmt: skip


@pytest.fixture(scope="module")
def entries() -> Any:
    """Dose of every voxel by light of every pixel, read off the operator voxel by voxel."""
    A, unit, rows = operator("numpy"), np.zeros((SIZE, SIZE, 1), np.float32), []
    for voxel in range(SIZE**2):
        unit[:] = 0.0
        unit.flat[voxel] = 1.0
        rows.append(sparse.csr_matrix(np.asarray(A(unit), np.float64).reshape(1, -1)))
    return sparse.vstack(rows).tocsr()


def optimum(entries: Any, inside: np.ndarray, near: np.ndarray) -> float:
    """Greatest a − b of light ≥ 0 whose dose is at least a and at most 1 in the part, and at most b elsewhere."""
    wanted, void = entries[inside & near] / entries.max(), entries[~inside & near] / entries.max()
    ones, none = (lambda k: np.ones((k, 1))), (lambda k: sparse.csr_matrix((k, 1)))
    k, rest = wanted.shape[0], void.shape[0]
    limits = sparse.vstack([
        sparse.hstack([-wanted, ones(k), none(k)]), sparse.hstack([void, none(rest), -ones(rest)]),
        sparse.hstack([wanted, none(k), none(k)]),
    ])  # fmt: skip
    cost = np.zeros(entries.shape[1] + 2)
    cost[-2:] = -1.0, 1.0
    found = linprog(cost, limits, np.r_[np.zeros(k + rest), np.ones(k)], method="highs").fun
    assert found is not None
    return -found


def strict(entries: Any, light: np.ndarray, inside: np.ndarray, near: np.ndarray) -> float:
    dose = entries @ light.reshape(-1)
    return float((dose[inside & near].min() - dose[~inside & near].max()) / dose[near].max())


def circle() -> np.ndarray:
    x, y = np.meshgrid(*2 * [np.arange(SIZE) - 0.5 * (SIZE - 1)], indexing="ij")
    return (np.hypot(x, y) <= 0.5 * (SIZE - 1) * (1.0 + 1e-6)).ravel()


@pytest.mark.parametrize("name", PARTS)
def test_it_comes_near_the_optimum_and_never_beyond(fast_device: Device, entries: Any, name: str) -> None:
    inside, near = part(name), circle()
    plan = optimize(operator(fast_device), inside[:, :, None].astype(np.float32), "widest", evaluations=400)
    top, found = optimum(entries, inside.ravel(), near), strict(entries, plan.sinogram.numpy(), inside.ravel(), near)
    assert plan.window == pytest.approx(found, abs=2e-5)
    assert 0.99 * top < found <= top + 2e-5, found / top
    assert plan.evaluations <= 400


def test_every_device_takes_the_same_way(device: Device) -> None:
    target = part("cross")[:, :, None].astype(np.float32)
    windows = [
        [step.window for step in optimize(operator(where), target, WidestWindow(), 12).history]
        for where in (device, "numpy")
    ]
    assert windows[0] == pytest.approx(windows[1], abs=2e-4)


@pytest.mark.parametrize("name", PARTS)
def test_the_bound_is_just_above_the_optimum(fast_device: Device, entries: Any, name: str) -> None:
    inside, near = part(name), circle()
    A, target = operator(fast_device), inside[:, :, None].astype(np.float32)
    top, found = optimum(entries, inside.ravel(), near), bound(A, target, evaluations=1000)
    assert top <= found.value <= 1.02 * top, found.value / top
    assert_certified(found.prices.numpy(), inside, near, found.value)


def assert_certified(prices: np.ndarray, inside: np.ndarray, near: np.ndarray, value: float) -> None:
    """Prices cost every pixel nothing or more, in float64, and their sums give the value."""
    part, void = (prices[:, :, 0].ravel().astype(np.float64)[where.ravel()] for where in (inside, ~inside))
    assert np.asarray(operator("numpy")(prices), np.float64).min() >= 0.0
    assert (
        void.min(initial=0.0) >= 0.0
        and -np.minimum(part, 0.0).sum() <= 1.0
        and not prices[:, :, 0].ravel()[~near].any()
    )
    assert value == pytest.approx(1.0 + part.sum() + max(0.0, void.sum() - 1.0), abs=1e-5)


def test_no_method_goes_beyond_a_bound_of_few_steps(fast_device: Device) -> None:
    inside = part("cross")
    A, target = operator(fast_device), inside[:, :, None].astype(np.float32)
    found = bound(A, target, evaluations=63)
    assert_certified(found.prices.numpy(), inside, circle(), found.value)
    assert found.value < 0.95
    for name in METHODS:
        plan = optimize(A, target, name, evaluations=20)
        assert plan.window < found.value and found.share(plan) == plan.window / found.value


def test_a_bound_comes_with_the_plan_and_changes_nothing() -> None:
    A, target = operator("numpy"), part("bars")[:, :, None].astype(np.float32)
    first = optimize(A, target, "widest", 29)
    assert first.bound is None
    with pytest.raises(BadInput, match="63"):
        bound(A, target, evaluations=62)
    second = optimize(A, target, "widest", 70, resume=first)
    third = optimize(A, target, "widest", 75, resume=second)
    whole = optimize(A, target, "widest", 75)
    assert third.history == whole.history and 75 < third.evaluations == whole.evaluations < 90
    assert third.bound is not None and whole.bound is not None and third.bound.value == whole.bound.value
    assert bound(A, target, third, evaluations=75).value <= third.bound.value
    assert second.bound is not None
    assert bound(A, target, second, evaluations=75).value <= min(second.bound.value, third.bound.value)
    said = third.bound.statement(third)
    assert said.startswith(f"no light whatever gives more than +{third.bound.value:.3f}; this one has ")
    assert said.endswith(f"({100 * third.window / third.bound.value:.0f} %)")


@pytest.mark.filterwarnings("ignore:31 % of the target")
def test_a_part_without_a_void_has_a_bound(fast_device: Device) -> None:
    full = np.ones((SIZE, SIZE, 1), np.float32)
    found = bound(operator(fast_device), full, evaluations=120)
    plan = optimize(operator(fast_device), full, "recipe")
    assert plan.window <= found.value
    assert_certified(found.prices.numpy(), full[:, :, 0] > 0, circle(), found.value)


@pytest.mark.parametrize("name", PARTS)
def test_the_default_is_the_widest_at_any_number_of_evaluations(name: str) -> None:
    A, target = operator("numpy"), part(name)[:, :, None].astype(np.float32)
    for budget in (20, 80):
        plan, other = optimize(A, target, evaluations=budget), optimize(A, target, "widest", evaluations=budget)
        assert plan.history == other.history and (plan.bound is None) == (other.bound is None)
        thresholds = optimize(A, target, "window", evaluations=budget)
        assert plan.window > thresholds.window


def test_elsewhere_the_default_takes_thresholds_for_few_evaluations_and_goes_on_by_prices_for_many() -> None:
    turned = Turntable(np.linspace(0.0, 2.0 * np.pi, 30, endpoint=False) + 0.02)
    A = Projection(Grid((SIZE, SIZE, 1), PITCH), Beam((30, 1), PITCH), turned, device="numpy")
    target = part("bars")[:, :, None].astype(np.float32)
    few = optimize(A, target)
    assert few.bound is None and few.history == optimize(A, target, "window").history
    many = optimize(A, target, evaluations=240, resume=few)
    kept = optimize(A, target, evaluations=60, resume=few)
    assert kept.history == optimize(A, target, evaluations=60).history
    assert many.window > 1.2 * kept.window and many.bound is not None
    assert optimize(A, target, evaluations=241, resume=many).evaluations == 241
    assert bound(A, target, few, evaluations=80).value < 1.0


def test_resin_above_and_below_the_part_stays_dark(fast_device: Device) -> None:
    """Rows beside the volume light it by a tail of the point spread, and what lies above and below by more."""
    deep, rows = 6, 14
    solid = np.repeat(part("cross")[:, :, None], deep, axis=2).astype(np.float32)
    low, high = (
        Projection(Grid((SIZE, SIZE, z), 0.1), Beam((30, rows), 0.1, spread=0.08), Turntable(40), None, fast_device)
        for z in (deep, 14)
    )
    plan = optimize(low, solid, evaluations=60)
    dose = np.asarray(high.T(plan.sinogram))
    inner = dose[:, :, 4 : 4 + deep]
    np.testing.assert_allclose(inner, np.asarray(plan.dose()), atol=1e-4)
    threshold = 0.5 * (inner[solid > 0].min() + inner[(solid == 0) & low.grid.cylinder()[:, :, None]].max())
    assert plan.window > 0.1
    assert dose[:, :, 5 + deep :].max() < threshold and dose[:, :, :3].max() < threshold


def test_a_bound_of_slices_counts_the_point_spread_of_its_beam() -> None:
    """That of half a pixel, unless told otherwise, takes light of the next rows to a slice."""
    upper, lower = part("cross"), part("ring")
    solid = np.stack([lower] * 3 + [upper] * 3, axis=2).astype(np.float32)
    A = Projection(Grid((SIZE, SIZE, 6), PITCH), Beam((30, 10), PITCH), Turntable(30))
    plan = optimize(A, solid, WidestWindow(rim=0.0), evaluations=150)
    assert plan.window <= bound(A, solid, evaluations=150, slices=(2, 4)).value
    same = Projection(A.grid, Beam((30, 10), PITCH, spread=0.5 * PITCH), A.motion)
    assert bound(A, solid, evaluations=70, slices=(2, 4)).value == pytest.approx(
        bound(same, solid, evaluations=70, slices=(2, 4)).value, abs=1e-3
    )


def test_what_a_plan_knows_is_of_its_own_task() -> None:
    A, ring = operator("numpy"), part("ring")[:, :, None].astype(np.float32)
    blurred = Projection(A.grid, Beam((30, 1), PITCH, spread=0.4), A.motion, device="numpy")
    plan = optimize(A, ring, "widest", iterations=40)
    assert plan.bound is not None
    for other, target, said in ((blurred, ring, "spread=0.4"), (A, 1.0 - ring, "another target")):
        with pytest.raises(BadInput, match=f"bound of the plan is of .*{said}"):
            bound(other, target, plan)
        with pytest.raises(BadInput, match=f"plan to resume is of .*{said}"):
            optimize(other, target, "widest", iterations=50, resume=plan)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"evaluations": "many"}, "evaluations is 'many'"), ({"slices": 5}, "two whole numbers"),
        ({"slices": (0.0, 1.0)}, "two whole numbers"), ({"slices": (0, 9)}, "expected 0 ≤ first < behind ≤ 1"),
        ({"plan": 0.2}, "plan is 0.2"), ({"tolerances": 0.1}, "tolerances are 0.1"),
    ],
)  # fmt: skip
def test_what_a_bound_cannot_take_is_named(given: dict[str, Any], said: str) -> None:
    with pytest.raises(BadInput, match=said):
        bound(operator("numpy"), part("ring")[:, :, None].astype(np.float32), **given)


def test_a_run_that_goes_on_needs_the_memory_it_had(monkeypatch: pytest.MonkeyPatch) -> None:
    A, ring = operator("numpy"), part("ring")[:, :, None].astype(np.float32)
    plan = optimize(A, ring, "widest", iterations=3)

    def full(*_: Any) -> None:
        raise OutOfMemory("no room")

    monkeypatch.setattr(split, "SplitSteps", full)
    with pytest.raises(OutOfMemory, match="no room"):
        optimize(A, ring, "widest", iterations=5, resume=plan)
    assert "free" not in optimize(A, ring, "widest", iterations=3).state, "a run that begins goes another way"


def test_the_example_of_the_documents_runs(capsys: pytest.CaptureFixture[str]) -> None:
    page = Path(__file__).resolve().parents[2] / "docs" / "best-light.md"
    for code in re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.S):
        exec(compile(code, str(page), "exec"), {})
    assert capsys.readouterr().out.startswith("no light whatever gives more than +0.")
