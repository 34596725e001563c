"""Diffusion of a dose against its formula, and doses that make up for it."""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from vamgpu.backend import open_device
from vamgpu.backend.device import Device
from vamgpu.chemistry.diffusion import Diffusion, Spread, heat_taps
from vamgpu.chemistry.precompensate import Compensated, precompensate, stream
from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.methods import Recipe, optimize
from vamgpu.operators.projection import Projection
from vamgpu.operators.reductions import window
from vamgpu.web import WebGrid

SMALL = Grid((8, 7, 9), 0.05)
VOXEL = Diffusion(1.0, 1.0)
"""Deviation of one voxel of a grid whose pitch is 1."""


def gyroid(n: int) -> np.ndarray:
    """Sheets, four to five voxels thick, in a cylinder."""
    x, y, z = np.indices((n, n, n)) - 0.5 * (n - 1)
    (sx, cx), (sy, cy), (sz, cz) = ((np.sin(0.35 * a), np.cos(0.35 * a)) for a in (x, y, z))
    wave = sx * cy + sy * cz + sz * cx
    inside = (np.hypot(x, y) < 0.38 * n) & (np.abs(z) < 0.38 * n)
    return ((np.abs(wave) < 0.35) & inside).astype(np.float32)


@cache
def compensated(background: float) -> Compensated:
    part = gyroid(40)
    return precompensate(part, Grid(part.shape, 1.0), VOXEL, background=background, device="numpy")  # type: ignore[arg-type]


# ---- the blur ----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("variance", [1e-4, 0.1, 1.0, 9.0, 100.0])
def test_taps_hold_all_mass_and_their_variance(variance: float) -> None:
    taps = heat_taps(variance)
    place = np.arange(len(taps))
    assert (taps >= 0).all() and taps[0] + 2 * taps[1:].sum() == pytest.approx(1.0, abs=1e-12)
    assert 2 * (taps * place**2).sum() == pytest.approx(variance, rel=1e-4)


@pytest.mark.parametrize("wave", [4, 6, 16])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_waves_fall_as_the_mean_of_heat_kernels(axis: int, wave: int) -> None:
    shape = [2, 2, 2]
    shape[axis] = 97
    edges = [1e4, 1e4, 1e4]
    edges[axis] = 1.0
    diffusion = Diffusion(0.6, 2.0, optical=0.3)
    place = np.arange(97) - 48
    line = np.cos(2 * np.pi * place / wave)
    field = np.broadcast_to(line.reshape([-1 if a == axis else 1 for a in range(3)]), shape)
    spread = Spread(WebGrid(tuple(shape), tuple(edges)), diffusion, "numpy")  # type: ignore[arg-type]
    middle = np.take(spread(field), 48, axis=axis).mean()
    q = 1.2 * (2.0 - 2.0 * np.cos(2 * np.pi / wave))  # of differences between voxels, instead of k²
    wanted = (1.0 - np.exp(-q)) / q * np.exp(-0.09 * (1.0 - np.cos(2 * np.pi / wave)))
    assert middle == pytest.approx(wanted, abs=1e-5)
    if wave == 16:
        decay, blur = 1.2 * (2.0 * np.pi / wave) ** 2, 0.5 * (0.3 * 2.0 * np.pi / wave) ** 2  # of a continuous medium
        assert middle == pytest.approx(-np.expm1(-decay) / decay * np.exp(-blur), abs=3e-3)


def test_the_blur_is_its_transposes_transpose(device: Device) -> None:
    spread = Spread(SMALL, Diffusion(1e-5, 200.0, 0.02), device)
    assert spread.dot_test() < 1e-6
    if device.name == "numpy":
        assert np.allclose(spread.dense(), spread.T.dense().T, atol=1e-12)


def test_devices_agree(device: Device) -> None:
    x = np.random.default_rng(0).random(SMALL.shape).astype(np.float32)
    diffusion = Diffusion(1e-5, 200.0)
    wanted = Spread(SMALL, diffusion, "numpy")(x)
    assert np.abs(Spread(SMALL, diffusion, device)(x) - wanted).max() < 1e-6 * wanted.max()
    here = precompensate(x, SMALL, diffusion, background=0.5, device=device)
    there = precompensate(x, SMALL, diffusion, background=0.5, device="numpy")
    assert np.abs(here.dose.numpy() - there.dose.numpy()).max() < 1e-4 * there.greatest
    assert here.after == pytest.approx(there.after, rel=1e-3)


# ---- the compensation --------------------------------------------------------------------------------------------
def test_over_a_background_it_comes_several_times_nearer() -> None:
    found = compensated(0.6)
    assert found.factor > 4.0
    assert found.dose.numpy().min() >= 0.0


@pytest.mark.parametrize(
    ("blur", "background", "factor"),
    [
        (1.0, 0.6, 4.93),
        pytest.param(2.0, 0.6, 1.76, marks=pytest.mark.slow),
        pytest.param(1.0, 0.0, 1.14, marks=pytest.mark.slow),
    ],
)
def test_how_much_nearer_is_as_documented(blur: float, background: float, factor: float) -> None:
    part = gyroid(64)
    grid, diffusion = Grid((64, 64, 64), 1.0), Diffusion(blur**2, 1.0)
    assert precompensate(part, grid, diffusion, background=background).factor == pytest.approx(factor, rel=0.02)


