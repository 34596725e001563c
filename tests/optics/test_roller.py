"""The roller against formulas and marching rays written here from Snell's law alone."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from vamgpu.errors import BadInput, RayError
from vamgpu.geometry import Beam
from vamgpu.optics.film import Film
from vamgpu.optics.roller import Roller
from vamgpu.optics.roller_index import FilmIndex
from vamgpu.optics.roller_rays import End, Layers, trace
from vamgpu.optics.wrap_map import WrapMap
from vamgpu.web import Propagation, WebGrid, Wrap

PAPER = Film(thickness=3.0, resin_index=1.49, bath_index=1.33, absorption=0.22)
STEP = math.radians(0.5)


def roller(film: Film = PAPER, **options: object) -> Roller:
    return Roller(7.5, film, STEP, **options)  # type: ignore[arg-type]


def grid(machine: Roller, layers: int = 30) -> WebGrid:
    return WebGrid((1000, layers, 4), (machine.advance, machine.film.thickness / layers, 0.1))


def columns_of(light: Propagation) -> np.ndarray:
    return np.bincount(light.r, light.weight, light.shape[0])


def test_numbers_of_the_paper() -> None:
    machine = roller()
    assert PAPER.coverage == pytest.approx(2.2, abs=0.05)
    assert PAPER.penetration == pytest.approx(13.6, abs=0.05)
    assert machine.outer == 10.5
    assert machine.advance == pytest.approx(0.0785, abs=5e-5)
    assert math.pi * (machine.radius + machine.outer) / 4 == pytest.approx(14.1, abs=0.05)
    light = machine.propagation(grid(machine), Beam((8, 4), 0.1))
    assert isinstance(machine, Wrap)
    window = light.shape[2] * machine.advance
    assert 0 <= window - (math.pi * 9.0 + 2 * PAPER.penetration) < machine.advance
    assert light.middle == pytest.approx(0.5 * window)


def test_entries_are_sparse_sorted_and_positive() -> None:
    machine = roller()
    light = machine.propagation(grid(machine), machine.beam(0.2, 4))
    flat = np.ravel_multi_index((light.r, light.rho, light.l), light.shape)
    assert np.all(np.diff(flat) > 0)
    assert np.all(light.weight > 0)
    assert light.r.dtype == light.rho.dtype == light.l.dtype == np.int32
    assert flat.size < 0.02 * np.prod(light.shape)
    mirrored = light.dense()[::-1, :, ::-1]
    assert np.max(np.abs(light.dense() - mirrored)) < 1e-12


def test_map_goes_both_ways_and_is_smooth_at_the_legs() -> None:
    machine = roller()
    map = machine.map()
    l, rho = np.meshgrid(np.linspace(0, map.length, 501), np.linspace(0, 3, 13), indexing="ij")  # noqa: E741
    x, y = map.wrapped(l, rho)
    back = map.flat(x, y)
    assert np.max(np.abs(back[0] - l)) < 1e-12
    assert np.max(np.abs(back[1] - rho)) < 1e-12
    assert np.all(map.inside(x[1:-1, 1:-1], y[1:-1, 1:-1]))
    for side in (-1, 1):
        edge = map.middle + side * 0.5 * map.arc
        here, there = (np.array(map.wrapped(edge + d, 1.2)) for d in (-1e-9, 1e-9))
        assert np.max(np.abs(here - there)) < 1e-8
    assert map.wrapped(map.middle, 3.0) == (pytest.approx(0.0), pytest.approx(-10.5))
    h = 1e-5
    places = np.array([2.0, map.middle - 9.0, map.middle, map.middle + 5.0, map.length - 3.0])
    (x_l, y_l), (x_r, y_r) = (
        tuple((np.array(b) - np.array(a)) / (2 * h))
        for a, b in (
            (map.wrapped(places - h, 0.7), map.wrapped(places + h, 0.7)),
            (map.wrapped(places, 0.7 - h), map.wrapped(places, 0.7 + h)),
        )
    )
    assert map.jacobian(places, 0.7) == pytest.approx(np.abs(x_l * y_r - x_r * y_l), rel=1e-8)


def march(machine: Roller, u: float, leg: float, step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """x, y and way of points along one ray in the film, and its transmittance, from Snell's law in angles."""
    bath, resin, outer, inner = machine.film.bath_index, machine.film.resin_index, machine.outer, machine.radius
    incidence = math.asin(u / outer)
    refraction = math.asin(bath / resin * math.sin(incidence))
    c1, c2 = math.cos(incidence), math.cos(refraction)
    share = 1 - 0.5 * ((bath * c1 - resin * c2) / (bath * c1 + resin * c2)) ** 2
    share -= 0.5 * ((resin * c1 - bath * c2) / (resin * c1 + bath * c2)) ** 2
    lean = incidence - refraction
    way = (np.arange(int((leg + outer) / math.cos(lean) / step)) + 0.5) * step
    x, y = u - math.sin(lean) * way, -outer * math.cos(incidence) + math.cos(lean) * way
    # Behind the axis the faces of the leg reflect totally: straight on, folded back.
    fold = np.abs((x - inner) % (2 * (outer - inner)))
    x = np.where(y > 0, inner + np.minimum(fold, 2 * (outer - inner) - fold), x)
    stopped = (np.hypot(x, y) < inner) & (y <= 0) | (y > leg)
    kept = int(np.argmax(stopped)) if stopped.any() else way.size
    return x[:kept], y[:kept], way[:kept], share


