"""Light of two colors through the kinetics: the step against the equations, the adjoint against finite differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from widest import entries_of, widest

import vamgpu
from vamgpu.backend.device import Device
from vamgpu.chemistry.kinetics import advance
from vamgpu.chemistry.species import LightCycle, Rates, SpeciesState
from vamgpu.errors import BadInput, Cancelled, DeviceError, ShapeMismatch
from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.kernels.inhibition import inhibition_step
from vamgpu.methods.dual import Colors, superpose
from vamgpu.methods.joint import (
    ColorPlan,
    KineticModel,
    LinearModel,
    LossWeights,
    Pair,
    TwoColorResin,
    optimize_colors,
)
from vamgpu.methods.joint.rule import ThroughKinetics
from vamgpu.methods.joint.run import EffectiveContrast
from vamgpu.methods.state import OptimizerState
from vamgpu.operators.pose_runs import PoseRuns
from vamgpu.operators.projection import Projection
from vamgpu.optics.vat import Vat

PITCH = 0.1
RATES = Rates(k_a=1 / 30, k_b=0.2138 / 30, k_c=1 / 30, k_2=0.43, supply=5.0)


def both(shape: tuple[int, int, int], poses: int, device: str | Device) -> tuple[Projection, Projection]:
    """Operators of both colors in a vat that absorbs them unlike; a sharp lens keeps light within few slices."""
    beam, radius = Beam((shape[0], shape[2]), PITCH, spread=0.0), 0.5 * shape[0] * PITCH
    vats = (Vat(2.0 * radius, radius=radius, absorption=mu) for mu in (0.05, 0.1))
    visible, ultraviolet = (
        Projection(Grid(shape, PITCH), beam, Turntable(poses, lit_share=0), vat, device) for vat in vats
    )
    return visible, ultraviolet


def stepped(resin: TwoColorResin, visible: float, ultraviolet: float, seconds: float, steps: int) -> np.ndarray:
    """[A], [B], [C] and X after constant exposures that arrive in equal steps."""
    state = [np.full((1, 1, 1), value) for value in (1.0, 0.0, resin.supply, 0.0)]
    for _ in range(steps):
        inhibition_step.definition(
            np.full((1, 1, 1), visible / steps), np.full((1, 1, 1), ultraviolet / steps), resin.visible,
            resin.ultraviolet, resin.cross, resin.alpha, resin.pairing * seconds / steps, resin.floor, *state, *state,
        )  # fmt: skip
    return np.array([part.item() for part in state])


def plain(**values: float) -> TwoColorResin:
    return TwoColorResin(**{"visible": 1.0, "ultraviolet": 0.2, "supply": 5.0, "alpha": 0.2138, **values})


@pytest.mark.parametrize("pairing", [0.0, 0.43])
def test_steps_converge_to_the_equations(pairing: float) -> None:
    """Second order in the step, first in the floor: against eqs 5-6 with C of first order, before the event."""
    seconds, visible, ultraviolet = 30.0, 0.7, 1.5
    rates = Rates(1 / 30, 0.2138 / 30, 1.0, pairing, supply=5.0, order=1)
    resin = plain(pairing=pairing, floor=1e-7)
    light = LightCycle([visible], [resin.ultraviolet * 5.0 * ultraviolet / 30.0], [seconds])
    end = advance(rates, SpeciesState(1.0, 0.0, 5.0), light, tolerance=1e-10, device="numpy")
    exact = np.array([values[0, 0] for values in (end.a, end.b, end.c)])
    errors = [np.abs(stepped(resin, visible, ultraviolet, seconds, n)[:3] - exact).max() for n in (50, 100, 200)]
    assert errors[2] < 1e-4
    assert errors[0] / errors[1] > 3.5 and errors[1] / errors[2] > 3.5
    floors = [stepped(replace(resin, floor=f), visible, ultraviolet, seconds, 640)[:3] for f in (0.04, 0.02, 0.01)]
    gaps = [np.abs(f - exact).max() for f in floors]
    assert gaps[0] > 1.7 * gaps[1] > 1.7**2 * gaps[2]


def test_nothing_is_lost_and_nothing_is_negative() -> None:
    resin = plain(pairing=0.5, cross=0.01)
    rng = np.random.default_rng(3)
    shape = (6, 5, 4)
    state = [rng.random(shape), rng.random(shape), rng.random(shape), np.zeros(shape)]
    before = [part.copy() for part in state]
    visible, ultraviolet = rng.random(shape) * 3.0, rng.random(shape) * 9.0
    inhibition_step.definition(
        visible, ultraviolet, 1.0, 0.2, 0.01, resin.alpha, 0.7, resin.floor, *state, *state)  # fmt: skip
    assert all((part >= 0.0).all() for part in state)
    exposure = visible + 0.01 * ultraviolet
    given = (before[1] + 2 * before[2] - state[1] - 2 * state[2]) / resin.alpha
    assert np.abs(before[0] - state[0] + given + state[3] - exposure).max() <= 1e-12


def test_without_ultraviolet_the_effective_dose_is_the_dose(device: Device) -> None:
    A, B = both((16, 16, 4), 12, device)
    resin = TwoColorResin(11.0, 0.2, 3.0, 0.5, pairing=0.1)
    rng = np.random.default_rng(5)
    light = Pair(device.upload(rng.random(A.range.shape)), device.upload(np.zeros(B.range.shape)))
    models = KineticModel(A, B, resin, 3, period=10.0, runs=5), LinearModel(A, B, resin, 3)
    kinetic, line = (model.expose(light).numpy() for model in models)
    assert np.abs(kinetic - line).max() <= 2e-5 * np.abs(line).max()
    assert line.max() > 1.2


def test_runs_of_poses_add_up_to_the_turn(device: Device) -> None:
    for poses, count in ((24, 6), (22, 4), (12, 12)):
        A, _ = both((16, 16, 6), poses, device)
        straight = Projection(A.grid, A.beam, A.motion, device=device)
        for operator in (A, straight):
            rng = np.random.default_rng(1)
            light, volume = device.upload(rng.random(A.range.shape)), device.upload(rng.random(A.domain.shape))
            runs, part, projected = PoseRuns(operator, count), device.empty(A.domain.shape), device.empty(A.range.shape)
            total = np.zeros(A.domain.shape)
            for run in range(count):
                runs.expose(run, light, part)
                total += part.numpy()
                runs.project(run, volume, projected)
            dose, wanted = operator.T(light).numpy(), operator(volume).numpy()
            assert np.abs(total - dose).max() <= 1e-5 * dose.max()
            assert np.abs(projected.numpy() - wanted).max() <= 1e-5 * wanted.max()


def loss_of(dose: np.ndarray, part: np.ndarray) -> np.ndarray:
    return np.where(part, np.maximum(1.25 - dose, 0.0) ** 2, np.maximum(dose - 0.6, 0.0) ** 2)


def slope_of(dose: np.ndarray, part: np.ndarray) -> np.ndarray:
    return np.where(part, -2.0 * np.maximum(1.25 - dose, 0.0), 2.0 * np.maximum(dose - 0.6, 0.0))


def test_the_adjoint_agrees_with_finite_differences(device: Device) -> None:
    """20 random pixels of both colors at 32³ through three turns with depletion, pairing and cross-reactivity.

    No two of them share a slice, so that one pair of exposures gives all differences: slices do not know one another.
    """
    n, poses, count = 32, 20, 20
    A, B = both((n, n, n), poses, device)
    rng = np.random.default_rng(0)
    light = [rng.random(A.range.shape), rng.random(A.range.shape)]
    means = [float(op.T(device.upload(part)).numpy().mean()) for op, part in zip((A, B), light, strict=True)]
    resin = TwoColorResin(0.5 / means[0], 0.3 / means[1], 1.0, 0.8, 0.02, 0.02 / means[1])
    model = KineticModel(A, B, resin, 3, period=20.0, runs=5)
    x, y, _ = np.meshgrid(*A.grid.axes(), indexing="ij")
    part = (np.hypot(x, y) < 1.0) & (np.hypot(x - 0.25, y) > 0.4)

    def exposed(values: list[np.ndarray]) -> np.ndarray:
        return model.expose(Pair(*map(device.upload, values))).numpy().astype(np.float64)

    dose = exposed(light)
    assert dose.max() > 1.25  # beyond the event, which the floor makes smooth
    gradient = [g.numpy() for g in model.gradient(device.upload(slope_of(dose, part)))]
    color, pose, column = rng.integers(0, 2, count), rng.integers(0, poses, count), rng.integers(7, 25, count)
    row = rng.permutation(n)[:count]
    small, sums = (1e-4 if device.name == "numpy" else 0.05), []
    for side in (small, -small):
        moved = [values.copy() for values in light]
        for k in range(count):
            moved[color[k]][pose[k], column[k], row[k]] += side
        sums.append(loss_of(exposed(moved), part).sum(axis=(0, 1))[row])
    slopes = (sums[0] - sums[1]) / (2.0 * small)
    found = np.array([gradient[color[k]][pose[k], column[k], row[k]] for k in range(count)])
    assert np.abs(slopes / found - 1.0).max() <= (1e-6 if device.name == "numpy" else 1e-3)


def test_the_linear_gradient_is_the_slope() -> None:
    A, B = both((12, 12, 4), 8, "numpy")
    model, rng = LinearModel(A, B, plain(), 2), np.random.default_rng(2)
    way = Pair(*(A.device.upload(rng.normal(size=A.range.shape)) for _ in range(2)))
    slope = A.device.upload(rng.normal(size=A.domain.shape))
    by_light = model.gradient(slope)
    change = sum(np.vdot(g.numpy(), w.numpy()) for g, w in zip(by_light, way, strict=True))
    assert change == pytest.approx(np.vdot(model.expose(way).numpy(), slope.numpy()), rel=1e-10)


def part_of(grid: Grid) -> np.ndarray:
    """A disc with two holes and a slot."""
    x, y, _ = np.meshgrid(*grid.axes(), indexing="ij")
    holes = (np.hypot(x - 0.4, y) > 0.3) & (np.hypot(x + 0.5, y - 0.2) > 0.2) & (np.abs(y + 0.8) > 0.1)
    return ((np.hypot(x, y) < 1.3) & holes).astype(float)


@pytest.mark.slow
def test_both_colors_through_the_kinetics_beat_the_linear_model() -> None:
    """Judged by the kinetics; B pairs up fast, so that the linear model counts on light that is long forgotten."""
    A, B = both((40, 40, 4), 40, vamgpu.devices()[0])
    target, weights = part_of(A.grid), LossWeights(0.7, 1.4, 1.6)
    model = KineticModel(A, B, TwoColorResin.of(RATES, A, B), 3, period=10.0, runs=8)
    found = optimize_colors(model, target, weights, 30)
    line = optimize_colors(LinearModel(A, B, model.resin, 3), target, weights, 30)
    dark = optimize_colors(model, target, replace(weights, share=0.0), 25)
    joint, linear, single = found.contrast(), line.contrast(model), dark.contrast()
    assert joint.window > linear.window + 0.05 > single.window + 0.1
    assert joint.bulk > linear.bulk and joint.overcured == joint.uncured == 0.0
    assert line.contrast().window > linear.window  # it promises more than it keeps
    assert (
        np.abs(LinearModel(A, B, model.resin, 3).expose(found.light).numpy() - found.effective_dose().numpy()).max()
        > 0.1
    )
    assert min(found.visible.numpy().min(), found.ultraviolet.numpy().min()) >= 0.0
    assert dark.ultraviolet.numpy().max() == 0.0
    assert found.history[-1].loss < 0.1 * found.history[0].loss  # the first is that of the linear model's light
    # from the light of the linear model, which stays as it is, it goes on
    kept = line.visible.numpy()
    again = optimize_colors(model, target, weights, 12, start=line)
    assert again.history[-1].loss < again.history[0].loss and np.array_equal(line.visible.numpy(), kept)


def test_a_stopped_run_goes_on_bit_by_bit(device: Device) -> None:
    A, B = both((12, 12, 2), 12, device)
    target = part_of(A.grid)
    model = KineticModel(A, B, TwoColorResin.of(RATES, A, B), 2, period=10.0, runs=4)
    whole, seen = optimize_colors(model, target, iterations=7, warm=2), []
    with pytest.raises(Cancelled, match="resume=") as stopped:
        optimize_colors(model, target, warm=2, progress=seen.append, cancel=lambda: len(seen) == 3)
    part = stopped.value.plan
    assert isinstance(part, ColorPlan) and len(part.history) == 3
    kept = [light.numpy().copy() for light in part.light]
    again = optimize_colors(model, target, iterations=7, resume=part)
    assert again.history == whole.history and again.best_iteration == whole.best_iteration
    for found, wanted, before, now in zip(again.light, whole.light, kept, part.light, strict=True):
        assert np.array_equal(found.numpy(), wanted.numpy()) and np.array_equal(before, now.numpy())
    assert again.seconds > part.seconds
    with pytest.raises(BadInput, match="for a new run"):
        optimize_colors(model, target, LossWeights(0.7), resume=part)
    with pytest.raises(BadInput, match="one"):
        optimize_colors(model, target, start=part, resume=part)


def test_gains_follow_from_rates() -> None:
    """An evenly lit voxel at the axis sees the fluence of one pixel for each pose."""
    A, B = both((32, 32, 2), 16, "numpy")
    resin = TwoColorResin.of(RATES, A, B, floor=1e-4)
    light = Pair(A.device.upload(np.full(A.range.shape, 0.1)), A.device.upload(np.zeros(B.range.shape)))
    dose = KineticModel(A, B, resin, 1, period=10.0, runs=4).expose(light).numpy()[15:17, 15:17].mean()
    fluence = 16 * 0.1 * np.exp(-0.05 * 1.6)  # mJ/mm², through half the vat
    assert dose == pytest.approx(RATES.k_a * fluence, rel=5e-3)
    assert resin.subtraction == pytest.approx(2 * 5 / 0.2138 * resin.ultraviolet)


def test_the_model_follows_the_kinetics_of_the_same_rates() -> None:
    """At the axis, where light is steady, with [A]₀ and [C]₀ not 1: every constant that `of` converts counts."""
    A, B = both((32, 32, 2), 16, "numpy")
    rates, period, turns = Rates(0.03, 0.02, 0.05, 0.08, oxygen=0.8, supply=3.0), 10.0, 2
    model = KineticModel(A, B, TwoColorResin.of(rates, A, B, floor=1e-6), turns, period=period, runs=16, steps=8)
    per_pose = (0.6, 0.4)
    light = Pair(*(A.device.upload(np.full(A.range.shape, value)) for value in per_pose))
    dose = model.expose(light).numpy()[15:17, 15:17].mean()
    seen = [16 * value * np.exp(-mu * 1.6) / period for value, mu in zip(per_pose, (0.05, 0.1), strict=True)]
    end = advance(rates, rates.start(), LightCycle(seen[0], seen[1], turns * period), device="numpy")
    assert not end.depleted.any() and end.b[0, 0] > 0.1
    wanted = 1.0 - (end.a[0, 0] + end.b[0, 0] / rates.alpha) / rates.oxygen
    assert dose == pytest.approx(wanted, abs=5e-3)


def test_cross_reactivity_is_that_of_visible_light() -> None:
    """The same number that `Reaction` takes: radicals that ultraviolet starts, over those of as much visible light."""
    A, B = both((32, 32, 2), 16, "numpy")
    rates = Rates(0.03, 0.02, 1e-9, 0.08, oxygen=0.8, supply=3.0)
    fluence = 16 * 0.5 * np.exp(-0.1 * 1.6)  # mJ/mm² of ultraviolet at the axis
    resin = TwoColorResin.of(rates, A, B, cross=0.3)
    light = Pair(A.device.upload(np.zeros(A.range.shape)), A.device.upload(np.full(B.range.shape, 0.5)))
    dose = KineticModel(A, B, resin, 1, period=10.0, runs=4).expose(light).numpy()[15:17, 15:17].mean()
    assert dose == pytest.approx(0.3 * rates.k_a / rates.oxygen * fluence, rel=5e-3)


def test_contrast_counts_what_is_wrong() -> None:
    target = np.zeros((4, 4, 2))
    target[1:3, 1:3] = 1.0
    dose = np.where(target > 0, 1.5, 0.5)
    dose[1, 1, 0], dose[0, 0, 1] = 0.9, 1.2
    found = EffectiveContrast.of(dose, target)
    assert (found.uncured, found.overcured) == (1 / 8, 1 / 24)
    assert found.window == pytest.approx((0.9 - 1.2) / 1.5)


def test_wrong_input_is_refused() -> None:
    A, B = both((12, 12, 4), 8, "numpy")
    model = KineticModel(A, B, plain(), 2, runs=4)
    target = part_of(A.grid)
    with pytest.raises(BadInput, match="alpha"):
        plain(alpha=0.0)
    with pytest.raises(BadInput, match="at most 0.5"):
        plain(floor=0.7)
    with pytest.raises(BadInput, match="recombines in pairs"):
        KineticModel(A, B, plain(pairing=0.1), 2)
    with pytest.raises(BadInput, match="turn of 8 angles"):
        KineticModel(A, B, plain(), 2, runs=9)
    with pytest.raises(BadInput, match="turns"):
        KineticModel(A, B, plain(), 0)
    with pytest.raises(BadInput, match="one grid"):
        LinearModel(A, both((12, 12, 5), 8, "numpy")[1], plain())
    with pytest.raises(DeviceError):
        LinearModel(A, both((12, 12, 4), 8, "warp:cpu")[1], plain())
    with pytest.raises(BadInput, match="call expose"):
        model.gradient(A.device.upload(target))
    with pytest.raises(BadInput, match="outside < 1"):
        LossWeights(1.1, 1.4)
    with pytest.raises(BadInput, match="iterations"):
        optimize_colors(model, target, iterations=0)
    with pytest.raises(ShapeMismatch):
        optimize_colors(model, target, start=Pair(A.device.upload(target), A.device.upload(target)))
    with pytest.raises(BadInput, match="supply of 0"):
        TwoColorResin.of(Rates(1, 1, 1, 1, supply=0.0, order=0), A, B)
    with pytest.raises(BadInput, match="order 0"):
        TwoColorResin.of(replace(RATES, order=0), A, B)


def test_the_best_light_looked_at_is_returned() -> None:
    """Its loss, computed anew, is the least of the history; light is never negative, nor was any that was looked at."""
    A, B = both((12, 12, 1), 12, "numpy")
    x, y, _ = np.meshgrid(*A.grid.axes(), indexing="ij")
    part = np.where((np.hypot(x, y) < 0.45) & (np.hypot(x, y) > 0.2), 1.0, 0.0)
    model, weights = LinearModel(A, B, TwoColorResin(11.0, 0.2, 3.0, 0.5), 3), LossWeights()
    for count in (4, 9, 14):
        plan = optimize_colors(model, part, weights, count, warm=2)
        losses = [step.loss for step in plan.history]
        state = OptimizerState(A, A.device.upload(part), {})
        loss = state.loss(plan.effective_dose(), weights.band(model.resin))
        assert loss == pytest.approx(min(losses), rel=1e-9, abs=1e-12)
        assert plan.best_iteration == 1 + max(i for i, loss in enumerate(losses) if loss == min(losses))
        assert plan.visible.numpy().min() >= 0.0 and plan.ultraviolet.numpy().min() >= 0.0


def rule(**other: float) -> ThroughKinetics:
    return ThroughKinetics(**{"k_a": 1 / 30, "k_b": 0.2138 / 30, "k_c": 1 / 30, "k_2": 0.43, "supply": 5.0,
                              "turns": 2, "period": 10.0, "runs": 4, "iterations": 4, **other})  # type: ignore[arg-type]  # fmt: skip


def test_the_peak_counts_what_cures_before_inhibitors_come(device: Device) -> None:
    """The peak is the greatest effective dose of turns that end after any run; its slope by differences."""
    A, B = both((12, 12, 4), 12, device)
    rng, resin = (
        np.random.default_rng(4),
        TwoColorResin(9.0, 4.0, 3.0, 0.5),
    )
    light = [rng.random(A.range.shape), rng.random(A.range.shape)]
    light[1][:6] = 0.0  # ultraviolet light comes late
    model = KineticModel(A, B, resin, 1, period=10.0, runs=6, peak=True)
    last = KineticModel(A, B, resin, 1, period=10.0, runs=6)

    def pair(values: list[np.ndarray], angles: int = 12) -> Pair:
        shown = (np.arange(12) < angles)[:, None, None]
        return Pair(*(device.upload(part * shown) for part in values))

    peak = model.expose(pair(light)).numpy()
    doses = [last.expose(pair(light, 2 * run)).numpy() for run in range(1, 7)]
    np.testing.assert_allclose(peak, np.max(doses, axis=0), atol=2e-5)
    assert (peak > doses[-1] + 0.1).any() and (peak < doses[-1] + 1e-6).any()
    slope, way = rng.normal(size=A.domain.shape), [rng.normal(size=A.range.shape) for _ in range(2)]
    model.expose(pair(light))
    found = sum(np.vdot(g.numpy(), w) for g, w in zip(model.gradient(device.upload(slope)), way, strict=True))
    small = 1e-6 if device.name == "numpy" else 2e-3
    moved = [model.expose(pair([v + side * w for v, w in zip(light, way, strict=True)])).numpy().astype(float)
             for side in (small, -small)]  # fmt: skip
    assert found == pytest.approx(np.vdot(slope, moved[0] - moved[1]) / (2.0 * small), rel=2e-3)


@pytest.mark.slow
def test_the_window_of_the_kinetics_holds_by_the_exact_equations() -> None:
    """Eqs 5-7 without the floor: the part cures with 25 % more exposure and without it, nothing else ever does."""
    A, B = both((14, 14, 1), 24, vamgpu.devices()[0])
    x, y, _ = np.meshgrid(*A.grid.axes(), indexing="ij")
    part, near = (np.hypot(x, y) < 0.5) & (np.hypot(x, y) > 0.25), A.grid.cylinder()
    plan = superpose(Colors(A, B), part.astype(float), rule(turns=3, runs=12, iterations=80))
    dose, entries = plan.dose().numpy()[near], entries_of(A)
    within = part[near]
    window = (dose[within].min() - dose[~within].max()) / dose.max()
    inside, outside = (part & near[:, :, None]).ravel(), (~part & near[:, :, None]).ravel()
    assert window > 2.2 * widest(entries[inside], entries[outside])
    seen, runs = np.zeros((2, 24, int(near.sum()))), (PoseRuns(A, 24), PoseRuns(B, 24))
    fluence = A.beam.pixel_area / A.grid.voxel_volume / np.array([0.05, 0.1])
    assert plan.uv is not None
    for color, light in enumerate((plan.visible, plan.uv)):
        for angle in range(24):
            part_dose = A.device.empty(A.domain.shape)
            runs[color].expose(angle, light, part_dose)
            seen[color, angle] = part_dose.numpy()[near][:, 0] * fluence[color] * 2.4
    for share in (1.0, 1.25):
        cycle = LightCycle(share * seen[0].T, share * seen[1].T, np.full(24, 10.0 / 24.0))
        start = SpeciesState(np.ones(near.sum()), np.zeros(near.sum()), np.full(near.sum(), 5.0))
        end = advance(RATES, start, cycle, intervals=72, device="numpy")
        assert np.array_equal(end.depleted[0], within[:, 0])


def test_the_rule_of_the_kinetics_gives_the_peak_dose() -> None:
    """The dose of the plan is that of the model, of at most 1.5, and errors of every pass are those of that dose."""
    A, B = both((12, 12, 2), 12, vamgpu.devices()[0])
    target, seen = part_of(A.grid), []
    plan = superpose(Colors(A, B), target, rule(iterations=30), progress=seen.append)
    assert plan.uv is not None and min(plan.visible.numpy().min(), plan.uv.numpy().min()) >= 0.0
    dose = np.asarray(plan.dose().numpy(), np.float64)
    assert np.array_equal(dose, rule().model(A, B).expose(Pair(plan.visible, plan.uv)).numpy())
    assert 1.0 < dose[A.grid.cylinder()].max() < 1.6
    most = np.where(target > 0.5, 1.5, 1.0)
    dose = np.maximum(dose, 0.0)
    errors = (np.sqrt(np.mean(np.maximum(field, 0.0) ** 2)) for field in (target - dose, dose - most))
    last = plan.history[-1]
    assert (last.undersupply, last.oversupply) == pytest.approx(tuple(errors), rel=1e-4, abs=1e-7)
    assert len(seen) == len(plan.history) == last.number
    every, finer = (rule(runs=None).model(A, B, finer) for finer in (False, True))  # type: ignore[arg-type]
    assert (len(every.runs[0]), every.steps, len(finer.runs[0]), finer.steps) == (12, 1, 12, 4)
    assert finer.resin.floor == pytest.approx(0.1 * every.resin.floor)
    stopped = superpose(Colors(A, B), target, rule(), cancel=lambda: True)
    assert len(stopped.history) == 1
    for strong in (2.0, 0.5):
        with pytest.raises(BadInput, match="strength .* leave it out"):
            superpose(Colors(A, B, strength=strong), target, rule())
