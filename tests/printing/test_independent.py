"""The independent exposure against energy, closed forms, and rays traced one by one; and the proofs made of it."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.special import ndtr

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, OpticsWarning
from vamgpu.operators.oblique import Oblique
from vamgpu.optics.beams import Fan
from vamgpu.optics.occluder import Occluded
from vamgpu.optics.rising_beams import Inclined
from vamgpu.printing import independent_exposure as independent
from vamgpu.printing.independent_exposure import IndependentExposure

sys.path.insert(0, str(Path(__file__).parents[1] / "physics"))
from raytracer import trace  # noqa: E402  # pyright: ignore[reportMissingImports]

VIAL = vam.Vial(radius=12.4, wall=1.0, resin_index=1.49962, wall_index=1.473, bath_index=1.0, absorption=0.05)
WIDE = vam.Vial(radius=9.2, wall=0.2, resin_index=1.45, wall_index=1.47, bath_index=1.45, absorption=0.05)
SMALL = vam.Vial(radius=3.2, wall=0.2, resin_index=1.45, wall_index=1.47, bath_index=1.3, absorption=0.08)


def exposed(A: vam.Projection, light: np.ndarray, **options: int) -> np.ndarray:
    """Dose on the part's voxels as float64."""
    return IndependentExposure(A, **options).averaged(A.device.upload(light))[0].numpy().astype(float)


