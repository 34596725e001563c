"""Beams that are not ideal against formulas, independent ray integrals, and what they become where they are ideal."""

# pyright: reportCallIssue=false
# (it cannot count the arguments of *a[:3])
from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.operators.blur import gaussian, width_of
from vamgpu.operators.defocus import Defocus, Defocused
from vamgpu.operators.oblique import Oblique
from vamgpu.operators.ray_table import OpenAir
from vamgpu.operators.shifts import Tiles, Wobbled
from vamgpu.operators.wobble import Wobble
from vamgpu.optics.beams import Fan, Misaligned
from vamgpu.optics.occluder import Occluded
from vamgpu.optics.rising_beams import Cone, Inclined

FAST = None
"""The fastest device there is."""
GLASS = vam.Vial(radius=12.4, wall=1.0, resin_index=1.49962, wall_index=1.473, absorption=0.05)
PITCH = 0.1


def blob(grid: vam.Grid, center: tuple[float, float, float], sigma: float) -> np.ndarray:
    x, y, z = np.meshgrid(*grid.axes(), indexing="ij")
    square = sum((a - c) ** 2 for a, c in zip((x, y, z), center, strict=True))
    return np.exp(-0.5 * square / sigma**2)


def smooth(beam: vam.Beam, motion: vam.Turntable, middle: float, sigma: float) -> np.ndarray:
    """Images that fall off as a Gaussian across the columns."""
    profile = np.exp(-0.5 * ((beam.columns() - middle) / sigma) ** 2)
    return np.broadcast_to(profile[:, None], (motion.angles, *beam.pixels)).copy()


def line_integral(start: np.ndarray, forth: np.ndarray, center: np.ndarray, sigma: float) -> np.ndarray:
    """Of a Gaussian blob along infinite lines; start and forth are [..., 3]."""
    unit = forth / np.linalg.norm(forth, axis=-1, keepdims=True)
    apart = np.linalg.norm(np.cross(start - center, unit), axis=-1)
    return np.sqrt(2.0 * np.pi) * sigma * np.exp(-0.5 * (apart / sigma) ** 2)


def laboratory(point: tuple[float, float, float], theta: float) -> np.ndarray:
    x, y, z = point
    c, s = np.cos(theta), np.sin(theta)
    return np.array([y * c - x * s, -(x * c + y * s), z])


@pytest.mark.parametrize("rises", [False, True])
def test_a_fan_and_a_cone_sum_along_every_ray(fast_device: Device, rises: bool) -> None:
    throw, sigma, offset = 40.0, 0.5, 0.37
    center = (1.0, -0.8, 0.3)
    grid, beam, motion = vam.Grid((120, 120, 90), 0.5 * PITCH), vam.Beam((72, 44), PITCH), vam.Turntable(6, lit_share=0)
    sharp = vam.Beam((72, 44), PITCH, spread=0)
    if rises:
        A = Oblique(grid, beam, motion, Cone(throw=throw, offset=offset), device=fast_device)
    else:
        A = vam.Projection(grid, sharp, motion, Fan(throw=throw, offset=offset), fast_device)
    got = A(blob(grid, center, sigma))
    u, w = np.meshgrid(beam.columns(), (np.arange(44) - 21.5) * PITCH, indexing="ij")
    start = np.stack([np.zeros_like(u) - offset, np.full_like(u, -throw), np.zeros_like(u) if rises else w], axis=-1)
    forth = np.stack([u, np.full_like(u, throw), w if rises else np.zeros_like(u)], axis=-1)
    for pose, theta in enumerate(motion.poses):
        wanted = line_integral(start, forth, laboratory(center, theta), sigma)
        assert np.abs(got[pose] - wanted).max() <= 0.012 * wanted.max()


