"""The light that gives nearly a required dose: the inverse of the blur of exposing and projecting."""

from __future__ import annotations

from dataclasses import replace
from math import ceil, hypot, inf, sqrt
from typing import Any, final

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.geometry import FULL_TURN
from vamgpu.kernels.pointwise import disc
from vamgpu.kernels.spectrum import ROWS, gather_rings, light_rings
from vamgpu.kernels.stack import put_slices
from vamgpu.kernels.update import multiply
from vamgpu.operators.compose import combine
from vamgpu.operators.polar import PolarGrid
from vamgpu.operators.projection import Projection
from vamgpu.operators.reductions import dot
from vamgpu.operators.ring_projection import RingProjection, uneven_reason, unsupported_reason
from vamgpu.operators.scenarios import Scenarios
from vamgpu.operators.spectral import SpectralProjection, table_arguments
from vamgpu.operators.transforms import straight_passes

RIM = 0.1  # weight of the voxels outside the judged cylinder
AT_ONCE = 32  # number of columns whose blur is computed at a time
SHARES = (0.01, 0.02, 0.04, 0.08, 0.16, 0.32, 0.64)
"""Initial ``base``, relative to the greatest gain of A Aᵀ on light; it grows until it is safe."""
MOST, STEPS, SETTLED = 1.4, 40, 0.01
"""Greatest gain in brightness before ``base`` grows, greatest number of steps of the search for it, and residual at
which the search ends."""
MIRRORED = 1e-5
"""Greatest difference of a blur from its mirror image, relative to its greatest entry, for mirrored light."""
DARK = 1e-6  # share of the brightest column's blur into itself, below which a column lights nothing relevant