def plane(A: vam.Projection, light: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions and dose [x, y] of the middle fine slice."""
    slabs = list(IndependentExposure(A).fine(A.device.upload(light)))
    dose = np.concatenate([slab.dose.numpy() for slab in slabs], axis=2).astype(float)
    return slabs[0].x, dose[:, :, dose.shape[2] // 2]


# ---- closed forms --------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("pitch", [0.1, 0.0877, 0.17])
def test_even_straight_light_gives_even_dose(pitch: float) -> None:
    A = vam.Projection(vam.Grid((25, 22, 9), 0.1), vam.Beam((60, 40), pitch), vam.Turntable(17, lit_share=0.0))
    even = exposed(A, np.ones(A.range.shape)) / (17 * 0.1**3 / pitch**2)
    assert np.abs(even - 1.0).max() < 1e-3


@pytest.mark.parametrize(("fill", "spread"), [(1.0, None), (0.6, 0.05), (1.0, 0.0)])
def test_one_pixel_is_a_box_under_a_gaussian(fill: float, spread: float | None) -> None:
    """At θ = 0 a voxel's shadow is a box as wide as itself. Power and variance are right with bins of any width."""
    pitch, h = 0.1, 0.0431
    beam = vam.Beam((20, 15), pitch, fill=fill, spread=spread)
    A = vam.Projection(vam.Grid((30, 30, 30), 2 * h), beam, vam.Turntable(1, lit_share=0.0))
    light = np.zeros(A.range.shape)
    light[0, 12, 6] = 1.0
    slab = next(IndependentExposure(A).fine(A.device.upload(light)))
    got = slab.dose.numpy().astype(float)[slab.x.size // 2]  # [y, z]: r is y
    sigma = beam.sigma * pitch

    def mean(place: np.ndarray) -> np.ndarray:
        """Of the pixel's profile over a voxel about each place, by 2000 points."""
        points = place[:, None] + (np.arange(2000) + 0.5) / 2000 * h - 0.5 * h
        side = np.sqrt(fill) * pitch
        if sigma == 0:
            return (np.abs(points) < 0.5 * side).mean(axis=1) / np.sqrt(fill)
        return (ndtr((points + 0.5 * side) / sigma) - ndtr((points - 0.5 * side) / sigma)).mean(axis=1) / np.sqrt(fill)

    wanted = mean(slab.y - 2.5 * pitch)[:, None] * mean(slab.z + pitch)[None, :] * (2 * h) ** 3 / pitch**2
    assert np.abs(got - wanted).max() <= (5e-4 if sigma == 0 and fill == 1.0 else 0.02) * wanted.max()
    assert got.sum() == pytest.approx(wanted.sum(), rel=1e-4)
    for axis, places in ((0, slab.y), (1, slab.z)):
        weights = [g.sum(axis=1 - axis) / g.sum() for g in (got, wanted)]
        means = [float(w @ places) for w in weights]
        assert means[0] == pytest.approx(means[1], abs=2e-3 * pitch)
        spreads = [float(w @ (places - m) ** 2) for w, m in zip(weights, means, strict=True)]
        assert spreads[0] == pytest.approx(spreads[1], abs=4e-3 * pitch**2)


def test_all_light_that_a_vial_absorbs_is_in_its_dose() -> None:
    """Even light over the whole vial, caustics, shadows and rim included: ∫ T (1 − exp(−α L)) du, to 1e-3."""
    A = vam.Projection(vam.Grid((32, 32, 1), 0.2), vam.Beam((300, 12), 0.09), vam.Turntable(60, lit_share=0.0), VIAL)
    x, dose = plane(A, np.ones(A.range.shape))
    inside = np.hypot(x[:, None], x[None, :]) <= VIAL.inner_radius
    u = np.linspace(-VIAL.aperture, VIAL.aperture, 200_001)
    chords = VIAL.chords(u)
    absorbed = np.trapezoid(chords.transmittance * -np.expm1(-VIAL.absorption * chords.length), u)
    found = dose[inside].mean() * np.pi * VIAL.inner_radius**2 * 0.09**2 / 0.2**3 / 60
    assert found == pytest.approx(absorbed, rel=1e-3)


# ---- rays traced one by one ----------------------------------------------------------------------------------------
POSES, COLUMNS, AIR = 45, 181, 0.134
REST = vam.Turntable(POSES, lit_share=0.0)


def _profile(light: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Light [pose, u] of columns under a point spread of half a pixel."""
    distance = u[:, None] / AIR - (np.arange(COLUMNS) - 0.5 * (COLUMNS - 1))
    return light @ (ndtr((distance + 0.5) / 0.5) - ndtr((distance - 0.5) / 0.5)).T


def _traced(light: np.ndarray, x: float, y: float, width: float, points: int) -> float:
    """Mean over a square of every ray that meets each of its points, all branches: Σ light T density α exp(−α s)."""
    u = np.linspace(-VIAL.aperture, VIAL.aperture, 12_001)[1:-1]
    theta = 2.0 * np.pi * np.arange(POSES) / POSES
    rays, bright = trace(VIAL, theta[:, None], u[None, :]), _profile(light, u)
    step = ((np.arange(points) + 0.5) / points - 0.5) * width
    total = 0.0
    for dx in step:
        for dy in step:
            miss = rays.heading[..., 1] * (x + dx - rays.start[..., 0])
            miss = miss - rays.heading[..., 0] * (y + dy - rays.start[..., 1])
            pose, k = np.nonzero(miss[:, 1:] * miss[:, :-1] <= 0.0)
            near, far = miss[pose, k], miss[pose, k + 1]
            share = near / (near - far)
            path = np.hypot(x + dx - rays.start[pose, k, 0], y + dy - rays.start[pose, k, 1])
            power = rays.power[pose, k] + share * (rays.power[pose, k + 1] - rays.power[pose, k])
            sent = bright[pose, k] + share * (bright[pose, k + 1] - bright[pose, k])
            density = (u[1] - u[0]) / np.abs(far - near)
            total += float(np.sum(sent * power * density * VIAL.absorption * np.exp(-VIAL.absorption * path)))
    return total / points**2


@pytest.fixture(scope="module")
def noisy() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Light [pose, column], positions and fine dose of a slice: light without any order, the hardest there is."""
    patch = pytest.MonkeyPatch()
    patch.setattr(independent, "SAMPLES", (256, 256))
    light = np.random.default_rng(1).random((POSES, COLUMNS))
    A = vam.Projection(vam.Grid((100, 100, 1), 0.18), vam.Beam((COLUMNS, 9), AIR), REST, VIAL)
    x, dose = plane(A, np.repeat(light[:, :, None], 9, axis=2))
    patch.undo()
    return light, x, dose * AIR**2 / 0.18**3


@pytest.mark.slow
@pytest.mark.parametrize(("radius", "angle", "within"), [
    (0.0, 0.0, 2e-3), (6.0, 0.8, 3e-3), (8.2, 0.7, 5e-3), (9.5, 4.2, 5e-3),
    *(pytest.param(*place, marks=pytest.mark.slow) for place in (
        (3.0, 0.3, 2e-3), (7.0, 2.1, 3e-3), (7.6, 3.9, 3e-3), (8.0, 5.0, 4e-3), (8.6, 1.4, 5e-3), (10.4, 1.3, 0.01))),
])  # fmt: skip
def test_the_dose_is_that_of_rays_traced_one_by_one(
    noisy: tuple[np.ndarray, np.ndarray, np.ndarray], radius: float, angle: float, within: float
) -> None:
    """Beyond 8.27 mm two and three rays meet, and on the caustics the density of rays has no bound."""
    light, x, dose = noisy
    i, j = (int(np.argmin(np.abs(x - radius * f(angle)))) for f in (np.cos, np.sin))
    wanted = _traced(light, x[i], x[j], x[1] - x[0], 6 if radius < 8.0 else 12)
    assert dose[i, j] == pytest.approx(wanted, rel=within)


# ---- grids, slabs, devices -----------------------------------------------------------------------------------------
def _case(device: Device | str | None = None) -> tuple[vam.Projection, np.ndarray]:
    A = vam.Projection(vam.Grid((26, 22, 20), 0.2), vam.Beam((32, 22), 0.2), vam.Turntable(16), SMALL, device)
    x = np.linspace(-1, 1, 32)[None, :, None] + 0.3 * np.cos(np.arange(16))[:, None, None]
    return A, np.exp(-(3 * x**2)) * np.random.default_rng(2).random(A.range.shape)


@pytest.fixture(scope="module")
def defined() -> np.ndarray:
    """Dose of the case by the definition."""
    return exposed(*_case("numpy"))


def test_devices_agree_with_the_definition(fast_device: Device, defined: np.ndarray) -> None:
    wanted, got = defined, exposed(*_case(fast_device))
    assert np.abs(got - wanted).max() <= 2e-5 * wanted.max()


def test_slabs_of_any_height_give_the_same(device: Device) -> None:
    """70 slices, 211 fine ones, in slabs of 40, or of as many as a device with lanes keeps together: 16, 32 or 48."""
    A = vam.Projection(
        vam.Grid((12, 11, 70), 0.2), vam.Beam((16, 72), 0.2), vam.Turntable(8, lit_share=0.0), SMALL, device
    )
    light = np.random.default_rng(2).random(A.range.shape)
    whole = list(IndependentExposure(A).fine(device.upload(light)))
    bins = 3 * (16 + 2 * 3)
    memory = 40 * device.real.itemsize * (8 * (16 + bins) + 2 * whole[0].x.size ** 2)
    cut = list(IndependentExposure(A, memory).fine(device.upload(light)))
    assert len(whole) == 1 and 4 <= len(cut) <= 7
    assert np.array_equal(np.concatenate([slab.z for slab in cut]), whole[0].z)
    assert np.allclose(np.diff(whole[0].z), 0.2 / 3) and whole[0].z.size == 211
    together = np.concatenate([slab.dose.numpy() for slab in cut], axis=2)
    assert np.abs(together - whole[0].dose.numpy()).max() <= 1e-6 * together.max()
    mean = exposed(A, light)
    assert np.abs(exposed(A, light, memory=memory) - mean).max() <= 1e-6 * mean.max()
    assert np.abs(exposed(A, light, memory=1) - mean).max() <= 1e-6 * mean.max()


def test_the_grid_does_not_matter() -> None:
    """Voxels half as wide, averaged back: what is left is how well fine voxels stand for their mean."""
    A, light = _case()
    B = vam.Projection(vam.Grid((52, 44, 40), 0.1), A.beam, A.motion, SMALL)
    coarse, fine = exposed(A, light), exposed(B, light)
    back = 8 * fine.reshape(26, 2, 22, 2, 20, 2).mean(axis=(1, 3, 5))
    lit = np.broadcast_to(A.grid.cylinder()[:, :, None], coarse.shape)
    assert np.abs(coarse - back)[lit].max() <= 5e-3 * back.max()


@pytest.mark.slow
def test_a_frame_is_lit_while_the_container_turns() -> None:
    """Against the mean over containers at rest at many places of each arc; even doses would hide a mistake."""
    angles, places = 24, 40
    grid, beam = vam.Grid((40, 39, 1), 0.2), vam.Beam((60, 1), 0.2)
    light = np.random.default_rng(4).random((angles, 60, 1)) ** 8
    turning = vam.Turntable(angles, lit_share=0.7)
    vessel = vam.Vial(radius=6.0, wall=0.5, resin_index=1.5, wall_index=1.47, bath_index=1.2, absorption=0.05)
    wanted = np.zeros(grid.shape)
    for place in (np.arange(places) + 0.5) / places - 0.5:
        at = vam.Turntable([*((turning.poses + place * turning.arcs) % (2.0 * np.pi))])
        wanted = wanted + exposed(vam.Projection(grid, beam, at, vessel), light) / places
    still = exposed(vam.Projection(grid, beam, turning.stepped, vessel), light)
    found = exposed(vam.Projection(grid, beam, turning, vessel), light)
    lit = grid.cylinder()
    off, moved = (np.abs(dose - wanted)[lit].max() / wanted[lit].max() for dose in (found, still))
    assert off <= 1e-3 < 0.01 < moved


def test_voxels_get_finer_until_the_dose_agrees_with_itself() -> None:
    """Light of single columns, as wide in the resin as a voxel: against four times as many voxels."""
    grid, beam = vam.Grid((40, 40, 1), 0.2), vam.Beam((60, 1), 0.2)
    light = np.zeros((20, 60, 1))
    light[np.arange(20), np.arange(20, 40)] = 1.0
    A = vam.Projection(grid, beam, vam.Turntable(20, lit_share=0.0))
    coarse = IndependentExposure(A, finer=2)
    fine = coarse.agreed(A.device.upload(light))
    best = exposed(A, light, finer=9)
    off = [
        np.abs(exposed(A, light, finer=one.finer) - best)[grid.cylinder()].max() / best.max() for one in (coarse, fine)
    ]
    assert fine.finer > 2 and fine.agrees is not None and fine.agrees <= 1e-3
    assert off[1] <= 1.5e-3 < off[0]


def test_the_mean_of_fine_voxels_is_exact_for_smooth_dose() -> None:
    """Voxels two to five times as fine, an even and an odd number along x and y: a dose of degree 5."""
    A, _ = _case("cpu")
    A = vam.Projection(vam.Grid((26, 21, 20), 0.2), A.beam, A.motion, A.vessel, "cpu")
    for finer in (2, 3, 4, 5):
        exposure = IndependentExposure(A, finer=finer)
        disc = exposure._near

        def mean(axis: np.ndarray, width: float) -> np.ndarray:
            return (((axis + 0.5 * width) ** 6) - (axis - 0.5 * width) ** 6) / (6.0 * width)

        fine = mean(disc.axis, disc.width)[:, None] + mean(disc.axis, disc.width)[None, :]
        got = exposure._averaged(disc, A.device.upload(np.repeat(fine[:, :, None], 2, axis=2)), A.grid).numpy()[:, :, 0]
        x, y, _ = A.grid.axes()
        wanted = mean(x, 0.2)[:, None] + mean(y, 0.2)[None, :]
        assert np.abs(got - wanted).max() <= 1e-6 * wanted.max()
        matrices = [exposure._averaging(n, disc) for n in (26, 21)]
        assert np.einsum("xu,yv,uv->xy", *matrices, fine) == pytest.approx(wanted, abs=1e-9)


# ---- beyond the part -----------------------------------------------------------------------------------------------
def test_the_greatest_dose_beyond_the_cylinder_is_found() -> None:
    """Light of two columns that miss the part's cylinder."""
    A = vam.Projection(vam.Grid((20, 20, 4), 0.2), vam.Beam((32, 8), 0.2), vam.Turntable(24), SMALL)
    light = np.zeros(A.range.shape)
    light[:, 28:30] = 1.0
    _, outer = IndependentExposure(A).averaged(A.device.upload(light))
    assert outer is not None and 2.3 < outer.distance < 2.9 and outer.radius == 3.0
    x, dose = plane(A, light)
    far = np.hypot(x[:, None], x[None, :])
    assert outer.dose == pytest.approx(dose[(far > A.grid.inscribed_radius) & (far < 3.0)].max(), rel=0.05)


def _wide(light: np.ndarray | None = None) -> tuple[float, independent.Outer]:
    """A wall eight corners of the grid away: the greatest dose of the grid beyond the cylinder, and of all."""
    A = vam.Projection(vam.Grid((16, 16, 2), 0.1), vam.Beam((32, 2), 0.1), vam.Turntable(24), WIDE, "cpu")
    spot = np.zeros(A.grid.shape)
    spot[15, 15] = 1.0
    dose, outer = IndependentExposure(A).averaged(A.device.upload(np.asarray(A(spot)) if light is None else light))
    assert outer is not None and outer.radius == 9.0
    return float(dose.numpy()[~A.grid.cylinder()].max()), outer


def test_in_the_corners_of_the_grid_no_wide_voxel_hides_a_bright_spot() -> None:
    corner, outer = _wide()
    assert outer.width == 0.1 and outer.dose == corner
    assert np.abs(np.array(outer.place[:2])) == pytest.approx([0.75, 0.75])


def test_far_from_the_grid_resin_is_looked_at_on_wider_voxels() -> None:
    """A ring, half a millimeter wide, around a part in wide resin."""
    light = np.zeros((24, 32, 2))
    light[:, 27:] = 1.0
    corner, wide = _wide(light)
    assert wide.width == pytest.approx(0.4) and wide.dose > corner and wide.distance > 1.14
    A = vam.Projection(vam.Grid((40, 40, 2), 0.1), vam.Beam((32, 2), 0.1), vam.Turntable(24), WIDE, "cpu")
    fine = exposed(A, light)[np.hypot(*np.meshgrid(*A.grid.axes()[:2])) > 0.8].max()
    assert 0.6 * fine < wide.dose <= fine


@pytest.mark.slow
@pytest.mark.parametrize("vessel", [None, replace(SMALL, radius=2.6), WIDE], ids=["straight", "near wall", "far wall"])
def test_light_above_and_below_the_grid_is_judged_too(device: Device, vessel: vam.Vial | None) -> None:
    """The last rows of a beam three times as high as the grid, against a grid that holds them."""
    grids = [vam.Grid((20, 20, n), 0.1) for n in (4, 18)]
    low, high = (vam.Projection(g, vam.Beam((24, 12), 0.1), vam.Turntable(16), vessel, device) for g in grids)
    light = np.zeros(low.range.shape)
    light[:, 8:16, 5:7] = 1.0
    _, dim = IndependentExposure(low).averaged(device.upload(light))
    light[:, 10:14, -1] = 2.0
    whole = exposed(high, light)
    whole[:, :, 7:11] = 0.0
    for memory in (independent.MEMORY, 1):
        _, outer = IndependentExposure(low, memory).averaged(device.upload(light))
        assert outer is not None and outer.dose == pytest.approx(whole.max(), rel=1e-3)
        assert outer.place[2] == pytest.approx(0.55) and outer.distance < 0.3
    assert dim is not None and dim.dose < 0.5 * outer.dose


def test_slices_of_dark_rows_are_left_alone() -> None:
    A = vam.Projection(vam.Grid((8, 8, 4), 0.1), vam.Beam((8, 40), 0.1), vam.Turntable(4), None, "cpu")
    light = np.zeros(A.range.shape)
    light[:, :, 17:25] = 1.0  # to 0.5 mm above and 0.3 mm below the middle, and 0.225 mm of blur
    z = IndependentExposure(A)._above_and_below(A.device.upload(light))
    assert z == pytest.approx([*np.arange(-0.55, -0.2, 0.1), *np.arange(0.25, 0.8, 0.1)])


def test_a_single_row_has_neither_top_nor_bottom() -> None:
    """It stands for every height: as bright as the middle of a high beam, on all voxels of its slice."""
    flat, high = (
        vam.Projection(vam.Grid((20, 18, n), 0.1), vam.Beam((24, n), 0.1), vam.Turntable(16), SMALL, "cpu")
        for n in (1, 21)
    )
    light = np.random.default_rng(3).random(flat.range.shape)
    upload = flat.device.upload
    (found,) = IndependentExposure(flat).fine(upload(light))
    (among,) = IndependentExposure(high).fine(upload(np.repeat(light, 21, axis=2)))
    assert found.z == pytest.approx([-0.1 / 3, 0.0, 0.1 / 3], abs=1e-9)
    middle = int(np.argmin(np.abs(among.z)))
    for level in range(3):
        assert found.dose.numpy()[:, :, level] == pytest.approx(among.dose.numpy()[:, :, middle], rel=1e-6)
    coarse = vam.Projection(flat.grid, vam.Beam((8, 1), 0.3), flat.motion, SMALL, "cpu")
    assert not IndependentExposure(coarse)._above_and_below(upload(np.ones(coarse.range.shape))).size


@pytest.mark.parametrize("reach", [0.0, -1.0, np.nan, np.inf, "a"])
def test_a_reach_that_is_none_is_refused(reach: float) -> None:
    A, light = _case("cpu")
    with pytest.raises(BadInput, match="reach"):
        IndependentExposure(A).fine(A.device.upload(light), reach)


# ---- other vessels -------------------------------------------------------------------------------------------------
def test_a_fan_thins_with_the_square_of_nothing_but_the_plane() -> None:
    """One pose of even light from a pupil: in the plane its density falls as 1 / distance."""
    fan = Fan(throw=8.0)
    A = vam.Projection(vam.Grid((30, 30, 1), 0.1), vam.Beam((80, 9), 0.1), vam.Turntable(1, lit_share=0.0), fan)
    x, dose = plane(A, np.ones(A.range.shape))
    _, density = fan.illuminate(x[None, :], -x[:, None])
    near = np.hypot(x[:, None], x[None, :]) < 1.4
    assert np.abs(dose / (0.1**3 / 0.1**2) / density - 1.0)[near].max() < 2e-3


def test_a_rod_shades_what_is_behind_it() -> None:
    rod = Occluded(None, across=0.5, along=-0.2, radius=0.3, transmittance=0.25)
    A = vam.Projection(vam.Grid((30, 30, 1), 0.1), vam.Beam((60, 9), 0.1), vam.Turntable(1, lit_share=0.0), rod)
    x, dose = plane(A, np.ones(A.range.shape))
    share = dose / 0.1
    at = {name: (int(np.argmin(np.abs(x + y))), int(np.argmin(np.abs(x - c)))) for name, c, y in (
        ("behind", 0.5, 0.9), ("before", 0.5, -0.9), ("beside", -0.5, 0.9))}  # fmt: skip
    assert share[at["behind"]] == pytest.approx(0.25, abs=1e-3)
    assert share[at["before"]] == pytest.approx(1.0, abs=1e-3) and share[at["beside"]] == pytest.approx(1.0, abs=1e-3)


# ---- proofs --------------------------------------------------------------------------------------------------------
class Shown:
    """Frames that are nothing but their light."""

    def __init__(self, light: np.ndarray) -> None:
        self.light, self.scale = light, 1.0

    def irradiance(self, device: Device) -> vam.DeviceArray:  # pyright: ignore[reportAttributeAccessIssue]
        return device.upload(self.light)


def test_a_proof_says_who_judged_and_what_was_claimed() -> None:
    A, light = _case()
    target = np.zeros(A.grid.shape)
    target[8:18, 7:15, 6:14] = 1.0
    proof = vam.simulate(A, Shown(light), target)
    lines = {line.name: line.value for line in proof.lines()}
    assert proof.independent and lines["judged by"] == "traced rays"
    assert lines["window by the solver"] == f"{proof.claimed.window:+.4f}"
    assert np.abs(proof.dose.numpy() - exposed(A, light)).max() <= 1e-6 * proof.scores.peak
    assert proof.outer is not None and lines["dose beyond the cylinder"] == f"{proof.outer_share:.3f}"
    slabs = list(proof.fine(reach=A.grid.inscribed_radius))
    assert slabs[0].radius == A.grid.inscribed_radius and slabs[0].pitch == 0.2 / 3
    assert sum(slab.z.size for slab in slabs) == 61
    assert proof.width == 0.2 / IndependentExposure(A).finer and (proof.agrees or 1.0) <= 1e-3


@pytest.mark.parametrize("rows", [16, 20], ids=["as high as the part", "two pixels more on either side"])
def test_what_prints_above_a_part_as_high_as_its_grid_is_seen(rows: int) -> None:
    grid, motion = vam.Grid((16, 16, 16), 0.1), vam.Turntable(24)
    beam = vam.Beam((20, 20), 0.1, spread=0.02)
    A = vam.Projection(grid, beam, motion)
    target = np.zeros(grid.shape)
    target[5:11, 5:11, :] = 1.0
    light = np.zeros(A.range.shape)
    light[:, :, 10 - rows // 2 : 10 + rows // 2] = np.asarray(A(target)).mean(axis=2, keepdims=True)
    surface = vam.simulate(A, Shown(light), target).judgement.surface
    assert (surface.greatest_excess > 0.15) == (rows > 16), surface.greatest_excess


def test_an_operator_without_rays_of_its_own_proves_nothing_and_says_so() -> None:
    grid, beam, motion = vam.Grid((16, 16, 12), 0.2), vam.Beam((20, 16), 0.2), vam.Turntable(8, lit_share=0.0)
    A = Oblique(grid, beam, motion, Inclined(elevation=0.2))
    target = np.zeros(grid.shape)
    target[5:11, 5:11, 4:8] = 1.0
    proof = vam.simulate(A, Shown(np.ones(A.range.shape)), target)  # pyright: ignore[reportArgumentType]
    beyond = proof.dose.numpy()[~grid.cylinder()]
    assert not proof.independent and proof.outer is not None and proof.outer.dose == pytest.approx(beyond.max())
    assert proof.scores == proof.claimed
    lines = {line.name: line.value for line in proof.lines()}
    assert lines["judged by"] == "its own operator" and "dose beyond the cylinder" in lines
    assert (
        not proof.verdict.proved
        and "according to the solver's own dose" in str(proof.verdict)
        and not proof.all_correct
    )
    with pytest.raises(BadInput, match="the dose is the operator's own"):
        proof.fine()


def test_what_prints_beyond_the_cylinder_spoils_a_proof() -> None:
    """Light for a part that is right everywhere in the cylinder, and as much again outside."""
    A = vam.Projection(vam.Grid((20, 20, 4), 0.2), vam.Beam((32, 8), 0.2), vam.Turntable(24), SMALL)
    light = np.zeros(A.range.shape)
    light[:, 11:21, 2:6] = 1.0
    target = np.broadcast_to((A.grid.axes()[0][:, None] ** 2 + A.grid.axes()[1] ** 2 < 1.0)[:, :, None], A.grid.shape)
    good = vam.simulate(A, Shown(light), target.astype(float))
    for place in (np.s_[:, 28:30], np.s_[:, 11:21, 7]):
        more = light.copy()
        more[place] = 4.0
        bad = vam.simulate(A, Shown(more), target.astype(float), threshold=good.scores.threshold)
        assert good.outer_share < 1.0 < bad.outer_share and not bad.all_correct
        assert "esin beyond the judged cylinder also prints" in str(bad.verdict)


def test_resin_within_a_pixel_of_the_part_is_its_surface_where_the_grid_ends_with_it() -> None:
    """Light as high as the part, and one row and two rows higher."""
    A = vam.Projection(vam.Grid((20, 20, 4), 0.2), vam.Beam((32, 12), 0.2), vam.Turntable(24), SMALL)
    target = np.broadcast_to((A.grid.axes()[0][:, None] ** 2 + A.grid.axes()[1] ** 2 < 1.0)[:, :, None], A.grid.shape)
    found = []
    for top in (8, 9, 10):
        light = np.zeros(A.range.shape)
        light[:, 11:21, 4:top] = 1.0
        found.append(vam.simulate(A, Shown(light), target.astype(float)))
    near = IndependentExposure(A).averaged(found[1].frames.irradiance(A.device))[1]
    assert near is not None and near.place[2] == pytest.approx(0.5) and near.dose > found[1].solid_from
    assert found[0].outer_share < 1.0 and found[1].outer_share < 1.0 < found[2].outer_share
    assert found[2].outer is not None and found[2].outer.place[2] == pytest.approx(0.7)


def test_voxels_of_the_part_that_nobody_judges_are_told_and_counted() -> None:
    """A bar through the whole grid, whose ends lie beyond the judged cylinder."""
    A = vam.Projection(vam.Grid((16, 22, 3), 0.2), vam.Beam((32, 3), 0.2), vam.Turntable(24), SMALL)
    target = np.zeros(A.grid.shape)
    target[6:10], target[6, 0, 0] = 1.0, 0.49
    with pytest.warns(OpticsWarning, match="neither optimized nor judged") as warned:
        proof = vam.simulate(A, Shown(np.asarray(A(target))), target)
    assert warned[0].filename == __file__
    lost = int((target[~A.grid.cylinder()] >= 0.5).sum())
    assert proof.unjudged_voxels == lost == 95 and not proof.all_correct
    assert {line.name: line.value for line in proof.lines()}["part beyond the cylinder"] == "95"
    assert "95 voxels of the part lie beyond the judged cylinder" in str(proof.verdict)


@pytest.mark.parametrize("columns", [pytest.param(64, marks=pytest.mark.slow), 65])
def test_the_last_columns_of_a_beam_as_wide_as_the_grid_light_its_rim(columns: int) -> None:
    """Against the definition's areas; rays that ended with the beam left the rim dark."""
    A = vam.Projection(
        vam.Grid((64, 64, 2), 0.1), vam.Beam((columns, 2), 0.1), vam.Turntable(5, lit_share=0.0), None, "numpy"
    )
    light = np.zeros(A.range.shape)
    light[:, :4] = 1.0
    wanted = np.asarray(A.T(light))
    found = IndependentExposure(A).averaged(A.device.upload(light))[0].numpy()
    inside = A.grid.cylinder()
    assert np.abs(found - wanted)[inside].max() <= 1e-2 * wanted.max() > 0.0
