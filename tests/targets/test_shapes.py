"""Bundled shapes: closed, in the vial, and with the features they are named for."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from manifold3d import CrossSection, Manifold

from vamgpu.errors import BadInput
from vamgpu.targets import shapes
from vamgpu.targets.shapes.csg import from_triangles
from vamgpu.targets.shapes.fasteners import PITCH, threaded_rod
from vamgpu.targets.shapes.gearing import CENTER_DISTANCE, PIN_DIAMETER, TEETH, gear_outline
from vamgpu.targets.solid import Solid

BODIES = {"exposure_disk": 8, "gears_0um": 2, "gears_50um": 2, "gears_100um": 2}


@cache
def made(name: str) -> Solid:
    return shapes.build(name)


def body(solid: Solid) -> Manifold:
    return from_triangles(solid.vertices, solid.faces)


def handles(solid: Solid) -> int:
    """Number of through holes (genus, summed over the bodies)."""
    return sum(part.genus() for part in body(solid).decompose())


def section(solid: Solid, z: float) -> CrossSection:
    return body(solid).slice(z)


@pytest.mark.slow
@pytest.mark.parametrize("name", shapes.names())
def test_every_shape_is_closed_centered_and_fits_the_vial(name: str) -> None:
    part = made(name)
    assert part.name == name
    assert part.open_edges == 0
    mesh = part.to_mesh()
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert part.volume > 0.0
    assert part.volume == pytest.approx(mesh.volume, rel=1e-9)
    assert 4.0 < part.radius <= 8.0
    assert part.bounds[:, 2].sum() == pytest.approx(0.0, abs=1e-9)
    assert len(body(part).decompose()) == BODIES.get(name, 1)


def test_unknown_names_and_dimensions_are_named() -> None:
    with pytest.raises(BadInput, match="boat"):
        shapes.build("teapot")
    with pytest.raises(BadInput, match="wingspan"):
        shapes.build("boat", wingspan=3.0)
    with pytest.raises(BadInput, match="height"):
        shapes.build("boat", height=-1.0)


def test_boat_has_its_height_and_scales_with_it() -> None:
    assert made("boat").height == pytest.approx(11.5, rel=1e-9)
    assert shapes.boat(height=23.0).volume == pytest.approx(8.0 * made("boat").volume, rel=1e-6)


def test_boat_is_open_where_it_should_be() -> None:
    part = body(made("boat"))
    # Door, front window, two windows a side and the chimney open the cabin: seven openings less one, two hawse pipes.
    assert part.genus() == 6 + 2
    low, high = made("boat").bounds
    probe = {
        "chimney": ((-1.0, 0.0, 8.6), (-1.0, 0.0, 11.4), 0.4),
        "transom": ((-6.0, 0.0, 1.4), (-4.7, 0.0, 1.4), 0.4),
        "flag pole": ((-5.75, 0.0, 3.1), (-5.75, 0.0, 4.3), 0.17),
    }
    shift = low - _drawn_low()
    for start, end, radius in probe.values():
        pin = _pin(np.add(start, shift), np.add(end, shift), radius)
        assert (part ^ pin).volume() == pytest.approx(0.0, abs=1e-9)
    # The blind holes end: a longer pin meets material.
    deep = _pin(np.add((-6.0, 0.0, 1.4), shift), np.add((-4.2, 0.0, 1.4), shift), 0.4)
    assert (part ^ deep).volume() > 0.1
    assert high[2] - low[2] == pytest.approx(11.5)


def _drawn_low() -> np.ndarray:
    """Lowest corner of the boat before it was centered, from its drawing: aft strake, widest strake, keel."""
    from vamgpu.targets.shapes.vessel import _hull

    return np.array(_hull().bounding_box()[:3])


def _pin(start: np.ndarray, end: np.ndarray, radius: float) -> Manifold:
    from vamgpu.targets.shapes.csg import rod

    return rod(tuple(start.tolist()), tuple(end.tolist()), radius)


def test_boat_roof_overhangs_the_cabin_and_the_letters_stand_out() -> None:
    part = made("boat")
    bottom = part.bounds[0, 2]
    # Above the deck box, below the eaves: the cabin's walls; at the eaves: the roof.
    wall, roof = section(part, bottom + 7.5).bounds(), section(part, bottom + 8.05).bounds()
    assert roof[0] < wall[0] - 0.5 and roof[1] < wall[1] - 0.5
    assert roof[2] > wall[2] + 0.5 and roof[3] > wall[3] + 0.5
    # A waterline through the text is wavier than one below it.
    assert section(part, bottom + 1.9).num_vert() > section(part, bottom + 0.6).num_vert() + 50


def test_boat_has_three_letters_a_side_outside_the_hull_only() -> None:
    from vamgpu.targets.shapes.vessel import _hull, _lettering

    letters = (_lettering("VAM") - _hull()).decompose()
    letters = [letter for letter in letters if letter.volume() > 1e-3]
    assert len(letters) == 6
    assert sum(letter.bounding_box()[1] > 1.9 for letter in letters) == 3
    # Raised by 0.16 mm sideways: volume over the area in side view.
    for letter in letters:
        seen = letter.rotate((90.0, 0.0, 0.0)).project().area()
        assert letter.volume() / seen == pytest.approx(0.16, rel=0.1)


def test_exposure_disk_has_the_spokes_and_gaps_of_the_paper() -> None:
    pixel, outline = 0.067, section(made("exposure_disk"), 0.0)
    assert made("exposure_disk").height == pytest.approx(2.0)
    parts = sorted(outline.decompose(), key=lambda part: part.area())
    center = _disk_center(parts[-1])
    gaps = sorted(float(np.hypot(*(_points(part) - center).T).min()) - 6.0 for part in parts[:-1])
    np.testing.assert_allclose(gaps, pixel * np.arange(2, 9), atol=2e-3)
    ring = CrossSection.circle(6.3, 256) - CrossSection.circle(6.25, 256)
    spokes = sorted(piece.area() / 0.05 for piece in (parts[-1] ^ ring.translate(tuple(center))).decompose())
    expected = np.repeat(pixel * np.arange(1, 8), 2)
    # The spokes stand 0.5 mm off the radius, so the ring crosses them at a small angle.
    np.testing.assert_allclose(spokes, expected, rtol=0.02)


def _points(figure: CrossSection) -> np.ndarray:
    return np.concatenate(figure.to_polygons())


def _disk_center(figure: CrossSection) -> np.ndarray:
    """Center of the main disk from the rim points on the side that has no spokes (a least-squares circle)."""
    points = _points(figure)
    rim = points[points[:, 1] < -1.0]
    solution = np.linalg.lstsq(np.column_stack([2.0 * rim, np.ones(len(rim))]), (rim**2).sum(axis=1), rcond=None)[0]
    return solution[:2]


def test_channels_cross_without_meeting() -> None:
    part = made("crossing_channels")
    assert handles(part) == 2
    block = Manifold.cube((8.0, 8.0, 2.4), True)
    ducts = (block - body(part)).decompose()
    assert len(ducts) == 2
    cut = (block - body(part)) ^ Manifold.cube((0.01, 8.0, 2.4), True).translate((2.0, 0.0, 0.0))
    assert cut.volume() / 0.01 == pytest.approx(0.3**2, rel=1e-6)


def test_thread_has_unified_dimensions_and_the_nut_goes_on() -> None:
    rod = threaded_rod(0.0, 4.0 * PITCH)
    radii = np.hypot(*_points(rod.slice(2.0)).T)
    assert radii.max() == pytest.approx(3.175, abs=1e-6)
    minor = 0.5 * (6.35 - 1.0825 * 1.27)
    assert minor * np.cos(np.pi / 72) - 1e-6 <= radii.min() <= minor + 1e-6
    # Right-handed: a quarter turn ahead the thread is a quarter pitch higher.
    turned = threaded_rod(0.0, 8.0 * PITCH).rotate((0.0, 0.0, 90.0)).translate((0.0, 0.0, 0.25 * PITCH))
    assert (rod.trim_by_plane((0, 0, 1), PITCH) - turned).volume() == pytest.approx(0.0, abs=1e-6)
    ring = Manifold.cylinder(2.0 * PITCH, 5.0).translate((0.0, 0.0, PITCH)) - threaded_rod(0.0, 4.0 * PITCH, 0.1)
    assert (ring ^ rod).volume() == pytest.approx(0.0, abs=1e-9)
    # Pulled by half a pitch without turning, it is held by the thread.
    assert (ring ^ rod.translate((0.0, 0.0, 0.5 * PITCH))).volume() > 1.0
    assert handles(made("nut")) == 1
    assert handles(made("screw")) == 0


@pytest.mark.parametrize(("name", "gap"), [("gears_0um", 0.0), ("gears_50um", 0.05), ("gears_100um", 0.1)])
def test_gears_have_the_bore_and_mesh_without_overlap(name: str, gap: float) -> None:
    part = made(name)
    assert handles(part) == 2
    outlines = section(part, 0.0).decompose()
    assert len(outlines) == 2
    left = min(outlines, key=lambda one: one.bounds()[0])
    middle = np.array([0.5 * (left.bounds()[0] + left.bounds()[2]), 0.0])
    bore = min(left.to_polygons(), key=lambda ring: float(np.ptp(ring[:, 0])))
    center = bore.mean(axis=0)
    assert center[0] == pytest.approx(middle[0], abs=0.02)
    reach = np.hypot(*(bore - center).T).min() * np.cos(np.pi / 96)
    assert reach == pytest.approx(0.5 * PIN_DIAMETER + gap, abs=1e-3)
    one = gear_outline(gap)
    for turn in np.linspace(0.0, 360.0 / TEETH, 7):
        other = one.rotate(180.0 + 180.0 / TEETH - float(turn)).translate((CENTER_DISTANCE, 0.0))
        assert (one.rotate(float(turn)) ^ other).area() < 1e-4


def test_gear_backlash_is_the_gap() -> None:
    gap, pitch_radius = 0.1, 0.5 * CENTER_DISTANCE
    play = np.degrees(gap / pitch_radius)
    fixed = gear_outline(gap)

    def overlap(turn: float) -> float:
        start = 180.0 + 180.0 / TEETH
        return (fixed ^ fixed.rotate(start + turn).translate((CENTER_DISTANCE, 0.0))).area()

    assert overlap(0.45 * play) < 1e-4 and overlap(-0.45 * play) < 1e-4
    assert overlap(0.7 * play) > 1e-3 and overlap(-0.7 * play) > 1e-3


def test_gear_base_has_two_pins() -> None:
    pins = section(made("gear_base"), 2.0).decompose()
    assert [pin.area() for pin in pins] == pytest.approx([np.pi * 1.5**2] * 2, rel=2e-3)
    centers = [0.5 * (pin.bounds()[0] + pin.bounds()[2]) for pin in pins]
    assert abs(centers[0] - centers[1]) == pytest.approx(CENTER_DISTANCE, abs=1e-6)


@pytest.mark.slow
def test_gyroid_wall_is_as_thick_as_asked() -> None:
    part = made("gyroid_sphere")
    # Steiner's formula for a sheet around a minimal surface: area 3.0915 and Euler number -8 in a unit cell.
    wall = 0.5 / 4.0
    expected = 3.0915 * wall - 8.0 * 2.0 * np.pi * wall**3 / 12.0
    core = (body(part) ^ Manifold.cube((4.0, 4.0, 4.0), True)).volume() / 64.0
    assert core == pytest.approx(expected, rel=0.02)
    assert part.radius == pytest.approx(6.0, abs=0.01)


def test_cubic_lattice_has_its_cells() -> None:
    part = made("cubic_lattice")
    nodes, struts = 6**3, 3 * 5 * 6**2
    assert handles(part) == struts - nodes + 1
    assert part.height == pytest.approx(5 * 1.8 + 0.5, abs=0.01)


def test_pentamode_bonds_touch_with_the_width_of_the_paper() -> None:
    from vamgpu.targets.shapes.lattices import _diamond

    atoms, bonds = _diamond(2)
    degree = np.bincount(bonds.ravel(), minlength=len(atoms))
    assert degree.max() == 4 and degree[degree > 0].min() == 2
    np.testing.assert_array_equal(np.abs(atoms[bonds[:, 0]] - atoms[bonds[:, 1]]), 1)
    part = shapes.pentamode(cells=2, touch=0.13)
    assert handles(part) == len(bonds) - int((degree > 0).sum()) + 1
    # Around the central atom, a plane halfway to its touch ball cuts cones of little more than the touch width.
    narrow, wide = shapes.pentamode(cells=2, touch=0.13), shapes.pentamode(cells=2, touch=0.3)
    assert wide.volume > narrow.volume * 1.3
