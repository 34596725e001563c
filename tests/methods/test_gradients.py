"""Gradients of every loss against finite differences, responses against their formulas, filters against theirs."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, MemoryNotice
from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.losses.band import Band
from vamgpu.methods import BCLP, LBFGS, GeneralizedLogistic, Interpolated, Linear, Logistic, optimize
from vamgpu.methods.ramp import capped_ramp, ramp
from vamgpu.methods.state import OptimizerState
from vamgpu.operators.projection import Projection

SHAPE = (12, 12, 12)
MEASURED = Interpolated((0.0, 0.3, 0.8, 1.5), (0.0, 0.1, 0.9, 1.0))
BANDS = [
    Band.thresholds(0.6, 0.9),
    Band.thresholds(0.6, 0.9, power=3.0),
    Band((0.0, 1.0), (0.05, 0.01), (1.0, 2.0), 3.0, 0.04, response=Logistic()),
    Band((0.0, 1.0), (0.1, 0.1), power=2.5, response=GeneralizedLogistic(-0.1, 1.2, 8.0, 0.4, 0.7)),
    Band((0.1, 0.9), (0.0, 0.0), power=2.0, response=MEASURED),
    Band((0.0, 1.0), (0.02, 0.02), power=4.0, response=Linear(1.3)),
]


def bench(device: str | Device = "numpy") -> OptimizerState:
    operator = Projection(Grid(SHAPE, 0.25), Beam(SHAPE[1:], 0.25), Turntable(16), device=device)
    rng = np.random.default_rng(2)
    return OptimizerState(operator, operator.device.upload(rng.random(SHAPE)), {})


@pytest.mark.parametrize("band", BANDS, ids=range(len(BANDS)))
@pytest.mark.parametrize("weighted", [False, True])
def test_the_gradient_by_light_is_the_slope_of_the_loss(band: Band, weighted: bool) -> None:
    state, rng = bench(), np.random.default_rng(7)
    light, way = rng.random(state.operator.range.shape) * 0.4, rng.normal(size=state.operator.range.shape)
    weight = state.device.upload(rng.random(SHAPE)) if weighted else None

    def loss(step: float) -> tuple[float, np.ndarray]:
        dose, gradient = state.volume(), state.sinogram()
        state.expose(state.device.upload(light + step * way), dose)
        value = state.loss(dose, replace(band, weight=weight))
        state.project(dose, gradient)
        return value, gradient.numpy()

    small = 1e-7
    slope = (loss(small)[0] - loss(-small)[0]) / (2 * small)
    assert slope == pytest.approx(np.vdot(loss(0.0)[1], way), rel=1e-3)


def test_the_price_of_light_has_the_right_slope(device: Device) -> None:
    state, rng = bench(device), np.random.default_rng(8)
    light = rng.random(state.operator.range.shape)
    gradient = device.upload(np.zeros_like(light))
    penalty = state.apply_penalty(device.upload(light), gradient, 0.3, 4.0, hold=False)
    assert penalty == pytest.approx(0.3 * np.sum(light**4), rel=1e-5)
    assert np.allclose(gradient.numpy(), 1.2 * light**3, rtol=1e-5, atol=1e-6)


def test_dark_light_is_held(device: Device) -> None:
    state = bench(device)
    shape = state.operator.range.shape
    light = np.where(np.arange(shape[0])[:, None, None] % 2, 0.0, 1.0) * np.ones(shape)
    slope = np.random.default_rng(9).normal(size=shape).astype(np.float32)
    gradient = device.upload(slope)
    state.apply_penalty(device.upload(light), gradient)
    assert np.array_equal(gradient.numpy(), np.where((light <= 0) & (slope > 0), 0.0, slope))


def test_responses_follow_their_formulas() -> None:
    doses = np.linspace(0.0, 2.9, 77)
    wanted = {
        Linear(2.0): 2.0 * doses,
        Logistic(10.0, 0.5): 1 / (1 + np.exp(-10 * (doses - 0.5))),
        GeneralizedLogistic(0.1, 0.9, 12.0, 0.6, 0.5): 0.1 + 0.8 / (1 + np.exp(-12 * (doses - 0.6))) ** 2,
        MEASURED: np.interp(doses, MEASURED.doses, MEASURED.values),
    }
    for response, values in wanted.items():
        curve = response.curve()
        position = (doses - curve.start) * curve.density
        cell = np.minimum(position.astype(int), len(curve.values) - 2)
        got = curve.values[cell] + (position - cell) * (curve.values[cell + 1] - curve.values[cell])
        assert np.abs(got - values).max() <= 1e-3
    with pytest.raises(BadInput, match="rising"):
        Interpolated((0.0, 0.0), (1.0, 2.0))
    for wrong in ({"low": 1.0, "high": 1.0}, {"middle": float("nan")}, {"high": float("inf")}):
        with pytest.raises(BadInput, match="low < high"):
            GeneralizedLogistic(**wrong)


def test_the_ramp_inverts_a_projection(fast_device: Device) -> None:
    n = 64
    operator = Projection(Grid((n, n, 1), 0.3), Beam((n, 1), 0.3, spread=0.0), Turntable(180), device=fast_device)
    x, y, _ = np.meshgrid(*operator.grid.axes(), indexing="ij")
    blob = np.exp(-((x - 1.0) ** 2 + (y + 2.0) ** 2) / 2.0)
    state = OptimizerState(operator, fast_device.upload(blob), {})
    projected, filtered, back = state.sinogram(), state.sinogram(), state.volume()
    state.project(state.target, projected)
    state.filter(projected, ramp(operator), filtered)
    state.expose(filtered, back)
    got = back.numpy()
    assert np.vdot(got, blob) / np.vdot(blob, blob) == pytest.approx(1.0, abs=0.02)
    assert np.abs(got - blob).max() <= 0.04


def test_a_full_cap_is_the_ramp() -> None:
    operator = bench().operator
    full, exact = capped_ramp(operator, 0.5).table.numpy(), ramp(operator).table.numpy()
    assert np.abs(full - exact).max() <= 0.01 * exact[0]


def test_the_history_shrinks_with_a_notice() -> None:
    operator = bench().operator
    target = bench().target
    size = 8 * int(np.prod(operator.range.shape))
    with pytest.warns(MemoryNotice, match="stops at 2 pairs"):
        short = optimize(operator, target, LBFGS(history=6, history_bytes=4 * size + 8), 8)
    assert short.history[-1].loss < short.history[0].loss
    with warnings.catch_warnings():
        warnings.simplefilter("error", MemoryNotice)
        two = optimize(operator, target, LBFGS(history=2), 8)
    assert np.array_equal(short.sinogram.numpy(), two.sinogram.numpy())


def test_a_price_on_bright_light_makes_it_even() -> None:
    operator, target = bench().operator, np.zeros(SHAPE)
    target[4:9, 3:8, 2:10] = 1.0

    def efficiency(penalty: float) -> float:
        light = optimize(operator, target, LBFGS(efficiency=penalty), 15).sinogram.numpy()
        return float(light.mean() / light.max())

    assert efficiency(0.5) > 1.2 * efficiency(0.0)


def test_weights_move_the_dose_where_they_are() -> None:
    operator, target = bench().operator, np.zeros(SHAPE)
    target[3:9, 3:9, 2:10] = 1.0
    target[4:6, 4:6] = 0.0
    heavy = np.ones(SHAPE)
    heavy[4:6, 4:6] = 20.0
    plain = optimize(operator, target, BCLP(response=Linear()), 15).dose().numpy()
    asked = optimize(operator, target, BCLP(response=Linear(), weight=heavy), 15).dose().numpy()
    assert asked[4:6, 4:6, 2:10].mean() < 0.8 * plain[4:6, 4:6, 2:10].mean()
