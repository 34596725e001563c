"""Optimizers on scans that are not even: what they take, how well they do, and what they refuse."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.chemistry.exposure_plan import TurnLight
from vamgpu.errors import BadInput
from vamgpu.methods import METHODS, optimize
from vamgpu.methods.dual import Colors, LeastSquares, superpose
from vamgpu.methods.joint import KineticModel, TwoColorResin
from vamgpu.methods.quadrature import balance, directions, is_complete
from vamgpu.methods.ramp import capped_ramp, ramp
from vamgpu.methods.rebin import rebin
from vamgpu.methods.state import OptimizerState
from vamgpu.operators.pose_runs import PoseRuns
from vamgpu.units import deg

GRID, BEAM = vam.Grid((24, 24, 2), 0.1), vam.Beam((36, 2), 0.1)
RNG = np.random.default_rng(5)
JITTERED = 2.0 * np.pi * (np.arange(40) + 0.4 * RNG.uniform(-1, 1, 40)) / 40
CROWDED = np.concatenate([np.linspace(0.0, 0.5 * np.pi, 60), np.linspace(0.5 * np.pi, np.pi, 12)[1:-1]])
TIMES = np.tile([1.0, 3.0], 30)

SCANS = {
    "jittered": vam.Turntable(JITTERED),
    "half turn": vam.Turntable.arc(30, np.pi),
    "arc": vam.Turntable.arc(30, 120 * deg),
    "unequal times": vam.Turntable(60, dwell=TIMES),
}


def part() -> np.ndarray:
    """An L, off the axis."""
    target = np.zeros(GRID.shape, np.float32)
    target[6:12, 6:18] = target[6:18, 6:11] = 1.0
    return target


@pytest.mark.parametrize(
    ("scan", "method"),
    [
        pytest.param(scan, method, marks=() if scan == "jittered" or method in ("recipe", "fbp") else pytest.mark.slow)
        for scan in SCANS
        for method in METHODS
    ],
)
def test_every_method_runs_on_every_scan_or_says_why_not(fast_device: vam.Projection, scan: str, method: str) -> None:
    A = vam.Projection(GRID, BEAM, SCANS[scan], device=fast_device)  # type: ignore[arg-type]
    if (scan, method) == ("arc", "fbp"):
        with pytest.raises(BadInput, match=r"filtered back projection got 30 measured.*120°.*expected 180°.*half turn"):
            optimize(A, part(), method)
        return
    plan = optimize(A, part(), method, iterations=None if method == "fbp" else 6)
    light = plan.sinogram.numpy()
    assert np.isfinite(light).all() and light.min() >= 0 and light.max() > 0
    assert plan.history[-1].loss <= plan.history[0].loss
    dose = plan.dose().numpy()
    assert dose[part() > 0].mean() > 1.3 * dose[part() == 0].mean()


@pytest.mark.slow
@pytest.mark.parametrize("scan", ["jittered", "half turn", "unequal times"])
def test_windows_are_those_of_an_even_turn(scan: str) -> None:
    """The step is as long as on an even turn, so thresholds do as well in as many iterations."""
    windows = {}
    for name, motion in (("even", vam.Turntable(SCANS[scan].angles)), (scan, SCANS[scan])):
        A = vam.Projection(GRID, BEAM, motion, device="numpy")
        windows[name] = optimize(A, part(), "lbfgs", iterations=15).window
    assert windows["even"] > 0.1 and windows[scan] > windows["even"] - 0.05


def test_poses_count_by_the_directions_they_stand_for() -> None:
    even = np.pi / 12
    assert directions(vam.Turntable(12)) == pytest.approx(np.full(12, even))
    assert directions(vam.Turntable(2 * np.pi * np.arange(12) / 12 + 0.2)) == pytest.approx(np.full(12, even))
    assert directions(vam.Turntable.arc(12, np.pi, start=-1.0)) == pytest.approx(np.full(12, even))
    both_ends = directions(vam.Turntable(np.linspace(0, np.pi, 13)))
    assert both_ends == pytest.approx(np.array([0.5, *np.ones(11), 0.5]) * even)
    overlapping = directions(vam.Turntable.arc(270, 1.5 * np.pi))
    assert overlapping[:89] == pytest.approx(np.full(89, 0.5 * deg)), "0 to 90° is seen from 180° to 270° too"
    assert overlapping[91:179] == pytest.approx(np.full(88, 1.0 * deg))
    for n in (7, 40):
        theta = 2 * np.pi * (np.arange(n) + 0.4 * np.random.default_rng(n).uniform(-1, 1, n)) / n
        assert directions(vam.Turntable(theta)).sum() == pytest.approx(np.pi)
    pairs = directions(vam.Turntable(np.repeat(2 * np.pi * np.arange(12) / 12, 2)))
    assert pairs == pytest.approx(np.full(24, 0.5 * even)), "poses that are shown twice"
    crowded = directions(vam.Turntable(CROWDED))
    assert crowded[5:50] == pytest.approx(np.full(45, 90 / 59 * deg))
    assert crowded.sum() == pytest.approx(np.pi - 0.5 * (90 / 11 - 90 / 59) * deg), "ends as inside"


def test_a_scan_that_lacks_directions_is_not_complete() -> None:
    lost = np.delete(np.arange(360), np.arange(40, 80)) * deg
    assert is_complete(vam.Turntable(lost)), "the other side sees what is lost on one"
    assert directions(vam.Turntable(lost)).sum() == pytest.approx(np.pi)
    assert is_complete(vam.Turntable(1)) and is_complete(vam.Turntable([0.3]))
    assert not is_complete(vam.Turntable.arc(60, 120 * deg)) and not is_complete(vam.Turntable.arc(4, 120 * deg))


@pytest.mark.parametrize("motion", [vam.Turntable(CROWDED), vam.Turntable(70, dwell=np.linspace(1, 4, 70))])
def test_filtered_back_projection_of_crowded_poses_is_even(motion: vam.Turntable) -> None:
    """Aᵀ · ramp · A of a disc is the disc: without the balance crowded or long poses would draw streaks along them."""
    x = (np.arange(48) - 23.5) / 24
    disc = np.exp(-(((x[:, None] ** 2 + x[None, :] ** 2) / 0.3) ** 2))[:, :, None].astype(np.float32)
    grid, beam = vam.Grid((48, 48, 1), 0.1), vam.Beam((70, 1), 0.1)
    A = vam.Projection(grid, beam, motion, device="numpy")
    state = OptimizerState(A, A.device.upload(disc), {})
    projected, light, dose = state.sinogram(), state.sinogram(), state.volume()
    state.project(state.target, projected)
    state.filter(projected, ramp(A), light)
    state.expose(light, dose)
    middle = slice(8, 40)
    assert np.abs(dose.numpy() - disc)[middle, middle].max() < 0.06
    assert balance(vam.Turntable(70)) is None and balance(motion) is not None


def test_steps_are_balanced_as_filtered_light_is() -> None:
    A = vam.Projection(GRID, BEAM, vam.Turntable(JITTERED, dwell=np.linspace(1, 4, 40)), device="numpy")
    state, rng = OptimizerState(A, A.device.upload(part()), {}), np.random.default_rng(7)
    gradient, taps = rng.standard_normal(A.range.shape), capped_ramp(A, 0.25)
    state.memory |= {name: A.device.upload(np.full(A.range.shape, 100.0)) for name in ("light", "ahead")}
    filtered = state.sinogram()
    state.filter(A.device.upload(gradient), taps, filtered)
    state.step(A.device.upload(gradient), taps, 1.0, 0.0)
    assert 100.0 - state.buffer("light").numpy() == pytest.approx(filtered.numpy(), abs=1e-4)
    plain = state.sinogram()
    state.filter(A.device.upload(gradient), replace(taps, balance=None), plain)
    share = balance(A.motion)
    assert share is not None and filtered.numpy() == pytest.approx(plain.numpy() * share[:, None, None], abs=1e-5)


def test_rebinning_refuses_what_is_not_even() -> None:
    vial = vam.Vial(radius=2.5, wall=0.1, resin_index=1.5, wall_index=1.47, bath_index=1.0)
    straight, bent = (vam.Projection(GRID, BEAM, SCANS["jittered"], vessel, device="numpy") for vessel in (None, vial))
    plan = optimize(straight, part(), "recipe", iterations=1)
    with pytest.raises(BadInput, match="rebin got 40 measured.*expected even ones over a full turn.*vessel"):
        rebin(plan, bent)


def test_runs_of_poses_add_up_to_the_turn() -> None:
    motion = vam.Turntable(JITTERED, dwell=np.linspace(1, 3, 40))
    A = vam.Projection(GRID, BEAM, motion, device="numpy")
    light = A.device.upload(np.random.default_rng(6).random(A.range.shape))
    runs, dose, projected = PoseRuns(A, 7), A.device.empty(A.domain.shape), A.device.empty(A.range.shape)
    total = np.zeros(A.domain.shape)
    for run in range(7):
        runs.expose(run, light, dose)
        total += dose.numpy()
        runs.project(run, A.device.upload(part()), projected)
    assert np.abs(total - A.T(light).numpy()).max() <= 1e-5 * total.max()
    assert np.abs(projected.numpy() - A(part())).max() <= 1e-5 * projected.numpy().max()
    assert [run.motion.angles for run in runs.parts] == [6, 6, 6, 6, 6, 5, 5]


def test_kinetics_and_exposure_plans_refuse_unequal_times() -> None:
    long = vam.Projection(GRID, BEAM, SCANS["unequal times"], device="numpy")
    resin = TwoColorResin(visible=1.0, ultraviolet=0.2, supply=5.0, alpha=0.2, pairing=0.4)
    with pytest.raises(BadInput, match="in pairs, but 60 over a full turn, each lit .* leave dwell out"):
        KineticModel(long, long, resin, period=10.0)
    assert KineticModel(long, long, replace(resin, pairing=0.0)).turns == 3, "doses alone do not ask for times"
    light = long.device.upload(np.ones(long.range.shape))
    with pytest.raises(BadInput, match="the motion is 60 .* expected angles that divide a turn evenly"):
        TurnLight(long, light)


@pytest.mark.slow
def test_least_squares_of_two_colors_takes_a_scan() -> None:
    motion = vam.Turntable(JITTERED, dwell=np.linspace(1, 2, 40))
    visible, uv = (vam.Projection(GRID, BEAM, motion, device="numpy") for _ in range(2))
    plan = superpose(Colors(visible, uv), part(), LeastSquares(iterations=12))
    assert plan.history[-1].error < 0.5 * plan.history[0].error


def test_other_angles_are_no_continuation_and_no_other_color() -> None:
    even, jittered = (vam.Projection(GRID, BEAM, motion, device="numpy") for motion in (
        vam.Turntable(40), SCANS["jittered"]))  # fmt: skip
    plan = optimize(even, part(), iterations=2)
    with pytest.raises(BadInput, match=r"is of Turntable\(angles=40\), not of Turntable.*; resume that task"):
        optimize(jittered, part(), iterations=4, resume=plan)
    with pytest.raises(BadInput, match="uv has .* expected the same angles for both colors"):
        Colors(even, jittered)
