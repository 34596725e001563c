"""The judge of the leaderboard against formulas, and against the library's simulated print."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.interpolate import RegularGridInterpolator

import vamgpu
from profiling.leaderboard.judge import Exposure, RoundVial, Setup, SquareVial, read_frames, write_frames
from vamgpu.backend import open_device
from vamgpu.printing.independent_exposure import IndependentExposure

AIR: dict[str, float] = {
    "radius": 7.0, "wall": 1.0, "resin_index": 1.5, "wall_index": 1.47, "bath_index": 1.0, "absorption": 0.08,
}  # fmt: skip
MATCHED = AIR | dict.fromkeys(("resin_index", "wall_index", "bath_index"), 1.5)


def setup(vial: RoundVial | SquareVial, pitch: float = 0.4, lit_share: float = 1.0) -> Setup:
    return Setup(vial, pitch, 0.5 * pitch, lit_share, 2.0, 1.0, Path())


def passed(vial: dict[str, float], u: np.ndarray) -> np.ndarray:
    """Light that passes both faces of a round vial, by Fresnel's formulas in angles."""
    s = p = np.ones_like(u)
    for radius, before, after in ((7.0, vial["bath_index"], vial["wall_index"]),
                                  (6.0, vial["wall_index"], vial["resin_index"])):  # fmt: skip
        i, t = (np.arcsin(u * vial["bath_index"] / (radius * n)) for n in (before, after))
        if before != after:
            s = s * (1.0 - (np.sin(i - t) / np.sin(i + t)) ** 2)
            p = p * (1.0 - (np.tan(i - t) / np.tan(i + t)) ** 2)
    return 0.5 * (s + p)


def normal(*indices: float) -> float:
    """Light that passes faces at normal incidence."""
    return float(np.prod([1.0 - ((a - b) / (a + b)) ** 2 for a, b in zip(indices, indices[1:], strict=False)]))


def at(x: float, y: float) -> tuple[np.ndarray, np.ndarray]:
    return np.array([x]), np.array([y])


@pytest.mark.parametrize("depth", [0.0, 3.0, 11.9])
def test_a_slab_absorbs_by_beer_lambert(depth: float) -> None:
    vial = SquareVial(**AIR)
    ((u, light),) = [ray for ray in vial.rays(*at(vial.inner - depth, 0.5), 0.0) if ray[1].any()]
    expected = normal(1.0, 1.47, 1.5) * 0.08 * np.exp(-0.08 * depth)
    np.testing.assert_allclose((u[0], light[0]), (0.5, expected), rtol=1e-9)


def test_light_enters_a_slanted_slab_by_snell() -> None:
    vial, tilt = SquareVial(**AIR), 0.3
    inner, wall = (np.arcsin(np.sin(tilt) / n) for n in (1.5, 1.47))
    x, y = at(3.0, 0.7)
    u, light = max(vial.rays(x, y, tilt), key=lambda ray: float(ray[1][0]))
    face = 0.7 + 3.0 * np.tan(inner) + np.tan(wall)  # where the ray enters the outer face
    np.testing.assert_allclose(u[0], face * np.cos(tilt) - 7.0 * np.sin(tilt), rtol=1e-9)
    s = p = 1.0
    for i, t in ((tilt, wall), (wall, inner)):
        s *= 1.0 - (np.sin(i - t) / np.sin(i + t)) ** 2
        p *= 1.0 - (np.tan(i - t) / np.tan(i + t)) ** 2
    expected = 0.08 * 0.5 * (s + p) * np.cos(tilt) / np.cos(inner) * np.exp(-0.08 * 3.0 / np.cos(inner))
    np.testing.assert_allclose(light[0], expected, rtol=1e-9)