def test_irradiance_falls_with_distance() -> None:
    along, throw = np.linspace(-5.0, 5.0, 11), 30.0
    u, weight = Fan(throw=throw).illuminate(np.zeros(11), along)
    assert np.abs(u).max() < 1e-9
    assert np.allclose(weight, throw / (throw + along), rtol=1e-9)
    _, _, gain = Cone(throw=throw).rows(np.zeros(11), along)
    assert np.allclose(weight * gain, (throw / (throw + along)) ** 2, rtol=1e-9)
    u, _ = Fan(throw=throw, offset=0.4).illuminate(np.full(11, 0.8), along)
    assert np.allclose(u, 1.2 * throw / (throw + along), rtol=1e-8)


def test_a_fan_into_a_vial_is_the_inverse_of_its_chords() -> None:
    rng = np.random.default_rng(0)
    fan, radius, turn = Fan(GLASS, throw=150.0, offset=0.3, tilt=0.2), 7.9 * np.sqrt(rng.random(2000)), rng.random(2000)
    x, y = radius * np.cos(2 * np.pi * turn), radius * np.sin(2 * np.pi * turn)
    u, weight = fan.illuminate(x, y)
    step = 1e-4
    here, sides = fan.chords(u), [fan.chords(u + s * step) for s in (-1, 1)]
    assert np.abs(x * np.cos(here.angle) + y * np.sin(here.angle) - here.p).max() < 1e-8
    gaps = [x * np.cos(c.angle) + y * np.sin(c.angle) - c.p for c in sides]
    t = y * np.cos(here.angle) - x * np.sin(here.angle)
    share = 0.05 * np.exp(-0.05 * (t + 0.5 * here.length)) * here.transmittance
    assert np.allclose(weight, share * 2 * step / np.abs(gaps[1] - gaps[0]), rtol=1e-6)


@pytest.mark.parametrize("light", [
    Fan(throw=1e9), Misaligned(), Fan(GLASS, throw=1e10), Inclined(elevation=0.0), Cone(throw=1e9),
    Inclined(vam.Vat(width=30.0, absorption=0.1), elevation=0.0),
])  # fmt: skip
def test_what_is_ideal_is_the_plain_projector(light: Any) -> None:
    """In light so smooth that linear interpolation between rays does not tell from areas of pixels."""
    grid, motion = vam.Grid((14, 14, 5), 0.7), vam.Turntable(7, lit_share=0)
    beam, sharp = vam.Beam((34, 5), 0.7), vam.Beam((34, 5), 0.7, spread=0)
    plain = getattr(getattr(light, "plane", light), "vessel", getattr(light, "plane", None)) or OpenAir()
    wanted = vam.Projection(grid, sharp, motion, plain, "numpy").T(smooth(beam, motion, 0.5, 6.0))
    got = Oblique(grid, beam, motion, light, device="numpy").T(smooth(beam, motion, 0.5, 6.0))
    assert np.abs(got - wanted).max() <= 2e-3 * wanted.max()


def test_an_offset_is_found_again_and_a_tilt_is_a_turn(fast_device: Device) -> None:
    grid, beam, motion = vam.Grid((40, 40, 4), PITCH), vam.Beam((60, 4), PITCH), vam.Turntable(12, lit_share=0)
    x = blob(grid, (0.0, 0.0, 0.0), 0.4)
    image = vam.Projection(grid, beam, motion, Misaligned(offset=0.237), fast_device)(x).sum(axis=(0, 2))
    assert abs((image * beam.columns()).sum() / image.sum() - 0.237) <= 1e-3 * PITCH
    off = blob(grid, (0.9, 0.3, 0.0), 0.4)
    turned = vam.Projection(grid, beam, motion, Misaligned(tilt=motion.poses[2]), fast_device)(off)
    plain = vam.Projection(grid, beam, motion, OpenAir(), fast_device)(off)
    assert np.abs(turned - np.roll(plain, -2, axis=0)).max() <= 1e-5 * plain.max()


