"""The vial against a ray tracer written here from Snell's law, Fresnel's amplitudes and Beer-Lambert's law."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from profiling.deposit import deposit
from vamgpu.errors import BadInput, OpticsWarning, TargetTooLarge
from vamgpu.geometry import Beam, Grid, Vessel
from vamgpu.operators.ray_table import tabulate
from vamgpu.optics.square_bath import SquareBath
from vamgpu.optics.vial import Vial

PAPER = Vial(radius=12.4, wall=1.0, resin_index=1.49962, wall_index=1.473, bath_index=1.0, absorption=0.05)
WATER = Vial(radius=8.0, wall=0.7, resin_index=1.48, wall_index=1.52, bath_index=1.333, absorption=0.2)
DENSE_BATH = Vial(radius=10.0, wall=1.5, resin_index=1.45, wall_index=1.47, bath_index=1.5, absorption=0.1)
BARE = Vial(radius=10.0, wall=0.0, resin_index=1.5, wall_index=1.47, bath_index=1.0, absorption=0.1)
MATCHED = Vial(radius=10.0, wall=1.0, resin_index=1.5, wall_index=1.5, bath_index=1.5, absorption=0.1)
POLARIZED = [replace(PAPER, polarization="s"), replace(PAPER, polarization="p"), replace(BARE, polarization="p")]
VIALS = [PAPER, WATER, DENSE_BATH, BARE, MATCHED, *POLARIZED]


def _cross(
    point: tuple[float, float], heading: float, radius: float, before: float, after: float
) -> tuple[tuple[float, float], float, np.ndarray]:
    """March to the circle, then refract: new point, new heading [rad from +X], power shares of s and p light."""
    dx, dy = math.cos(heading), math.sin(heading)
    along = point[0] * dx + point[1] * dy
    distance = -along - math.sqrt(along**2 - point[0] ** 2 - point[1] ** 2 + radius**2)
    hit = (point[0] + distance * dx, point[1] + distance * dy)
    inward = math.atan2(-hit[1], -hit[0])
    incidence = math.remainder(heading - inward, 2 * math.pi)
    refraction = math.asin(before * math.sin(incidence) / after)
    c1, c2 = math.cos(incidence), math.cos(refraction)
    across = (before * c1 - after * c2) / (before * c1 + after * c2)
    along_plane = (after * c1 - before * c2) / (after * c1 + before * c2)
    return hit, inward + refraction, 1.0 - np.array([across, along_plane]) ** 2


def _trace(vial: Vial, u: float) -> tuple[tuple[float, float], float, float]:
    """Place where column u enters the resin, its heading there, and the share of its power that gets there."""
    inner = vial.radius - vial.wall
    kept = np.array({"none": [0.5, 0.5], "s": [1.0, 0.0], "p": [0.0, 1.0]}[vial.polarization])
    if vial.wall == 0:
        hit, heading, only = _cross((u, -3 * vial.radius), 0.5 * math.pi, inner, vial.bath_index, vial.resin_index)
        return hit, heading, float(kept @ only)
    hit, heading, first = _cross((u, -3 * vial.radius), 0.5 * math.pi, vial.radius, vial.bath_index, vial.wall_index)
    hit, heading, second = _cross(hit, heading, inner, vial.wall_index, vial.resin_index)
    return hit, heading, float(kept @ (first * second))


def _miss(vial: Vial, u: float, point: tuple[float, float]) -> float:
    """Signed distance of the point from the ray of column u, positive towards +X of a ray that runs along +Y."""
    (x, y), heading, _ = _trace(vial, u)
    return (point[0] - x) * math.sin(heading) - (point[1] - y) * math.cos(heading)


def _dose(vial: Vial, point: tuple[float, float]) -> tuple[float, float]:
    """Column through the point, and the power absorbed there per mm2 for 1 mW per mm of column."""
    low, high = -0.999 * vial.aperture, 0.999 * vial.aperture
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _miss(vial, middle, point) > 0 else (low, middle)
    u, h = 0.5 * (low + high), 1e-4
    entry, _, share = _trace(vial, u)
    tube = abs(_miss(vial, u + h, point) - _miss(vial, u - h, point)) / (2 * h)
    path = math.dist(entry, point)
    return u, share * vial.absorption * math.exp(-vial.absorption * path) / tube


def _points(vial: Vial, seed: int) -> list[tuple[float, float]]:
    rng = np.random.default_rng(seed)
    radius = 0.95 * vial.printable_radius * np.sqrt(rng.random(20))
    around = 2 * np.pi * rng.random(20)
    return [(float(r * np.cos(a)), float(r * np.sin(a))) for r, a in zip(radius, around, strict=True)]


@pytest.mark.parametrize("vial", VIALS)
def test_chords_are_the_traced_rays(vial: Vial) -> None:
    columns = np.linspace(-0.98, 0.98, 41) * vial.aperture
    chords = vial.chords(columns)
    for i, u in enumerate(columns):
        (x, y), heading, share = _trace(vial, float(u))
        deviation = heading - 0.5 * math.pi
        assert chords.angle[i] == pytest.approx(math.remainder(deviation, 2 * math.pi), abs=1e-10)
        assert chords.p[i] == pytest.approx(x * math.sin(heading) - y * math.cos(heading), abs=1e-10)
        assert chords.transmittance[i] == pytest.approx(share, abs=1e-10)
        exit_distance = -2 * (x * math.cos(heading) + y * math.sin(heading))
        assert chords.length[i] == pytest.approx(exit_distance, abs=1e-10)


@pytest.mark.parametrize("vial", VIALS)
def test_spread_is_the_slope_of_the_angle(vial: Vial) -> None:
    columns, h = np.linspace(-0.95, 0.95, 39) * vial.aperture, 1e-5
    slope = (vial.chords(columns + h).angle - vial.chords(columns - h).angle) / (2 * h)
    np.testing.assert_allclose(vial.chords(columns).spread, slope, atol=1e-7)


@pytest.mark.parametrize("vial", VIALS)
@pytest.mark.parametrize("seed", [1, 2])
def test_absorbed_dose_is_the_traced_dose(vial: Vial, seed: int) -> None:
    points = _points(vial, seed)
    u, weight = vial.illuminate([p[0] for p in points], [p[1] for p in points])
    for i, point in enumerate(points):
        column, dose = _dose(vial, point)
        assert u[i] == pytest.approx(column, abs=1e-9)
        assert weight[i] == pytest.approx(dose, rel=1e-5)


def test_rays_converge_towards_the_axis_where_the_resin_is_denser() -> None:
    # A column at +u must lean towards -X as it travels, so its chord at the far side is nearer to the plane X = 0.
    chord = PAPER.chords(4.0)
    near = chord.p * np.cos(chord.angle) + 2.0 * np.sin(chord.angle)
    far = chord.p * np.cos(chord.angle) - 2.0 * np.sin(chord.angle)
    assert chord.angle > 0 and far < near
    assert DENSE_BATH.chords(4.0).angle < 0
    # Converging rays are denser downstream, and a resin that does not absorb shows nothing but that.
    clear = Vial(12.4, 1.0, 1.49962, 1.473)
    _, weight = clear.illuminate([0.0, 0.0], [-5.0, 5.0])
    assert weight[1] > 1.2 * weight[0]


@pytest.mark.parametrize("vial", VIALS)
def test_map_returns_to_its_points_everywhere_it_is_lit(vial: Vial) -> None:
    axis = np.linspace(-vial.radius, vial.radius, 161)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    u, weight = vial.illuminate(x, y)
    assert np.all(np.isfinite(u)) and np.all(np.isfinite(weight)) and np.all(weight >= 0)
    radius = np.hypot(x, y)
    assert np.all(weight[radius >= vial.inner_radius] == 0)
    assert np.all(weight[radius < 0.999 * vial.printable_radius] > 0)
    lit, chords = weight > 0, vial.chords(u)
    off = x * np.cos(chords.angle) + y * np.sin(chords.angle) - chords.p
    assert np.max(np.abs(off[lit])) < 1e-9


def test_matched_vial_leaves_rays_straight() -> None:
    columns = np.linspace(-8.9, 8.9, 31)
    chords = MATCHED.chords(columns)
    np.testing.assert_allclose(chords.p, columns, atol=1e-12)
    np.testing.assert_allclose(chords.angle, 0.0, atol=1e-12)
    np.testing.assert_allclose(chords.transmittance, 1.0, atol=1e-12)
    x, y = np.array([-3.0, 0.0, 7.0]), np.array([2.0, -4.0, 5.0])
    u, weight = MATCHED.illuminate(x, y)
    np.testing.assert_allclose(u, x, atol=1e-12)
    np.testing.assert_allclose(weight, 0.1 * np.exp(-0.1 * (y + np.sqrt(81.0 - x**2))), rtol=1e-12)


def test_p_light_crosses_a_bare_face_whole_at_brewster_s_angle() -> None:
    """tan φ = n: the ray at u = R·sin φ. What s light loses there is r_s², ((n² − 1)/(n² + 1))²."""
    n, u = 1.5, 10.0 * math.sin(math.atan(1.5))
    kept = 1.0 - ((n**2 - 1.0) / (n**2 + 1.0)) ** 2
    for polarization, share in (("p", 1.0), ("s", kept), ("none", 0.5 * (1.0 + kept))):
        vial = replace(BARE, polarization=polarization)
        assert vial.chords(u).transmittance == pytest.approx(share, abs=1e-14)
        assert vial.illuminate(0.0, 0.0)[1] == pytest.approx(0.96 * n * 0.1 * math.exp(-1.0), rel=1e-12)


def test_light_without_polarization_is_half_s_and_half_p() -> None:
    u = np.linspace(-1.0, 1.0, 301) * PAPER.aperture
    plain, s, p = (replace(PAPER, polarization=name).chords(u).transmittance for name in ("none", "s", "p"))
    np.testing.assert_allclose(plain, 0.5 * (s + p), rtol=1e-14)
    # At 8 mm in the resin, where two faces of a vial in air reflect a quarter of the light.
    at = PAPER.resin_index * 8.0
    shares = [float(replace(PAPER, polarization=name).chords(at).transmittance) for name in ("none", "s", "p")]
    assert shares == pytest.approx([0.744668, 0.604047, 0.885289], abs=5e-7)
    with pytest.raises(BadInput, match="'circular'.*'none'.*'s'.*'p'"):
        replace(PAPER, polarization="circular")


def test_columns_that_miss_carry_nothing() -> None:
    chords = PAPER.chords([-13.0, 12.4, 20.0])
    assert np.all(chords.transmittance == 0) and np.all(chords.length == 0)
    assert np.all(np.isfinite(chords.p)) and np.all(np.isfinite(chords.angle)) and np.all(np.isfinite(chords.spread))


def test_printable_radius() -> None:
    assert PAPER.printable_radius == pytest.approx(8.27, abs=0.005)
    assert PAPER.printable_radius == pytest.approx(12.4 / 1.49962, rel=1e-12)
    assert MATCHED.printable_radius == pytest.approx(9.0, rel=1e-12)


@pytest.mark.parametrize("vial", [PAPER, WATER, DENSE_BATH, MATCHED])
def test_no_energy_is_lost_on_the_grid(vial: Vial) -> None:
    rng = np.random.default_rng(3)
    columns = (np.arange(200) - 99.5) * (2.02 * vial.radius / 200)
    angles, pitch = np.array([0.0, 0.7, 2.9, 5.1]), 2 * vial.inner_radius / 96
    power = rng.random((angles.size, columns.size))
    dose = deposit(vial, columns, power, angles, (100, 100), pitch)
    expected = 0.0
    for column, total in zip(columns, power.sum(axis=0), strict=True):
        if abs(column) < vial.aperture:
            (x, y), heading, share = _trace(vial, float(column))
            length = -2 * (x * math.cos(heading) + y * math.sin(heading))
            expected += total * share * (1 - math.exp(-vial.absorption * length))
    assert dose.sum() * pitch**3 == pytest.approx(expected, rel=1e-3)


@pytest.mark.slow
def test_scatter_agrees_with_the_inverse_map_inside_the_printable_radius() -> None:
    # Handedness too: one pose, absorption, and a beam brighter towards +u; the two ways share no coordinates.
    theta, n, pitch = 0.6, 80, 0.2
    columns = (np.arange(4000) - 1999.5) * (2 * 12.4 / 4000)
    power = np.exp(0.1 * columns)
    dose = deposit(PAPER, columns, power[None], [theta], (n, n), pitch, step=0.1)
    axis = (np.arange(n) - 0.5 * (n - 1)) * pitch
    x, y = axis[:, None], axis[None, :]
    across, along = y * np.cos(theta) - x * np.sin(theta), -(x * np.cos(theta) + y * np.sin(theta))
    u, weight = PAPER.illuminate(across, along)
    gathered = np.exp(0.1 * u) / (columns[1] - columns[0]) * weight / pitch
    inside = np.hypot(x, y) < 0.85 * PAPER.printable_radius
    np.testing.assert_allclose(dose[inside], gathered[inside], rtol=0.01)


def test_light_comes_from_plus_x_at_pose_zero_and_turns_with_it() -> None:
    columns = (np.arange(800) - 399.5) * 0.025
    power = np.where(columns > 0, 1.0, 0.0)[None]
    places = ((0.0, (70, 58), (10, 58), (40, 20)), (np.pi / 2, (20, 70), (20, 10), (58, 40)))
    for theta, near, far, unlit in places:
        dose = deposit(MATCHED, columns, power, [theta], (81, 81), 0.25)
        # r = y cos - x sin: positive columns light +y at pose 0 and -x at a quarter turn.
        assert dose[near] > 1.5 * dose[far] > 0
        assert dose[unlit] == 0


def test_targets_that_do_not_fit_are_named() -> None:
    with pytest.raises(TargetTooLarge, match=r"9 mm.*8\.269 mm"):
        PAPER.check_fits(9.0)
    with pytest.raises(TargetTooLarge, match="total reflection"):
        Vial(12.4, 1.0, 1.5, 1.4, 1.5).check_fits(11.0)
    with pytest.raises(BadInput, match="nan"):
        PAPER.check_fits(math.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        PAPER.check_fits(6.0)


def test_dim_edges_warn_with_the_radius() -> None:
    low, high = 0.0, PAPER.radius
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _trace(PAPER, middle)[2] > 0.8 else (low, middle)
    dim = low / PAPER.resin_index
    with pytest.warns(OpticsWarning, match=f"beyond {dim:.2f} mm"):
        PAPER.check_fits(8.2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        PAPER.check_fits(dim - 0.01)


@pytest.mark.parametrize(
    ("change", "number"),
    [
        ({"radius": math.nan}, "nan"),
        ({"radius": -1.0}, "-1"),
        ({"wall": 12.4}, "12.4"),
        ({"wall": -0.1}, "-0.1"),
        ({"resin_index": 0.5}, "0.5"),
        ({"bath_index": math.inf}, "inf"),
        ({"absorption": -0.05}, "-0.05"),
    ],
)
def test_wrong_values_are_named(change: dict[str, Any], number: str) -> None:
    good: dict[str, Any] = {"radius": 12.4, "wall": 1.0, "resin_index": 1.5, "wall_index": 1.47, "bath_index": 1.0}
    good["absorption"] = 0.1
    with pytest.raises(BadInput, match=number):
        Vial(**{**good, **change})


def test_positions_that_are_not_finite_are_refused() -> None:
    with pytest.raises(BadInput, match="1 numbers"):
        PAPER.chords([0.0, math.nan])
    with pytest.raises(BadInput, match="along"):
        PAPER.illuminate([0.0], [math.inf])
    with pytest.raises(BadInput, match="expected"):
        deposit(PAPER, [0.0, 1.0], [[1.0]], [0.0], (8, 8), 0.1)


class Tinted(Vial):
    """A vial of one's own, which passes a share that is no field."""

    def illuminate(self: Any, across: Any, along: Any) -> Any:
        u, weight = Vial.illuminate(self, across, along)
        return u, self.passed * weight


