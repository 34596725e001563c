"""Band constraint Lp norm minimization with the choices of the roll-to-roll paper, its loss computed by hand."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from vamgpu import Beam, Film, Grid, Projection, Roller, Turntable
from vamgpu.backend.device import Device
from vamgpu.errors import DivergenceWarning
from vamgpu.losses import Loss
from vamgpu.methods import BCLP, Logistic, optimize
from vamgpu.methods.state import OptimizerState
from vamgpu.operators.web import WebProjection
from vamgpu.targets.lattices import SheetGyroid, SkeletalGyroid
from vamgpu.web import WebGrid
from vamgpu.webs.proof import prove_web
from vamgpu.webs.stream import Stream

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


ROLLER = Roller(7.6, Film(3.0, 1.49, 1.33, 0.22), np.radians(3.0))


def web(design: SheetGyroid | SkeletalGyroid, columns: int) -> tuple[WebProjection, np.ndarray]:
    """A design on the roll-to-roll paper's film and roller, coarse."""
    layers, pitch = 15, 0.2
    grid = WebGrid((columns, layers, 1), (ROLLER.advance, pitch, pitch))
    poses = columns + round(ROLLER.map(grid).length / ROLLER.advance) - 1
    A = WebProjection(grid, ROLLER.beam(pitch, 1), ROLLER, poses=poses, start=float(columns - poses))
    l, rho, z = grid.axes()  # noqa: E741 - the web's axis
    return A, (design(l[:, None, None], rho[:, None], z) < 0).astype(np.float32)


def test_apart_from_its_power_a_norm_has_the_same_minimum() -> None:
    """Where the slope of the coupled loss is 0, so is that of the loss with q = p."""
    A, part = web(SkeletalGyroid(6.0), 24)
    method = BCLP.roll_to_roll()
    state = OptimizerState(A, A.device.upload(part), {})
    dose = np.random.default_rng(5).random(part.shape)

    def slope(loss: Loss) -> tuple[float, np.ndarray]:
        field = A.device.upload(dose)
        return state.loss(field, loss), np.asarray(field, np.float64)

    excess = slope(replace(method, q=None, ridge=0.0).loss)[0] / part.size
    coupled, alone = slope(method.loss)[1], slope(method.apart(excess).loss)[1]
    scale = (coupled * alone).sum() / (alone * alone).sum()
    assert np.abs(coupled - scale * alone).max() < 1e-3 * np.abs(coupled).max()
    assert method.apart(excess).ridge == pytest.approx(3.0 * method.ridge * excess ** (2.0 / 3.0))
    assert method.apart(excess).coupling == "" and BCLP.paper_002().apart(excess) == BCLP.paper_002()


@pytest.mark.slow
@pytest.mark.parametrize(("method", "iterations"), [(BCLP.roll_to_roll(), 120), (BCLP.paper_002(), 60)])
def test_a_stream_reaches_the_authors_overlap(method: BCLP, iterations: int, tmp_path: Path) -> None:
    """Their dose of a sheet gyroid has an IoU of 0.9986, of another cell on finer voxels; ours in five segments."""
    A, part = web(SheetGyroid(6.0), 32)
    job = Stream(
        part, ROLLER, A.beam, method=method, section=(15, 1), pitch=A.grid.edges, core=0.3, iterations=iterations,
        device=A.device,
    )  # fmt: skip
    folder = job.write(tmp_path / "web.vam")
    assert len(folder.segments) == 5
    pieces = list(prove_web(folder, device=A.device).pieces())
    assert overlap(*(np.concatenate([getattr(piece, name) for piece in pieces]) for name in ("dose", "target"))) > 0.998


def test_a_reference_run_that_was_stopped_goes_on_with_the_same_regularization(tmp_path: Path) -> None:
    A, part = web(SheetGyroid(6.0), 32)

    def stop(done: int, of: int | None) -> None:
        if done == 2:
            raise InterruptedError

    def job() -> Stream:
        return Stream(
            part, ROLLER, A.beam, method=BCLP.roll_to_roll(), section=(15, 1), pitch=A.grid.edges, core=0.3,
            iterations=8, length=32 * ROLLER.advance, device=A.device,
        )  # fmt: skip

    whole = job().write(tmp_path / "whole.vam")
    with pytest.raises(InterruptedError):
        job().write(tmp_path / "web.vam", progress=stop)
    assert np.array_equal(job().write(tmp_path / "web.vam").read("frames", 0, whole.frames),
                          whole.read("frames", 0, whole.frames))  # fmt: skip
    one = job()
    loss = one.alone(3, whole.details["frames"]["scale"]).loss
    assert loss == pytest.approx(whole.segments[3].loss) and one.solver.norm is None  # type: ignore[union-attr]


def overlap(dose: np.ndarray, inside: np.ndarray) -> float:
    """IoU at the best of all thresholds."""
    order = np.argsort(dose, axis=None)[::-1]
    hit = np.cumsum(inside.ravel()[order])
    return float((hit / (np.arange(dose.size) + 1 + inside.sum() - hit)).max())


@pytest.mark.slow
def test_the_reference_run_is_stable_for_400_iterations() -> None:
    """On the paper's film and roller, coarse: its loss never rises, and nothing tells of divergence."""
    A, part = web(SkeletalGyroid(6.0), 24)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DivergenceWarning)
        plan = optimize(A, part, BCLP.roll_to_roll(), 400)
    losses = [step.loss for step in plan.history]
    assert len(losses) == 400 and losses[-1] < 0.5 * losses[0]
    assert (np.diff(losses) <= 1e-6).all()
