"""Oxygen through the turns of a print: against the equations, Radau, `Transport` and differences."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq

import vamgpu as vam
from vamgpu.backend import open_device
from vamgpu.backend.device import Device
from vamgpu.chemistry import turns
from vamgpu.chemistry.diffusion import Heat
from vamgpu.chemistry.oxygen import Oxygen, OxygenModel
from vamgpu.chemistry.transport import Boundary, Box, Reaction, Transport
from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.interop.functions import function_of
from vamgpu.kernels.inhibition import inhibition_step, oxygen_step
from vamgpu.losses import Band
from vamgpu.methods.joint import KineticModel, Pair, TwoColorResin
from vamgpu.operators.pose_runs import PoseRuns
from vamgpu.operators.ring_projection import RingProjection

PITCH = 0.1


def projection(shape: tuple[int, int, int], angles: int, device: str | Device = "numpy") -> vam.Projection:
    vat = vam.Vat(2.0 * shape[0] * PITCH, radius=shape[0] * PITCH, absorption=0.05)
    beam = vam.Beam((shape[0], shape[2]), PITCH, spread=0.05)
    return vam.Projection(vam.Grid(shape, PITCH), beam, vam.Turntable(angles, lit_share=0), vat, device)


def lit(model: OxygenModel, most: float, seed: int = 0) -> np.ndarray:
    """Random patterns whose greatest dose without diffusion is ``most``."""
    light = np.random.default_rng(seed).random(model.range.shape)
    return light * most / float(np.asarray(model.operator.T(light)).max())


def laplacian(shape: tuple[int, int], open_: np.ndarray | None = None) -> np.ndarray:
    """The matrix of second derivatives of [x, y], no flux at the edges, nor to voxels that are not ``open_``."""
    found = np.zeros((2, *(shape[0] * shape[1],) * 2))
    for i, j in np.ndindex(shape):
        for axis, other in enumerate(((i + 1, j), (i, j + 1))):
            if other[0] < shape[0] and other[1] < shape[1] and (open_ is None or (open_[i, j] and open_[other])):
                a, b = i * shape[1] + j, other[0] * shape[1] + other[1]
                found[axis][[a, b, a, b], [a, b, b, a]] += (-1.0, -1.0, 1.0, 1.0)
    return np.sum([sixth(each) for each in found], axis=0)


def sixth(second: np.ndarray) -> np.ndarray:
    """The second derivative to sixth order, by second differences."""
    return second - second @ second / 12.0 + second @ second @ second / 90.0


def test_the_step_is_that_of_two_inhibitors_without_the_second() -> None:
    rng, shape = np.random.default_rng(0), (9, 8, 7)
    used, dose = rng.uniform(0.0, 0.999, shape), rng.uniform(0.0, 3.0, shape) * rng.integers(0, 2, shape)
    zero, ends = np.zeros(shape), [np.empty(shape) for _ in range(6)]
    inhibition_step.definition(dose, zero, 0.7, 0.0, 0.0, 0.9, 0.0, 0.02, 1.0 - used, zero, zero, zero, *ends[:4])
    oxygen_step.definition(dose, 0.7, 0.02, used, zero, *ends[4:])
    assert np.abs(1.0 - ends[4] - ends[0]).max() <= 1e-14 and np.abs(ends[5] - ends[3]).max() <= 1e-14


def test_diffusion_is_that_of_the_differences(device: Device) -> None:
    """Against the exponential of the matrix in the plane; along z, air holds the upper face at 0."""
    grid, rng = vam.Grid((6, 5, 4), PITCH), np.random.default_rng(1)
    field = rng.random(grid.shape)
    plane = expm(0.6 * laplacian((6, 5)))
    line = np.diag([-1.0, -2.0, -2.0, -3.0]) + np.eye(4, k=1) + np.eye(4, k=-1)
    exact = (plane @ field.reshape(30, 4) @ expm(0.6 * sixth(line))).reshape(grid.shape)
    for back in (False, True):
        found = device.upload(field)
        Heat(grid, 0.6 * PITCH**2, device, ("z high",)).spread(found, back)
        assert np.abs(found.numpy() - exact).max() <= 2e-6


def test_no_oxygen_passes_the_wall() -> None:
    """Exact transposes with a wall, where the passes along x and y do not commute; voxels in the wall stay."""
    grid, device, rng = vam.Grid((9, 9, 1), PITCH), open_device("numpy"), np.random.default_rng(2)
    heat, wall = Heat(grid, 0.7 * PITCH**2, device, wall=0.37), np.hypot(*np.meshgrid(*grid.axes()[:2])) > 0.37
    x, y = rng.random(grid.shape), rng.random(grid.shape)
    forth, back = device.upload(x), device.upload(y)
    heat.spread(forth)
    heat.spread(back, back=True)
    after = forth.numpy()
    assert np.vdot(after, y) == pytest.approx(np.vdot(x, back.numpy()), rel=1e-12)
    assert np.array_equal(after[wall], x[wall]) and after[~wall].sum() == pytest.approx(x[~wall].sum(), rel=1e-12)
    assert np.abs(after - x)[~wall].max() > 0.1


@pytest.mark.parametrize("spread", [0.2, 1.0, 4.0])
def test_diffusion_beside_the_wall_is_that_of_the_differences(spread: float, device: Device) -> None:
    """Every point of a round plane against the exponential of its matrix, relative to the peak of that point."""
    grid = vam.Grid((16, 16, 1), PITCH)
    x, y, _ = grid.axes()
    exact = expm(spread * laplacian((16, 16), np.hypot(x[:, None], y) <= 0.76))
    heat, off = Heat(grid, spread * PITCH**2, device, wall=0.76), 0.0
    for at, back in product(range(0, 256, 3), (False, True)):
        field = device.upload(np.eye(256)[at].reshape(grid.shape))
        heat.spread(field, back)
        off = max(off, float(np.abs(field.numpy().ravel() - exact[at]).max() / exact[at].max()))
    assert off <= 0.01


def test_without_diffusion_the_effective_dose_is_the_dose(device: Device) -> None:
    model = OxygenModel(projection((12, 12, 4), 12, device), Oxygen(0.0, turns=3, period=9.0, runs=4, used=0.25))
    light = lit(model, 2.0)
    light[:, :4] = light[:, 8:] = 0.0
    plain = np.asarray(model.operator.T(light))
    assert np.abs(model.T(light) - plain - 0.25).max() <= 1e-5
    state = model.state(light)
    low = plain < 0.6
    assert 0.0 < state.cured.numpy()[low].max() < 0.1 and state.used.numpy()[plain > 1.2].min() > 0.9


def test_the_adjoint_is_exact() -> None:
    """Every pixel in float64: uneven oxygen, air, two turns of unequal runs."""
    used = np.random.default_rng(3).uniform(0.0, 0.6, (4, 4, 2))
    oxygen = Oxygen(3e-3, turns=2, period=9.0, runs=3, used=used, air=("z high", "x low"))
    model = OxygenModel(projection((4, 4, 2), 4), oxygen)
    light, slope = lit(model, 5.0), np.random.default_rng(4).normal(size=model.domain.shape)
    assert model.T(light).min() < 0.7 and model.T(light).max() > 1.5
    gradient, step = np.asarray(model(slope)), 1e-4 * light.max()
    differences = np.zeros(light.shape)
    for at in np.ndindex(light.shape):
        for factor, share in ((8.0, 1.0), (-1.0, 2.0)):
            for side in (step, -step):
                moved = light.copy()
                moved[at] += share * side
                differences[at] += factor * np.sign(side) * np.vdot(model.T(moved), slope) / (12.0 * step)
    assert np.abs(differences - gradient).max() <= 1e-8 * np.abs(gradient).max()


def test_devices_agree_with_the_definition(device: Device) -> None:
    oxygen = Oxygen(3e-3, turns=3, period=9.0, runs=4, used=np.linspace(0.0, 0.5, 5), air=("z low",))
    exact, model = (OxygenModel(projection((11, 11, 5), 12, where), oxygen) for where in ("numpy", device))
    light, slope = lit(exact, 1.6), np.random.default_rng(5).normal(size=exact.domain.shape)
    doses = [np.asarray(each.T(light), np.float64) for each in (exact, model)]
    assert np.abs(doses[1] - doses[0]).max() <= 1e-5
    slopes = [np.asarray(each(slope), np.float64) for each in (exact, model)]
    way = np.random.default_rng(6).normal(size=light.shape)
    gap = abs(np.vdot(slopes[1] - slopes[0], way)) / (np.linalg.norm(slopes[0]) * np.linalg.norm(way))
    assert gap <= 1e-6


def test_it_agrees_with_radau() -> None:
    """The equations themselves, the light of every angle at its time; uneven oxygen."""
    shape, angles, period, count = (8, 8), 12, 9.0, 2
    used = np.random.default_rng(7).uniform(0.0, 0.5, (*shape, 1))
    model = OxygenModel(projection((*shape, 1), angles), Oxygen(2e-3, count, period, used, runs=angles))
    light, spread, floor = lit(model, 1.6), 2e-3 / PITCH**2 * laplacian(shape), 0.02
    rates, runs = [], PoseRuns(model.operator, angles)
    for angle in range(angles):
        dose = model.device.empty((*shape, 1))
        runs.expose(angle, model.device.upload(light), dose)
        rates.append(dose.numpy().ravel() * angles / (period * count))
    state = np.concatenate([1.0 - used.ravel(), np.zeros(64)])
    for k in range(angles * count):

        def change(_: float, y: np.ndarray, rate: np.ndarray = rates[k % angles]) -> np.ndarray:
            shares = rate / (y[:64] + floor)
            return np.concatenate([spread @ y[:64] - shares * y[:64], shares * floor])

        state = solve_ivp(change, (0.0, period / angles), state, "Radau", rtol=1e-7, atol=1e-9).y[:, -1]
    exact = (1.0 + state[64:] - state[:64]).reshape(*shape, 1)
    assert np.abs(model.T(light) - exact).max() <= 0.005 * exact.max()
    assert np.abs(np.asarray(model.operator.T(light)) + used - exact).max() > 0.04 * exact.max()  # diffusion matters


def transported(model: OxygenModel, light: np.ndarray, runs: int, steps: int) -> np.ndarray:
    """Effective dose by the explicit steps of `Transport`, without a floor."""
    A: Any = model.operator
    oxygen: Any = model.oxygen
    air = (Boundary.fixed(1.0, *oxygen.air), Boundary(), Boundary())
    walk = Transport(Box(A.grid.shape, (A.grid.pitch,) * 3), (oxygen.diffusivity,) * 3, Reaction(1.0, 0.0, 0.0, 0.0),
                     air, model.device)  # fmt: skip
    state, seconds = walk.start(a=1.0 - np.broadcast_to(oxygen.used, A.grid.shape)), oxygen.period / runs
    parts, dose = PoseRuns(A, runs), model.device.empty(A.grid.shape)
    for turn in range(oxygen.turns * runs):
        parts.expose(turn % runs, model.device.upload(light / (oxygen.turns * seconds)), dose)
        walk.advance(state, seconds, max(steps, walk.steps(seconds)), visible=dose)
    found = state.numpy()
    return 1.0 + found["dose"] - found["a"]


def test_it_agrees_with_transport(fast_device: Device) -> None:
    """Explicit steps on voxels of a quarter of the width: oxygen that is uneven along z, under air."""

    def model(finer: int) -> OxygenModel:
        vat, beam = vam.Vat(2.0, radius=1.0, absorption=0.05), vam.Beam((10, 6), PITCH, spread=0.05)
        grid = vam.Grid((10 * finer, 10 * finer, 6 * finer), PITCH / finer)
        A = vam.Projection(grid, beam, vam.Turntable(24, lit_share=0), vat, fast_device)
        used = np.linspace(0.5, 0.0, 6).repeat(finer)
        return OxygenModel(A, Oxygen(5e-4, 3, 9.0, used, ("z high",), runs=24, floor=1e-3))

    def means(dose: np.ndarray, finer: int) -> np.ndarray:
        return dose.reshape(10, finer, 10, finer, 6, finer).mean(axis=(1, 3, 5))

    light = lit(model(1), 1.6)
    exact = means(transported(model(4), 64.0 * light, 24, 10), 4)
    for finer, most in ((1, 0.01), (2, 0.005)):
        own = means(np.asarray(model(finer).T(finer**3 * light)), finer)
        assert np.abs(own - exact).max() <= most * exact.max()
    assert exact[:, :, 0].mean() > exact[:, :, 5].mean() + 0.2


def test_voxels_a_pixel_wide_are_fine_enough(fast_device: Device) -> None:
    """Light with sharp edges, on voxels of a quarter of the width; values at centers are not means over voxels."""

    def model(finer: int) -> OxygenModel:
        grid, beam = vam.Grid((16 * finer, 16 * finer, 1), PITCH / finer), vam.Beam((16, 1), PITCH, spread=0.05)
        A = vam.Projection(grid, beam, vam.Turntable(24, lit_share=0), vam.Vat(4.0, absorption=0.05), fast_device)
        return OxygenModel(A, Oxygen(1e-3, 3, 9.0, 0.1, runs=24))

    x, y, _ = vam.Grid((16, 16, 1), PITCH).axes()
    away = np.hypot(x[:, None], y)
    part = ((away < 0.5) & (np.hypot(x[:, None] - 0.2, y) > 0.15))[:, :, None].astype(float)
    light = vam.optimize(model(1), part, iterations=30, progress=False).sinogram.numpy()
    exact = np.asarray(model(4).T(64.0 * light)).reshape(16, 4, 16, 4).mean(axis=(1, 3))
    assert np.abs(np.asarray(model(1).T(light))[:, :, 0] - exact)[away < 0.65].max() <= 0.0025 * exact.max()


def test_states_that_do_not_fit_are_computed_again(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    oxygen = Oxygen(2e-3, turns=3, period=9.0, runs=4)
    model = OxygenModel(projection((10, 10, 4), 8, device), oxygen)
    light, slope = lit(model, 1.6), np.random.default_rng(8).normal(size=model.domain.shape)
    dose, gradient = model.T(light), model(slope)
    monkeypatch.setattr(turns, "KEPT", {False: 0, True: 0})
    other = OxygenModel(model.operator, oxygen)
    assert np.array_equal(other.T(light), dose)
    for _ in range(2):  # the second one begins with the states of the first turn
        assert np.array_equal(other(slope), gradient)


def test_species_of_two_colors_diffuse() -> None:
    """The adjoint of three species that diffuse at their own rates, against differences."""
    A = projection((6, 6, 2), 6)
    resin = TwoColorResin(6.0, 2.0, 2.0, 0.5, pairing=0.1)
    model = KineticModel(A, A, resin, 2, period=9.0, runs=3, diffusivities=(3e-3, 1e-3, 5e-4))
    rng = np.random.default_rng(9)
    light, way = ([rng.random(A.range.shape) * 0.1 for _ in range(2)] for _ in range(2))
    slope = rng.normal(size=A.domain.shape)

    def exposed(step: float) -> float:
        moved = (A.device.upload(part + step * to) for part, to in zip(light, way, strict=True))
        return float(np.vdot(model.expose(Pair(*moved)).numpy(), slope))

    step = 1e-4
    differences = (exposed(step) - exposed(-step)) / (2.0 * step)
    exposed(0.0)
    by_light = model.gradient(A.device.upload(slope))
    along = sum(float(np.vdot(g.numpy(), to)) for g, to in zip(by_light, way, strict=True))
    assert along == pytest.approx(differences, rel=1e-7)
    still = KineticModel(A, A, resin, 2, period=9.0, runs=3)
    pair = Pair(*map(A.device.upload, light))
    assert np.abs(still.expose(pair).numpy() - model.expose(pair).numpy()).max() > 0.003


@pytest.mark.parametrize("made", ["rings", "spread"])
def test_any_projector_is_cut_into_runs(made: str) -> None:
    """Light of a run with the other angles dark gives the same doses as a projector that is cut."""
    rays = projection((16, 16, 4), 12)
    A = RingProjection.of(rays) if made == "rings" else rays * 1.0
    runs, cut, rng, device = PoseRuns(A, 4), PoseRuns(rays, 4), np.random.default_rng(1), rays.device
    light, volume = device.upload(rng.random(rays.range.shape)), device.upload(rng.random(rays.domain.shape))
    dose = device.empty(rays.domain.shape)
    found, exact = np.zeros(rays.domain.shape), np.asarray(A.T(light).numpy())
    back, wanted = rays.device.empty(rays.range.shape), A(volume).numpy()
    for run in range(4):
        runs.expose(run, light, dose)
        if made == "spread":
            own = rays.device.empty(rays.domain.shape)
            cut.expose(run, light, own)
            assert np.abs(dose.numpy() - own.numpy()).max() <= 1e-12 * exact.max()
        found += dose.numpy()
        runs.project(run, volume, back)
    assert np.abs(found - exact).max() <= 1e-10 * exact.max() and np.abs(back.numpy() - wanted).max() <= 1e-10


def wheel(A: vam.Projection) -> np.ndarray:
    """A wheel with two holes and teeth."""
    x, y, _ = np.meshgrid(*A.grid.axes(), indexing="ij")
    r, turn = np.hypot(x, y), np.arctan2(y, x)
    holes = (np.hypot(x - 0.6, y) > 0.25) & (np.hypot(x + 0.6, y) > 0.2)
    return ((r < 1.25 + 0.15 * np.sign(np.cos(6 * turn))) & holes).astype(np.float64)


@pytest.mark.slow
def test_patterns_that_follow_oxygen_print_better() -> None:
    """Judged by Transport on finer runs: an older print took 40 % of the oxygen nearby."""
    A = projection((40, 40, 2), 60, vam.devices()[0])
    x, y, _ = np.meshgrid(*A.grid.axes(), indexing="ij")
    oxygen = Oxygen(5e-5, 5, 9.0, 0.4 * np.exp(-((x - 0.8) ** 2 + y**2)), runs=6)
    model, part = OxygenModel(A, oxygen), wheel(A)
    near = A.grid.cylinder()[:, :, None] & np.ones(part.shape, bool)
    static = vam.optimize(A, part, vam.LBFGS(0.85, 1.25, 1.5), 60, progress=False)
    plan = vam.optimize(model, part, iterations=60, progress=False)
    wrong, windows = [], []
    for patterns in (static, plan):
        dose = transported(model, patterns.sinogram.numpy(), 60, 3)
        wrong.append(int(((dose >= 1.05) != (part > 0.5))[near].sum()))
        windows.append(float(dose[near & (part > 0.5)].min() - dose[near & (part < 0.5)].max()))
    assert wrong[1] == 0 < 40 < wrong[0]
    assert windows[1] > 0.1 > -0.2 > windows[0]
    times = model.gel_times(plan.sinogram, 1.05)
    assert np.isfinite(times[part > 0.5]).all() and np.isinf(times[near & (part < 0.5)]).all()


def test_other_libraries_differentiate_at_their_own_patterns() -> None:
    """A function's derivatives are those at its inputs, whatever was exposed last."""
    model = OxygenModel(projection((6, 6, 2), 4), Oxygen(3e-3, 2, 9.0, runs=2))
    light, slope = lit(model, 5.0), np.random.default_rng(4).normal(size=model.domain.shape)
    dose, gradient, function, device = model.T(light), model(slope), function_of(model), model.device
    model.T(0.3 * light)
    assert np.abs(model(slope) - gradient).max() > 1e-3 * np.abs(gradient).max()
    (found,) = function.slopes((device.upload(light),), device.upload(slope))
    assert np.array_equal(found.numpy(), gradient)
    assert np.array_equal(function.value(device.upload(light)).numpy(), dose)