@final
class GramInverse:
    """(A Aᵀ + base)⁻¹ for light [angle, r, z], for a projector A whose light at all angles is the same, rotated."""

    # A Aᵀ weights voxels beyond ``reach`` [voxels] by ``rim``. For even angles, it is a matrix (columns × columns) for
    # each angular frequency; their inverses are applied between two Fourier transforms. For rows, the greatest gain of
    # the blur along z is used. ``base`` grows until no light becomes more than `MOST` times brighter by (A Aᵀ + base)
    # and its inverse, and steps are scaled by ``pace``: an upper bound by Lanczos, on two slices.

    base: float

    def __init__(self, operator: Any, reach: float, rim: float = RIM) -> None:
        self.device: Device = operator.device
        members = _members(operator)
        blur = np.sum([weight * _shared(each) * _blur(each, reach, rim) for weight, each in members], axis=0)
        angles, columns, rows = operator.range.shape
        wide = -(-columns // ROWS) * ROWS
        self._there = straight_passes(self.device, angles, columns)
        self._back = straight_passes(self.device, angles, columns, wide)
        thin, greatest = _Thin(members, reach, rim), float(np.linalg.norm(blur[0], 2))
        self._take_room((angles, columns, 2), wide)
        most = inf
        for share in SHARES:
            self.base = share * greatest
            self._entries = _table(self.device, _inverses(blur, self.base) / np.float32(angles), wide)
            most = thin.most(self)
            if most <= MOST:
                break
        self.pace: float = 1.0 / max(most, 1.0)
        self._take_room((angles, columns, rows), wide)

    @staticmethod
    def unsupported_reason(operator: Any) -> str:
        """Reason why there is no inverse for a projector, or for scenarios of some; empty if there is one."""
        for each in operator.operators if isinstance(operator, Scenarios) else (operator,):
            if isinstance(each, RingProjection):
                continue
            if not isinstance(each, Projection):
                return unsupported_reason(each)
            if why := uneven_reason(each.motion):
                return why
        return ""

    def _take_room(self, light: tuple[int, int, int], wide: int) -> None:
        """Work fields for light of a shape."""
        (angles, columns, rows), empty = light, self.device.empty
        deep = rows + rows % 2
        even = (angles, columns, deep)
        self._even = None if rows == deep else (self.device.upload(np.zeros(even, np.float32)), empty(even))
        self._held, self._wide = empty(even), empty((angles, wide, deep))

    def __call__(self, light: DeviceArray, out: DeviceArray) -> None:
        """Apply the inverse to light [angle, r, z]; ``out`` may be ``light``. An odd number of rows gets a dark one."""
        launch, even = self.device.launch, self._even
        source, sink = even or (light, out)
        if even is not None:
            launch(put_slices, source=light, first=0, factor=1.0, keep=0, lanes=light, stack=source)
        spectrum = self._there.run(-1.0, source, lambda number: (self._held, sink)[number % 2])
        launch(light_rings, light=spectrum, **self._entries, spectrum=self._wide)
        last = self._back.count % 2  # alternating, because the last pass must not write to its source
        self._back.run(1.0, self._wide, lambda number: (self._held, sink)[(number + last) % 2], last=sink)
        if even is not None:
            launch(put_slices, source=sink, first=0, factor=1.0, keep=0, lanes=sink, stack=out)


def _members(operator: Any) -> list[tuple[float, Any]]:
    """Projectors, each with an upper bound of the weight of its blur."""
    if not isinstance(operator, Scenarios):
        return [(1.0, operator)]
    shares = np.abs(operator.mix)  # |Σ m d|² ≤ Σ|m| · Σ|m| d²
    weights = (shares.sum(axis=1, keepdims=True) * shares).sum(axis=0).tolist()
    return [(weight, each) for weight, each in zip(weights, operator.operators, strict=True) if weight]


def _blur(operator: Projection | RingProjection, reach: float, rim: float) -> np.ndarray:
    """A Aᵀ for each angular frequency up to half of the number of angles, complex64 (frequency, column, column)."""
    grid, beam, angles = operator.grid, operator.beam, operator.motion.angles
    columns = beam.pixels[0]
    count = ceil(0.5 * hypot(*grid.shape[:2]))
    rings = PolarGrid(-(-count // ROWS) * ROWS, 2 * AT_ONCE, grid.pitch, angles)  # out to the corners
    shape = replace(beam, pixels=(columns, 2 * AT_ONCE))
    pose = SpectralProjection(rings, shape, operator.vessel, operator.device, square=grid.pitch, motion=operator.motion)
    device, entries = pose.device, pose._entries
    away = rings.places[0] / grid.pitch
    counts = FULL_TURN * away * np.where(away <= reach, 1.0, rim)  # area · samples of the ring, for plain transforms
    counted = device.upload(np.broadcast_to(counts[:, None], rings.shape).astype(np.float32))
    spectrum = device.empty(rings.shape)
    found = np.empty((angles // 2 + 1, columns, columns), np.complex64)
    half = (columns + 1) // 2 if entries["mirrored"] else columns
    for begin in range(0, half, AT_ONCE):
        some = np.arange(begin, min(begin + AT_ONCE, half))
        units = np.zeros((angles, columns, 2 * AT_ONCE), np.float32)
        units[:, some, 2 * (some - begin)] = 1.0
        lit = device.upload(units)
        device.launch(light_rings, light=lit, **entries, spectrum=spectrum)
        device.launch(multiply, x=spectrum, y=counted, out=spectrum)
        device.launch(gather_rings, spectrum=spectrum, **entries, light=lit)
        values = lit.numpy()[: len(found), :, : 2 * len(some)]
        found[:, :, some] = values[..., 0::2] + 1j * values[..., 1::2]
    found[:, :, half:] = found[:, ::-1, : columns - half][:, :, ::-1].conj()
    return np.float32(0.5 * angles) * (found + found.conj().swapaxes(1, 2))


def _shared(operator: Projection | RingProjection) -> float:
    """The greatest gain of light along z through rows, forward and back."""
    return float(np.linalg.norm(operator.row_weights, 2)) ** 2


class _Thin:
    """A Aᵀ on two slices; the gain of rows along z is that of the whole."""

    def __init__(self, members: list[tuple[float, Any]], reach: float, rim: float) -> None:
        self._members: list[tuple[float, Any]] = []
        for weight, each in members:
            thin: Any
            if isinstance(each, RingProjection):
                thin = each._thinned(2)
            else:
                (wide, deep, _), beam = each.grid.shape, replace(each.beam, pixels=(each.beam.pixels[0], 2))
                grid = replace(each.grid, shape=(wide, deep, 2))
                thin = Projection(grid, beam, each.motion, each.vessel, each.device)
            self._members.append((weight * _shared(each) / _shared(thin), thin))
        first = self._members[0][1]
        shape = first.domain.shape
        counted = np.where(disc(shape[0], shape[1], reach), 1.0, rim)[:, :, None]
        self._counted = first.device.upload(np.broadcast_to(counted, shape).astype(np.float32))

    def most(self, inverse: GramInverse) -> float:
        """Lanczos' bound, including the residual, on the gain of (A Aᵀ + base) · inverse in brightness."""
        thin, device = self._members[0][1], self._members[0][1].device
        ahead, light, blurred, part = (device.empty(thin.range.shape) for _ in range(4))
        before = device.upload(np.zeros(thin.range.shape, np.float32))
        held = device.upload(np.random.default_rng(0).standard_normal(before.shape).astype(np.float32))
        dose, own, beside, bound = device.empty(thin.domain.shape), [], [0.0], 0.0
        for step in range(STEPS):
            inverse(held, light)
            beside[-1] = sqrt(max(dot(held, light), 1e-30))
            combine(1.0 / beside[-1], light, 0.0, light, light)
            combine(inverse.base, light, 0.0, light, blurred)
            for weight, each in self._members:
                each.T(light, out=dose)
                device.launch(multiply, x=dose, y=self._counted, out=dose)
                each(dose, out=part)
                combine(1.0, blurred, weight, part, blurred)
            combine(1.0 / beside[-1], held, 0.0, held, held)
            own.append(dot(blurred, light))
            combine(1.0, blurred, -own[-1], held, blurred)
            combine(1.0, blurred, -beside[-1] * (step > 0), before, blurred)
            before, held, blurred = held, blurred, before
            inverse(held, ahead)
            left = sqrt(max(dot(held, ahead), 0.0))
            values, vectors = np.linalg.eigh(np.diag(own) + np.diag(beside[1:], 1) + np.diag(beside[1:], -1))
            rest = left * abs(vectors[-1, -1])
            bound = float(values[-1] + rest)
            if values[-1] > MOST or rest < SETTLED:
                break
            beside.append(left)
        return bound


def _inverses(blur: np.ndarray, base: float) -> np.ndarray:
    """(blur + base)⁻¹ of each frequency; 0 for columns that light nothing."""
    own, found = np.real(np.diagonal(blur[0])), np.zeros_like(blur)
    lit = np.flatnonzero(own > DARK * own.max())
    first, last = lit[0], lit[-1] + 1
    ends = blur[[0, 1, -1]]
    mirrored = np.abs(ends - ends[:, ::-1, ::-1].conj()).max() <= MIRRORED * np.abs(ends).max()
    if mirrored:
        first = min(first, len(own) - last)
        last = len(own) - first
    for begin in range(0, len(blur), AT_ONCE):
        some = slice(begin, begin + AT_ONCE), slice(first, last), slice(first, last)
        found[some] = _mirrored_inverse(blur[some], base) if mirrored else _inverse(blur[some], base)
    return found


def _inverse(matrices: np.ndarray, base: float) -> np.ndarray:
    """(matrix + base)⁻¹ of each."""
    return np.linalg.inv(matrices + np.float32(base) * np.eye(matrices.shape[1], dtype=np.float32))


def _mirrored_inverse(matrices: np.ndarray, base: float) -> np.ndarray:
    """`_inverse` of Hermitian matrices that are conjugated by mirroring rows and columns: a quarter of the work."""
    # they are real for the sums of mirrored columns and i times their differences
    count = matrices.shape[1]
    pairs, some = count // 2, (count + 1) // 2
    own, mirror = matrices[:, :some, :some], matrices[:, :some, ::-1][:, :, :some]
    whole, rest = own + mirror, (own - mirror)[:, :, :pairs]
    real = np.empty(matrices.shape, np.float32)
    real[:, :some, :some], real[:, :some, some:] = np.real(whole), -np.imag(rest)
    real[:, some:, :some], real[:, some:, some:] = np.imag(whole)[:, :pairs], np.real(rest)[:, :pairs]
    middle = slice(pairs, some)  # a column without a pair, or none
    real[:, middle] *= np.float32(sqrt(0.5))
    real[:, :, middle] *= np.float32(sqrt(0.5))
    real = _inverse(real, base)
    real[:, middle] *= np.float32(sqrt(2.0))
    real[:, :, middle] *= np.float32(sqrt(2.0))
    of_pairs = np.zeros((2, len(matrices), some, some), np.complex64)  # what each column gives to its own, and its mate
    for sign, found in zip((1.0, -1.0), of_pairs, strict=True):
        found += real[:, :some, :some]
        found[:, :, :pairs] -= 1j * sign * real[:, :some, some:]
        found[:, :pairs] += 1j * real[:, some:, :some]
        found[:, :pairs, :pairs] += sign * real[:, some:, some:]
    inverse = np.empty_like(matrices)
    inverse[:, :some, :some], inverse[:, :some, ::-1][:, :, :some] = 0.5 * of_pairs
    inverse[:, some:] = inverse[:, :pairs][:, ::-1, ::-1].conj()
    return inverse


def _table(device: Device, matrices: np.ndarray, wide: int) -> dict[str, Any]:
    """Matrices (frequency, column, column) in the form of `light_rings`, with columns in place of cells."""
    count, columns, _ = matrices.shape
    filled = np.zeros((count, wide, wide), np.complex64)
    filled[:, :columns, :columns] = matrices
    tiles = wide // ROWS
    own = filled.reshape(count, tiles, ROWS, wide).transpose(0, 1, 3, 2)
    entries = np.stack([own.real, own.imag], axis=3)  # (frequency, tile, pair, part, cell)
    number = np.arange(tiles)
    table = np.stack([2 * ROWS * wide * number, number], axis=1)
    lit = np.full((count, tiles), wide)
    return table_arguments(device, device.table(entries.ravel()), float(np.abs(entries).max()), table, lit)
