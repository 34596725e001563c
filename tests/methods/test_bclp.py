"""Band constraint Lp norm minimization with the choices of the roll-to-roll paper, its loss computed by hand."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from vamgpu import Beam, Film, Grid, Projection, Roller, Turntable
from vamgpu.backend.device import Device
from vamgpu.errors import DivergenceWarning
from vamgpu.methods import BCLP, Logistic, optimize
from vamgpu.methods.state import OptimizerState
from vamgpu.operators.web import WebProjection
from vamgpu.targets.lattices import SkeletalGyroid
from vamgpu.web import WebGrid

N = 12


def test_the_papers_choices_are_its_numbers() -> None:
    method = BCLP.paper_002()
    assert (method.p, method.slack, method.penalty, method.ridge) == (3.0, (0.05, 0.01), (1.0, 1.0), 0.04)
    assert method.momentum == 0.5 and method.q in (None, 3.0)
    assert method.response == Logistic(10.0, 0.5)


@pytest.mark.parametrize("fractional", [False, True])
def test_the_loss_is_the_papers_sum(device: Device, fractional: bool) -> None:
    """Σ max(0, |M − f| − ε)³ + 0.04·Σ M² over the cylinder, M logistic in the dose; and its slope by dose."""
    operator = Projection(Grid((N, N, N), 0.25), Beam((N, N), 0.25), Turntable(8), device=device)
    rng = np.random.default_rng(3)
    target = rng.random((N, N, N)) if fractional else (rng.random((N, N, N)) > 0.6).astype(float)
    dose = rng.random((N, N, N)) * 1.2
    state = OptimizerState(operator, device.upload(target), {})
    field = device.upload(dose)
    found = state.loss(field, BCLP.paper_002().band())

    place = np.arange(N) - 0.5 * (N - 1)
    near = (np.hypot(place[:, None], place) <= state.reach)[:, :, None]
    made = 1.0 / (1.0 + np.exp(-10.0 * (dose - 0.5)))
    slack = 0.05 + (0.01 - 0.05) * target
    excess = np.maximum(0.0, np.abs(made - target) - slack)
    assert found == pytest.approx(float(np.sum((excess**3 + 0.04 * made**2) * near)), rel=1e-4)
    slope = (3.0 * excess**2 * np.sign(made - target) + 2.0 * 0.04 * made) * 10.0 * made * (1.0 - made) * near
    apart = np.abs(field.numpy() - slope)
    assert apart.max() < 0.02 * np.abs(slope).max()  # the response is a line between its samples


def test_the_reference_run_is_its_numbers() -> None:
    method = BCLP.roll_to_roll()
    assert (method.p, method.q, method.penalty, method.share) == (3.0, 1.0, (1.0, 3.0), 0.01)
    assert (method.slack, method.ridge, method.momentum) == ((0.05, 0.01), 0.04, 0.5)
    assert method.response == Logistic(10.0, 0.5) and "couples" in method.coupling


def test_the_loss_of_the_reference_run_is_a_norm_of_means(device: Device) -> None:
    """(mean of w·max(0, |M − f| − ε)³)^(1/3) + 0.04·mean of M² over the cylinder; its slope by differences."""
    operator = Projection(Grid((N, N, N), 0.25), Beam((N, N), 0.25), Turntable(8), device=device)
    rng = np.random.default_rng(3)
    target, dose = (rng.random((N, N, N)) > 0.6).astype(float), rng.random((N, N, N)) * 1.2
    state = OptimizerState(operator, device.upload(target), {})
    place = np.arange(N) - 0.5 * (N - 1)
    near = np.broadcast_to((np.hypot(place[:, None], place) <= state.reach)[:, :, None], dose.shape)

    def wanted(dose: np.ndarray) -> float:
        made = 1.0 / (1.0 + np.exp(-10.0 * (dose - 0.5)))
        excess = np.maximum(0.0, np.abs(made - target) - np.where(target > 0.5, 0.01, 0.05))
        norm = np.mean((1.0 + 2.0 * target[near]) * excess[near] ** 3) ** (1.0 / 3.0)
        return float(norm + 0.04 * np.mean(made[near] ** 2))

    field = device.upload(dose)
    assert state.loss(field, BCLP.roll_to_roll().loss) == pytest.approx(wanted(dose), rel=1e-4)
    way, small = rng.standard_normal(dose.shape), 1e-5
    rise = (wanted(dose + small * way) - wanted(dose - small * way)) / (2.0 * small)
    assert np.sum(field.numpy() * way) == pytest.approx(rise, rel=0.02)


def test_the_reference_run_is_stable_for_400_iterations() -> None:
    """On the paper's film and roller, coarse: its loss never rises, and nothing tells of divergence."""
    roller = Roller(7.6, Film(3.0, 1.49, 1.33, 0.22), np.radians(3.0))
    layers, pitch = 15, 0.2
    grid = WebGrid((24, layers, 1), (roller.advance, pitch, pitch))
    poses = 24 + round(roller.map(grid).length / roller.advance) - 1
    A = WebProjection(grid, roller.beam(pitch, 1), roller, poses=poses, start=24.0 - poses)
    l, rho, z = grid.axes()  # noqa: E741 - the web's axis
    part = (SkeletalGyroid(6.0)(l[:, None, None], rho[:, None], z) < 0).astype(np.float32)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DivergenceWarning)
        plan = optimize(A, part, BCLP.roll_to_roll(), 400)
    losses = [step.loss for step in plan.history]
    assert len(losses) == 400 and losses[-1] < 0.5 * losses[0]
    assert (np.diff(losses) <= 1e-6).all()