def test_without_background_it_is_never_negative_and_still_nearer() -> None:
    found, part = compensated(0.0), gyroid(40)
    dose = found.dose.numpy()
    assert dose.min() >= 0.0 and found.factor > 1.05
    spread = Spread(Grid((40, 40, 40), 1.0), VOXEL, "numpy")
    wrong = [int(((spread(field) >= 0.5) != (part >= 0.5)).sum()) for field in (part, dose)]
    assert wrong[1] < 0.1 * wrong[0]


def test_what_it_reports_is_what_a_blur_of_its_dose_misses() -> None:
    found, part = compensated(0.6), gyroid(40).astype(float)
    spread = Spread(Grid((40, 40, 40), 1.0), VOXEL, "numpy")
    model = found.dose.numpy() - 0.6  # the background is everywhere, so it stays as it is
    assert found.after == pytest.approx(np.sqrt(((spread(model) - 0.4 * part) ** 2).mean()), rel=1e-3)
    assert found.before == pytest.approx(0.4 * np.sqrt(((spread(part) - part) ** 2).mean()), rel=1e-3)
    assert found.greatest == pytest.approx(found.dose.numpy().max())


def test_more_ridge_asks_for_smaller_doses() -> None:
    part, grid = gyroid(24), Grid((24, 24, 24), 1.0)
    doses = [precompensate(part, grid, VOXEL, background=0.6, ridge=r, device="numpy") for r in (1e-3, 1e-2, 1e-1)]
    assert all(a.greatest > b.greatest and a.factor > b.factor for a, b in pairwise(doses))


@cache
def column() -> tuple[np.ndarray, Any]:
    """A part as high as a stream needs, and what is precompensated of it as a whole."""
    part = gyroid(40)[8:32, 8:32]
    return part, precompensate(part, Grid(part.shape, 1.0), VOXEL, background=0.6, device=open_device())


@pytest.mark.slow
@pytest.mark.parametrize("thick", [pytest.param((40,), marks=pytest.mark.slow), (5, 1, 30, 4), (13, 13, 14)])
def test_a_stream_of_slabs_gives_what_the_whole_gives(thick: tuple[int, ...]) -> None:
    (part, whole), grid, device = column(), Grid((24, 24, 1), 1.0), open_device()
    slabs = iter(np.split(part, np.cumsum(thick)[:-1], axis=2))
    pieces = list(stream(slabs, grid, VOXEL, background=0.6, block=12, device=device))
    assert max(piece.shape[2] for piece in pieces) <= 12
    together = np.concatenate(pieces, axis=2)
    assert together.shape == part.shape and together.min() >= 0.0
    assert np.abs(together - whole.dose.numpy()).max() < 1e-3 * whole.greatest


def test_a_stream_yields_before_it_has_seen_the_end() -> None:
    def endless() -> Any:
        while True:
            yield np.ones((6, 6, 5), np.float32)

    doses = stream(endless(), Grid((6, 6, 1), 1.0), Diffusion(0.05, 1.0), block=4, iterations=2, device="numpy")
    assert next(doses).shape == (6, 6, 4) and next(doses).shape == (6, 6, 4)


def test_the_recipe_makes_up_for_diffusion() -> None:
    part, grid = gyroid(32), Grid((32, 32, 32), 0.1)
    A = Projection(grid, Beam((48, 32), 0.1, spread=0.0), Turntable(48), device=open_device())
    diffusion = Diffusion(1e-4, 80.0)
    spread = Spread(grid, diffusion, A.device)
    strict = []
    for method in (Recipe(), Recipe(diffusion=diffusion)):
        plan = optimize(A, part, method, 8)
        felt = spread(A.T(plan.sinogram))
        least, leak, most = window(felt, A.device.upload(part), 16.0)
        strict.append((least - leak) / most)
        assert plan.sinogram.numpy().min() >= 0.0
    assert strict[1] > strict[0] + 0.05
    assert plan.history[-1].window == pytest.approx(strict[1], abs=1e-6)


# ---- refusals ----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (lambda: Diffusion(0.0, 10.0), "diffusivity"),
        (lambda: Diffusion(-1e-7, 10.0), "diffusivity"),
        (lambda: Diffusion(1e-7, float("nan")), "seconds"),
        (lambda: Diffusion(1e-7, 10.0, optical=-1.0), "optical"),
        (lambda: Diffusion(1e-7, 10.0, stages=0), "stages"),
        (lambda: precompensate(np.ones(SMALL.shape), SMALL, VOXEL, background=1.0, device="numpy"), "background"),
        (lambda: precompensate(np.ones(SMALL.shape), SMALL, VOXEL, ridge=0.0, device="numpy"), "ridge"),
        (lambda: precompensate(np.ones(SMALL.shape), SMALL, VOXEL, iterations=0, device="numpy"), "iterations"),
        (lambda: precompensate(np.full(SMALL.shape, np.nan), SMALL, VOXEL, device="numpy"), "finite"),
        (lambda: list(stream([np.ones((2, 2, 2))], SMALL, VOXEL, block=0, device="numpy")), "block"),
    ],
)
def test_impossible_values_are_refused_by_name(make: Any, complaint: str) -> None:
    with pytest.raises(BadInput, match=complaint):
        make()


def test_other_shapes_are_refused() -> None:
    with pytest.raises(ShapeMismatch, match="fractions have shape"):
        precompensate(np.ones((2, 2, 2)), SMALL, VOXEL, device="numpy")
    with pytest.raises(ShapeMismatch, match="slab"):
        list(stream([np.ones((2, 2, 2))], SMALL, VOXEL, device="numpy"))