def test_a_wobble_of_whole_pixels_is_a_shifted_sinogram(fast_device: Device) -> None:
    grid, beam, motion = vam.Grid((20, 20, 6), PITCH), vam.Beam((40, 6), PITCH), vam.Turntable(9, lit_share=0)
    columns = np.array([0, 3, -2, 1, 5, -4, 2, 0, 1])
    wobble, x = Wobble(columns * PITCH, 0.7), blob(grid, (0.2, 0.1, 0.0), 0.25)
    plain = vam.Projection(grid, beam, motion, device=fast_device)
    wanted = np.stack([np.roll(image, k, axis=0) for image, k in zip(plain(x), columns, strict=True)])
    assert np.array_equal(Wobbled(plain, wobble)(x), wanted)
    light = smooth(beam, motion, 0.1, 0.9)
    back = np.stack([np.roll(image, -k, axis=0) for image, k in zip(light, columns, strict=True)])
    wanted = vam.Projection(grid, vam.Beam((40, 6), PITCH, spread=0), motion, OpenAir(), fast_device).T(back)
    got = Oblique(grid, beam, motion, None, wobble, fast_device).T(light)
    assert np.abs(got - wanted).max() <= 2e-3 * wanted.max()


def test_an_axis_off_center_wobbles_in_a_circle() -> None:
    motion, radius, phase = vam.Turntable(16, lit_share=0), 0.3, 0.7
    grid, beam = vam.Grid((70, 70, 2), 0.5 * PITCH), vam.Beam((50, 2), PITCH)
    place = (radius * np.cos(phase), radius * np.sin(phase), 0.0)
    wobble = Wobble.circle(radius, phase, motion)
    across = np.array([laboratory(place, theta)[:2] for theta in motion.poses])
    assert np.allclose(wobble.places(16), across, atol=1e-12)
    A = Oblique(grid, beam, motion, Cone(throw=40.0), wobble, "numpy")
    still = Oblique(grid, beam, motion, Cone(throw=40.0), device="numpy")
    moved, wanted = A(blob(grid, (0.0, 0.0, 0.0), 0.4)), still(blob(grid, place, 0.4))
    assert np.abs(moved - wanted).max() <= 0.02 * wanted.max()  # voxels on the diagonal ripple by one percent each


def test_the_way_along_the_light_matters_only_where_light_changes() -> None:
    grid, beam, motion = vam.Grid((20, 20, 2), PITCH), vam.Beam((24, 2), PITCH), vam.Turntable(5, lit_share=0)
    x = blob(grid, (0.3, 0.1, 0.0), 0.3)
    for light, matters in ((None, False), (Fan(throw=8.0), True)):
        near, far = (Oblique(grid, beam, motion, light, Wobble(0.0, d), "numpy")(x) for d in (0.0, 0.5))
        assert (np.abs(far - near).max() > 1e-3 * near.max()) == matters


@pytest.mark.parametrize("elevation", [0.5, -0.3])
def test_inclined_light_sums_along_every_ray(fast_device: Device, elevation: float) -> None:
    sigma, center = 0.5, (1.0, 0.4, -0.3)
    grid, beam, motion = vam.Grid((56, 56, 44), PITCH), vam.Beam((60, 64), PITCH), vam.Turntable(5, lit_share=0)
    got = Oblique(grid, beam, motion, Inclined(elevation=elevation), device=fast_device)(blob(grid, center, sigma))
    u, w = np.meshgrid(beam.columns(), (np.arange(64) - 31.5) * PITCH, indexing="ij")
    forth = np.broadcast_to([0.0, np.cos(elevation), np.sin(elevation)], (*u.shape, 3))
    start = np.stack([u, -w * np.sin(elevation), w * np.cos(elevation)], axis=-1)
    for pose, theta in enumerate(motion.poses):
        wanted = line_integral(start, forth, laboratory(center, theta), sigma)
        assert np.abs(got[pose] - wanted).max() <= 0.015 * wanted.max()


