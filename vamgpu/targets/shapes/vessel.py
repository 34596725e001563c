"""The test boat: one small part with every kind of feature that is hard to print."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from manifold3d import CrossSection, Manifold, OpType

from vamgpu.targets.shapes.csg import box, from_triangles, polygon, rod, stroke, to_solid, union
from vamgpu.targets.solid import Solid

_LENGTH, _BEAM, _DEPTH = 12.6, 6.4, 3.6
_DECK = 1.9  # height of the well's floor above the keel
_STATIONS, _LEVELS = 64, 24
_HEIGHT = 11.5  # height at which the boat is drawn [mm]; all other numbers here refer to it
_FLAG, _FLAG_TOP = (-5.75, 0.0), _DEPTH + 0.75
_GLYPHS: dict[str, tuple[float, list[list[tuple[float, float]]]]] = {
    "V": (0.9, [[(0.0, 1.0), (0.45, 0.0), (0.9, 1.0)]]),
    "A": (0.9, [[(0.0, 0.0), (0.45, 1.0), (0.9, 0.0)], [(0.2, 0.35), (0.7, 0.35)]]),
    "M": (1.0, [[(0.0, 0.0), (0.1, 1.0), (0.5, 0.3), (0.9, 1.0), (1.0, 0.0)]]),
}


def boat(height: float = 11.5) -> Solid:
    """A tug, bow along +x, upright along z.

    It has a flared hull, an overhanging cabin roof, windows and a door, a chimney with a through hole into the cabin,
    hawse pipes through the bulwarks, a blind hole in the transom and one in the deck box, a flag-pole hole with a 0.16
    mm wall, and raised text on both sides. At 11.5 mm it needs a printable radius of 6.6 mm.

    Args:
        height: Height of the boat [mm]; all its dimensions scale with it.

    Returns:
        The boat.
    """
    low, high = (-5.0, -0.9, _DECK - 0.3), (-3.6, 0.9, _DECK + 1.25)
    deck_box = box(low, high) - box((low[0] + 0.4, low[1] + 0.4, _DECK + 0.2), (high[0] - 0.4, high[1] - 0.4, 9.0))
    flag_pole_holder = rod((*_FLAG, 2.4), (*_FLAG, _FLAG_TOP), 0.36)
    body = _hull() + _cabin() + deck_box + flag_pole_holder + _lettering("VAM")
    chimney_hole = rod((-1.0, 0.0, 7.0), (-1.0, 0.0, _HEIGHT + 1.0), 0.45)
    blind_hole = rod((-8.0, 0.0, 1.4), (-4.6, 0.0, 1.4), 0.45)
    flag_pole_hole = rod((*_FLAG, _FLAG_TOP - 1.4), (*_FLAG, _FLAG_TOP + 1.0), 0.20)
    # pipes run from the foredeck outward and down through the bulwarks
    hawse_holes = union(rod((3.9, 0.6 * side, 4.1), (4.5, 3.6 * side, 3.3), 0.26) for side in (-1.0, 1.0))
    body = body - chimney_hole - hawse_holes - blind_hole - flag_pole_hole
    return to_solid(body, "boat").placed(height=height)


def _half_breadth(s: npt.NDArray[np.float64], t: float) -> npt.NDArray[np.float64]:
    """Half breadth at station s (0 transom .. 1 stem) and level t (0 keel .. 1 sheer)."""
    plan = np.where(s < 0.4, 1.0 - 0.22 * ((0.4 - s) / 0.4) ** 2, 1.0 - (np.maximum(s - 0.4, 0.0) / 0.6) ** 2.4)
    flare = 0.62 + 0.38 * (1.0 - (1.0 - min(t, 1.0)) ** 2.2) ** 0.6
    return 0.5 * _BEAM * plan * flare


def _loft(levels: npt.NDArray[np.float64], swell: float = 0.0, shrink: float = 1.0, lift: float = 0.0) -> Manifold:
    """A body between waterlines: swollen sideways by swell, shrunk in plan, raised by lift above the last level."""
    s = 1.0 - np.linspace(1.0, 0.0, _STATIONS) ** 1.5  # denser near the rounded stem
    rings = []
    for index, t in enumerate(levels):
        sheer = _DEPTH * (1.0 + 0.42 * s**2.5 + 0.06 * (1.0 - s) ** 2)
        z = t * sheer + (lift if index == len(levels) - 1 else 0.0)
        # the stem leans forward, the transom slightly aft
        aft, fore = -0.5 * _LENGTH + 0.5 * (1.0 - t), 0.5 * _LENGTH - 1.9 * (1.0 - t) ** 1.3
        x, y = shrink * (aft + s * (fore - aft)), shrink * _half_breadth(s, float(t)) + swell * (1.0 - s**8)
        starboard, port = np.stack([x, -y, z], axis=1), np.stack([x, y, z], axis=1)
        rings.append(np.concatenate([starboard, port[-2::-1]]))
    return from_triangles(np.concatenate(rings), _ring_faces(len(levels)))


def _ring_faces(levels: int) -> npt.NDArray[np.int64]:
    """Triangles of stacked waterlines: the sides, and the two ends as strips from port to starboard."""
    ring = 2 * _STATIONS - 1
    here = np.arange(ring)
    after = (here + 1) % ring
    faces = []
    for level in range(levels - 1):
        a, b, c, d = here + level * ring, after + level * ring, after + (level + 1) * ring, here + (level + 1) * ring
        faces += [np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]
    right = np.arange(_STATIONS - 1)
    left = ring - 1 - right
    top = (levels - 1) * ring
    # At the stem both sides share a vertex, so the last strip is a triangle.
    faces += [np.stack([right, left, right + 1], axis=1), np.stack([left, left - 1, right + 1], axis=1)[:-1]]
    faces += [
        np.stack([right, right + 1, left], axis=1) + top,
        np.stack([left, right + 1, left - 1], axis=1)[:-1] + top,
    ]
    return np.concatenate(faces)


def _hull() -> Manifold:
    levels = np.linspace(0.0, 1.0, _LEVELS)
    strake = _loft(np.array([0.80, 0.83, 0.87, 0.90]), swell=0.2)
    well = _loft(np.array([0.3, 0.6, 0.8, 1.0]), shrink=0.87, lift=2.0)
    well = well ^ box((-9.0, -9.0, _DECK), (3.3, 9.0, 20.0))
    foredeck = _loft(np.array([0.5, 0.8, 1.0]), shrink=0.87, lift=2.0)
    foredeck = foredeck ^ box((3.0, -9.0, _DEPTH - 0.2), (9.0, 9.0, 20.0))
    return _loft(levels) + strake - well - foredeck


def _cabin() -> Manifold:
    aft, fore, half, eaves = -2.4, 2.3, 1.75, 8.0
    side = polygon([(aft, _DECK - 0.3), (fore + 0.5, _DECK - 0.3), (fore, eaves), (aft, eaves)])
    room = polygon([(aft + 0.45, _DECK), (fore, _DECK), (fore - 0.45, eaves + 0.15), (aft + 0.45, eaves + 0.15)])
    shell = _across(side, half) + _roof(aft - 0.85, fore + 0.75, half + 0.6, eaves) - _across(room, half - 0.45)
    window = (CrossSection.square((1.25, 1.5), True) + CrossSection.circle(0.625, 48).translate((0.0, 0.75))).translate(
        (0.0, 6.0)
    )
    shell -= _across(window.translate((-1.15, 0.0)) + window.translate((0.9, 0.0)), 5.0)
    shell -= box((fore - 1.0, -1.15, 5.2), (fore + 2.0, 1.15, 7.3))
    door = polygon([(-0.7, _DECK), (0.7, _DECK), (0.7, 5.7), (0.35, 6.5), (-0.35, 6.5), (-0.7, 5.7)])
    shell -= door.extrude(2.0).rotate((90.0, 0.0, 90.0)).translate((aft - 1.0, 0.0, 0.0))
    chimney = rod((-1.0, 0.0, eaves), (-1.0, 0.0, _HEIGHT), 0.85, 0.72)
    return shell + chimney + rod((-1.0, 0.0, _HEIGHT - 0.55), (-1.0, 0.0, _HEIGHT), 0.95)


def _roof(aft: float, fore: float, half: float, eaves: float) -> Manifold:
    """A vaulted plate with rounded corners that overhangs the cabin all round."""
    radius = 7.0
    plan = CrossSection.square((fore - aft - 1.2, 2.0 * half - 1.2), True).offset(0.6, circular_segments=32)
    slab = plan.translate((0.5 * (aft + fore), 0.0)).extrude(2.0).translate((0.0, 0.0, eaves - 0.3))
    vault = rod((aft - 1.0, 0.0, eaves + 0.75 - radius), (fore + 1.0, 0.0, eaves + 0.75 - radius), radius, segments=256)
    return slab ^ vault


def _lettering(text: str, size: float = 1.35, raised: float = 0.16) -> Manifold:
    """Letters on both sides, readable from outside, cut from a hull that is swollen by raised."""
    pen, space, glyphs = 0.3, 0.45, []
    cursor = 0.0
    for letter in text:
        width, lines = _GLYPHS[letter]
        glyphs += [stroke(np.array(line) * size, pen).translate((cursor, 0.0)) for line in lines]
        cursor += width * size + space
    flat = CrossSection.batch_boolean(glyphs, OpType.Add).translate((0.5 * (space - cursor), 0.0))
    starboard = flat.extrude(8.0).rotate((90.0, 0.0, 0.0)).translate((-0.4, 0.0, 1.2))
    port = starboard.rotate((0.0, 0.0, 180.0)).translate((-0.8, 0.0, 0.0))
    # The letters extend into the wall, but not through it into the well.
    inner = _loft(np.linspace(0.0, 1.0, _LEVELS), shrink=0.94, lift=1.0)
    return ((starboard + port) ^ _loft(np.linspace(0.05, 0.9, _LEVELS), swell=raised)) - inner


def _across(figure: CrossSection, half: float) -> Manifold:
    """Extrude a figure drawn in (x, z) from y = -half to y = half."""
    return figure.extrude(2.0 * half).rotate((90.0, 0.0, 0.0)).translate((0.0, half, 0.0))