def test_gel_times_follow_the_dose() -> None:
    """Without diffusion, and by even light of every angle, the dose is linear in time."""
    model = OxygenModel(projection((12, 12, 2), 24), Oxygen(0.0, turns=4, period=10.0, runs=12))
    light = np.zeros(model.range.shape)
    light[:, 4:8] = 1.0
    dose = np.asarray(model.operator.T(light))
    light *= 2.0 / dose[6, 6, 0]
    times, dose = model.gel_times(light, 1.0), 2.0 * dose / dose[6, 6, 0]
    assert times[6, 6, 0] == pytest.approx(20.0, rel=0.02)
    late = dose < 0.95
    assert late.any() and np.isinf(times[late]).all() and np.isfinite(times[dose > 1.05]).all()


def test_lamps_limit_the_brightness() -> None:
    """No pixel asks for more than the lamp gives in all turns; a lamp that is too weak is refused."""
    A = projection((16, 16, 2), 24, vam.devices()[0])
    model, part = OxygenModel(A, Oxygen(5e-4, 2, 9.0, runs=4)), np.zeros(A.domain.shape)
    part[5:11, 5:11] = 1.0
    free = vam.optimize(model, part, iterations=6, progress=False)
    brightest = float(free.sinogram.numpy().max())
    seconds = model.oxygen.seconds
    lamp = 0.5 * brightest * 0.05 / seconds * 24 / (A.beam.pixel_area / A.grid.voxel_volume)
    kept = vam.optimize(model, part, iterations=6, progress=False, irradiance=lamp, critical_dose=0.05)
    assert 0.49 * brightest <= kept.sinogram.numpy().max() <= 0.5001 * brightest
    with pytest.raises(BadInput, match="effective dose of 0.00.*in 2 turns"):
        vam.optimize(model, part, iterations=2, progress=False, irradiance=1e-3 * lamp, critical_dose=0.05)
    with pytest.raises(BadInput, match="exposure_limit without irradiance"):
        vam.optimize(model, part, iterations=2, progress=False, exposure_limit=seconds)
    with pytest.raises(BadInput, match="irradiance and critical_dose alone"):
        vam.optimize(model, part, irradiance=lamp, critical_dose=0.05, exposure_limit=20.0)


