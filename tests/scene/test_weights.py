"""What bodies ask for moves the dose there, in every method, or the method says that it does not take it."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.errors import BadInput
from vamgpu.losses import Band
from vamgpu.methods import METHODS, Descent
from vamgpu.targets.limits import Limits

PITCH, SHAPE = 0.15, (32, 32, 2)
ITERATIONS = {"fbp": 1}
LOSS = Descent(Band((0.0, 1.0), (0.5, 0.05)), history=5)
HOW: dict[str, Any] = {**{name: name for name in METHODS}, "loss of one's own": LOSS}
UNWEIGHTED = {"fbp", "osmo", "recipe"}
FIRST = ("ramp", "osmo", "loss of one's own")
"""Methods that are tried by default; the others with -m slow."""


def each(names: set[str]) -> list[Any]:
    return [pytest.param(name, marks=[pytest.mark.slow] * (name not in FIRST)) for name in sorted(names)]


def rod(radius: float, x: float = 0.0, y: float = 0.0) -> Any:
    """An upright rod without ends."""
    return lambda a, b, c: np.hypot(a - x, b - y) - radius + 0.0 * c


SQUARE = vam.Body(lambda x, y, z: np.maximum(np.abs(x), np.abs(y)) - 1.0 + 0 * z, name="square")


def target_of(*bodies: vam.Body) -> tuple[vam.Target, Limits]:
    target = vam.Scene(bodies).target(pitch=PITCH, shape=SHAPE, device="numpy")
    assert target.limits is not None
    return target, target.limits


def solved(method: str, target: vam.Target) -> np.ndarray:
    """Dose [x, y, z] in units of the part's."""
    A = vam.Projection(target.grid, vam.Beam((32, 2), PITCH), vam.Turntable(48), None, "numpy")
    return vam.optimize(A, target, HOW[method], ITERATIONS.get(method, 25)).dose().numpy()


def error(method: str, role: str, dose: float, weight: float) -> float:
    """How wrong the dose of a rod inside a square is on average, over what is asked of it."""
    target, limits = target_of(SQUARE, vam.Body(rod(0.35, 0.3, 0.2), role, dose=dose, weight=weight))
    off = solved(method, target)[limits.body == 1] / dose - 1.0
    return float(np.mean(np.abs(off) if role == "gray" else np.maximum(off, 0.0)))


@pytest.mark.parametrize(("role", "dose"), [("keep out", 0.1), pytest.param("gray", 0.5, marks=pytest.mark.slow)])
@pytest.mark.parametrize("method", each(set(HOW) - UNWEIGHTED))
def test_a_heavier_body_comes_nearer_to_what_is_asked_of_it(method: str, role: str, dose: float) -> None:
    light, heavy = (error(method, role, dose, weight) for weight in (1.0, 16.0))
    assert heavy < 0.9 * light


@pytest.mark.parametrize("method", sorted(UNWEIGHTED))
def test_methods_without_weights_say_which_take_them(method: str) -> None:
    able = ", ".join(name for name in METHODS if name not in UNWEIGHTED)
    with pytest.raises(BadInput, match=re.escape(f"one of these methods: {able}, or your own loss")):
        error(method, "keep out", 0.5, 2.0)


@pytest.mark.parametrize("method", each(set(HOW)))
def test_the_body_of_higher_priority_has_the_dose_of_what_it_shares(method: str) -> None:
    asked: dict[str, Any] = {"role": "gray", "dose": 0.4}
    doses = []
    for priority in (-1.0, 1.0):
        target, _ = target_of(SQUARE, vam.Body(rod(0.45, 0.9), priority=priority, **asked))
        x, y, _ = target.grid.axes()
        both = (np.hypot(x[:, None] - 0.9, y) < 0.4) & (np.abs(x[:, None]) < 0.95)
        dose = solved(method, target)
        doses.append(float(dose[both].mean() / dose[np.hypot(x[:, None] + 0.4, y) < 0.4].mean()))
    assert doses[1] < 0.85 * doses[0]


@pytest.mark.parametrize("method", sorted(HOW))
def test_a_gray_body_beside_a_part_gets_its_share_of_the_parts_dose(method: str) -> None:
    target, limits = target_of(vam.Body(rod(0.6, -0.8)), vam.Body(rod(0.5, 0.8), "gray", dose=0.6))
    dose = solved(method, target)
    assert dose[limits.body == 1].mean() / dose[limits.body == 0].mean() == pytest.approx(0.6, abs=0.15)
