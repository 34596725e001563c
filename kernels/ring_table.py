"""The table of a projection on rings: the light of one pose on the rings, by angular frequency."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated

import numpy as np

from vamgpu.kernels.footprint import share
from vamgpu.kernels.signature import Field, Integer, Real, Table, Tiling, kernel
from vamgpu.kernels.spectrum import ROWS, Spectrum

Feet = Annotated[np.ndarray, Table("float32", ("angle", "cell", "foot", "5"))]
"""Of each part of a cell: column that lights its middle, as a whole number and the rest; strength of its light; and the
widths of its trapezoid."""
PoseOut = Annotated[np.ndarray, Field(("angle", "cell", "z"), writes=True)]
Begins = Annotated[np.ndarray, Table("int32", ("sample",))]
"""First entry of a frequency in the tiles of frequencies k + j · angles, for each j."""
Arcs = Annotated[np.ndarray, Table("float32", ("2", "8"))]
"""Two arcs [rad] over which each of `ROWS` rings is averaged."""
EntriesOut = Annotated[np.ndarray, Table("float32", ("entry",), writes=True)]
EntriesInOut = Annotated[np.ndarray, Table("float32", ("entry",), writes=True, updates=True)]
Steps = Annotated[np.ndarray, Table("int32", ("tile", "8"))]
"""For each tile: first entry, pairs of columns, first ring, samples of a ring between two angles, m of its frequencies
k + m · angles, the tiles of the same m inward and outward or −1, and 0."""
Pivots = Annotated[np.ndarray, Table("float32", ("ring", "2"))]
"""Of the elimination along the radius, for even and odd frequencies."""
Peaks = Annotated[np.ndarray, Table("float32", ("frequency", "tile", "block"), writes=True)]


@kernel(over="pose", reach="all", cpu=Tiling(major=1, minor=0), gpu=Tiling(major=1, minor=4, group=(128, 1)))
def ring_pose(
    feet: Feet, first: Integer, columns: Integer, factor: Real, fill: Real, sigma: Real, pose: PoseOut
) -> None:  # fmt: skip
    """pose[angle, cell, z] = Σ over parts of the cell of strength × share of column first + z; 0 from ``columns``."""
    # factor: of the first column. fill, sigma: of a pixel and of its point spread [columns].
    column = first + np.arange(pose.shape[2])
    pose[...] = 0.0
    for part in range(feet.shape[2]):
        whole, rest, strength, a, b = (each[..., None] for each in np.moveaxis(feet[:, :, part], -1, 0))
        pose += strength * share(whole - column + rest, a, b, fill, sigma)
    pose[..., columns:] = 0.0
    pose[..., 0] *= factor


@kernel(over="spectrum", cpu=Tiling(major=1, minor=0), gpu=Tiling(major=1, minor=1, group=(128, 1)))
def ring_entries(spectrum: Spectrum, begins: Begins, arcs: Arcs, columns: Integer, entries: EntriesOut) -> None:
    """Write at most ``columns`` (even) columns of a spectrum of real samples into a table, over the sample count."""
    # Neighboring columns are real and imaginary part of one complex number before the transform; F(κ) and F(−κ) give
    # both of them again. A mean over an arc multiplies a wave by sin(x) / x, x = κ · arc / 2.
    angles, samples, width = len(spectrum), len(begins), spectrum.shape[2]
    n = angles * samples
    each = (spectrum[..., 0::2] + 1j * spectrum[..., 1::2]).reshape(angles, samples, ROWS, -1)
    found = each.swapaxes(0, 1).reshape(n, ROWS, -1)  # by frequency
    mirrored = np.conj(found[-np.arange(n) % n])
    parted = np.stack([0.5 * (found + mirrored), -0.5j * (found - mirrored)], axis=-1).reshape(n, ROWS, width)
    wave = np.minimum(np.arange(n), n - np.arange(n))
    left = np.prod(np.sinc(arcs / (2.0 * np.pi) * wave[:, None, None]), axis=1) / n
    parted = (parted * left[..., None]).swapaxes(1, 2)
    kept, shown = angles // 2 + 1, min(int(columns), width)
    rows = entries.reshape(kept, -1)
    for j, begin in enumerate(begins.tolist()):
        own, some = of_tile(rows, begin, shown), parted[j * angles : j * angles + kept, :shown]
        own[:, :, 0], own[:, :, 1] = np.real(some), np.imag(some)


@kernel(over="peaks")
def ring_coefficients(
    steps: Steps, pivots: Pivots, angles: Integer, own: Real, beside: Real, entries: EntriesInOut, peaks: Peaks
) -> None:  # fmt: skip
    """Replace entries of samples by those of spline coefficients; peaks = greatest entry of `ROWS` pairs of columns."""
    # own, beside: weights of a coefficient in its own sample and either next one. A track of tiles is eliminated along
    # the radius, outward and back; then each frequency is divided by its weight along the angle.
    rows = entries.reshape(len(peaks), -1)
    peaks[...] = 0.0
    for head in np.flatnonzero(steps[:, 5] < 0).tolist():
        track = [head]
        while (outward := int(steps[track[-1], 6])) >= 0:
            track.append(outward)
        kappa = np.arange(len(peaks)) + int(steps[head, 4]) * int(angles)
        pivot = pivots[:, kappa % 2][:, :, None, None]  # (ring, frequency, 1, 1)
        tiles = [of_tile(rows, int(steps[tile, 0]), int(steps[tile, 1])) for tile in track]
        rings = [
            (steps[number, 2] + i, tile[..., i])
            for number, tile in zip(track, tiles, strict=True) for i in range(ROWS)
        ]  # fmt: skip
        for (inner, before), (_, values) in pairwise(rings):
            columns = min(before.shape[1], values.shape[1])
            values[:, :columns] -= beside / pivot[inner] * before[:, :columns]
        beyond = rings[-1][1][:, :0]
        for ring, values in reversed(rings):
            columns = min(beyond.shape[1], values.shape[1])
            values[:, :columns] -= beside * beyond[:, :columns]
            values /= pivot[ring]
            beyond = values
        for number, tile in zip(track, tiles, strict=True):
            wave = own + 2.0 * beside * np.cos(2.0 * np.pi * kappa / (angles * steps[number, 3]))
            tile /= wave[:, None, None, None]
            greatest = np.hypot(tile[:, :, 0], tile[:, :, 1]).max(axis=2)
            blocks = greatest.reshape(len(peaks), -1, ROWS).max(axis=2, initial=0.0)
            peaks[:, number, : blocks.shape[1]] = blocks


def of_tile(rows: np.ndarray, begin: int, pairs: int) -> np.ndarray:
    """Entries (frequency, entry) of a tile, (frequency, pair, 2, `ROWS`)."""
    return rows[:, begin : begin + 2 * ROWS * pairs].reshape(len(rows), pairs, 2, ROWS)
