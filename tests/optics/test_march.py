"""Marched rays against the lenses that have formulas: Luneburg, Maxwell's fish-eye, the parabola, one index."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, RayError
from vamgpu.optics.index_field import (
    FormulaField,
    FunctionField,
    GridField,
    Region,
    fish_eye,
    parabolic,
)
from vamgpu.optics.interface import refract
from vamgpu.optics.march import Marched, Marcher, march

R = 3.0
HALF_TURN = 0.5 * np.pi * R
"""∫ds/n from rim to focus of a Luneburg lens, the same for every ray."""


def rim(count: int = 39, largest: float = 0.95) -> tuple[np.ndarray, np.ndarray]:
    """Parallel rays along +x where they meet the lens of radius R."""
    p = np.linspace(-largest, largest, count) * R
    return np.stack([-np.sqrt(R**2 - p**2), p], axis=1), np.tile([1.0, 0.0], (count, 1))


def luneburg(radius: float) -> FormulaField:
    """n² = 2 − r²/radius²: parallel rays meet on the rim opposite."""
    return FormulaField((1.0, 1.0, 1.0), (2.0, -1.0 / radius**2), region=Region.ball(radius))


def limit(device: Device, exact: float, single: float = 1e-5) -> float:
    return exact if device.real == np.float64 else single


# ---- Luneburg ------------------------------------------------------------------------------------------------------
def test_luneburg_focuses_on_the_rim(device: Device) -> None:
    free = FormulaField((1.0, 1.0, 1.0), (2.0, -1.0 / R**2))
    rays = march(free, *rim(), step=HALF_TURN / 256, until=HALF_TURN, device=device)
    np.testing.assert_allclose(rays.place, np.tile([R, 0.0, 0.0], (39, 1)), atol=limit(device, 1e-8) * R)


def test_luneburg_stops_on_its_border_with_equal_optical_paths(device: Device) -> None:
    places, along = rim()
    rays = march(luneburg(R), places, along, step=HALF_TURN / 256, device=device)
    # The focus lies on the border: across it the time is as free as the slant of a ray, so place is compared.
    np.testing.assert_allclose(np.linalg.norm(rays.place, axis=1), R, atol=limit(device, 1e-9) * R)
    np.testing.assert_allclose(rays.place, np.tile([R, 0.0, 0.0], (39, 1)), atol=limit(device, 1e-7) * R)
    # From a plane wave front in front of the lens all rays are equally long: ∫n ds = R (1 + π/2).
    np.testing.assert_allclose(rays.optical + places[:, 0] + R, R * (1.0 + 0.5 * np.pi), rtol=limit(device, 1e-8))


@pytest.mark.parametrize("shape", [(64, 64), (40, 40, 40)])
def test_luneburg_on_a_grid_of_its_formula_is_exact(device: Device, shape: tuple[int, ...]) -> None:
    def index(*at: np.ndarray) -> np.ndarray:
        return np.sqrt(np.maximum(2.0 - sum(a**2 for a in at) / R**2, 0.3))  # the corners are far from every ray

    places, along = rim(9)
    grid = GridField.from_function(index, shape, 2.2 * R / (shape[0] - 1))
    rays = march(grid, places, along, step=HALF_TURN / 256, until=HALF_TURN, device=device)
    np.testing.assert_allclose(rays.place, np.tile([R, 0.0, 0.0], (9, 1)), atol=limit(device, 1e-8) * R)


def lens_in_air(*at: np.ndarray) -> np.ndarray:
    return np.sqrt(np.maximum(2.0 - sum(a**2 for a in at) / R**2, 1.0))


def test_luneburg_in_air_on_a_grid_falls_with_the_grid(device: Device) -> None:
    """The index has a kink at the rim, which cells smear."""
    places, along = rim()
    worst = []
    for n in (64, 256):
        x = np.linspace(-1.2 * R, 1.2 * R, n)
        grid = GridField.from_array(lens_in_air(x[:, None], x), x[1] - x[0])
        rays = march(grid, places, along, step=HALF_TURN / 256, until=HALF_TURN, device=device)
        worst.append(np.linalg.norm(rays.place - [R, 0.0, 0.0], axis=1).max() / R)
    assert worst[1] <= 5e-3
    assert worst[1] < 0.5 * worst[0]


# ---- other lenses --------------------------------------------------------------------------------------------------
@pytest.mark.slow
def test_fish_eye_circles_close(device: Device) -> None:
    """Through a point at distance r the ray across the radius is a circle, closed after ∫ds/n of one period."""
    index, scale = 2.0, 1.5
    r = np.array([0.8, 1.2, 1.5])
    places, along = np.stack([r, 0 * r], axis=1), np.tile([0.0, 1.0], (3, 1))
    radius = 0.5 * (r + scale**2 / r)  # the other end of the diameter is the image, at −scale²/r
    center = r - radius
    theta = np.linspace(0.0, 2.0 * np.pi, 20_001)[:-1]
    distance2 = (center[:, None] + radius[:, None] * np.cos(theta)) ** 2 + (radius[:, None] * np.sin(theta)) ** 2
    period = radius * 2.0 * np.pi * np.mean((1.0 + distance2 / scale**2) / index, axis=1)
    steps = 4000 if device.real == np.float64 else 500  # single precision gathers rounding with every step
    for ray in range(3):
        rays = march(fish_eye(scale, index), places[ray], along[ray], step=period[ray] / steps,
                     until=period[ray], rows=201, device=device)  # fmt: skip
        np.testing.assert_allclose(rays.place[0, :2], places[ray], atol=limit(device, 1e-8, 1e-4) * radius[ray])
        away = np.hypot(rays.path[0, :, 0] - center[ray], rays.path[0, :, 1])
        np.testing.assert_allclose(away, radius[ray], rtol=limit(device, 1e-8, 2e-5))


@pytest.mark.parametrize("degrees", [0.0, 10.0, 30.0])
def test_parabolic_period(device: Device, degrees: float) -> None:
    index, slope = 1.5, 0.4
    theta = np.radians(degrees)
    period = 2.0 * np.pi * np.cos(theta) / slope
    # ∫ds/n of one period: the ray's z grows by n₀ cosθ per unit of it.
    rays = march(parabolic(index, slope), [[1e-3 * (degrees == 0), 0.0, 0.0]], [[np.sin(theta), 0.0, np.cos(theta)]],
                 step=period / 512, until=period / (index * np.cos(theta)), device=device)  # fmt: skip
    amplitude = np.sin(theta) / slope if degrees else 1e-3
    assert rays.place[0, 2] == pytest.approx(period, rel=limit(device, 1e-9 if degrees else 1e-6))
    drift = np.array([rays.place[0, 0] - 1e-3 * (degrees == 0), rays.place[0, 2] - period])
    assert np.abs(drift).max() < 1e-4 * period
    assert abs(drift[0]) < limit(device, 1e-8, 1e-4) * max(amplitude, 1e-3)
    # Where x crosses zero upwards again, from the slope of the last step.
    crossing = rays.place[0, 2] - drift[0] * rays.heading[0, 2] / rays.heading[0, 0] if degrees else period
    assert crossing == pytest.approx(period, rel=1e-4)


def test_one_index_is_straight_and_refracts_by_snell(device: Device) -> None:
    """A cylinder of glass: exact faces outside, marching inside, and the exit where the chord ends."""
    index, u = 1.49, np.linspace(-0.95, 0.95, 21) * R
    entry = np.stack([u, -np.sqrt(R**2 - u**2), 0 * u], axis=1)
    inside = refract(np.tile([0.0, 1.0, 0.0], (21, 1)), entry / R, 1.0, index)
    rays = march(
        FormulaField((1.0, 1.0, 1.0), (index**2,), region=Region.cylinder(R)), entry, inside, step=R / 20, device=device
    )
    chord = -2.0 * np.sum(entry * inside, axis=1, keepdims=True)
    atol = limit(device, 1e-10) * R
    np.testing.assert_allclose(rays.place, entry + chord * inside, atol=atol)
    np.testing.assert_allclose(rays.length, chord[:, 0], atol=atol)
    np.testing.assert_allclose(rays.optical, index * chord[:, 0], atol=2 * atol)
    out = refract(rays.direction, rays.place / np.linalg.norm(rays.place, axis=1, keepdims=True), index, 1.0)
    turn = 2.0 * (np.arcsin(u / R) - np.arcsin(u / (index * R)))
    np.testing.assert_allclose(np.arctan2(-out[:, 0], out[:, 1]), turn, atol=limit(device, 1e-9, 2e-5))


def test_index_times_distance_is_conserved_in_round_media(device: Device) -> None:
    places, along = rim(21)
    for field in (luneburg(R), FormulaField((1.0, 1.0, 0.0), (1.6, 0.3, -0.05), (1.0, 0.1), Region.cylinder(R))):
        rays = march(field, places, along, step=R / 200, device=device)
        before = places[:, 0] * along[:, 1] - places[:, 1] * along[:, 0]
        before *= np.sqrt(field.evaluate(np.pad(places, ((0, 0), (0, 1))))[1])
        after = rays.place[:, 0] * rays.heading[:, 1] - rays.place[:, 1] * rays.heading[:, 0]
        np.testing.assert_allclose(after, before, atol=limit(device, 1e-8) * R)


# ---- steppers ------------------------------------------------------------------------------------------------------
@cache
def bent(step: float, scheme: str) -> Marched:
    return march(fish_eye(1.0), [[0.7, 0.0]], [[0.2, 1.0]], step=step, until=2.0, scheme=scheme, device="numpy")


@pytest.mark.slow
@pytest.mark.parametrize("scheme, order", [("sharma", 4), ("leapfrog", 2), ("yoshida", 4)])
def test_the_order_of_a_stepper(scheme: str, order: int) -> None:
    exact = bent(2.0 / 8192, "sharma")
    errors = []
    for n in (64, 128, 256):
        rays = bent(2.0 / n, scheme)
        ends = np.concatenate([rays.place[0], rays.heading[0]])
        errors.append((np.linalg.norm(ends - np.concatenate([exact.place[0], exact.heading[0]])),
                       abs(rays.optical[0] - exact.optical[0]), abs(rays.length[0] - exact.length[0])))  # fmt: skip
    slopes = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert (slopes > order - 0.3).all(), slopes
    assert (slopes[:, 0] < order + 0.5).all(), slopes


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["leapfrog", "yoshida"])
def test_symplectic_steppers_keep_the_energy_over_long_marches(scheme: str) -> None:
    """T² − n² stays within its first swing after a hundred periods, where Sharma's drifts."""
    field, period = parabolic(1.5, 0.4), 2.0 * np.pi / (1.5 * 0.4)

    def swing(periods: int, method: str) -> float:
        worst = 0.0
        marcher, starts = Marcher(field, "numpy"), np.array([[0.0, 0.0, 0.0, 0.75, 0.0, 1.3]])
        for _ in range(periods):
            rays = marcher.trace(starts, period / 24, 25, method)
            _, square = field.evaluate(rays.place)
            worst = max(worst, abs(float((rays.heading**2).sum() - square[0]) - energy))
            starts = np.concatenate([rays.place, rays.heading], axis=1)
        return worst

    energy = 0.75**2 + 1.3**2 - 1.5**2
    assert swing(100, scheme) < 1.05 * swing(20, scheme)
    assert swing(100, "sharma") > 3.0 * swing(20, "sharma")


