"""Every method on every device: the loss falls, light stays possible, devices agree, runs resume and stop."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, Cancelled, OpticsWarning, ShapeMismatch, TargetTooLarge
from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.methods import (
    BCLP,
    LBFGS,
    METHODS,
    OSMO,
    FilteredBackProjection,
    GradientDescent,
    Linear,
    PenaltyMinimization,
    Plan,
    Recipe,
    SurfaceRamp,
    optimize,
)
from vamgpu.methods.choice import chosen
from vamgpu.operators.projection import Projection
from vamgpu.schema.read import read
from vamgpu.targets.target import Target

SIZE, ANGLES = 24, 30
ITERATIVE = [
    GradientDescent(),
    GradientDescent(momentum=0.5),
    OSMO(),
    PenaltyMinimization(),
    Recipe(background=0.8),
    BCLP.paper_002(),
    BCLP(p=2.0, q=1.0, response=Linear()),
    LBFGS(history=3, efficiency=0.01),
]
each_method = pytest.mark.parametrize("method", ITERATIVE, ids=lambda method: type(method).__name__)


def part() -> np.ndarray:
    """A ring with a notch, the same in most slices, and a bar across two of them."""
    x, y, z = np.meshgrid(*[np.arange(SIZE) - 0.5 * (SIZE - 1)] * 3, indexing="ij")
    radius = np.hypot(x, y)
    ring = (radius < 9) & (radius > 4) & ~((x > 0) & (abs(y) < 2)) & (abs(z) < 8)
    return np.where(ring | ((abs(y) < 2) & (radius < 8) & (abs(z) < 1)), 1.0, 0.0)


@cache
def operator(name: str | Device) -> Projection:
    return Projection(Grid((SIZE, SIZE, SIZE), 0.2), Beam((SIZE, SIZE), 0.2, spread=0), Turntable(ANGLES), device=name)


@cache
def solved(name: str | Device, method: Any, iterations: int) -> Plan:
    return optimize(operator(name), part(), method, iterations)


@each_method
def test_the_loss_falls_and_light_is_possible(fast_device: Device, method: Any) -> None:
    plan = solved(fast_device, method, 8)
    losses = [step.loss for step in plan.history]
    assert min(losses[-2:]) < 0.85 * losses[0]
    light = plan.sinogram.numpy()
    assert light.min() >= 0 and np.isfinite(light).all() and light.max() > 0
    assert [step.iteration for step in plan.history] == list(range(1, 9))
    pairs = [step.evaluations for step in plan.history]
    assert pairs == sorted(pairs) and plan.evaluations == pairs[-1]
    assert plan.papers == method.papers and plan.papers


@each_method
def test_devices_agree(fast_device: Device, method: Any) -> None:
    wanted, got = solved("numpy", method, 4), solved(fast_device, method, 4)
    light = wanted.sinogram.numpy()
    assert np.abs(got.sinogram.numpy() - light).max() <= 2e-4 * light.max()
    assert got.history[-1].loss == pytest.approx(wanted.history[-1].loss, rel=2e-3)


@each_method
def test_resuming_is_going_on(method: Any) -> None:
    half = solved("numpy", method, 4)
    before = half.sinogram.numpy()
    resumed, whole = optimize(operator("numpy"), part(), method, 8, resume=half), solved("numpy", method, 8)
    assert np.array_equal(resumed.sinogram.numpy(), whole.sinogram.numpy())
    assert resumed.history == whole.history
    assert np.array_equal(half.sinogram.numpy(), before)


def test_filtered_back_projection_is_done_at_once(fast_device: Device) -> None:
    plan = optimize(operator(fast_device), part(), FilteredBackProjection(), 10)
    assert len(plan.history) == 1 and plan.evaluations == 1.0
    dose = plan.dose().numpy()
    assert (dose * part()).sum() / part().sum() == pytest.approx(1.0, abs=1e-4)


def test_a_plan_knows_its_own_window(fast_device: Device) -> None:
    knows_its_window(solved(fast_device, LBFGS(), 8))


def knows_its_window(plan: Plan) -> None:
    dose, inside = plan.dose().numpy().astype(float), part() >= 0.5
    disc = plan.operator.grid.cylinder()[:, :, None]
    wanted = (dose[inside].min() - dose[~inside & disc].max()) / dose[np.broadcast_to(disc, dose.shape)].max()
    assert plan.window == pytest.approx(wanted, abs=1e-5)


@each_method
def test_nothing_large_crosses_the_bus(fast_device: Device, method: Any) -> None:
    device = operator(fast_device).device
    target = device.upload(part())
    with device.no_transfers():
        plan = optimize(operator(fast_device), target, method, 3)
    assert len(plan.history) == 3


@pytest.mark.slow
@pytest.mark.parametrize(("spread", "slices"), [(0.0, 0), (None, 1)], ids=["sharp", "blurred"])
@each_method
def test_memory_stays_within_three_volumes_and_four_sinograms(
    fast_device: Device, is_quick: bool, method: Any, spread: float | None, slices: int
) -> None:
    """And one more sinogram of the operator's own, by slices, where rows of pixels are not slices of voxels."""
    grid, beam = Grid((64, 64, 32), 0.2), Beam((64, 32), 0.2, spread=spread)
    here = Projection(grid, beam, Turntable(60), device=fast_device)
    device = here.device
    target = device.upload(np.pad(part()[..., :24], ((20, 20), (20, 20), (4, 4))))
    held = device.ledger.allocated - target.nbytes
    device.ledger.reset_peak()
    plan = optimize(here, target, method, 5 if is_quick else 2)
    budget = 3 * target.nbytes + (4 + slices + 2 * getattr(method, "history", 0)) * plan.sinogram.nbytes
    assert device.ledger.peak - held <= 1.02 * budget  # two hundredths for tables of partial results