@pytest.mark.parametrize("u", [0.31, 4.07, 7.03, 8.35, 8.401, 9.2, 10.33])
def test_voxels_along_a_ray_against_marching(u: float) -> None:
    machine = roller(rays=1)
    web, pitch = grid(machine), 2 * u
    light = machine.propagation(web, Beam((2, 4), pitch))
    map, step = machine.map(web), 1e-3
    x, y, way, share = march(machine, u, map.leg, step)
    l, rho = map.flat(x, y)  # noqa: E741
    wanted = np.zeros(light.shape[1:])
    absorbed = share * np.exp(-0.22 * (way - 0.5 * step)) * -np.expm1(-0.22 * step)
    np.add.at(wanted, (np.minimum(rho / web.edges[1], 29).astype(int), (l / web.edges[0]).astype(int)), absorbed)
    found = light.dense()[1]
    assert np.max(np.abs(found - wanted)) < 2.5 * 0.22 * step  # a step on either side of a wall
    assert found.sum() == pytest.approx(wanted.sum(), abs=2 * 0.22 * step)


def test_unrefracted_light_is_the_field_of_the_paper() -> None:
    """Fig. S11: α_V = α·exp(−α·β), β = √(r_o² − x²) + y, on the roller and in the legs."""
    machine = roller(Film(3.0, 1.49, 1.49, 0.22), rays=64)
    web = grid(machine, 24)
    map, beam = machine.map(web), Beam((210, 4), 0.1)
    light = machine.propagation(web, beam)
    flat = np.bincount(light.rho * light.shape[2] + light.l, light.weight, int(np.prod(light.shape[1:])))
    along = ((np.arange(light.shape[2] * 6) + 0.5) * web.edges[0] / 6)[None, :]
    depth = ((np.arange(24 * 6) + 0.5) * web.edges[1] / 6)[:, None]
    field = map.absorbed(*map.wrapped(along, depth), 0.22) * map.jacobian(along, depth)
    wanted = field.reshape(24, 6, -1, 6).mean(axis=(1, 3))
    dose = flat.reshape(24, -1) * beam.pitch / (web.edges[0] * web.edges[1])
    wide = np.abs((np.arange(light.shape[2]) + 0.5) * web.edges[0] - map.middle)
    steep = (wide > 1.5) & (np.abs(wide - 0.5 * map.arc) > web.edges[0])
    assert np.max(np.abs(dose / wanted - 1)[:, steep]) < 0.02
    assert np.sqrt(np.mean((dose / wanted - 1)[:, steep] ** 2)) < 0.003
    assert dose.sum() == pytest.approx(wanted.sum(), rel=1e-4)
    assert np.isnan(map.path(0.0, 0.0)) and np.isnan(map.path(0.0, -11.0)) and np.isnan(map.path(9.0, 99.0))
    assert map.path(9.0, 2.0) == pytest.approx(math.sqrt(10.5**2 - 81) + 2.0)


