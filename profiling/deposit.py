"""Scatter the energy that every ray loses onto the voxels: an energy balance, unlike the gathering operators."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vamgpu.errors import BadInput
from vamgpu.geometry import Chords, Vessel, counts, positive
from vamgpu.optics.inputs import Floats, as_offsets


def deposit(
    vessel: Vessel,
    u: ArrayLike,
    power: ArrayLike,
    angles: ArrayLike,
    shape: tuple[int, int],
    pitch: float,
    step: float = 0.25,
) -> Floats:
    """Power absorbed per volume [mW/mm³] in a slice of voxels, (nx, ny), over the whole disc. Raises `BadInput`."""
    # u: columns [mm], (columns,).  power: of each column at each pose [mW], (poses, columns).  angles: poses [rad].
    # pitch: of voxels [mm].  step: longest segment [pitches]. Beer-Lambert's law is exact over each segment, whose
    # power is divided among the four voxels around its middle: sum(result) · pitch³ = sum(power · transmittance · (1 −
    # exp(−absorption · length))) if the grid covers the resin. Clear resin counts 1 per mm of path.
    columns, powers, poses = as_offsets("u", u), as_offsets("power", power), as_offsets("angles", angles)
    pitch, step = positive("pitch [mm]", pitch), positive("step [pitches]", step)
    if columns.ndim != 1 or poses.ndim != 1 or powers.shape != (poses.size, columns.size):
        raise BadInput(
            f"u, angles and power have the shapes {columns.shape}, {poses.shape} and {powers.shape}; "
            "expected (columns,), (angles,) and (angles, columns)"
        )
    nx, ny = counts("shape", shape, 2)
    lab_x, lab_y, absorbed = _segments(vessel.chords(columns), vessel.absorption, step * pitch)
    energy = np.zeros((nx, ny))
    for theta, row in zip(poses, powers, strict=True):
        cos_t, sin_t = np.cos(theta), np.sin(theta)
        x, y = -lab_x * sin_t - lab_y * cos_t, lab_x * cos_t - lab_y * sin_t
        energy += _scatter(x / pitch, y / pitch, absorbed * row[:, None], (nx, ny))
    return energy / pitch**3


def _segments(chords: Chords, absorption: float, longest: float) -> tuple[Floats, Floats, Floats]:
    """Middle of each segment in the fixed frame [mm], and the absorbed share of its column's power."""
    count = max(1, int(np.ceil(np.max(chords.length, initial=0.0) / longest)))
    edges = chords.length[:, None] * np.linspace(0.0, 1.0, count + 1)
    size = np.diff(edges, axis=1)
    share = np.exp(-absorption * edges[:, :-1]) * -np.expm1(-absorption * size) if absorption > 0 else size
    t = 0.5 * (edges[:, 1:] + edges[:, :-1]) - 0.5 * chords.length[:, None]
    cos_d, sin_d = np.cos(chords.angle)[:, None], np.sin(chords.angle)[:, None]
    p = chords.p[:, None]
    return p * cos_d - t * sin_d, p * sin_d + t * cos_d, chords.transmittance[:, None] * share


def _scatter(x: Floats, y: Floats, value: Floats, shape: tuple[int, int]) -> Floats:
    """Divide values among the four voxels around each position, given in voxels from the middle of the grid."""
    across, along = x + 0.5 * (shape[0] - 1), y + 0.5 * (shape[1] - 1)
    i, j = np.floor(across).astype(np.int64), np.floor(along).astype(np.int64)
    fx, fy = across - i, along - j
    total = np.zeros(shape[0] * shape[1])
    for di, wx in ((0, 1.0 - fx), (1, fx)):
        for dj, wy in ((0, 1.0 - fy), (1, fy)):
            inside: NDArray[np.bool_] = (i + di >= 0) & (i + di < shape[0]) & (j + dj >= 0) & (j + dj < shape[1])
            place = (i + di)[inside] * shape[1] + (j + dj)[inside]
            total += np.bincount(place, (value * wx * wy)[inside], minlength=total.size)
    return total.reshape(shape)