@pytest.mark.parametrize(("share", "fits"), [(1.02, True), (0.98, False)])
def test_lamps_are_judged_by_the_effective_dose(share: float, fits: bool) -> None:
    """Under air, full-on pixels whose light gels the darkest voxel of the part pass, far from a linear dose."""
    A = projection((12, 12, 4), 24)
    model, part = OxygenModel(A, Oxygen(2e-2, 3, 9.0, air=("z low", "z high"), runs=4)), np.zeros(A.domain.shape)
    part[4:8, 4:8] = 1.0

    def least(light: float) -> float:
        return float(model.T(np.full(A.range.shape, light))[part > 0.5].min())

    needed = float(brentq(lambda light: least(light) - 1.0, 1.0, 1e4))  # type: ignore[arg-type]
    assert abs(needed * least(1.0) - 1.0) > 0.1
    given: Any = {"irradiance": share * needed * 0.05 / 27.0 * 24 / (A.beam.pixel_area / A.grid.voxel_volume),
             "critical_dose": 0.05}  # fmt: skip
    if fits:
        assert vam.optimize(model, part, iterations=1, progress=False, **given).sinogram.numpy().max() > 0.0
    else:
        with pytest.raises(BadInput, match=r"effective dose of 0\.9\d* in 3 turns"):
            vam.optimize(model, part, iterations=1, progress=False, **given)