@pytest.mark.parametrize("stop", ["asked", "interrupt"])
def test_a_stopped_run_keeps_its_plan(stop: str) -> None:
    seen: list[int] = []

    def cancel() -> bool:
        if len(seen) == 3 and stop == "interrupt":
            raise KeyboardInterrupt
        return len(seen) == 3

    with pytest.raises(Cancelled) as caught:
        optimize(
            operator("numpy"), part(), Recipe(), 8, cancel=cancel, progress=lambda step: seen.append(step.iteration)
        )
    plan = caught.value.plan
    assert isinstance(plan, Plan) and seen == [1, 2, 3] and len(plan.history) == 3
    assert np.array_equal(plan.sinogram.numpy(), solved("numpy", Recipe(), 3).sinogram.numpy())
    assert optimize(operator("numpy"), part(), Recipe(), 4, resume=plan).history[:3] == plan.history


@pytest.mark.parametrize("method", ["default", "lbfgs", BCLP()])
def test_no_iteration_is_the_light_to_begin_with(method: Any) -> None:
    """Filtered back projection, or one's own light in units of the part's dose; runs go on from either."""
    A = operator("numpy")
    plan = optimize(A, part(), method, iterations=0, progress=False)
    assert plan.history == () and plan.best_iteration == 0 and "after" in repr(plan)
    assert 0.5 <= np.mean(plan.dose().numpy()[part() > 0]) <= 2.0
    knows_its_window(plan)
    going = optimize(A, part(), method, iterations=2, resume=plan, progress=False)
    assert len(going.history) == 2 and optimize(A, part(), method, iterations=0, resume=going) is going
    own = filtered().sinogram.numpy() ** 2
    light = optimize(A, part(), method, iterations=0, start=7.0 * own, progress=False).sinogram.numpy()
    assert np.allclose(light, own * (light.max() / own.max()), atol=1e-9)
    assert 0.5 <= np.mean(A.T(light)[part() > 0]) <= 2.0
    with pytest.raises(BadInput, match="OSMO begins with the target"):
        optimize(A, part(), "osmo", iterations=0, progress=False)
    with pytest.raises(BadInput, match="exposure_limit=.* iterations=0"):
        optimize(A, part(), method, iterations=0, exposure_limit=3.0, irradiance=1.0, critical_dose=1.0)


@cache
def filtered() -> Plan:
    return optimize(operator("numpy"), part(), "fbp", progress=False)


def test_the_stop_rule_ends_a_run_early() -> None:
    plan = optimize(operator("numpy"), part(), OSMO(), 20, tolerance=0.5)
    assert plan.history[-1].loss <= 0.5 * plan.history[0].loss
    assert all(step.loss > 0.5 * plan.history[0].loss for step in plan.history[:-1]) and len(plan.history) < 20


