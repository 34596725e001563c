"""Ten parts, from the library's generators, that are difficult in different ways."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from profiling.below_voxel import bracket
from vamgpu.targets import shapes
from vamgpu.targets.shapes import csg
from vamgpu.targets.solid import Solid

Maker = Callable[[float], Solid]
"""A part in pixels, from the radius about the axis that it may have."""


def scaled(make: Callable[[], Solid]) -> Maker:
    """A part of any size, scaled until ``size`` is its radius about the axis."""

    def fit(size: float) -> Solid:
        solid = make().centered()
        return Solid(solid.vertices * (size / solid.radius), solid.faces, solid.name)

    return fit


def bundled(name: str) -> Maker:
    """A bundled shape."""
    return scaled(lambda: shapes.build(name))


def screw_and_nut() -> Solid:
    """A screw standing beside its nut."""
    screw, nut = (shapes.build(name).centered() for name in ("screw", "nut"))
    low = 0.5 * (screw.height - nut.height)
    apart = 1.25 * 0.5 * (np.ptp(screw.vertices[:, 0]) + np.ptp(nut.vertices[:, 0]))
    placed = [(screw, 0.0, 0.0), (nut, apart, -low)]
    bodies = [csg.from_triangles(each.vertices + (x, 0.0, z), each.faces) for each, x, z in placed]
    return csg.to_solid(csg.union(bodies), "screw and nut")


def thin_walls(size: float) -> Solid:
    """Six walls on a plate, 1 to 6 pixels thick."""
    length, high = size, 0.8 * size
    walls = [csg.box((-0.77 * size, -0.5 * length, 0.0), (0.77 * size, 0.5 * length, 4.0))]
    gap = (1.5 * size - 21.0) / 5.0
    at = -0.75 * size
    for width in range(1, 7):
        walls.append(csg.box((at, -0.5 * length, 1.0), (at + width, 0.5 * length, high)))
        at += width + gap
    return csg.to_solid(csg.union(walls), "thin walls")


def bars(size: float) -> Solid:
    """Five square bars, 4 pixels wide, with gaps of 1 to 4 pixels between them, held at one end."""
    ends, at = [csg.box((-0.6 * size, -0.5 * size, 0.0), (0.6 * size, -0.5 * size + 4.0, 8.0))], -15.0
    for gap in (1.0, 2.0, 3.0, 4.0, 0.0):
        ends.append(csg.box((at, -0.5 * size + 1.0, 0.0), (at + 4.0, 0.7 * size, 8.0)))
        at += 4.0 + gap
    return csg.to_solid(csg.union(ends), "bars")


PARTS: dict[str, Maker] = {
    "boat": bundled("boat"),
    "gyroid": bundled("gyroid_sphere"),
    "pentamode": bundled("pentamode"),
    "screw and nut": scaled(screw_and_nut),
    "thin walls": thin_walls,
    "bars": bars,
    "text": scaled(bracket),
    "channel": bundled("crossing_channels"),
    "lattice": bundled("cubic_lattice"),
    "gear": bundled("gear_base"),
}


def write(name: str, size: float, pixel: float, path: Path) -> Solid:
    """Write a part of at most ``size`` pixels of radius as binary STL [mm]; return it."""
    made = PARTS[name](size).centered()
    solid = Solid(made.vertices * pixel, made.faces, name)
    corners = solid.vertices[solid.faces].astype("<f4")
    record = np.zeros(len(corners), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    record["corners"] = corners
    path.write_bytes(bytes(80) + len(corners).to_bytes(4, "little") + record.tobytes())
    return solid