def test_every_device_marches_the_same_rays(fast_device: Device) -> None:
    rng = np.random.default_rng(5)
    places = rng.uniform(-0.4, 0.4, (35, 3)) * R
    along = rng.standard_normal((35, 3))

    def blobs(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        return 1.48 + 0.03 * np.exp(-((x - 0.5) ** 2 + y**2 + (z + 0.3) ** 2))

    media = [fish_eye(R), luneburg(R), GridField.from_function(blobs, (30, 31, 32), 0.25),
             GridField.from_function(lambda x, y: blobs(x, y, x), (30, 41), 0.25)]  # fmt: skip
    for field in media:
        for scheme in ("sharma", "leapfrog", "yoshida"):
            options = {"step": R / 64, "until": 4.0, "scheme": scheme, "rows": 9}
            got, want = (march(field, places, along, device=d, **options) for d in (fast_device, "numpy"))
            for name in ("place", "heading", "optical", "length", "time", "path"):
                np.testing.assert_allclose(getattr(got, name), getattr(want, name), atol=1e-5 * R, err_msg=name)
            assert (got.left == want.left).all()


# ---- the host's part -----------------------------------------------------------------------------------------------
def test_a_tolerance_bounds_the_error() -> None:
    places, along = rim()
    for tolerance in (1e-4, 1e-7, 1e-10):
        rays = march(luneburg(R), places, along, tolerance=tolerance, device="numpy")
        assert rays.error.max() <= tolerance
        assert np.linalg.norm(rays.place - [R, 0.0, 0.0], axis=1).max() <= 2.0 * tolerance
    assert np.unique(rays.step).size > 1  # easy rays are not marched as finely


def test_a_tolerance_on_devices(fast_device: Device) -> None:
    rays = march(luneburg(R), *rim(), tolerance=1e-4, device=fast_device)
    assert np.linalg.norm(rays.place - [R, 0.0, 0.0], axis=1).max() <= 2e-4
    with pytest.raises(RayError, match="below what"):
        march(luneburg(R), *rim(), tolerance=1e-9, device=fast_device)


def test_any_function_of_the_place(device: Device) -> None:
    def index(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.sqrt(np.maximum(2.0 - (x**2 + y**2) / R**2, 0.3))

    field = FunctionField(index, Region.cylinder(R))
    rays = march(field, *rim(), step=HALF_TURN / 256, device=device)
    np.testing.assert_allclose(rays.place, np.tile([R, 0.0, 0.0], (39, 1)), atol=limit(device, 1e-6) * R)


def test_off_center_boxes_are_sampled_where_they_are() -> None:
    field = FunctionField(lambda x, y: 1.5 + 0.01 * x - 0.02 * y, Region.box((1.0, -3.0), (3.0, 0.0)), samples=24)
    at = np.array([[1.2, -0.4, 0.0], [2.7, -2.9, 5.0]])
    for got, want in zip(field.sampled.evaluate(at), field.evaluate(at), strict=True):
        np.testing.assert_allclose(got, want, rtol=1e-9, atol=1e-12)


def test_splines_are_exact_for_cubics_and_fourth_order_beyond() -> None:
    rng = np.random.default_rng(2)
    at = rng.uniform(-1.0, 1.0, (50, 3))
    errors = []
    for n in (16, 32):
        x = np.linspace(-1.2, 1.2, n)
        wave = np.sin(3.0 * x)[:, None, None] * np.cos(2.0 * x)[:, None] * np.cos(x)
        waves = GridField.from_array(1.5 + 0.1 * wave, x[1] - x[0])
        square = (1.5 + 0.1 * np.sin(3.0 * at[:, 0]) * np.cos(2.0 * at[:, 1]) * np.cos(at[:, 2])) ** 2
        errors.append(np.abs(waves.evaluate(at)[1] - square).max())
    assert np.log2(errors[0] / errors[1]) > 3.5
    x = np.linspace(-2.0, 2.0, 9)
    cubic = GridField.from_array(np.sqrt(3.0 + 0.1 * x**3)[:, None] * np.ones(9), 0.5)
    pull, square = cubic.evaluate(at)
    np.testing.assert_allclose(square, 3.0 + 0.1 * at[:, 0] ** 3, rtol=1e-12)
    np.testing.assert_allclose(pull[:, 0], 0.15 * at[:, 0] ** 2, atol=1e-12)


# ---- bad input -----------------------------------------------------------------------------------------------------
def test_rays_that_never_leave_are_told_with_numbers(device: Device) -> None:
    guide = FormulaField((1.0, 1.0, 0.0), (2.25, -0.6), region=Region.cylinder(1.5))
    with pytest.raises(RayError, match=r"1 of 2 rays never leave: ray 1 .* mm wide"):
        march(guide, [[1.2, 0.0], [np.sqrt(2.25 / 1.2), 0.0]], [[1.0, 0.0], [0.0, 1.0]], step=0.1, device=device)


def test_bad_values_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    places, along = rim(3)
    with pytest.raises(RayError, match="n²"):
        march(parabolic(1.5, 1.0), [[2.0, 0.0]], [[1.0, 0.0]], step=0.1, until=1.0)
    with pytest.raises(BadInput, match="give one"):
        march(luneburg(R), places, along)
    with pytest.raises(BadInput, match="no border"):
        march(fish_eye(R), places, along, step=0.1)
    with pytest.raises(BadInput, match="stepper"):
        march(luneburg(R), places, along, step=0.1, scheme="euler")
    with pytest.raises(BadInput, match="zero"):
        march(luneburg(R), places, 0.0 * along, step=0.1)
    with pytest.raises(BadInput, match="shape"):
        march(luneburg(R), np.zeros((3, 4)), along, step=0.1)
    with pytest.raises(BadInput, match="4 or more"):
        GridField.from_array(np.ones((3, 8)), 0.1)
    with pytest.raises(BadInput, match="falls to"):
        GridField.from_array(np.zeros((8, 8)), 0.1)
    with pytest.raises(BadInput, match="borders"):
        FunctionField(lambda x, y: x + y, Region())
    with pytest.raises(BadInput, match="medium"):
        march(1.5, places, along, step=0.1)  # type: ignore[arg-type]
    monkeypatch.setattr("vamgpu.optics.march.HALVINGS", 3)
    with pytest.raises(RayError, match="after 3 halvings"):
        march(GridField.from_array(lens_in_air(*np.meshgrid(*(np.linspace(-4, 4, 40),) * 2)), 0.2), places, along,
              tolerance=1e-12, device="numpy")  # fmt: skip


def test_a_great_many_rays_go_in_one_launch(opencl_device: Device) -> None:
    """Drivers that pick their own work-groups have run out of stack here."""
    across = np.linspace(-0.9, 0.9, 1 << 18)
    place, heading = np.stack([across, -np.sqrt(1.0 - across**2)], 1), np.tile([0.0, 1.0], (across.size, 1))
    end = march(luneburg(1.0), place, heading, step=0.05, device=opencl_device).place
    assert np.abs(end[:, :2] - [0.0, 1.0]).max() < 1e-4