class Slotted(Tinted):
    """The same, kept in a slot."""

    __slots__ = ("passed",)


@dataclass(frozen=True)
class Attributed(Vial):
    """The same, made a dataclass."""

    illuminate = Tinted.illuminate


@dataclass(frozen=True)
class Uncompared(Vial):
    """The same, with a field that is not compared."""

    passed: float = field(default=1.0, compare=False)
    illuminate = Tinted.illuminate


def light_of(vessel: Vessel) -> np.ndarray:
    return tabulate(Grid((24, 24, 1), 0.1), Beam((24, 1), 0.1), vessel).map[..., 1]


@pytest.mark.parametrize("kind", [Tinted, Slotted, Attributed, Uncompared])
@pytest.mark.parametrize("bathed", [False, True])
def test_equal_vials_that_pass_other_shares_have_tables_of_their_own(kind: type[Vial], bathed: bool) -> None:
    def vessel(passed: float) -> Vessel:
        vial = kind(8.0, 0.7, 1.48, 1.52, 1.333, 0.2)
        object.__setattr__(vial, "passed", passed)
        return SquareBath(vial, width=20.0, wall=1.0, wall_index=1.5) if bathed else vial

    assert vessel(1.0) == vessel(0.5)
    np.testing.assert_allclose(light_of(vessel(0.5)), 0.5 * light_of(vessel(1.0)), rtol=1e-12)


@pytest.mark.parametrize("bathed", [False, True])
def test_equal_vials_of_the_library_are_traced_once(bathed: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    def vessel() -> Vessel:
        vial = replace(WATER, radius=8.1)
        return SquareBath(vial, width=20.0, wall=1.0, wall_index=1.5) if bathed else vial

    traced: list[None] = []
    illuminate = Vial.illuminate
    monkeypatch.setattr(Vial, "illuminate", lambda *given: traced.append(None) or illuminate(*given))
    first = light_of(vessel())
    count = len(traced)
    assert count and np.array_equal(light_of(vessel()), first) and len(traced) == count


def test_columns_alone_are_those_that_illuminate() -> None:
    vial = Vial(radius=4.0, wall=0.3, resin_index=1.5, wall_index=1.47, bath_index=1.0, absorption=0.1)
    x, y = np.meshgrid(np.linspace(-4.2, 4.2, 41), np.linspace(-4.2, 4.2, 40))
    assert np.array_equal(vial.columns(x, y), vial.illuminate(x, y)[0])
