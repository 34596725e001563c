"""A 1/4-20 UNC cap screw and its nut by the Unified Thread Standard.

Source: A. Orth et al., Automatic exposure volumetric additive manufacturing, Fig. 6a.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from manifold3d import CrossSection, Manifold

from vamgpu.targets.shapes.csg import from_triangles, polygon, to_solid
from vamgpu.targets.solid import Solid

INCH = 25.4  # one inch [mm]
MAJOR = 0.25 * INCH  # major diameter of 1/4-20 UNC [mm]
PITCH = INCH / 20.0  # thread pitch of 1/4-20 UNC [mm]

_AROUND = 72
_PROFILE = np.array([(0.0, 0.0), (0.25, 0.0), (9 / 16, 1.0), (11 / 16, 1.0)])
"""Basic profile over one pitch: (height / pitch, radius from minor 0 to major 1): root P/4, crest P/8, 60 degrees."""


def screw(length: float = 6.35, clearance: float = 0.0) -> Solid:
    """A 1/4-20 UNC socket head cap screw, head down.

    Args:
        length: Length of the threaded part [mm].
        clearance: Amount by which the thread's radius is reduced [mm].

    Returns:
        The screw.
    """
    head_radius, head, socket, depth = 0.5 * 0.375 * INCH, 0.25 * INCH, 3 / 16 * INCH, 3.0
    chamfer = 0.4
    outline = [
        (0.0, 0.0),
        (head_radius - chamfer, 0.0),
        (head_radius, chamfer),
        (head_radius, head),
        (0.0, head),
    ]
    body = Manifold.revolve(polygon(outline), 96) - hexagon(socket).extrude(depth)
    tip = head + length
    # The thread starts inside the head; a 45 degree chamfer leads it in.
    minor = 0.5 * (MAJOR - 1.0825 * PITCH) - clearance
    envelope = [
        (0.0, head - 1.0),
        (MAJOR, head - 1.0),
        (MAJOR, tip - MAJOR + minor - 0.2),
        (minor - 0.2, tip),
        (0, tip),
    ]
    thread = threaded_rod(head - 1.0, tip, -clearance) ^ Manifold.revolve(polygon(envelope), 96)
    return to_solid(body + thread, "screw")


def nut(clearance: float = 0.1) -> Solid:
    """A 1/4-20 UNC hex nut, 7/16 in across flats, 7/32 in high.

    Args:
        clearance: Amount by which the thread's radius is increased [mm].

    Returns:
        The nut.
    """
    flats, height = 7 / 16 * INCH, 7 / 32 * INCH
    corner = flats / np.sqrt(3.0)
    chamfer = corner - 0.5 * flats
    rise = chamfer * np.tan(np.radians(30.0))
    turned = [
        (0.0, 0.0),
        (0.5 * flats, 0.0),
        (corner, rise),
        (corner, height - rise),
        (0.5 * flats, height),
        (0, height),
    ]
    body = hexagon(flats).extrude(height) ^ Manifold.revolve(polygon(turned), 96)
    hole = threaded_rod(-0.1, height + 0.1, clearance)
    lead = 0.5 * MAJOR + clearance + 0.2
    sink = Manifold.cylinder(lead, lead, 0.0, _AROUND)
    return to_solid(body - hole - sink - sink.mirror((0.0, 0.0, 1.0)).translate((0.0, 0.0, height)), "nut")


def hexagon(flats: float) -> CrossSection:
    """A regular hexagon of the given width across flats [mm]."""
    return CrossSection.circle(float(flats / np.sqrt(3.0)), 6)


def threaded_rod(low: float, high: float, clearance: float = 0.0) -> Manifold:
    """A right-handed 1/4-20 UNC rod between two heights [mm], its radius larger by clearance [mm]."""
    turns = range(int(np.floor(low / PITCH)) - 2, int(np.ceil(high / PITCH)) + 2)
    rows = np.array([(turn + z, r) for turn in turns for z, r in _PROFILE])
    minor = 0.5 * (MAJOR - 1.0825 * PITCH)
    radius = minor + clearance + rows[:, 1] * (0.5 * MAJOR - minor)
    angle = 2.0 * np.pi * np.arange(_AROUND) / _AROUND
    height = (rows[None, :, 0] + np.arange(_AROUND)[:, None] / _AROUND) * PITCH
    spread = np.broadcast_to(radius, height.shape)
    side = np.stack([spread * np.cos(angle)[:, None], spread * np.sin(angle)[:, None], height], axis=-1)
    ends = np.array([[0.0, 0.0, height[0, 0] + 0.5 * PITCH], [0.0, 0.0, height[0, -1] + 0.5 * PITCH]])
    vertices = np.concatenate([side.reshape(-1, 3), ends])
    return (
        from_triangles(vertices, _helix_faces(len(rows))).trim_by_plane((0, 0, 1), low).trim_by_plane((0, 0, -1), -high)
    )


def _helix_faces(rows: int) -> np.ndarray:
    """Triangles of a helical strip; at the seam, row k continues one turn higher."""
    turn = len(_PROFILE)

    def at(column: int, row: int) -> int:
        return column * rows + row if column < _AROUND else row + turn

    faces: list[tuple[int, int, int]] = []
    bottom, top = _AROUND * rows, _AROUND * rows + 1
    for column in range(_AROUND):
        last = rows - 1 if column < _AROUND - 1 else rows - 1 - turn
        for row in range(last):
            a, b = at(column, row), at(column + 1, row)
            c, d = at(column + 1, row + 1), at(column, row + 1)
            faces += [(a, b, c), (a, c, d)]
        faces.append((at(column + 1, 0), at(column, 0), bottom))
        if column < _AROUND - 1:
            faces.append((at(column, rows - 1), at(column + 1, rows - 1), top))
    faces += [(row, row + 1, bottom) for row in range(turn)]
    seam = [at(_AROUND - 1, row) for row in range(rows - 1 - turn, rows)]
    faces += [(upper, lower, top) for lower, upper in pairwise(seam)]
    faces.append((at(_AROUND - 1, rows - 1 - turn), rows - 1, top))
    return np.array(faces)