def test_states_are_kept_for_derivatives_alone() -> None:
    A, kept = projection((6, 6, 2), 6), []
    model = OxygenModel(A, Oxygen(2e-3, 4, 9.0, runs=6))
    volumes = type(model)._volumes
    light = lit(model, 1.5)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(type(model), "_volumes", lambda self, count: kept.append(count) or volumes(self, count))
        dose, without = model.T(light), len(kept)
        model(dose)
    assert without <= 13 + 2 < 24 < len(kept) - without
    assert np.array_equal(model.T(light), dose), "the dose does not depend on what is kept"


def test_any_loss_and_the_start_do_not_depend_on_earlier_light() -> None:
    A = projection((14, 14, 2), 16, vam.devices()[0])
    model, part = OxygenModel(A, Oxygen(1e-3, 2, 9.0, runs=4)), np.zeros(A.domain.shape)
    part[4:10, 4:10] = 1.0
    loss = Band.thresholds(0.85, 1.25, 1.5)
    first = vam.optimize(model, part, loss, 5, progress=False)
    again = vam.optimize(model, part, loss, 5, progress=False)
    assert first.history == again.history and first.history[-1].loss < 0.7 * first.history[0].loss
    whole = vam.optimize(model, part, iterations=6, progress=False)
    begun = vam.optimize(model, part, iterations=3, progress=False)
    resumed = vam.optimize(model, part, iterations=6, progress=False, resume=begun)
    assert np.array_equal(resumed.sinogram.numpy(), whole.sinogram.numpy())


