"""Periodic structures in the size of a vial: gyroid, cubic lattice, pentamode.

Source: A. Orth et al., Automatic exposure volumetric additive manufacturing, Fig. 5b-d.
"""

from __future__ import annotations

from itertools import product

import numpy as np
import numpy.typing as npt
from manifold3d import Manifold

from vamgpu.targets.shapes.csg import Point, along, from_triangles, polygon, rod, to_solid, union
from vamgpu.targets.solid import Solid

Array = npt.NDArray[np.float64]


def gyroid_sphere(radius: float = 6.0, cell: float = 4.0, wall: float = 0.5, pitch: float = 0.125) -> Solid:
    """A sheet of nearly even thickness along the gyroid sin x cos y + sin y cos z + sin z cos x = 0, cut by a sphere.

    Args:
        radius: Radius of the sphere [mm].
        cell: Period of the gyroid [mm].
        wall: Thickness of the sheet [mm].
        pitch: Pitch of the sampling grid [mm].

    Returns:
        The sphere.
    """
    count = int(np.ceil(radius / pitch)) + 2
    axis = (np.arange(-count, count + 1, dtype=np.float64) + 0.5) * pitch
    field = 0.5 * wall - np.abs(_gyroid_distance(axis, cell, wall))
    sheet = _level_surface(field, pitch) ^ Manifold.sphere(radius, 128)
    # Fragments of the sheet that the sphere cuts off would float in the resin.
    largest = max(sheet.decompose(), key=lambda body: body.volume())
    return to_solid(largest.simplify(0.02 * pitch), "gyroid_sphere")


def cubic_lattice(cells: int = 5, cell: float = 1.8, strut: float = 0.5) -> Solid:
    """A cube of cells × cells × cells open cells with round struts.

    Args:
        cells: Number of cells along an edge.
        cell: Edge of a cell [mm].
        strut: Diameter of a strut [mm].

    Returns:
        The cube.
    """
    end = cells * cell
    bars = []
    for a, b in product(np.arange(cells + 1) * cell, repeat=2):
        bars += [
            rod((0.0, a, b), (end, a, b), 0.5 * strut, segments=24),
            rod((a, 0.0, b), (a, end, b), 0.5 * strut, segments=24),
            rod((a, b, 0.0), (a, b, end), 0.5 * strut, segments=24),
        ]
    corners = [Manifold.sphere(0.5 * strut, 24).translate((a, b, c)) for a, b, c in product((0.0, end), repeat=3)]
    return to_solid(union(bars + corners), "cubic_lattice")


def pentamode(cells: int = 3, cell: float = 3.2, touch: float = 0.13, middle: float = 0.6) -> Solid:
    """A diamond lattice whose bonds are double cones, thick in the middle, that meet in touch points.

    Args:
        cells: Number of cells along an edge.
        cell: Edge of the cubic diamond cell [mm].
        touch: Diameter of a bond at its ends [mm].
        middle: Diameter of a bond in its middle [mm].

    Returns:
        The lattice.
    """
    atoms, bonds = _diamond(cells)
    length = 0.25 * np.sqrt(3.0) * cell
    half_outline = [(0.0, 0.0), (0.5 * touch, 0.0), (0.5 * middle, 0.5 * length), (0.5 * touch, length), (0.0, length)]
    cone = Manifold.revolve(polygon(half_outline), 16)
    points: list[Point] = [(float(x), float(y), float(z)) for x, y, z in atoms * 0.25 * cell]
    struts = [along(cone, points[a], points[b]) for a, b in bonds]
    used = np.unique(bonds)
    joints = [Manifold.sphere(0.5 * touch, 12).translate(points[a]) for a in used]
    return to_solid(union(struts + joints), "pentamode")


def _diamond(cells: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Atoms (n, 3) in quarters of a cell and bonds (k, 2); atoms on fewer than two bonds are dropped."""
    face_centers = np.array([(0, 0, 0), (0, 2, 2), (2, 0, 2), (2, 2, 0)])
    corners = 4 * np.array(list(product(range(cells + 1), repeat=3)))
    even = (corners[:, None] + face_centers).reshape(-1, 3)
    atoms = np.concatenate([even, even + 1])
    atoms = atoms[(atoms <= 4 * cells).all(axis=1)]
    index = {tuple(atom): number for number, atom in enumerate(atoms.tolist())}
    steps = ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1))
    first = [atom for atom in index if (atom[0] % 2, atom[1] % 2, atom[2] % 2) == (0, 0, 0)]
    pairs = [(atom, (atom[0] + x, atom[1] + y, atom[2] + z)) for atom in first for x, y, z in steps]
    bonds = np.array([(index[a], index[b]) for a, b in pairs if b in index])
    while True:
        degree = np.bincount(bonds.ravel(), minlength=len(atoms))
        keep = (degree[bonds] >= 2).all(axis=1)
        if keep.all():
            return atoms, bonds
        bonds = bonds[keep]


def _gyroid_distance(axis: Array, cell: float, reach: float) -> Array:
    """Distance [mm] to the gyroid on the grid axis × axis × axis, accurate below reach: a Newton step and its rest."""
    scale = 2.0 * np.pi / cell
    phase = scale * axis
    value, gradient = _gyroid(phase[:, None, None], phase[None, :, None], phase[None, None, :])
    # The gradient vanishes only far from the surface, where any large value is acceptable.
    distance = value / np.sqrt(np.maximum(sum(part * part for part in gradient), 0.05))
    near = np.nonzero(np.abs(distance) < 1.5 * reach * scale)
    at = [phase[index] for index in near]
    value, gradient = _gyroid(*at)
    step = value / np.maximum(sum(part * part for part in gradient), 0.05)
    foot = [place - step * part for place, part in zip(at, gradient, strict=True)]
    rest, slope = _gyroid(*foot)
    rest = rest / np.sqrt(np.maximum(sum(part * part for part in slope), 0.05))
    distance[near] = step * np.sqrt(sum(part * part for part in gradient)) + rest
    return distance / scale


def _gyroid(x: Array, y: Array, z: Array) -> tuple[Array, tuple[Array, Array, Array]]:
    """The gyroid's function and its gradient."""
    (sx, sy, sz), (cx, cy, cz) = (np.sin(x), np.sin(y), np.sin(z)), (np.cos(x), np.cos(y), np.cos(z))
    return sx * cy + sy * cz + sz * cx, (cx * cy - sz * sx, cy * cz - sx * sy, cz * cx - sy * sz)


def _level_surface(field: Array, pitch: float) -> Manifold:
    """The body field > 0 on a centered grid, closed at the grid's border."""
    from skimage.measure import marching_cubes

    closed = np.pad(field, 1, constant_values=-abs(pitch))
    vertices, faces, _, _ = marching_cubes(closed, 0.0, gradient_direction="ascent")
    center = 0.5 * (np.array(closed.shape) - 1.0)
    body = from_triangles((vertices - center) * pitch, faces.astype(np.int64))
    return body if body.volume() > 0.0 else from_triangles((vertices - center) * pitch, faces[:, ::-1].astype(np.int64))
