"""Contracts of the projector of webs: equal to an unfolded matrix product, exact transpose, every device alike."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from transposes import transpose_gap

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, ShapeMismatch, SkippedColumns
from vamgpu.geometry import Beam
from vamgpu.operators.web import WebProjection
from vamgpu.web import Propagation, WebGrid, Wrap


def random_light(columns: int, layers: int, window: int, seed: int = 0) -> Propagation:
    """Signed weights on a third of the window."""
    rng = np.random.default_rng(seed)
    dense = rng.standard_normal((columns, layers, window)) * (rng.random((columns, layers, window)) < 0.35)
    dense[0, 0, :] = 1.0  # every column of the window is lit
    r, rho, l = np.nonzero(dense)  # noqa: E741 - the web's axis
    return Propagation.gathered(dense.shape, r, rho, l, dense[r, rho, l])


def straight_light(columns: int, layers: int, window: int) -> Propagation:
    """Rays at slopes from steep to grazing, weighted by the absorption on the way."""
    r, rho, along = np.meshgrid(np.arange(columns), np.arange(layers), np.linspace(0, 1, 12), indexing="ij")
    slope = 0.9 * (2.0 * r / max(columns - 1, 1) - 1.0) * window / layers
    l = np.floor(0.5 * window + slope * (rho + along - 0.5 * layers)).astype(int)  # noqa: E741 - the web's axis
    seen = (l >= 0) & (l < window)
    weight = 0.08 * np.exp(-0.02 * (layers - rho)) * np.hypot(1.0, slope) / 12
    return Propagation.gathered((columns, layers, window), r[seen], rho[seen], l[seen], weight[seen])


def unfolded(web: np.ndarray, window: int, positions: np.ndarray) -> np.ndarray:
    """The matrix [rho · l, pose] of every slice, copied out of the web: (z, rho·window, poses)."""
    n_l, layers, n_z = web.shape
    out = np.zeros((n_z, layers, window, positions.size))
    for pose, position in enumerate(positions):
        below = int(np.floor(position + 1e-9))
        for column, share in ((below, 1.0 - (position - below)), (below + 1, position - below)):
            for l in range(max(0, -column), min(window, n_l - column)):  # noqa: E741 - the web's axis
                out[:, :, l, pose] += share * web[l + column].T
    return out.reshape(n_z, layers * window, -1)


@dataclass(frozen=True)
class Case:
    """A web, its light and how it moves."""

    shape: tuple[int, int, int]
    columns: int
    window: int
    step: float = 1.0
    start: float | None = None
    poses: int | None = None
    rows: tuple[int, float] | None = None

    def operator(self, device: Device | str) -> WebProjection:
        grid = WebGrid(self.shape, (0.08, 0.06, 0.07))
        rows, pitch = self.rows or (self.shape[2], 0.07)
        light = random_light(self.columns, self.shape[1], self.window)
        beam = Beam((self.columns, rows), pitch)
        return WebProjection.from_light(grid, light, self.step, beam, device, self.poses, self.start)


CASES = {
    "step of one": Case((13, 4, 3), 5, 6),
    "longer than a tile": Case((45, 2, 2), 3, 5),
    "one of everything": Case((1, 1, 1), 1, 1),
    "shorter than the window": Case((3, 4, 2), 5, 9),
    "two columns a pose": Case((14, 3, 3), 4, 7, 2.0),
    "five columns a pose": Case((17, 3, 2), 4, 5, 5.0),
    "half a column a pose": Case((9, 3, 2), 4, 5, 0.5),
    "between columns": Case((11, 3, 3), 4, 6, 1.3),
    "nearly one": Case((12, 3, 2), 4, 6, 0.997),
    "a third of the way at every pose": Case((12, 3, 2), 4, 6, 1.0, -2.35),
    "a segment": Case((12, 3, 2), 4, 6, 1.0, 2.0, 5),
    "poses before and behind the web": Case((5, 3, 2), 4, 3, 1.0, -7.0, 20),
    "more rows than slices": Case((10, 3, 4), 4, 5, rows=(6, 0.07)),
    "finer rows": Case((10, 3, 4), 4, 5, rows=(9, 0.03)),
    "coarser rows between columns": Case((10, 3, 5), 4, 5, 1.5, rows=(3, 0.12)),
}

every_case = pytest.mark.parametrize("case", CASES.values(), ids=CASES)


@every_case
def test_the_transpose_is_exact_entry_by_entry(device: Device, case: Case) -> None:
    A = case.operator(device)
    assert transpose_gap(A, most=200) <= 3e-6


@every_case
def test_the_product_is_that_with_the_unfolded_matrix(device: Device, case: Case) -> None:
    if case.rows:
        case = Case(case.shape, case.columns, case.window, case.step)
    A, rng = case.operator(device), np.random.default_rng(2)
    web, light = rng.standard_normal(A.domain.shape), rng.standard_normal(A.range.shape)
    P = A.light.dense().reshape(case.columns, -1)
    wanted = np.moveaxis(P @ unfolded(web, case.window, A.motion.positions), 0, -1).swapaxes(0, 1)
    assert np.abs(A(web) - wanted).max() <= 1e-5 * np.abs(wanted).max()
    gap = np.vdot(wanted, light) - np.vdot(web, np.asarray(A.T(light), np.float64))  # folding transposes unfolding
    assert abs(gap) <= 1e-6 * np.linalg.norm(wanted) * np.linalg.norm(light)


@pytest.mark.slow
def test_the_products_agree_at_the_size_of_a_half_turn(fast_device: Device) -> None:
    """Half a degree a pose over half a turn, 3 mm of film in 80 µm layers, a beam as wide as the roller."""
    grid, window = WebGrid((300, 38, 2), 0.0785), 180
    A = WebProjection.from_light(grid, straight_light(262, 38, window), device=fast_device)
    rng = np.random.default_rng(3)
    web, light = rng.random(A.domain.shape), rng.random(A.range.shape)
    P, poses = A.light.dense().reshape(262, -1), A.motion.positions
    wanted = np.moveaxis(P @ unfolded(web, window, poses), 0, -1).swapaxes(0, 1)
    assert np.abs(A(web) - wanted).max() <= 1e-5 * wanted.max()
    spread = np.einsum("prz,rk->zkp", light, P, optimize=True).reshape(2, 38, window, -1)
    dose = np.zeros((300 + 2 * window, 38, 2))
    for pose, position in enumerate(poses.astype(int)):
        dose[position + window : position + 2 * window] += spread[..., pose].transpose(2, 1, 0)
    dose = dose[window : window + 300]
    assert np.abs(A.T(light) - dose).max() <= 1e-5 * dose.max()


@pytest.mark.slow
@pytest.mark.parametrize("step", [1.0, 3.0, 1.37])
def test_the_dot_test_holds_at_real_size(fast_device: Device, step: float) -> None:
    grid = WebGrid((300, 20, 36), 0.0785)
    A = WebProjection.from_light(grid, straight_light(80, 20, 120), step, device=fast_device)
    assert max(A.dot_test(seed) for seed in range(2)) <= 2e-8


@every_case
def test_devices_agree_with_the_reference(device: Device, case: Case) -> None:
    rng, A, reference = np.random.default_rng(1), case.operator(device), case.operator("numpy")
    x, y = rng.random(A.domain.shape), rng.random(A.range.shape)
    for got, wanted in ((A(x), reference(x)), (A.T(y), reference.T(y))):
        assert np.abs(got - wanted).max() <= 1e-5 * np.abs(wanted).max()


SIZES = {"small": (60, 7, 3, 23, 19), "half a turn in half degrees": (400, 38, 2, 360, 262)}


@pytest.mark.parametrize("size", SIZES.values(), ids=SIZES)
def test_torch_unfolds_and_folds_the_same(fast_device: Device, size: tuple[int, ...]) -> None:
    torch = pytest.importorskip("torch", reason="a test extra")
    length, layers, slices, window, columns = size
    grid = WebGrid((length, layers, slices), 0.0785)
    A = WebProjection.from_light(grid, straight_light(columns, layers, window), device=fast_device)
    rng = np.random.default_rng(5)
    web, light = rng.random(A.domain.shape), rng.random(A.range.shape)
    P, padded = torch.tensor(A.light.dense().reshape(columns, -1)), (layers, length + 2 * (window - 1))
    slices = torch.nn.functional.pad(torch.tensor(web).permute(2, 1, 0)[:, None], (window - 1, window - 1))
    wanted = (P @ torch.nn.functional.unfold(slices, (layers, window))).permute(2, 1, 0).numpy()
    assert np.abs(A(web) - wanted).max() <= 1e-5 * wanted.max()
    folded = torch.nn.functional.fold(P.T @ torch.tensor(light).permute(2, 1, 0), padded, (layers, window))
    dose = folded[:, 0, :, window - 1 : 1 - window].permute(2, 1, 0).numpy()
    assert np.abs(A.T(light) - dose).max() <= 1e-5 * dose.max()


def test_work_on_the_device_crosses_no_bus_and_needs_no_unfolded_matrix(fast_device: Device) -> None:
    A = WebProjection.from_light(WebGrid((400, 8, 16), 0.08), straight_light(32, 8, 100), device=fast_device)
    x, y = fast_device.empty(A.domain.shape), fast_device.empty(A.range.shape)
    fast_device.ledger.reset_peak()
    before = fast_device.ledger.allocated
    with fast_device.no_transfers():
        A(x, out=y)
        A.T(y, out=x)
    assert fast_device.ledger.peak == before


@dataclass(frozen=True)
class Half:
    """A wrap that moves half a column a pose."""

    advance: float = 0.04

    def propagation(self, grid: WebGrid, beam: Beam) -> Propagation:
        return random_light(beam.pixels[0], grid.shape[1], 6)


def test_a_wrap_gives_light_and_step() -> None:
    grid, beam = WebGrid((10, 3, 2), 0.08), Beam((4, 2), 0.08)
    assert isinstance(Half(), Wrap)
    A = WebProjection(grid, beam, Half(), device="numpy")
    assert A.motion.step == 0.5 and A.first == -5.0 and A.motion.poses == 30
    assert A.domain.shape == (10, 3, 2) and A.range.shape == (30, 4, 2) and A.T.T is A
    last = A.motion.positions[-1]
    assert last < 10 <= last + A.motion.step  # one more pose would see nothing


def test_a_small_drift_is_kept_and_rounding_is_not() -> None:
    light = random_light(4, 3, 6)
    A = WebProjection.from_light(WebGrid((2000, 3, 1), 0.08), light, 1.0 + 1e-5, device="numpy")
    assert not A.motion.whole and A.motion.positions[-1] == pytest.approx(-5 + 2004 * (1 + 1e-5))
    assert WebProjection.from_light(WebGrid((2000, 3, 1), 0.08), light, 1.0 + 1e-12, device="numpy").motion.whole


def test_bad_webs_are_named() -> None:
    grid, light = WebGrid((30, 3, 2), 0.08), random_light(4, 3, 6)
    with pytest.raises(SkippedColumns, match="7 columns per angle and the window of light is 6"):
        WebProjection.from_light(grid, light, 7.0, device="numpy")
    few = Propagation((4, 3, 6), *(np.array([v], np.int32) for v in (1, 1, 2)), np.ones(1))  # type: ignore[arg-type]
    with pytest.raises(SkippedColumns, match="15 of 30 columns are never lit, the first is column 0"):
        WebProjection.from_light(grid, few, 2.0, device="numpy", start=None)
    with pytest.raises(SkippedColumns, match="none of 30"):
        WebProjection.from_light(grid, light, 1.0, device="numpy", poses=3, start=-20)
    with pytest.raises(BadInput, match="behind the 30 columns"):
        WebProjection.from_light(grid, light, 1.0, device="numpy", start=30)
    for step in (0.0, -1.0, float("nan")):
        with pytest.raises(BadInput, match="step"):
            WebProjection.from_light(grid, light, step, device="numpy")
    with pytest.raises(ShapeMismatch, match="4 columns and 3 layers"):
        WebProjection.from_light(WebGrid((30, 5, 2), 0.08), light, device="numpy")
    with pytest.raises(BadInput, match="Wrap is expected"):
        WebProjection(grid, Beam((4, 2), 0.08), "roller")  # type: ignore[arg-type]
