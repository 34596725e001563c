"""The light that makes a dose nearly what is asked: the inverse of how projecting and exposing blur light."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from math import ceil, hypot, sqrt
from typing import Any, final

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.geometry import Grid
from vamgpu.kernels.lanes import copy_slices
from vamgpu.kernels.reduce import disc
from vamgpu.kernels.spectrum import ROWS, gather_rings, light_rings, most_lit_first
from vamgpu.kernels.update import multiply
from vamgpu.operators.compose import combine
from vamgpu.operators.polar import PolarGrid
from vamgpu.operators.projection import Projection
from vamgpu.operators.reductions import dot
from vamgpu.operators.ring_projection import RingProjection, against_rings, against_turns
from vamgpu.operators.scenarios import Scenarios
from vamgpu.operators.spectral import SpectralProjection, straight_passes

AT_LEAST = 8
"""Steps that are taken."""
RIM = 0.1
"""What voxels count that nobody judges."""
AT_ONCE = 32
"""Columns whose blur is computed at once."""
SHARES = (0.01, 0.02, 0.04, 0.08, 0.16, 0.32, 0.64)
"""``base`` over the greatest that A Aᵀ makes of light, from the least on that is safe."""
MOST, STEPS, SETTLED = 1.15, 40, 1e-3
"""Times that light may become brighter, steps that the brightest is looked for at most, and growth of a step, a share,
below which it counts as found."""
EVEN = 1e-3
"""Difference between rows up to which they count alike."""
FAINT = 1e-8
"""Share of what the most seen row shares, up to which a row lights nothing."""
DARK = 1e-6
"""Share of what the brightest column blurs into itself, up to which a column lights nothing that counts."""


@final
class GramInverse:
    """(A Aᵀ + base)⁻¹ for light [angle, r, z], of a projector A whose light is one pose, turned.

    A Aᵀ exposes light and projects its dose, of which voxels beyond the judged cylinder count ``rim``. At even angles
    it is, on rings, a matrix (columns × columns) for each angular frequency, of which this applies the inverses between
    two Fourier transforms; it costs about as much as the products of one projection on rings. What rows of pixels share
    along z counts by its greatest amount, and of several scenarios their sum does; where rows share less, `weigh_rows`
    makes up for it. Voxels are no rings: what sharp or fine pixels tell apart is more than rings know of. So ``base``
    grows until no light is made more than `MOST` times as bright as it was by what A Aᵀ + base and this make of it, as
    far as power steps on two slices tell.

    Args:
        operator: For which `against_gram` has no reason.
        reach: Radius of the judged cylinder, in voxels.
        rim: What voxels beyond it count, a share.
    """

    base: float
    device: Device

    def __init__(self, operator: Any, reach: float, rim: float = RIM) -> None:
        self.device = operator.device
        members = _members(operator)
        blur = np.sum([weight * _shared(each) * _blur(each, reach, rim) for weight, each in members], axis=0)
        angles, columns, rows = operator.range.shape
        wide = -(-columns // ROWS) * ROWS
        self._there = straight_passes(self.device, angles, columns)
        self._back = straight_passes(self.device, angles, columns, wide)
        self._weights = _row_weights(members)
        thin, greatest = _Thin(members, reach, rim), float(np.linalg.norm(blur[0], 2))
        self._take_room((angles, columns, 2), wide)
        for share in SHARES:
            self.base = share * greatest
            self._entries = _table(self.device, _inverses(blur, self.base) / np.float32(angles), wide)
            if thin.most(self) <= MOST:
                break
        self._take_room((angles, columns, rows), wide)
        self._shape = (angles, columns, rows)

    def weigh_rows(self, light: DeviceArray) -> None:
        """Multiply rows of projected dose by the greatest that rows share over what each does, in place.

        Applied to that, the inverse is the one for a ``base`` divided by as much: rows that light the last slices, or
        those by no more than a tail of the point spread, then move as far as others.

        Args:
            light: [angle, r, z].
        """
        if np.ptp(self._weights) > EVEN:
            self.device.launch(multiply, x=light, y=self._rows, out=light)

    @cached_property
    def _rows(self) -> DeviceArray:
        return self.device.upload(np.broadcast_to(self._weights, self._shape).astype(np.float32))

    def _take_room(self, light: tuple[int, int, int], wide: int) -> None:
        """Fields to work in for light of a shape."""
        (angles, columns, rows), empty = light, self.device.empty
        deep = rows + rows % 2
        even = (angles, columns, deep)
        self._even = None if rows == deep else (self.device.upload(np.zeros(even, np.float32)), empty(even))
        self._held, self._wide = empty(even), empty((angles, wide, deep))

    def __call__(self, light: DeviceArray, out: DeviceArray) -> None:
        """Apply it.

        Args:
            light: [angle, r, z]; an odd number of rows is filled up with a dark one.
            out: Takes the result; may be ``light``.
        """
        launch, even = self.device.launch, self._even
        source, sink = even or (light, out)
        if even is not None:
            launch(copy_slices, source=light, first=0, lanes=light, field=source)
        spectrum = self._there.run(-1.0, source, lambda number: (self._held, sink)[number % 2])
        launch(light_rings, light=spectrum, **self._entries, spectrum=self._wide)
        last = self._back.count % 2  # in turn, so that the last pass does not write what it reads
        self._back.run(1.0, self._wide, lambda number: (self._held, sink)[(number + last) % 2], last=sink)
        if even is not None:
            launch(copy_slices, source=sink, first=0, lanes=sink, field=out)


def against_gram(operator: Any) -> str:
    """Why there is no `GramInverse` of an operator.

    Args:
        operator: The projector, or scenarios of some.

    Returns:
        The reason; empty where there is one.
    """
    members = operator.operators if isinstance(operator, Scenarios) else (operator,)
    for each in members:
        if isinstance(each, RingProjection):
            continue
        if not isinstance(each, Projection) or each.footprint != "exact":
            return against_rings(each)
        if why := against_turns(each.motion):
            return why
    return ""


def _members(operator: Any) -> list[tuple[float, Any]]:
    """Projectors, and how often the blur of each counts at most."""
    if not isinstance(operator, Scenarios):
        return [(1.0, operator)]
    shares = np.abs(operator.mix)  # |Σ m d|² ≤ Σ|m| · Σ|m| d²
    return [
        (float(weight), each)
        for weight, each in zip(
            (shares.sum(axis=1, keepdims=True) * shares).sum(axis=0), operator.operators, strict=True
        )
        if weight
    ]


def _blur(operator: Projection | RingProjection, reach: float, rim: float) -> np.ndarray:
    """A Aᵀ for each angular frequency up to half of the angles, complex64 (frequency, column, column)."""
    grid, beam, angles = operator.grid, operator.beam, operator.motion.angles
    columns = beam.pixels[0]
    rings = _rings(grid, angles)
    shape = replace(beam, pixels=(columns, 2 * AT_ONCE))
    pose = SpectralProjection(rings, shape, operator.vessel, operator.device, square=grid.pitch)
    device, entries = pose.device, pose._entries
    counted = device.upload(np.broadcast_to(_counted(rings, reach, rim)[:, None], rings.shape).astype(np.float32))
    spectrum = device.empty(rings.shape)
    found = np.empty((angles // 2 + 1, columns, columns), np.complex64)
    for begin in range(0, columns, AT_ONCE):
        some = np.arange(begin, min(begin + AT_ONCE, columns))
        units = np.zeros((angles, columns, 2 * AT_ONCE), np.float32)
        units[:, some, 2 * (some - begin)] = 1.0
        lit = device.upload(units)
        device.launch(light_rings, light=lit, **entries, spectrum=spectrum)
        device.launch(multiply, x=spectrum, y=counted, out=spectrum)
        device.launch(gather_rings, spectrum=spectrum, **entries, light=lit)
        values = lit.numpy()[: len(found), :, : 2 * len(some)]
        found[:, :, some] = values[..., 0::2] + 1j * values[..., 1::2]
    return np.float32(0.5 * angles) * (found + found.conj().swapaxes(1, 2))


def _shared(operator: Projection | RingProjection) -> float:
    """The greatest that rows make of light along z, there and back."""
    return float(np.linalg.norm(operator.row_weights, 2)) ** 2


def _row_weights(members: list[tuple[float, Any]]) -> np.ndarray:
    """The greatest that rows share over what each does, (rows,); 0 for rows that light nothing."""
    shared = sum(weight * _shared(each) for weight, each in members)
    own = np.sum([weight * (each.row_weights.T @ each.row_weights).sum(axis=1) for weight, each in members], axis=0)
    return np.where(own > FAINT * own.max(), shared / np.maximum(own, FAINT * own.max()), 0.0)


class _Thin:
    """A Aᵀ on two slices; what rows share along z is as of the whole."""

    def __init__(self, members: list[tuple[float, Any]], reach: float, rim: float) -> None:
        self._members: list[tuple[float, Any]] = []
        for weight, each in members:
            (wide, deep, _), beam = each.grid.shape, replace(each.beam, pixels=(each.beam.pixels[0], 2))
            thin = Projection(replace(each.grid, shape=(wide, deep, 2)), beam, each.motion, each.vessel, each.device)
            self._members.append((weight * _shared(each) / _shared(thin), thin))
        first: Projection = self._members[0][1]
        shape = first.domain.shape
        counted = np.where(disc(shape[0], shape[1], reach), 1.0, rim)[:, :, None]
        self._counted = first.device.upload(np.broadcast_to(counted, shape).astype(np.float32))

    def most(self, inverse: GramInverse) -> float:
        """Times that what A Aᵀ + base and its inverse make of a light is as bright as that, at most."""
        thin = self._members[0][1]
        device = thin.device
        light, dose, part, blurred = (
            device.empty(space.shape) for space in (thin.range, thin.domain, thin.range, thin.range)
        )
        found = device.upload(np.random.default_rng(0).standard_normal(light.shape).astype(np.float32))
        grown = 1.0
        for step in range(STEPS):
            combine(1.0 / sqrt(dot(found, found)), found, 0.0, found, light)
            combine(inverse.base if step else 0.0, light, 0.0, light, blurred)  # what makes no dose is left behind
            for weight, each in self._members:
                each.T(light, out=dose)
                device.launch(multiply, x=dose, y=self._counted, out=dose)
                each(dose, out=part)
                combine(1.0, blurred, weight, part, blurred)
            inverse(blurred, found)
            before, grown = grown, sqrt(dot(found, found))
            if grown > MOST or (step >= AT_LEAST and grown - before < SETTLED * grown):
                break
        return grown


def _rings(grid: Grid, angles: int) -> PolarGrid:
    """Rings as wide as voxels, out to the corners."""
    count = ceil(0.5 * hypot(*grid.shape[:2]))
    return PolarGrid(-(-count // ROWS) * ROWS, 2 * AT_ONCE, grid.pitch, angles)


def _counted(rings: PolarGrid, reach: float, rim: float) -> np.ndarray:
    """What a cell counts: its area in voxels, times the samples of its ring, which its transforms leave out."""
    samples = np.concatenate([np.full(b.rings * b.samples, b.samples * rings.angles) for b in rings.belts])
    return rings.areas * samples * np.where(rings.places[0] <= reach * rings.pitch, 1.0, rim)


def _inverses(blur: np.ndarray, base: float) -> np.ndarray:
    """(blur + base)⁻¹ of each frequency; nothing for columns that light nothing."""
    own = np.real(np.diagonal(blur[0]))
    lit = np.flatnonzero(own > DARK * own.max())
    found = np.zeros_like(blur)
    some = blur[:, lit[:, None], lit]
    some[:, range(len(lit)), range(len(lit))] += np.float32(base)
    found[:, lit[:, None], lit] = np.linalg.inv(some)
    return found


def _table(device: Device, matrices: np.ndarray, wide: int) -> dict[str, Any]:
    """Matrices (frequency, column, column) as `light_rings` takes them, columns in place of cells."""
    count, columns, _ = matrices.shape
    filled = np.zeros((count, wide, wide), np.complex64)
    filled[:, :columns, :columns] = matrices
    tiles = wide // ROWS
    own = filled.reshape(count, tiles, ROWS, wide).transpose(0, 1, 3, 2)
    entries = np.stack([own.real, own.imag], axis=3)  # (frequency, tile, pair, part, cell)
    number = np.arange(tiles)
    table = np.stack([2 * ROWS * wide * number, number], axis=1)
    lit = np.full((count, tiles), wide)
    return {
        "entries": device.table(entries.ravel()),
        "greatest": float(np.abs(entries).max()),
        "tiles": device.table(table, "int32"),
        "lit": device.table(lit, "int32"),
        "order": device.table(most_lit_first(table, lit), "int32"),
        "mirrored": 0,
        "tf32": 0,
    }