def test_rays_end_at_the_roller_or_run_on_in_a_leg() -> None:
    traced = roller().trace([0.0, 5.0, 9.0, 10.4, 10.6])
    assert traced.end.tolist() == [End.ROLLER, End.ROLLER, End.LEG, End.LEG, End.MISSED]
    assert traced.length[0] == pytest.approx(3.0)
    assert traced.transmittance[0] == pytest.approx(1 - (0.16 / 2.82) ** 2)
    assert traced.length[4] == traced.transmittance[4] == 0
    assert set(traced.segments.side[traced.segments.ray == 3]) == {0, 1}
    # A denser bath sends rays outwards: past the roller, and out of the leg's outer face.
    outwards = roller(Film(3.0, 1.40, 1.49, 0.22)).trace([7.0, 9.0, 9.85, 9.87])
    assert outwards.end.tolist() == [End.ROLLER, End.BATH, End.BATH, End.MISSED]


def test_roller_throws_a_shadow() -> None:
    """Light of a denser bath leans away from the axis behind the ray that grazes the roller: there it stays dark."""
    film = Film(3.0, 1.40, 1.49, 0.22)
    machine = roller(film)
    light = machine.propagation(grid(machine), machine.beam(0.05, 4))
    dose = np.bincount(light.rho * light.shape[2] + light.l, light.weight, int(np.prod(light.shape[1:])))
    dose = dose.reshape(light.shape[1:])
    lean = math.asin(7.5 / 10.5) - math.asin(7.5 * 1.40 / 1.49 / 10.5)  # of the grazing ray, away from the axis
    y = (np.arange(light.shape[2]) + 0.5) * machine.advance - light.middle - 0.5 * math.pi * 9.0
    rim = (7.5 + y * math.sin(lean)) / math.cos(lean) - 7.5  # rho of the grazing ray in the leg
    slack = machine.advance * math.tan(lean)
    upper = (np.arange(30) + 1) * 0.1
    leg = y > machine.advance
    dark = leg & (upper[:, None] < rim - slack)
    bright = leg & (upper[:, None] > rim + 0.1 + slack) & (upper[:, None] < rim + 0.5)
    assert dark.sum() > 300 and bright.sum() > 300
    assert np.all(dose[dark] == 0)
    assert np.all(dose[bright] > 0)


@pytest.mark.parametrize("share", [0.3, 1.0])
def test_reflective_roller_sends_the_same_way_back(share: float) -> None:
    film = Film(3.0, 1.49, 1.33, 0.22)
    dark, bright = roller(film), roller(film, reflectivity=share)
    u = np.linspace(0.0, 5.0, 11)
    down, both = dark.trace(u), bright.trace(u)
    assert np.all(both.end == End.BATH)
    assert both.length == pytest.approx(2 * down.length, rel=1e-12)
    loss = np.exp(-0.22 * down.length)
    wanted = down.transmittance * ((1 - loss) + share * loss * (1 - loss))
    s = both.segments
    assert np.bincount(s.ray, s.absorbed(0.22), u.size) == pytest.approx(wanted, rel=1e-12)
    impact = s.x * s.dy - s.y * s.dx
    assert impact == pytest.approx(u[s.ray] * 1.33 / 1.49, abs=1e-12)
    light = bright.propagation(grid(bright), Beam((20, 4), 0.1))
    more = dark.propagation(grid(dark), Beam((20, 4), 0.1))
    assert light.weight.sum() > more.weight.sum()


def test_diverging_beam_reaches_every_angle_inside_the_film() -> None:
    machine = roller(Film(3.0, 1.49, 1.33, 0.05), divergence=1.5, rays=4, fan=41)
    beam, web = Beam((100, 4), 0.1), grid(machine)
    light = machine.propagation(web, beam)
    offsets, leans = machine._bundle(beam.pitch)
    assert np.sin(leans) == pytest.approx(np.sin(1.5) * np.arange(-20, 21) / 20.5)
    traced = machine.trace(beam.columns()[:, None, None] + offsets[:, None], leans, machine.map(web).leg)
    s = traced.segments
    lost = np.bincount(s.ray, s.absorbed(0.05), traced.end.size)
    assert columns_of(light) == pytest.approx(lost.reshape(100, -1).mean(axis=1), abs=1e-12)
    assert np.max(np.abs(light.dense() - light.dense()[::-1, :, ::-1])) < 1e-9
    on_roller = s.side == 0
    foot = -(s.x * s.dx + s.y * s.dy)[on_roller]
    turns = (foot > 0) & (foot < s.length[on_roller])
    assert turns.sum() > 100  # rays that turn within the film are at 90° to its normal there
    axial = roller(Film(3.0, 1.49, 1.33, 0.05), rays=4).propagation(web, beam)
    assert np.unique(light.l).size > 1.5 * np.unique(axial.l).size


