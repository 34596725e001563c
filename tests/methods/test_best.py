"""A run returns the best light it evaluated, says when it diverges, and spends no more than it may."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

import numpy as np
import pytest

from vamgpu.backend.device import Device
from vamgpu.errors import Diverged, DivergenceWarning, SamplingWarning
from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.methods import (
    BCLP,
    LBFGS,
    OSMO,
    FilteredBackProjection,
    GradientDescent,
    PenaltyMinimization,
    Plan,
    Recipe,
    optimize,
)
from vamgpu.methods.trajectory import LossTrajectory
from vamgpu.operators.projection import Projection
from vamgpu.operators.web import WebProjection
from vamgpu.optics.roller import Film, Roller
from vamgpu.targets.lattices import SheetGyroid
from vamgpu.units import mm
from vamgpu.web import WebGrid

SIZE = 16
METHODS: list[Any] = [
    Recipe(),
    OSMO(),
    GradientDescent(),
    GradientDescent(share=0.5, growth=1.2, momentum=0.5),
    PenaltyMinimization(),
    BCLP(),
    BCLP.paper_002(),
    BCLP(p=2.0, q=1.0),
    LBFGS(efficiency=0.1),
    FilteredBackProjection(),
]
each_method = pytest.mark.parametrize("method", METHODS, ids=lambda method: type(method).__name__)
untold = pytest.mark.filterwarnings("ignore::vamgpu.errors.DivergenceWarning")


@cache
def operator() -> Projection:
    return Projection(
        Grid((SIZE, SIZE, 2), 0.25), Beam((SIZE, 2), 0.25, spread=0.0), Turntable(24, lit_share=0.0), device="numpy"
    )


def part() -> np.ndarray:
    """A ring with a notch and a dot within."""
    x, y, _ = np.meshgrid(*[np.arange(n) - 0.5 * (n - 1) for n in (SIZE, SIZE, 2)], indexing="ij")
    radius = np.hypot(x, y)
    return np.where(((radius < 6) & (radius > 3) & ~((x > 0) & (abs(y) < 2))) | (radius < 1), 1.0, 0.0)


def window_of(light: Any) -> float:
    dose, inside = operator().T(light).numpy(), part() >= 0.5
    disc = np.broadcast_to(operator().grid.cylinder()[:, :, None], dose.shape)
    return float((dose[inside & disc].min() - dose[~inside & disc].max()) / dose[disc].max())


# ---- best light -------------------------------------------------------------------------------------------------
@untold
@each_method
def test_no_light_that_was_evaluated_is_better(method: Any) -> None:
    plan = optimize(operator(), part(), method, 14)
    assert plan.window == pytest.approx(window_of(plan.sinogram), abs=1e-12)
    if method.criterion == "window":
        assert plan.window >= max(step.window for step in plan.history) - 1e-12
    longer = [optimize(operator(), part(), method, k) for k in (14, 15, 16)]
    key = "window" if method.criterion == "window" else "loss"
    best = [plan.window if key == "window" else -min(s.loss for s in plan.history) for plan in longer]
    assert best == sorted(best)


@untold
@each_method
def test_a_record_is_of_the_light_held(method: Any) -> None:
    """The window recorded is that of light whose dose was never projected, found from what momentum looked at."""
    whole = optimize(operator(), part(), method, 9)
    makes = isinstance(method, (Recipe, OSMO, LBFGS, FilteredBackProjection))  # in the iteration that records it
    guarded = method.criterion == "loss" and not makes
    for count in range(1, len(whole.history)):
        light = optimize(operator(), part(), method, count).state["light"]
        step = whole.history[count - 1 if makes else count]
        if not guarded or step.loss < whole.history[count - 1].loss:  # else the light was taken back
            assert step.window == pytest.approx(window_of(light), abs=1e-9)


def test_where_the_last_light_is_worse_the_best_is_returned() -> None:
    with pytest.warns(DivergenceWarning):
        plan = optimize(operator(), part(), Recipe(), 40)
    windows = [step.window for step in plan.history]
    assert plan.best_iteration == 1 + int(np.argmax(windows)) < 40
    assert plan.window == pytest.approx(max(windows), abs=1e-12)
    assert plan.window > 0.0 > windows[-1] + 0.05  # the best light prints, the last one does not
    again = optimize(operator(), part(), Recipe(), plan.best_iteration)
    assert np.array_equal(plan.sinogram.numpy(), again.sinogram.numpy())


@untold
@pytest.mark.parametrize("method", [Recipe(), BCLP.paper_002()], ids=repr)
def test_a_resumed_run_knows_the_best_of_before(method: Any) -> None:
    whole = optimize(operator(), part(), method, 12)
    half = optimize(operator(), part(), method, 6)
    resumed = optimize(operator(), part(), method, 12, resume=half)
    assert resumed.best_iteration == whole.best_iteration and resumed.window == whole.window
    assert np.array_equal(resumed.sinogram.numpy(), whole.sinogram.numpy())
    assert optimize(operator(), part(), method, 6, resume=half) is half


@untold
@each_method
def test_looking_costs_one_pair_and_choosing_half_a_pair_at_most(method: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[str] = []
    for name in ("forward", "transposed"):
        plain = getattr(Projection, name)
        monkeypatch.setattr(
            Projection, name, lambda self, x, out, plain=plain, name=name: (calls.append(name), plain(self, x, out))[1]
        )
    plan = optimize(operator(), part(), method, 6)
    assert calls[:2] == ["forward", "transposed"] and calls[-1] == "transposed"
    choice = 0 if isinstance(method, Recipe | OSMO) else 1  # these offered their last light too: nothing is to be asked
    assert len(calls) == 2 + 2 * plan.evaluations + choice  # whether light reaches the part, the run, the choice


# ---- divergence -------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("method", [GradientDescent(share=0.5, growth=1.2), PenaltyMinimization(share=0.5, growth=2.0),
                                    BCLP(share=1.0, growth=2.0), BCLP(p=3.0, ridge=0.04, share=1.0, growth=2.0,
                                    momentum=0.9)], ids=repr)  # fmt: skip
def test_steps_that_raise_the_loss_are_taken_back(method: Any) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", SamplingWarning)
        plan = optimize(operator(), part(), method, 80)
    losses = np.array([step.loss for step in plan.history])
    assert (np.diff(losses) <= 1e-9 * losses[0]).all() and losses[-1] < 0.5 * losses[0]
    assert plan.dose().numpy().max() < 4.0


@dataclass(frozen=True)
class Bursting:
    """Offers light twice, then finds that its loss is no number."""

    losses: tuple[float, ...] = (3.0, 2.0, 2.5, float("nan"))
    papers: ClassVar[tuple[str, ...]] = ("none",)
    iterations: ClassVar[int] = 9
    cost: ClassVar[float] = 1.0
    criterion: ClassVar[Any] = "loss"

    def steps(self, state: Any) -> Any:
        for loss in self.losses:
            value = loss if loss < 9.0 else 0.0
            state.memory["light"] = state.device.upload(np.full(state.operator.range.shape, value))
            state.offer(loss, 0.1, 1)
            yield loss, 0.1


def test_a_loss_that_is_no_number_is_an_error_with_the_best_plan() -> None:
    with pytest.raises(Diverged, match="2 at iteration 2 to nan at iteration 4") as caught:
        optimize(operator(), part(), Bursting())
    plan = caught.value.plan
    assert isinstance(plan, Plan) and caught.value.iteration == 2 and plan.best_iteration == 2
    assert (plan.sinogram.numpy() == 2.0).all()
    with pytest.raises(Diverged) as caught:
        optimize(operator(), part(), Bursting((float("inf"),)))
    assert caught.value.plan is None


def test_a_runaway_ends_early_and_names_the_iteration() -> None:
    with pytest.warns(DivergenceWarning, match=r"iteration 3 to .* at iteration 5: the method diverged"):
        plan = optimize(operator(), part(), Bursting((3.0, 2.0, 1.0, 8.0, 4e3, 5e3)))
    assert len(plan.history) == 5 and plan.best_iteration == 3 and (plan.sinogram.numpy() == 1.0).all()


@pytest.mark.parametrize(
    ("losses", "risen", "blown"),
    [((5.0, 3.0, 1.0), False, False), ((5.0, 1.0, 2.9), False, False), ((5.0, 1.0, 3.1), True, False),
     ((1.0, 1.04), False, False), ((1.0, 1.06), True, False), ((1.0, 1100.0), True, True),
     ((100.0, 1e-6, 1e-3), False, False), ((1.0,), False, False), ((0.0, 0.0), False, False)],
)  # fmt: skip
def test_what_counts_as_divergence(losses: tuple[float, ...], risen: bool, blown: bool) -> None:
    trajectory = LossTrajectory(losses, 4)
    assert (trajectory.risen, trajectory.blown, trajectory.lost) == (risen, blown, False)
    assert trajectory.began == 5 + int(np.argmin(losses))


# ---- webs -------------------------------------------------------------------------------------------------------
def gyroid(device: Device) -> tuple[WebProjection, np.ndarray]:
    """A film of a sheet gyroid, coarse."""
    film = Film(thickness=3 * mm, resin_index=1.49, bath_index=1.33, absorption=0.22 / mm)
    web = Roller(radius=7.5 * mm, film=film, step=np.deg2rad(2.0))
    beam = web.beam(0.2, 1)
    grid = WebGrid((90, 15, 1), (web.advance, 0.2, 0.2))
    length, rho, z = np.meshgrid(*grid.axes(), indexing="ij")
    return WebProjection(grid, beam, web, device=device), np.where(SheetGyroid(cell=3.0)(length, rho, z) < 0, 1.0, 0.0)


def overlap(dose: np.ndarray, part: np.ndarray) -> float:
    """Intersection over union at the best threshold."""
    levels = np.quantile(dose, np.linspace(0, 1, 300))
    return max(((dose >= level) & part).sum() / ((dose >= level) | part).sum() for level in levels)


def test_bclp_does_not_run_away_on_a_web(fast_device: Device) -> None:
    A, solid = gyroid(fast_device)
    plan = optimize(A, solid, BCLP.paper_002(), 80)
    losses = [step.loss for step in plan.history]
    assert losses[-1] <= 1.05 * min(losses) < 0.2 * losses[0]
    assert overlap(plan.dose().numpy(), solid > 0.5) > 0.99