@pytest.mark.parametrize("build", [
    lambda *a: vam.Projection(*a, Fan(vam.Vat(width=9.0, radius=3.0, absorption=0.3), throw=25.0), FAST),
    lambda *a: Oblique(*a, Cone(vam.Vat(width=9.0, radius=3.0, absorption=0.3), throw=25.0), device=FAST),
    lambda *a: Oblique(*a, vam.Vat(width=9.0, radius=3.0, absorption=0.3), Wobble(0.0), FAST),
])  # fmt: skip
def test_every_ray_leaves_what_the_resin_absorbs(build: Any) -> None:
    geometry = vam.Grid((144, 144, 18), 0.5 * PITCH), vam.Beam((56, 9), PITCH), vam.Turntable(4, lit_share=0)
    A = build(*geometry)
    chords = A.vessel.chords(geometry[1].columns())
    absorbed = A(np.ones(A.domain.shape))[:, :, 4]
    assert np.abs(absorbed[:, 2:-2] / -np.expm1(-0.3 * chords.length[2:-2]) - 1.0).max() <= 0.02


def full_width(place: np.ndarray, profile: np.ndarray) -> float:
    fine = np.linspace(place[0], place[-1], 20001)
    over = np.flatnonzero(np.interp(fine, place, profile) >= 0.5 * profile.max())
    return fine[over[-1]] - fine[over[0]]


@pytest.mark.parametrize("focus", [0.0, 0.02])
@pytest.mark.parametrize("kind", [vam.Projection, Oblique])
def test_one_pixel_is_as_wide_as_the_formula_at_every_depth(kind: type, focus: float) -> None:
    grid, beam = vam.Grid((41, 121, 121), 0.002), vam.Beam((33, 33), 0.008)
    defocus = Defocus(fwhm=0.0324, depth_of_focus=0.06, focus=focus)
    A = Defocused(kind(grid, beam, vam.Turntable(1, lit_share=0), None, device=FAST), defocus)
    light = np.zeros(A.range.shape)
    light[0, 16, 16] = 1.0
    dose, (x, y, z) = A.T(light), grid.axes()
    for i in range(0, 41, 5):
        wanted = defocus.width(-x[i] - focus)
        assert full_width(y, dose[i, :, 60]) == pytest.approx(wanted, rel=0.022)
        assert full_width(z, dose[i, 60, :]) == pytest.approx(wanted, rel=0.022)
    assert np.ptp(dose.sum(axis=(1, 2))) <= 1e-3 * dose.sum(axis=(1, 2)).mean()


@pytest.mark.parametrize("vessel", [None, vam.Vial(3.0, 0.2, resin_index=1.5, wall_index=1.47, absorption=0.1)])
def test_sorting_light_by_its_focus_neither_makes_nor_takes_any(vessel: vam.Vial | None) -> None:
    A = vam.Projection(
        vam.Grid((24, 24, 20), 0.1), vam.Beam((70, 40), 0.1), vam.Turntable(5, lit_share=0), vessel, "numpy"
    )
    even = np.ones(A.range.shape)
    plain, sorted_ = (np.asarray(each.T(even))[:, :, 8:12] for each in (A, Defocused(A, Defocus(0.12, 0.6), 0.1)))
    assert np.abs(sorted_ / plain - 1.0).max() < 2e-3


def test_two_numbers_of_a_focus_make_a_beam_quality() -> None:
    assert Defocus(0.0324, 3.8).quality(442e-6) == pytest.approx(2.83, abs=0.01)
    assert Defocus(0.0324, 3.8).width(1.9) == pytest.approx(0.0324 * np.sqrt(2.0))


def test_a_focus_may_be_curved() -> None:
    defocus = Defocus(0.03, 1.0, focus=lambda u: -np.sqrt(4.0 - u**2))
    u = np.array([0.0, 1.0, 1.9])
    least = defocus.variance(u, -np.sqrt(4.0 - u**2))
    assert np.allclose(least, least[0]) and (defocus.variance(u, np.zeros(3)) > least).all()


def test_taps_are_as_wide_as_asked() -> None:
    for fwhm, width in ((1.4, 1.0), (2.3, 1.5), (4.05, 1.0), (30.0, 1.0)):
        taps = gaussian(fwhm, width)
        assert width_of(taps, width) == pytest.approx(fwhm, rel=2e-3) and 2 * taps.sum() - taps[0] == pytest.approx(1)
    assert len(gaussian(0.5)) == 1