def test_light_spreads_with_the_distance_from_its_focus_plane() -> None:
    """Straight rays, as the film is of the bath's index: each passes the plane at its column, whatever its lean."""
    film, planes = Film(3.0, 1.33, 1.33, 0.05), (-9.0, -6.5, -3.0)
    machine = roller(film, divergence=0.1, planes=planes)
    u, lean = np.array([0.0, 2.0, 6.0, 8.0]), np.array([[-0.1], [0.04]])
    s = machine.trace(u, lean).segments
    ray, first = np.unique(s.ray, return_index=True)
    column = np.tile(u, 2)[ray]
    depth = -np.sqrt((machine.radius + 1.5) ** 2 - column**2)
    plane = np.array(planes)[np.abs(depth[:, None] - planes).argmin(axis=1)]
    across = s.x[first] + (plane - s.y[first]) * (s.dx / s.dy)[first]
    assert ray.size == 8 and set(plane) == set(planes) and across == pytest.approx(column, abs=1e-9)


@pytest.mark.slow
def test_a_plane_for_every_depth_is_focus_that_follows_the_film() -> None:
    from vamgpu.printing.focus import FocusMasks

    machine = roller(Film(3.0, 1.49, 1.33, 0.2), divergence=0.02, rays=4)
    beam, web = Beam((60, 2), 0.25), grid(machine, 15)
    light = [machine.propagation(web, beam).dense()]
    masks = FocusMasks.around(beam, machine.radius, 3.0, 30)
    assert masks.defocus.max() < 1e-9
    for bins in (30, 3, 1):
        planes = FocusMasks.around(beam, machine.radius, 3.0, bins).planes
        light.append(replace(machine, planes=planes, rays=4).propagation(web, beam).dense())
    following, all_planes, three, one = light
    assert all_planes == pytest.approx(following, rel=0.2, abs=0.02 * following.max())
    assert np.abs(all_planes - following).sum() < 0.3 * np.abs(three - following).sum()
    assert np.abs(three - following).sum() < np.abs(one - following).sum()


def test_substrate_keeps_snells_invariant() -> None:
    u = np.linspace(0.2, 10.0, 25)
    bare = roller().trace(u)
    for sheet in (1.33, 1.49, 1.65):
        film = Film(3.0, 1.49, 1.33, 0.22, substrate=(0.075, sheet))
        s = roller(film).trace(u).segments
        first = s.before == 0
        assert np.count_nonzero(first) == u.size
        assert (s.x * s.dy - s.y * s.dx)[first] == pytest.approx(u * 1.33 / 1.49, rel=1e-12)
    same = roller(Film(3.0, 1.49, 1.33, 0.22, substrate=(0.075, 1.33))).trace(u)
    assert same.transmittance == pytest.approx(bare.transmittance, rel=1e-12)
    assert same.length == pytest.approx(bare.length, rel=1e-12)
    head_on = roller(Film(3.0, 1.49, 1.33, 0.22, substrate=(0.075, 1.65))).trace([0.0]).transmittance[0]
    assert head_on == pytest.approx((1 - (0.32 / 2.98) ** 2) * (1 - (0.16 / 3.14) ** 2))


