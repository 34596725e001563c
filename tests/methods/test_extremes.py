"""Targets and weights at the ends of what can be: an answer or a typed error, never NaN, never in silence."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, EmptyMesh, OpticsWarning, SamplingWarning
from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.kernels.update import linear
from vamgpu.losses.band import Band
from vamgpu.methods import BCLP, LBFGS, METHODS, OSMO, GradientDescent, PenaltyMinimization, optimize
from vamgpu.methods.state import OptimizerState
from vamgpu.operators.projection import Projection

SHAPE = (12, 12, 4)


def operator(device: str | Device = "numpy") -> Projection:
    return Projection(Grid(SHAPE, 0.25), Beam(SHAPE[1:], 0.25, spread=0.0), Turntable(12), device=device)


def block(value: float = 1.0) -> np.ndarray:
    part = np.zeros(SHAPE)
    part[4:8, 4:8, 1:3] = value
    return part


def disc() -> np.ndarray:
    return np.broadcast_to(operator().grid.cylinder()[:, :, None], SHAPE)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300, -1e300, 1.5, -0.5])
def test_a_target_that_is_no_fraction_is_refused(device: Device, value: float) -> None:
    target = block()
    target[5, 5, 1] = value
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(BadInput, match="the target reaches from"):
            optimize(operator(device), target, iterations=1)


def test_a_target_on_the_device_that_is_no_number_is_refused(device: Device) -> None:
    target = device.upload(block())
    device.launch(linear, a=np.inf, x=target, b=1.0, y=target, floor=-3e38, out=target)  # 0 · ∞ in the void
    with pytest.raises(BadInput, match="the target holds NaN or infinity"):
        optimize(operator(device), target, iterations=1)


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300, 1e13, -1.0])
def test_a_weight_that_cannot_be_used_is_refused(device: Device, value: float) -> None:
    weight = np.ones(SHAPE)
    weight[5, 5, 1] = value
    with pytest.raises(BadInput, match="the weight reaches from"):
        optimize(operator(device), block(), BCLP(weight=weight), 2)


@pytest.mark.parametrize(("value", "told"), [(0.0, "some above 0"), (1e-320, "float32 rounds to 0")])
def test_a_weight_of_nothing_is_refused(fast_device: Device, value: float, told: str) -> None:
    with pytest.raises(BadInput, match=told):
        optimize(operator(fast_device), block(), BCLP(weight=np.full(SHAPE, value)), 2)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: BCLP(penalty=(1e300, 1.0)),
        lambda: BCLP(slack=(np.nan, 0.0)),
        lambda: BCLP(ridge=1e300),
        lambda: BCLP(p=1e3),
        lambda: BCLP(share=1e400),
        lambda: PenaltyMinimization(penalty=(1.0, 1e300)),
        lambda: PenaltyMinimization(share=np.inf),
        lambda: GradientDescent(growth=np.inf),
        lambda: GradientDescent(share=np.nan),
        lambda: OSMO(gain=np.inf),
        lambda: LBFGS(efficiency=np.inf),
        lambda: LBFGS(power=1e3),
        lambda: Band((np.nan, 1.0), (0.0, 0.0)),
        lambda: optimize(operator(), block(), evaluations=0.0),
        lambda: optimize(operator(), block(), evaluations=float("nan")),
    ],
)
def test_numbers_that_would_leave_float32_are_refused(wrong: Any) -> None:
    with pytest.raises(BadInput):
        wrong()


def test_great_weights_still_give_light(fast_device: Device) -> None:
    plan = optimize(operator(fast_device), block(), BCLP(penalty=(1e11, 1e11), weight=np.full(SHAPE, 10.0)), 8)
    losses = [step.loss for step in plan.history]
    assert np.isfinite(losses).all() and losses[-1] < losses[0]
    assert np.isfinite(plan.sinogram.numpy()).all()


@pytest.mark.parametrize(
    "target", [np.zeros(SHAPE), block(0.4), np.where(disc(), 0.0, 1.0)], ids=["empty", "thin", "out"]
)
def test_a_target_without_a_voxel_to_judge_is_refused(device: Device, target: np.ndarray) -> None:
    with pytest.raises(EmptyMesh, match="is 0|at least half filled"):
        optimize(operator(device), target, iterations=1)


@pytest.mark.filterwarnings("ignore::vamgpu.errors.DivergenceWarning")
@pytest.mark.parametrize("method", sorted(set(METHODS) - {"default"}))
def test_a_target_without_a_void_is_answered(method: str) -> None:
    """Nothing can leak: the window is the least dose over the greatest."""
    plan = optimize(operator(), np.where(disc(), 1.0, 0.0), method, 4)
    dose = plan.dose().numpy()[disc()]
    assert plan.window == pytest.approx(dose.min() / dose.max(), abs=1e-9)
    assert np.isfinite([step.loss for step in plan.history]).all() and 0.0 < plan.window <= 1.0


@pytest.mark.filterwarnings("ignore::vamgpu.errors.DivergenceWarning")
@pytest.mark.parametrize("method", sorted(set(METHODS) - {"default"}))
def test_a_part_that_reaches_the_wall_is_answered_and_one_beyond_it_told(fast_device: Device, method: str) -> None:
    A, touching = operator(fast_device), np.zeros(SHAPE)
    touching[:, 5:7] = 1.0
    touching *= disc()
    with warnings.catch_warnings():
        warnings.simplefilter("error", OpticsWarning)
        warnings.simplefilter("ignore", SamplingWarning)
        plan = optimize(A, touching, method, 3)
    assert np.isfinite(plan.sinogram.numpy()).all() and -1.0 <= plan.window <= 1.0
    beyond = touching.copy()
    beyond[:2, :2] = 1.0
    with pytest.warns(OpticsWarning, match=r"17 % of the target is farther than 1\.375 mm"):
        out = optimize(A, beyond, method, 3)
    assert np.isfinite(out.sinogram.numpy()).all() and np.isfinite([s.loss for s in out.history]).all()


def test_light_that_reaches_nothing_is_the_worst() -> None:
    state = OptimizerState(operator(), operator().device.upload(block()), {})
    for value in (0.0, -1.0):
        assert state.window(state.device.upload(np.full(SHAPE, value)))[0] == -1.0