def test_a_plan_reads_back(tmp_path: Path) -> None:
    A = projection((12, 12, 2), 12, vam.devices()[0])
    used = np.random.default_rng(1).uniform(0.0, 0.5, A.domain.shape)
    model, part = OxygenModel(A, Oxygen(1e-3, 2, 9.0, used, ("z high",), runs=3)), np.zeros(A.domain.shape)
    part[4:8, 4:8] = 1.0
    plan = vam.optimize(model, part, iterations=2, progress=False)
    found: Any = vam.load(plan.save(tmp_path / "square.vam"), device=A.device)
    assert isinstance(found.operator, OxygenModel) and found.operator.oxygen.air == ("z high",)
    assert np.array_equal(found.dose().numpy(), plan.dose().numpy())


def test_wrong_input_is_refused() -> None:
    A = projection((10, 10, 2), 8)
    for wrong, said in (
        ({"diffusivity": -1.0}, "diffusivity"), ({"turns": 0}, "turns"), ({"period": 0.0}, "period"),
        ({"used": 1.2}, "shares"), ({"used": np.array([np.nan, 0.1])}, "shares"), ({"floor": 0.7}, "at most 0.5"),
        ({"used": np.zeros((2, 2))}, "expected"), ({"air": ("top",)}, "z high"), ({"air": "z high"}, "some of"),
        ({"air": None}, r'air=\("z high",\)'), ({"air": [["z high"]]}, "some of"),
    ):  # fmt: skip
        with pytest.raises(BadInput, match=said):
            Oxygen(**{"diffusivity": 1e-3, "turns": 2, "period": 9.0, **wrong})
    with pytest.raises(ShapeMismatch, match=r"\(3,\)"):
        OxygenModel(A, Oxygen(1e-3, 2, 9.0, np.zeros(3), runs=4))
    with pytest.raises(BadInput, match="runs is 12 in a turn of 8 angles"):
        OxygenModel(A, Oxygen(1e-3, 2, 9.0))
    with pytest.raises(BadInput, match="Oxygen\\(diff"):
        OxygenModel(A, 1e-3)  # type: ignore[arg-type]
    uneven = vam.Projection(A.grid, A.beam, vam.Turntable(8, np.arange(1.0, 9.0)), A.vessel, "numpy")
    with pytest.raises(BadInput, match="unequal times"):
        OxygenModel(uneven, Oxygen(1e-3, 2, 9.0, runs=4))
    model, part = OxygenModel(A, Oxygen(1e-3, 2, 9.0, runs=4)), np.zeros(A.domain.shape)
    part[3:7, 3:7] = 1.0
    with pytest.raises(BadInput, match="not linear"):
        vam.optimize(model, part, "osmo")
    with pytest.raises(BadInput, match="leave out the tolerances"):
        vam.optimize(model, part, tolerances=vam.Tolerances(dose=0.05))
    with pytest.raises(BadInput, match="3 diffusivities|A, B and C"):
        KineticModel(A, A, TwoColorResin(1.0, 0.2, 5.0, 0.2), 2, runs=4, period=9.0, diffusivities=(1e-3,))