def test_the_package_is_the_function(capsys: pytest.CaptureFixture[str]) -> None:
    import vamgpu.methods

    plan = vamgpu.optimize(operator("numpy"), part(), "fbp")  # pyright: ignore[reportCallIssue]
    assert isinstance(plan, Plan) and plan.target_name == "target"
    assert capsys.readouterr().out == ""
    assert set(METHODS) >= {"default", "recipe", "osmo", "cal", "penalty", "bclp", "lbfgs", "fbp"}


def test_a_bar_is_shown_when_asked(capsys: pytest.CaptureFixture[str]) -> None:
    optimize(operator("numpy"), part(), Recipe(), 2, progress=True)
    assert "window" in capsys.readouterr().out


def test_bad_input_is_named() -> None:
    here = operator("numpy")
    with pytest.raises(BadInput, match="there are default"):
        optimize(here, part(), "magic")
    with pytest.raises(BadInput, match="an instance"):
        optimize(here, part(), OSMO)  # type: ignore[arg-type]
    with pytest.raises(ShapeMismatch, match="the target"):
        optimize(here, np.zeros((3, 4, 5)))
    for iterations in (-1, False, 1.5, True, "ten", np.nan, np.inf):
        with pytest.raises(BadInput, match="iterations"):
            optimize(here, part(), iterations=iterations)  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="build the operator on target.grid"):
        optimize(here, Target.from_array(part(), 0.1))
    with pytest.raises(BadInput, match="same method"):
        optimize(here, part(), OSMO(), resume=solved("numpy", Recipe(), 3))
    for wrong in (
        lambda: LBFGS(outside=0.97),
        lambda: Recipe(background=1.0),
        lambda: BCLP(p=0.5),
        lambda: BCLP(p=2.0, q=0.5),
        lambda: OSMO(gain=0.0),
        lambda: LBFGS(history=0),
        lambda: LBFGS(efficiency=float("nan")),
        lambda: BCLP(p=float("nan")),
        lambda: BCLP(penalty=(1.0, float("nan"))),
        lambda: optimize(here, part(), tolerance=float("nan")),
        lambda: optimize(here, -part()),
        lambda: optimize(here, 0.0 * part()),
    ):
        with pytest.raises(BadInput, match="expected"):
            wrong()
    with pytest.raises(BadInput, match="got 5 as vessel; expected a Vial"):
        Projection(here.grid, here.beam, here.motion, 5, "numpy")  # type: ignore[arg-type]


def test_a_part_that_sticks_out_of_the_light_is_named() -> None:
    grid, target = Grid((SIZE, SIZE, SIZE), 0.2), Target.from_array(part(), 0.2)
    low, narrow = (Projection(grid, Beam(pixels, 0.2), Turntable(4), device="numpy") for pixels in ((24, 10), (16, 24)))
    with pytest.raises(TargetTooLarge, match=r"3\.2 mm high, the light of .* 2 mm"):
        optimize(low, target, "fbp")
    with pytest.warns(OpticsWarning, match=r"radius of 1\.772 mm, the light of .* 1\.6 mm"):
        optimize(narrow, target, "fbp")


def test_every_method_names_its_papers_and_iterations() -> None:
    assert {name for name in METHODS if METHODS[name].iterations < 1} == set()
    assert all(METHODS[name].papers for name in METHODS)


@pytest.mark.parametrize(("said", "kind"), [("OSMO", OSMO), ("Ramp", SurfaceRamp), ("L-BFGS", LBFGS)])
def test_a_method_is_known_in_any_spelling(said: str, kind: type[Any]) -> None:
    assert isinstance(chosen(said), kind)


def test_a_method_that_is_nearly_known_is_offered() -> None:
    with pytest.raises(BadInput, match="no method 'OSMOO'.*did you mean 'osmo'"):
        chosen("OSMOO")


@pytest.mark.parametrize("name", ["best", "window", "Widest"])
def test_a_removed_method_is_refused_with_the_one_that_replaces_it(name: str) -> None:
    with pytest.raises(BadInput, match=f'no method {name!r}.*the default, "ramp", replaces it'):
        chosen(name)
    with pytest.raises(BadInput, match='the default, "ramp", replaces it'):
        read("method", {"kind": name.lower()})
