"""The bound of the window and PDHG, against the optimum that linear programming finds and certifies."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from widest import entries_of, widest

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.methods import METHODS, Tolerances, bound, optimize
from vamgpu.methods.pdhg import PDHG
from vamgpu.operators.projection import Projection
from vamgpu.optics.vial import Vial

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
    return entries_of(operator("numpy"))


def optimum(entries: Any, inside: np.ndarray, near: np.ndarray) -> float:
    return widest(entries[inside & near], entries[~inside & near])


def strict(entries: Any, light: np.ndarray, inside: np.ndarray, near: np.ndarray) -> float:
    dose = entries @ light.reshape(-1)
    return float((dose[inside & near].min() - dose[~inside & near].max()) / dose[near].max())


def circle() -> np.ndarray:
    x, y = np.meshgrid(*2 * [np.arange(SIZE) - 0.5 * (SIZE - 1)], indexing="ij")
    return (np.hypot(x, y) <= 0.5 * (SIZE - 1) * (1.0 + 1e-6)).ravel()


@pytest.mark.parametrize("name", ["cross", *(pytest.param(name, marks=pytest.mark.slow) for name in ("ring", "bars"))])
@pytest.mark.slow
def test_it_comes_near_the_optimum_and_never_beyond(fast_device: Device, entries: Any, name: str) -> None:
    inside, near = part(name), circle()
    plan = optimize(operator(fast_device), inside[:, :, None].astype(np.float32), PDHG(), evaluations=1000)
    top, found = optimum(entries, inside.ravel(), near), strict(entries, plan.sinogram.numpy(), inside.ravel(), near)
    assert plan.window == pytest.approx(found, abs=2e-5)
    assert 0.98 * top < found <= top + 2e-5, found / top
    assert plan.evaluations <= 1000


def test_every_device_takes_the_same_way(device: Device) -> None:
    target = part("cross")[:, :, None].astype(np.float32)
    windows = [
        [step.window for step in optimize(operator(where), target, PDHG(), 12).history] for where in (device, "numpy")
    ]
    assert windows[0] == pytest.approx(windows[1], abs=2e-4)


@pytest.mark.parametrize("name", ["ring", *(pytest.param(name, marks=pytest.mark.slow) for name in PARTS[1:])])
def test_the_bound_is_just_above_the_optimum(fast_device: Device, entries: Any, name: str) -> None:
    inside, near = part(name), circle()
    A, target = operator(fast_device), inside[:, :, None].astype(np.float32)
    top, found = optimum(entries, inside.ravel(), near), bound(A, target, evaluations=1500)
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


@pytest.mark.parametrize("name", ["cross", pytest.param("bars", marks=pytest.mark.slow)])
@pytest.mark.slow
def test_a_bound_in_a_vial_is_just_above_what_light_has(fast_device: Device, name: str) -> None:
    """There the part can have the greatest dose everywhere, and its own prices come to less than those outside."""
    radius = 0.5 * SIZE * PITCH / 0.79 * 1.5
    vial = Vial(radius, radius / 12.4, resin_index=1.5, wall_index=1.473, bath_index=1.0, absorption=0.6 / radius)
    A = Projection(Grid((SIZE, SIZE, 1), PITCH), Beam((32, 1), PITCH), Turntable(30), vial, fast_device)
    plan = optimize(A, part(name)[:, :, None].astype(np.float32), PDHG(), evaluations=1000)
    assert plan.bound is not None and plan.window <= plan.bound.value <= 1.025 * plan.window
    assert (np.asarray(A(plan.bound.prices.numpy())) >= -1e-6).all()


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
    first = optimize(A, target, PDHG(), 59)
    assert first.bound is None
    with pytest.raises(BadInput, match="63"):
        bound(A, target, evaluations=62)
    second = optimize(A, target, PDHG(), 70, resume=first)
    third = optimize(A, target, PDHG(), 75, resume=second)
    whole = optimize(A, target, PDHG(), 75)
    assert third.history == whole.history and third.evaluations == whole.evaluations == 76
    assert third.bound is not None and whole.bound is not None and third.bound.value == whole.bound.value
    said = third.bound.statement(third)
    where = f"{SIZE} × {SIZE} × 1 voxels of {1e3 * PITCH:g} µm, turning while lit for 1 of each step"
    assert said.startswith(f"no patterns give more than +{third.bound.value:.3f} on {where}; this one has ")
    assert where in repr(third.bound)
    assert said.endswith(f"({100 * third.window / third.bound.value:.0f} %)")


@pytest.mark.filterwarnings("ignore:31 % of the target")
def test_a_part_without_a_void_has_a_bound(fast_device: Device) -> None:
    full = np.ones((SIZE, SIZE, 1), np.float32)
    found = bound(operator(fast_device), full, evaluations=120)
    plan = optimize(operator(fast_device), full, "recipe")
    assert plan.window <= found.value
    assert_certified(found.prices.numpy(), full[:, :, 0] > 0, circle(), found.value)


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
    assert plan.window > 0.05
    assert dose[:, :, 5 + deep :].max() < threshold and dose[:, :, :3].max() < threshold


def test_a_bound_of_slices_counts_the_point_spread_of_its_beam() -> None:
    """That of half a pixel, unless told otherwise, takes light of the next rows to a slice."""
    upper, lower = part("cross"), part("ring")
    solid = np.stack([lower] * 3 + [upper] * 3, axis=2).astype(np.float32)
    A = Projection(Grid((SIZE, SIZE, 6), PITCH), Beam((30, 10), PITCH), Turntable(30))
    plan = optimize(A, solid, PDHG(), evaluations=150)
    assert plan.window <= bound(A, solid, evaluations=150, slices=(2, 4)).value
    same = Projection(A.grid, Beam((30, 10), PITCH, spread=0.5 * PITCH), A.motion)
    assert bound(A, solid, evaluations=70, slices=(2, 4)).value == pytest.approx(
        bound(same, solid, evaluations=70, slices=(2, 4)).value, abs=1e-3
    )


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"evaluations": "many"}, "evaluations is 'many'"), ({"slices": 5}, "two whole numbers"),
        ({"slices": (0.0, 1.0)}, "two whole numbers"), ({"slices": (0, 9)}, "expected 0 ≤ first < behind ≤ 1"),
        ({"tolerances": 0.1}, "tolerances are 0.1"),
    ],
)  # fmt: skip
def test_what_a_bound_cannot_take_is_named(given: dict[str, Any], said: str) -> None:
    with pytest.raises(BadInput, match=said):
        bound(operator("numpy"), part("ring")[:, :, None].astype(np.float32), **given)


@pytest.mark.slow
def test_a_bound_at_all_corners_is_just_above_what_light_has(fast_device: Device) -> None:
    off = Tolerances(axis=0.25 * PITCH, spread=(0.5 * PITCH, PITCH))
    A, target = operator(fast_device), part("cross")[:, :, None].astype(np.float32)
    plan = optimize(A, target, PDHG(), evaluations=3000, tolerances=off)
    assert plan.bound is not None and plan.window <= plan.bound.value <= 1.3 * plan.window
    assert (np.asarray(off.scenarios(A)(plan.bound.prices.numpy())) >= -1e-6).all()
    assert optimize(A, target, iterations=20, tolerances=off).window < plan.bound.value


@pytest.mark.slow
def test_the_example_of_the_documents_runs(capsys: pytest.CaptureFixture[str]) -> None:
    page = Path(__file__).resolve().parents[2] / "docs" / "best-light.md"
    for code in re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.S):
        exec(compile(code, str(page), "exec"), {})
    assert capsys.readouterr().out.startswith("no patterns give more than +0.")
