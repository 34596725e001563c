"""A container that turns while a frame is lit: operators against those of a container at rest, at many angles of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from transposes import transpose_gap

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import FULL_TURN
from vamgpu.operators.gram import _blur
from vamgpu.operators.polar import PolarGrid
from vamgpu.operators.ring_projection import RingProjection
from vamgpu.operators.spectral import SpectralProjection
from vamgpu.units import deg

VIAL = vam.Vial(radius=12.4, wall=1.0, resin_index=1.49962, wall_index=1.473, absorption=0.05)
GRID, BEAM = vam.Grid((44, 44, 2), 0.36), vam.Beam((90, 2), 0.27)
MOTIONS = {
    "fine": vam.Turntable(90),
    "lit for a part of a step": vam.Turntable(60, lit_share=0.4),
    "few": vam.Turntable(8),
    "measured": vam.Turntable(np.array([5, 9, 11, 40, 41, 200, 290]) * deg, np.arange(1.0, 8.0), lit_share=1.0),
}
SMALL = MOTIONS | {"fine": vam.Turntable(30), "lit for a part of a step": vam.Turntable(20, lit_share=0.4)}
every_motion = pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)


def at_rest(motion: vam.Turntable, place: float) -> vam.Turntable:
    """The same angles and a share of their arcs on, at rest while they are lit."""
    return vam.Turntable(motion.poses + place * motion.arcs, motion.times, lit_share=0.0)


def shown(motion: vam.Turntable, make: Any, light: np.ndarray, places: int = 32) -> np.ndarray:
    """Mean dose of operators at rest at many places of every arc."""
    at = (np.arange(places) + 0.5) / places - 0.5
    return np.mean([np.asarray(make(at_rest(motion, place)).T(light), np.float64) for place in at], axis=0)


@every_motion
@pytest.mark.parametrize("vessel", [None, VIAL], ids=["air", "vial"])
def test_voxels_see_the_mean_of_the_way(opencl_device: Device, motion: vam.Turntable, vessel: Any) -> None:
    def make(turning: vam.Turntable) -> vam.Projection:
        return vam.Projection(GRID, BEAM, turning, vessel, opencl_device)

    A = make(motion)
    light = np.random.default_rng(0).random(A.range.shape).astype(np.float32)
    many = motion.angles > 10
    wanted, found = shown(motion, make, light, places=8 if many else 32), np.asarray(A.T(light))
    x, y, _ = GRID.axes()
    inside = np.hypot(x[:, None], y) <= GRID.inscribed_radius - 2 * GRID.pitch
    assert np.abs(found - wanted)[inside].max() <= (1e-3 if many else 3e-3) * wanted.max()
    still = np.abs(np.asarray(make(motion.stepped).T(light)) - wanted)[inside].max()
    assert still > (5 if many else 15) * np.abs(found - wanted)[inside].max()


@pytest.mark.parametrize(("motion", "vessel"), [
    *(pytest.param(motion, VIAL, id=f"vial-{name}") for name, motion in SMALL.items()),
    *(pytest.param(motion, None, id=f"air-{name}", marks=[pytest.mark.slow] * (name != "few"))
      for name, motion in SMALL.items()),
])  # fmt: skip
def test_the_transpose_is_exact(device: Device, motion: vam.Turntable, vessel: Any) -> None:
    A = vam.Projection(vam.Grid((9, 8, 2), 1.7), vam.Beam((16, 3), 1.5), motion, vessel, device)
    assert transpose_gap(A, most=60) <= 3e-6
    if device.name != "numpy":
        light = np.random.default_rng(0).random(A.range.shape)
        reference = vam.Projection(A.grid, A.beam, motion, vessel, "numpy").T(light)
        assert np.abs(A.T(light) - reference).max() <= 3e-6 * reference.max()


def rays(kind: str, device: Device, motion: vam.Turntable, grid: vam.Grid = GRID) -> Any:
    """Operators that follow one ray a pixel."""
    beam = vam.Beam((grid.shape[0], grid.shape[2]), grid.pitch)
    if kind == "oblique":
        return vam.Oblique(grid, beam, motion, VIAL, vam.Wobble(0.1, 0.2), device)
    x, y, _ = grid.axes()
    index = 1.5 + 0.02 * np.exp(-((x[:, None] - 2.0) ** 2 + (y + 1.0) ** 2) / 4.0)
    if kind == "marched":
        index = np.repeat(index[:, :, None], grid.shape[2], axis=2)
    return vam.TracedProjection(grid, beam, motion, vam.CoRotatingMedium(index, bath=1.5), device=device)


@pytest.mark.parametrize("kind", ["oblique", "traced", "marched"])
def test_rays_see_the_mean_of_the_way(opencl_device: Device, kind: str) -> None:
    motion = vam.Turntable.arc(40, 300 * deg, lit_share=0.8)
    A = rays(kind, opencl_device, motion)
    light = np.random.default_rng(0).random(A.range.shape).astype(np.float32)
    wanted = shown(motion, lambda still: rays(kind, opencl_device, still), light, places=16)
    off = (np.asarray(A.T(light)) - wanted)[GRID.cylinder()] / wanted.max()
    assert off.std() <= 5e-4 and np.abs(off).max() <= 3e-3


@pytest.mark.parametrize("kind", ["oblique", "traced", "marched"])
def test_the_transpose_of_rays_is_exact(device: Device, kind: str) -> None:
    A = rays(kind, device, vam.Turntable(3, np.arange(1, 4)), vam.Grid((6, 6, 2), 2.0))
    assert transpose_gap(A, most=12) <= 3e-6


def test_no_voxel_is_missed(fast_device: Device) -> None:
    """A gather that does not look as far as voxels move shows as 3e-5."""
    A = vam.Projection(vam.Grid((96, 96, 4), 0.16), vam.Beam((120, 4), 0.2), vam.Turntable(45), VIAL, fast_device)
    assert A.dot_test() < 5e-8


def test_parts_of_a_turn_turn_as_the_whole(opencl_device: Device) -> None:
    A = vam.Projection(GRID, BEAM, vam.Turntable(12), None, opencl_device)
    light = np.random.default_rng(0).random(A.range.shape).astype(np.float32)
    halves = ([0, 1, 5], [2, 3, 4, *range(6, 12)])
    parts = np.sum([np.asarray(A.of_poses(some).T(light[some])) for some in halves], axis=0)
    assert np.abs(parts - np.asarray(A.T(light))).max() <= 1e-5 * parts.max()


@pytest.mark.parametrize("lit_share", [1.0, 0.5])
def test_waves_on_rings_fade_as_a_moving_box_makes_them(device: Device, lit_share: float) -> None:
    """Light that is a wave over the angles gives a wave of each angular frequency, k and beyond the angles."""
    grid, k = PolarGrid(24, 2, 0.05, 12), 2
    beam, motion = vam.Beam((40, 2), 0.06), vam.Turntable(12, lit_share=lit_share)
    rest, turning = (SpectralProjection(grid, beam, None, device, motion=each) for each in (motion.stepped, motion))
    light = np.zeros(rest.range.shape, np.float32)
    light[:, 11] = 1.0 + np.cos(k * motion.poses)[:, None]
    band = grid.bands[-1]
    waves = []
    for A in (rest, turning):
        cells = np.asarray(A.T(light), np.float64)[:, band.cell :, 0].reshape(12 * band.samples, band.rings)
        waves.append(np.fft.rfft(cells, axis=0))
    m = np.arange(len(waves[0]))
    x = 0.5 * m * lit_share * FULL_TURN / 12
    kept = np.where(x == 0.0, 1.0, np.sin(x) / np.where(x == 0.0, 1.0, x))
    assert band.samples > 4 and np.abs(waves[0]).max(axis=1)[12 + k] > 1e-2 * np.abs(waves[0]).max()
    assert np.abs(waves[1] - kept[:, None] * waves[0]).max() <= 3e-6 * np.abs(waves[0]).max()


def test_light_on_rings_turns_as_that_of_voxels(opencl_device: Device) -> None:
    def off(motion: vam.Turntable) -> tuple[float, float]:
        A = vam.Projection(GRID, BEAM, motion, VIAL, opencl_device)
        light = np.random.default_rng(0).random(A.range.shape).astype(np.float32)
        wanted, found = np.asarray(A.T(light)), np.asarray(RingProjection.of(A).T(light))
        return float((found - wanted)[GRID.cylinder()].std() / wanted.max()), RingProjection.of(A).dot_test()

    (rest, _), (turning, gap) = off(vam.Turntable(90, lit_share=0.0)), off(vam.Turntable(90))
    assert turning <= rest + 2e-4 and gap < 5e-8


@pytest.mark.parametrize("motion", [vam.Turntable(8), vam.Turntable(12, dwell=np.arange(1, 13)), "steadily"])
def test_rings_refuse_another_motion(motion: Any) -> None:
    with pytest.raises(BadInput, match="expected a Turntable of the grid's 12 evenly spaced angles"):
        SpectralProjection(PolarGrid(8, 2, 0.1, 12), vam.Beam((16, 2), 0.1), None, "numpy", motion=motion)


WEB = vam.WebGrid((64, 6, 3), (0.1, 0.1, 0.3))


def web(share: float, start: float = 4.0) -> Any:
    """One pose of a film that moves by a column and a half."""
    roller = vam.Roller(1.1, vam.Film(0.6, 1.49, 1.33, 0.5), step=0.15 / 1.4, legs=0.45, rays=4, lit_share=share)
    return vam.WebProjection(WEB, vam.Beam((8, 3), 0.3), roller, device="numpy", poses=1, start=start)


@pytest.mark.parametrize("start", [4.0, 4.3], ids=["at a column", "between columns"])
def test_a_film_moves_while_it_is_lit(start: float) -> None:
    light = np.random.default_rng(0).random((1, 8, 3)).astype(np.float32)
    places = start + 1.5 * 0.8 * ((np.arange(32) + 0.5) / 32 - 0.5)
    wanted = np.mean([np.asarray(web(0.0, place).T(light), np.float64) for place in places], axis=0)
    A = web(0.8, start)
    found = np.asarray(A.T(light))
    inner = slice(8, A.light.shape[2])  # light that would leave the window stays in its last column
    assert np.abs(found - wanted)[inner].max() <= 1e-3 * wanted.max()
    assert np.abs(np.asarray(web(0.0, start).T(light)) - wanted)[inner].max() > 0.02 * wanted.max()
    assert found.sum() == pytest.approx(wanted.sum(), rel=1e-3)
    assert transpose_gap(A) <= 1e-6


def test_what_undoes_blur_knows_that_light_turns() -> None:
    """A wave of light in one column: how much of it A Aᵀ keeps, over what it keeps at rest."""
    turning = vam.Projection(GRID, BEAM, vam.Turntable(24), VIAL, "numpy")
    rest = vam.Projection(GRID, BEAM, vam.Turntable(24, lit_share=0), VIAL, "numpy")
    column, k = 70, 6
    light = np.zeros(rest.range.shape)
    light[:, column] = np.cos(k * rest.motion.poses)[:, None]
    kept, wanted = [], []
    for A in (rest, turning):
        wanted.append(float((np.asarray(A.T(light), np.float64) ** 2).sum()))
        kept.append(float(_blur(A, 1e3, 1.0)[k, column, column].real))
    assert wanted[1] < 0.9 * wanted[0]
    assert kept[1] / kept[0] == pytest.approx(wanted[1] / wanted[0], abs=0.03)