def test_tiles_share_their_overlap_without_a_seam(fast_device: Device) -> None:
    grid, tall, motion = (
        vam.Grid((12, 12, 40), PITCH),
        vam.Beam((14, 40), PITCH, spread=0),
        vam.Turntable(6, lit_share=0),
    )
    A = vam.Projection(grid, tall, motion, device=fast_device)
    light = np.random.default_rng(0).random(A.range.shape)
    tiles = Tiles(A, rows=17, overlap=5)
    assert tiles.range.shape == (3 * 6, 14, 17)
    dose = A.T(light)
    assert np.abs(tiles.T(tiles.split(light)) - dose).max() <= 2e-6 * dose.max()


@pytest.mark.parametrize(("rows", "center", "seam"), [(22, 1.1, 0.4), (30, 0.7, 0.04 / 1.6)])
def test_a_tile_set_down_off_its_place_leaves_a_seam_as_strong_as_its_overlap_is_short(
    rows: int, center: float, seam: float
) -> None:
    grid, tall, motion = (
        vam.Grid((12, 12, 40), PITCH),
        vam.Beam((14, 40), PITCH, spread=0),
        vam.Turntable(6, lit_share=0),
    )
    A = vam.Projection(grid, tall, motion, device=FAST)
    meant, real = Tiles(A, rows, 0, [-center, center]), Tiles(A, rows, 0, [-center, center - 0.04])
    even = np.ones(A.range.shape)
    dose = real.T(meant.split(even)) / A.T(even)
    assert np.abs(dose[4:8, 4:8, 4:-4] - 1.0).max() == pytest.approx(seam, rel=0.1)


def test_a_rod_casts_its_shadow_downstream() -> None:
    rod = Occluded(None, across=0.5, along=0.0, radius=0.2, transmittance=0.25)
    across = np.array([0.5, 0.5, 0.5, 0.8, 0.69])
    along = np.array([-1.0, 0.0, 1.0, 1.0, 1.0])
    u, weight = rod.illuminate(across, along)
    assert np.array_equal(u, across) and np.array_equal(weight, [1.0, 0.25, 0.25, 1.0, 0.25])
    fan = Occluded(Fan(throw=10.0), across=0.5, along=0.0, radius=0.2)
    assert fan.illuminate(np.array([0.75]), np.array([5.0]))[1] == 0.0
    assert fan.illuminate(np.array([0.5]), np.array([7.0]))[1] > 0.0


@pytest.mark.parametrize("build", [
    lambda *a: vam.Projection(*a, Fan(vam.Vat(width=4.0, radius=1.0), throw=20.0, offset=0.05), FAST),
    lambda *a: Oblique(*a, Cone(throw=20.0), Wobble(0.03), FAST),
    lambda *a: Wobbled(vam.Projection(*a, device=FAST), Wobble(0.04)),
    lambda *a: Defocused(vam.Projection(*a, device=FAST), Defocus(0.2, 0.8)),
    lambda *a: Tiles(vam.Projection(*a, device=FAST), rows=9, overlap=2),
])  # fmt: skip
@pytest.mark.parametrize("method", ["default", "osmo", pytest.param("lbfgs", marks=pytest.mark.slow)])
def test_optimizers_and_packers_take_them(build: Any, method: str) -> None:
    grid = vam.Grid((20, 20, 16), PITCH)
    A = build(grid, vam.Beam((24, 16), PITCH), vam.Turntable(24, lit_share=0))
    x, y, z = np.meshgrid(*grid.axes(), indexing="ij")
    target = ((np.hypot(x - 0.2, y) < 0.4) & (np.abs(z) < 0.5)).astype(np.float32)
    begun, plan = (vam.optimize(A, target, name, iterations=6) for name in ("fbp", method))
    assert plan.sinogram.shape == A.range.shape and plan.window > begun.window
    proof = vam.simulate(A, vam.pack(plan, bits=8), target)
    assert proof.scores.window == pytest.approx(plan.window, abs=0.01)