@pytest.mark.parametrize("polarization", ["none", "s", "p"])
def test_a_substrate_takes_from_s_and_p_light_on_its_own(polarization: str) -> None:
    """Both faces' amplitudes r_s and r_p from Snell's invariant alone; unpolarized light keeps the mean product."""
    u = np.linspace(-10.0, 10.0, 41)
    machine = roller(Film(3.0, 1.49, 1.33, 0.22, substrate=(0.075, 1.65)), polarization=polarization)
    kept = np.ones((2, u.size))
    for radius, before, after in ((10.575, 1.33, 1.65), (10.5, 1.65, 1.49)):
        one, two = (np.cos(np.arcsin(1.33 * u / (radius * index))) for index in (before, after))
        kept[0] *= 1 - ((before * one - after * two) / (before * one + after * two)) ** 2
        kept[1] *= 1 - ((after * one - before * two) / (after * one + before * two)) ** 2
    wanted = {"none": kept.mean(axis=0), "s": kept[0], "p": kept[1]}[polarization]
    traced = machine.trace(u)
    np.testing.assert_allclose(machine.transmittance(u), wanted, rtol=1e-12)
    np.testing.assert_allclose(traced.transmittance, wanted, rtol=1e-12)
    first = traced.segments.before == 0
    np.testing.assert_allclose(traced.segments.power[first], wanted[traced.segments.ray[first]], rtol=1e-12)
    np.testing.assert_allclose(machine.gain(u, 1.05), np.minimum(1 / wanted, 1.05), rtol=1e-12)
    limit = machine.coverage(1.05)
    assert machine.transmittance(10.5 * math.sin(limit.clipped)) == pytest.approx(1 / 1.05, rel=1e-9)


def test_compensation_is_clipped_and_says_what_it_costs() -> None:
    machine, plain = roller(compensation=2.0), roller()
    beam = machine.beam(0.05, 4)
    u = beam.columns()
    gain = machine.gain(u)
    assert gain == pytest.approx(np.minimum(1 / plain.transmittance(u), 2.0))
    assert columns_of(machine.propagation(grid(machine), beam)) == pytest.approx(
        gain * columns_of(plain.propagation(grid(plain), beam)))  # fmt: skip
    report = plain.coverage()
    assert report.limit == 2.0
    assert 1 / plain.transmittance(10.5 * math.sin(report.clipped)) == pytest.approx(2.0, rel=1e-9)
    assert report.outer == pytest.approx(2 * math.asin(1.33 / 1.49))
    assert report.inner == pytest.approx(math.pi)
    kept = 2 * math.asin(1.33 / 1.49 * math.sin(report.clipped))
    assert report.lost == pytest.approx(report.outer - kept)
    assert plain.coverage(3.7).clipped == pytest.approx(math.radians(88), abs=math.radians(0.1))
    assert plain.coverage(1.28).clipped == pytest.approx(math.radians(80), abs=math.radians(0.2))


def test_film_that_absorbs_nothing_counts_lengths() -> None:
    machine = roller(Film(3.0, 1.49, 1.33), legs=5.0)
    beam = machine.beam(0.1, 4)
    light = machine.propagation(grid(machine), beam)
    traced = machine.trace(beam.columns()[:, None] + machine._bundle(0.1)[0], leg=machine.map(grid(machine)).leg)
    wanted = (traced.transmittance * traced.length).reshape(beam.pixels[0], -1).mean(axis=1)
    assert columns_of(light) == pytest.approx(wanted, rel=1e-12)