def test_light_at_the_axis_of_a_round_vial() -> None:
    u, light = RoundVial(**AIR).through(*at(0.0, 0.0))
    expected = 0.08 * np.exp(-0.08 * 6.0) * normal(1.0, 1.47, 1.5) * 1.5  # columns are narrower by the index
    np.testing.assert_allclose((u[0], light[0]), (0.0, expected), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("vial", [AIR, MATCHED, AIR | {"wall_index": 1.6, "bath_index": 1.33}])
def test_a_round_vial_absorbs_what_enters_it(vial: dict[str, float]) -> None:
    judged, width = RoundVial(**vial), 0.7
    nodes, weights = np.polynomial.legendre.leggauss(60)
    across = np.linspace(-5.0, 5.0, 501)[:, None]
    half = np.sqrt(36.0 - across**2)
    u, light = judged.through(np.broadcast_to(across, (501, 60)), half * nodes)
    beam = np.exp(-0.5 * (u / width) ** 2)
    absorbed = np.trapezoid((light * beam * half * weights).sum(1), across[:, 0])
    u = np.linspace(-5.0, 5.0, 2000)  # none is 0
    chord = 2.0 * np.sqrt(36.0 - (u * vial["bath_index"] / vial["resin_index"]) ** 2)
    entered = np.trapezoid(passed(vial, u) * np.exp(-0.5 * (u / width) ** 2) * (1.0 - np.exp(-0.08 * chord)), u)
    np.testing.assert_allclose(absorbed, entered, rtol=1e-4)


def test_even_light_gives_the_mean_over_a_turn() -> None:
    exposure = Exposure(setup(RoundVial(**MATCHED)), (60, 40, 12), radius=4.0)
    dose = exposure.dose_rate(np.ones(exposure.shape))
    x = exposure.x[exposure.x > 0.0]
    away = np.hypot(x, x[0])[:, None]
    turn = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    path = away * np.cos(turn) + np.sqrt(36.0 - (away * np.sin(turn)) ** 2)
    expected = 2.0 * 0.08 * np.exp(-0.08 * path).mean(1)
    middle, first = dose.shape[2] // 2, exposure.x.size // 2
    inner = away[:, 0] < 3.9
    np.testing.assert_allclose(dose[first:, first, middle][inner], expected[inner], rtol=1e-4)


def test_a_square_vial_gives_the_mean_of_its_slabs_over_a_turn() -> None:
    exposure = Exposure(setup(SquareVial(**AIR)), (360, 42, 10), radius=0.5)  # there, light of every angle enters
    dose = exposure.dose_rate(np.ones(exposure.shape))
    tilt = (np.arange(8000) + 0.5) / 8000 * 0.5 * np.pi  # of the light to the normal of a face that it meets
    wall, inner = (np.arcsin(np.sin(tilt) / n) for n in (1.47, 1.5))
    s = p = np.cos(tilt) / np.cos(inner)  # light is wider behind a slanted face
    for i, t in ((tilt, wall), (wall, inner)):
        s = s * (1.0 - (np.sin(i - t) / np.sin(i + t)) ** 2)
        p = p * (1.0 - (np.tan(i - t) / np.tan(i + t)) ** 2)
    x, near = exposure.x, exposure.x.size // 2  # voxels (x, x[near]), and their depths below the four faces
    depths = 6.0 + np.stack([x, -x, *np.broadcast_to([[x[near]], [-x[near]]], (2, x.size))])
    slabs = 0.5 * (s + p) * np.exp(-0.08 * depths[..., None] / np.cos(inner))
    expected = 2.0 * 0.08 * 0.5 * slabs.mean(-1).sum(0)  # a face is lit for half a turn
    lit = exposure.inside[:, near]
    np.testing.assert_allclose(dose[lit, near, dose.shape[2] // 2], expected[lit], rtol=1e-4)


def test_a_pixel_lights_its_own_corner_when_its_frame_is_shown() -> None:
    exposure = Exposure(setup(RoundVial(**MATCHED), lit_share=0.01), (4, 20, 10), radius=3.5)
    light = np.zeros(exposure.shape)
    light[1, 2, 7] = 1.0  # at 90°, X = -x: column 2 is at x = 3, row 7 above the middle
    x, y, z = np.unravel_index(exposure.dose_rate(light).argmax(), (exposure.x.size, exposure.x.size, exposure.z.size))
    np.testing.assert_allclose((exposure.x[x], exposure.z[z]), (3.0, 1.0), atol=0.11)
    assert exposure.x[y] > 0.0, "light travels towards -y at 90°"


def test_frames_are_read_as_they_were_written(tmp_path: Path) -> None:
    light = np.random.default_rng(1).random((3, 5, 4))
    write_frames(tmp_path, light)
    np.testing.assert_allclose(read_frames(tmp_path), light / light.max(), atol=0.5 / 255.0 + 1e-12)
    with Image.open(tmp_path / "00002.png") as image:
        assert image.getpixel((4, 0)) == round(255 * light[2, 4, 3] / light.max()), "top right: largest X, largest z"
    Image.new("RGB", (5, 4)).save(tmp_path / "00003.png")
    with pytest.raises(ValueError, match="expected 8-bit gray"):
        read_frames(tmp_path)


@pytest.mark.parametrize("vial", [AIR, MATCHED])
@pytest.mark.filterwarnings("ignore::vamgpu.errors.SamplingWarning")
def test_the_dose_is_that_of_the_librarys_proof(vial: dict[str, Any]) -> None:
    pitch = 0.3
    A: Any = vamgpu.Projection(vamgpu.Grid((24, 24, 8), 0.2), vamgpu.Beam((26, 12), pitch, spread=0.5 * pitch),
                               vamgpu.Turntable(24), vamgpu.Vial(**vial), open_device("numpy"))  # fmt: skip
    theta, r, z = (np.linspace(0.0, 1.0, n) for n in A.range.shape)
    turn = 1.0 + 0.5 * np.cos(2.0 * np.pi * theta)[:, None, None]
    light = (turn * (0.3 + r**2)[:, None] * (0.5 + z)).astype(np.float32)
    slab = next(IndependentExposure(A, finer=3).fine(A.device.upload(light), 2.2))
    exposure = Exposure(setup(RoundVial(**vial), pitch), A.range.shape, 2.6)
    proved = slab.dose.numpy() * A.beam.pixel_area / A.grid.voxel_volume * 2.0 / 24
    near = np.linspace(-1.1, 1.1, 12)
    points = np.stack(np.meshgrid(near, near, np.linspace(-0.45, 0.45, 5), indexing="ij"), axis=-1)
    found, expected = (RegularGridInterpolator((x, x, z), dose, method="cubic")(points) for x, z, dose in (
        (exposure.x, exposure.z, exposure.dose_rate(light)), (slab.x, slab.z, proved)))  # fmt: skip
    np.testing.assert_allclose(found, expected, rtol=1e-3)
