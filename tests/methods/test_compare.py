"""Methods on equal terms: equal thresholds, equal projector evaluations."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from vamgpu.errors import BadInput
from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.methods import METHODS
from vamgpu.methods.compare import LABELS, at_thresholds, compared
from vamgpu.operators.projection import Projection

pytestmark = pytest.mark.filterwarnings("ignore::vamgpu.errors.DivergenceWarning")
A = Projection(Grid((12, 12, 2), 0.3), Beam((12, 2), 0.3, spread=0.0), Turntable(16), device="numpy")
PART = np.zeros((12, 12, 2))
PART[3:9, 3:6] = PART[7:9, 7:9] = 1.0


def test_every_method_is_compared() -> None:
    assert set(LABELS) == set(METHODS) - {"default"}
    assert all(isinstance(at_thresholds(name), METHODS[name]) for name in LABELS)


@pytest.mark.parametrize("name", LABELS)
def test_thresholds_are_those_asked_for(name: str) -> None:
    method = at_thresholds(name, 0.5, 0.8)
    asked = {"outside": 0.5, "inside": 0.8}
    held = {field.name: getattr(method, field.name) for field in fields(method) if field.name in asked}  # type: ignore[arg-type]
    assert held == asked or (name in ("bclp", "cal", "recipe", "fbp") and not held)
    if name in ("bclp", "cal"):
        assert method.response.middle == pytest.approx(0.65)  # type: ignore[attr-defined]


@pytest.mark.parametrize("budget", [4.0, pytest.param(11.0, marks=pytest.mark.slow), 20.0])
@pytest.mark.parametrize("name", LABELS)
def test_the_budget_is_kept_and_spent(name: str, budget: float) -> None:
    plan = compared(A, PART, name, budget)
    assert plan.evaluations == plan.history[-1].evaluations <= budget
    done = name == "fbp" or plan.history[-1].loss == 0.0 or plan.state.get("stuck")
    assert done or plan.evaluations > budget - plan.method.cost
    if name not in ("fbp", "lbfgs"):  # the line search ends where the budget does
        more = compared(A, PART, name, budget + 6.0, resume=plan)
        assert np.array_equal(more.sinogram.numpy(), compared(A, PART, name, budget + 6.0).sinogram.numpy())


def test_wrong_terms_are_refused() -> None:
    with pytest.raises(BadInput, match="to compare; there are ramp, lbfgs, bclp"):
        at_thresholds("magic")
    with pytest.raises(BadInput, match="expected 0 ≤ outside < inside"):
        at_thresholds("fbp", 0.9, 0.8)