def test_legs_and_neutral_line_are_parameters() -> None:
    machine = roller(legs=2.0, neutral=0.0)
    assert machine.advance == pytest.approx(STEP * 7.5)
    light = machine.propagation(grid(machine), Beam((4, 4), 0.1))
    assert light.shape[2] == math.ceil((math.pi * 7.5 + 4.0) / machine.advance)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Film(15.0, 1.49, 1.33, 0.22), "13.62 mm"),
        (lambda: Film(3.0, 0.9, 1.33, 0.22), "resin_index"),
        (lambda: Film(3.0, 1.49, 1.33, 0.22, substrate=(0.1,)), "substrate"),  # type: ignore[arg-type]
        (lambda: Film(-1.0, 1.49, 1.33, 0.22), "thickness"),
        (lambda: Roller(7.5, PAPER, 0.0), "step"),
        (lambda: Roller(7.5, PAPER, 4.0), "step"),
        (lambda: Roller(-7.5, PAPER, STEP), "radius"),
        (lambda: roller(reflectivity=1.2), "reflectivity"),
        (lambda: roller(divergence=1.6), "divergence"),
        (lambda: roller(planes=(-3.0, -4.0)), "planes"),
        (lambda: roller(planes=()), "planes"),
        (lambda: roller(neutral=-0.1), "neutral"),
        (lambda: roller(compensation=0.5), "at least 1"),
        (lambda: roller(rays=0), "rays"),
        (lambda: Roller(7.5, "film", STEP), "Film"),  # type: ignore[arg-type]
        (lambda: roller(Film(3.0, 1.49, 1.33)), "never leaves"),
        (lambda: roller().propagation(WebGrid((9, 30, 4), 0.11), Beam((4, 4), 0.1)), "3.3 mm thick"),
        (lambda: roller().propagation(grid(roller()), Beam((256, 4), 0.1)), "46 of 256 columns"),
        (lambda: roller(Film(3.0, 1.40, 1.49, 0.22)).propagation(grid(roller()), Beam((210, 4), 0.1)),
         "totally reflected"),
        (lambda: roller().coverage(0.9), "at least 1"),
        (lambda: WrapMap(7.5, 7.0, 7.2, 1.0), "inner < outer"),
        (lambda: roller().trace([float("nan")]), "finite"),
    ],
)  # fmt: skip
def test_bad_input_says_what_was_wanted(make: object, says: str) -> None:
    with pytest.raises(BadInput, match=says.replace(".", r"\.")):
        make()  # type: ignore[operator]


def test_ray_that_never_leaves_is_told() -> None:
    layers = Layers(7.5, 7.55, 7.55, 1000.0, 1.49, 1.33, 1.49, 0.0)
    one = np.ones(1)
    with pytest.raises(RayError, match="1 rays still run"):
        trace(layers, 7.5499 * one, -one, 0 * one, one)


def test_widest_beam_meets_the_film_everywhere() -> None:
    machine = roller()
    for pitch in (0.05, 0.0786, 0.1, 0.7):
        beam = machine.beam(pitch, 4)
        assert np.max(np.abs(beam.columns())) < 10.5
        assert 0.5 * beam.pixels[0] * pitch >= 10.5 * (1 - 1e-9)


def graded(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Denser towards the roller, the same along the web."""
    rho = np.hypot(x, np.minimum(y, 0.0)) - 7.5
    return 1.49 + 0.03 * np.exp(-rho)


def test_marching_through_one_index_is_going_straight() -> None:
    same = FilmIndex(lambda x, y: np.full(x.shape, 1.49), stride=0.31)
    machine, marched = roller(rays=4), roller(rays=4, index=same)
    beam = Beam((100, 4), 0.2)
    one, other = (m.propagation(grid(m), beam).dense() for m in (machine, marched))
    assert np.max(np.abs(one - other)) < 1e-9


def test_marched_rays_keep_the_invariant_of_a_graded_film() -> None:
    """n(r)·p is the same all along a ray where n depends on r alone; the error falls with the stride squared."""
    u = np.linspace(0.5, 9.5, 19)
    errors = []
    for stride in (0.2, 0.1, 0.05):
        traced = roller(index=FilmIndex(graded, stride)).trace(u)
        s = traced.segments
        kept = [np.flatnonzero((s.ray == ray) & (s.side == 0))[-1] for ray in range(u.size)]
        middle = np.hypot(s.x + 0.5 * s.length * s.dx, s.y + 0.5 * s.length * s.dy)[kept]
        impact = (s.x * s.dy - s.y * s.dx)[kept]
        found = (1.49 + 0.03 * np.exp(-(middle - 7.5))) * impact
        errors.append(np.max(np.abs(found / (u * 1.33) - 1)))
    assert errors[2] < 2e-5
    assert errors[0] / errors[2] > 10
    assert roller(index=FilmIndex(graded)).trace(u).length[-1] != pytest.approx(roller().trace(u).length[-1], rel=1e-4)


def test_index_that_is_none_is_told() -> None:
    with pytest.raises(BadInput, match="at least 1"):
        roller(index=FilmIndex(lambda x, y: 0.5 + 0 * x)).trace([1.0])
    with pytest.raises(BadInput, match="expected a FilmIndex"):
        roller(index=1.5)
    with pytest.raises(BadInput, match="function"):
        FilmIndex(1.5)  # type: ignore[arg-type]
