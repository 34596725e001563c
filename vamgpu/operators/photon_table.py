"""Scattered light of one angle on rings, counted with photons."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import ceil, log2, sqrt
from typing import Any, Protocol, runtime_checkable

import numpy as np

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, OutOfMemory
from vamgpu.geometry import FULL_TURN, Beam
from vamgpu.kernels.photon_bins import sum_bins
from vamgpu.kernels.photons import UNITS, WAYS, photons
from vamgpu.kernels.spectrum import ROWS
from vamgpu.operators.polar import PolarGrid, WritesPose, writes_stored

QUANTILES = 1 << 12
RAYS = 64  # rays of a column, each of an equal part of its light
ITEMS, MOST_ITEMS = 1 << 12, 1 << 17
"""Least and greatest number of items of a launch, which follow their photons one after another."""
OWN = 8  # photons of an item, where there are enough
SEGMENTS = 1 << 14  # greatest number of segments of a photon
TALLY = 1 << 28  # bytes of the tally of some columns
EXACT_LAGS, GROWTH = 4, 1.25  # bins along z: one per slice near 0, then growing by a factor
SAMPLED = 24  # least number of columns from which the profiles along z are chosen


@runtime_checkable
class Scatterer(Protocol):
    """A resin that scatters, such as `vamgpu.optics.scattering.Scattering`."""

    @property
    def coefficient(self) -> float:
        """Scattering events per length [1/mm]."""
        ...

    def cosines(self, count: int) -> np.ndarray:
        """Cosines of the scattering angle at even quantiles, (count + 1,)."""
        ...


@dataclass(frozen=True)
class PhotonCount:
    """Photons to follow: the light of a beam in a round vessel, on rings."""

    grid: PolarGrid
    beam: Beam
    vessel: Any
    scatterer: Scatterer
    photons: int

    @property
    def half(self) -> int:
        """The first column that is counted; columns before it are mirror images."""
        return self.beam.pixels[0] // 2

    @property
    def extinction(self) -> float:
        """Collisions per length [1/mm]."""
        return self.scatterer.coefficient + self.vessel.absorption

    @property
    def rings(self) -> np.ndarray:
        """First cell and number of cells of each ring, (rings, 2)."""
        count = np.concatenate([np.full(band.rings, band.samples * self.grid.angles) for band in self.grid.bands])
        return np.stack([np.cumsum(count) - count, count], axis=1)

    @property
    def least(self) -> int:
        """Smallest number of photons that are followed."""
        return 2 * ITEMS * ceil(RAYS * (self.beam.pixels[0] - self.half) / ITEMS)

    @property
    def areas(self) -> np.ndarray:
        """Area of a cell of each ring [mm²], (rings,)."""
        ring = np.arange(self.grid.rings)
        return FULL_TURN * (ring + 0.5) * self.grid.pitch**2 / self.rings[:, 1]

    @property
    def lags(self) -> np.ndarray:
        """Bin of each distance along z [slices], (lags,): a single one if light is the same at every height."""
        if self.beam.flat:
            return np.zeros(1, int)
        found = [0]
        while len(found) < self.grid.slices:
            wide = max(round((GROWTH - 1.0) * len(found)), 1) if len(found) > EXACT_LAGS else 1
            found += [found[-1] + 1] * wide
        return np.array(found[: self.grid.slices])

    @property
    def slices_of_bins(self) -> np.ndarray:
        """Number of slices in each bin, above and below, (bins,)."""
        return np.bincount(self.lags, np.where(np.arange(self.lags.size), 2.0, 1.0))

    def light(self, device: Device, seed: int, basis: np.ndarray, every: int = 1) -> tuple[np.ndarray, np.ndarray]:
        """Fluence rates in cells of light of 1 in a slice: (columns, cells), and by terms (columns, cells, terms)."""
        rays, rings, bins = self._rays[::every], self.rings, self.slices_of_bins.size
        cells, columns = int(rings[-1].sum()), len(rays)
        launches = ceil(columns / max(TALLY // (8 * cells * bins), 1))
        rays = np.pad(rays, ((0, -columns % launches), (0, 0), (0, 0)))  # columns without photons fill the last launch
        given, at_once = self._tables(device), len(rays) // launches
        wanted = max(0.5 * self.photons / columns, RAYS) * at_once  # one photon at least from each ray
        items = int(min(max(2.0 ** int(log2(wanted / OWN)), ITEMS), MOST_ITEMS))
        each = ceil(wanted / items)
        factor = self.beam.pitch / UNITS * at_once / (items * each) / np.repeat(self.areas, rings[:, 1])
        given_bins = {"factor": device.table(factor), "basis": device.table(basis)}
        tally = device.table(np.zeros((at_once, cells, bins, 2)), "uint32")
        sums = [device.empty((at_once, cells, *rest), table=True) for rest in ((), basis.shape[1:])]
        ends = [device.empty((items,), np.dtype(np.uint32), table=True) for _ in range(2)]
        whole, light = (np.empty((len(rays), *some.shape[1:]), np.float32) for some in sums)
        for first in range(0, len(rays), at_once):
            some = slice(first, first + at_once)
            device.launch(photons, rays=device.table(rays[some]), **given, first=0, each=each, most=SEGMENTS,
                          seed=(seed * len(rays) + first) & 0x7FFFFFFF, absorbed=ends[0], escaped=ends[1],
                          tally=tally)  # fmt: skip
            ended = sum(int(end.numpy().sum(dtype=np.int64)) for end in ends)
            if ended < 0.999 * items * each:
                raise BadInput(f"{ended} of {items * each} photons ended within {SEGMENTS} collisions; expected 99.9 %:"
                               f" a resin with {self.scatterer.coefficient:g} /mm of scattering needs more absorption, "
                               "or a smaller vial")  # fmt: skip
            device.launch(sum_bins, tally=tally, **given_bins, whole=sums[0], light=sums[1])
            whole[some], light[some] = (each.numpy() for each in sums)
        return whole[:columns], light[:columns]

    def _tables(self, device: Device) -> dict[str, Any]:
        """Arguments of `photons` that are the same for all columns."""
        tables = {
            "faces": [[face.radius, face.inner_index, face.outer_index, 0.0] for face in reversed(self.vessel.faces)],
            "cosines": self.scatterer.cosines(QUANTILES),
            "ways": [[np.cos(way), np.sin(way)] for way in FULL_TURN * np.arange(WAYS) / WAYS],
        }
        given: dict[str, Any] = {name: device.table(np.array(table)) for name, table in tables.items()}
        given |= {"rings": device.table(self.rings, "int32"), "lags": device.table(self.lags, "int32")}
        given |= {"extinction": self.extinction, "albedo": self.scatterer.coefficient / self.extinction}
        return given | {
            "per_ring": 1.0 / self.grid.pitch,
            "per_slice": 0.0 if self.beam.flat else 1.0 / self.grid.slice_pitch,
        }

    @cached_property
    def _rays(self) -> np.ndarray:
        """`vamgpu.kernels.photons.Rays` of the columns from `half` on."""
        columns, beam = np.arange(self.half, self.beam.pixels[0]), self.beam
        place = _profile(sqrt(beam.fill), beam.sigma, (np.arange(RAYS) + 0.5) / RAYS)
        u = (columns[:, None] - 0.5 * (beam.pixels[0] - 1) + place) * beam.pitch
        chords = self.vessel.chords(u)
        cosine, sine, half = np.cos(chords.angle), np.sin(chords.angle), 0.5 * chords.length
        across, along = chords.p * cosine + half * sine, chords.p * sine - half * cosine
        share = -np.expm1(-self.extinction * chords.length)
        weight = chords.transmittance * share * self.scatterer.coefficient / self.extinction
        none = np.zeros_like(u)
        return np.stack([-along, across, -cosine, -sine, none, share, weight, none], axis=-1)


def _profile(width: float, sigma: float, share: np.ndarray) -> np.ndarray:
    """Quantiles of a box of a width blurred by a point spread [columns]."""
    from scipy.special import ndtr

    place = np.linspace(-0.5 * width - 6.0 * sigma, 0.5 * width + 6.0 * sigma, 8193)
    if sigma < 1e-6:
        return (share - 0.5) * width

    def summed(x: np.ndarray) -> np.ndarray:
        return x * ndtr(x) + np.exp(-0.5 * x * x) / sqrt(FULL_TURN)

    light = (summed((place + 0.5 * width) / sigma) - summed((place - 0.5 * width) / sigma)) * sigma / width
    return np.interp(share, light, place)


@dataclass(frozen=True, eq=False)
class ScatteredLight:
    """Scattered light as a sum of patterns on rings times profiles along z."""

    patterns: np.ndarray  # (terms, columns from the half on, cells), for an irradiance of 1
    profiles: np.ndarray  # (terms, lags)
    noise: float  # root mean square error of its dose for random frames, over the greatest


@lru_cache(maxsize=1)
def scattered_light(count: PhotonCount, device: Device, tolerance: float, seed: int) -> ScatteredLight:
    """The light of two halves of the photons, in the fewest terms within a tolerance; their difference is the noise."""
    counter, columns = getattr(device, "members", (device,))[0], count.beam.pixels[0] - count.half
    basis = _profiles(count, counter, tolerance, seed, max(columns // SAMPLED, 1))
    needed = 16 * columns * int(count.rings[-1].sum()) * (1 + basis.shape[1])
    if hasattr(os, "sysconf") and needed > os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"):
        raise OutOfMemory(f"the scattered light of each pixel of a row on rings takes {needed / 1e9:.0f} GB, more than"
                          " this machine has: use a coarser grid, or wider pixels")  # fmt: skip
    (first, light), (second, other) = (count.light(counter, 2 * seed + half, basis) for half in range(2))
    light += other
    patterns = np.ascontiguousarray(np.moveaxis(0.5 * light, -1, 0))
    return ScatteredLight(patterns, basis.T[:, count.lags], _noise(count, first, second))


def _profiles(count: PhotonCount, device: Device, tolerance: float, seed: int, every: int) -> np.ndarray:
    """Profiles along z (bins, terms) that give the light of some columns within the tolerance."""
    weight, area = np.sqrt(count.slices_of_bins), np.repeat(count.areas, count.rings[:, 1])
    first, second = (count.light(device, 2 * seed + half, np.eye(weight.size), every)[1] for half in range(2))
    gram = sum(np.einsum("cb,cd->bd", a * area[:, None], b, dtype=np.float64, optimize=True)
               for a, b in zip(first, second, strict=True)) / np.outer(weight, weight)  # fmt: skip
    power, vectors = np.linalg.eigh(0.5 * (gram + gram.T))  # of both halves, whose noise is not the same
    power, vectors = np.maximum(power[::-1], 0.0), vectors[:, ::-1]
    terms = 1 + int(np.count_nonzero(np.cumsum(power)[:-1] < (1.0 - tolerance**2) * power.sum()))
    return vectors[:, :terms] / weight[:, None]


def _noise(count: PhotonCount, first: np.ndarray, second: np.ndarray) -> float:
    """Difference of the doses of two counts (columns, cells) for random frames, halved, over the greatest dose."""
    angles, columns = count.grid.angles, count.beam.pixels[0]
    lit = np.random.default_rng(0).integers(0, 2, (angles, columns)).astype(np.float32)
    waves = np.fft.fft(lit, axis=0)
    right, left = waves[:, count.half :], waves[:, count.half - 1 + columns % 2 :: -1] if count.half else waves[:, :0]
    apart, greatest = list[np.ndarray](), 0.0
    for begin, cells in count.rings[: max(int(count.vessel.lit_radius / count.grid.pitch), 1)].tolist():
        doses = []
        for table in (first, second):
            spectrum = np.fft.fft(table[:, begin : begin + cells], axis=1).T
            turn = np.arange(cells) % angles
            skip = columns % 2
            total = (spectrum * right[turn]).sum(axis=1)
            total += (np.conj(spectrum[:, skip:]) * left[turn][:, skip:]).sum(axis=1)
            doses.append(np.fft.ifft(total).real)
        apart.append(doses[0] - doses[1])
        greatest = max(greatest, 0.5 * float(np.max(doses[0] + doses[1])))
    return float(0.5 * np.sqrt(np.mean(np.concatenate(apart) ** 2)) / max(greatest, 1e-30))


@dataclass(frozen=True, eq=False)
class PhotonTile:
    """A pattern in `ROWS` rings, as a `PoseTile`; light of columns before ``half`` is its mirror image."""

    light: np.ndarray  # (columns from the half on, cells of `ROWS` rings)
    half: int
    arc: float  # turn [rad] of a frame

    @property
    def arcs(self) -> np.ndarray:
        return np.repeat([[self.arc], [0.0]], ROWS, axis=1)

    def is_mirrored(self, columns: int) -> bool:
        return columns // 2 == self.half

    def last(self, beam: Beam) -> int:
        return beam.pixels[0] - 1

    def pose(self, beam: Beam, shape: tuple[int, ...], device: Device) -> WritesPose:
        return writes_stored(self.light.T, self.half, shape, device)


def tiles_of(count: PhotonCount, pattern: np.ndarray, scale: float, arc: float) -> list[PhotonTile]:
    """The tiles of a pattern (columns, cells); rings beyond the resin repeat the last whole one inside."""
    whole, rings = max(int(count.vessel.inner_radius / count.grid.pitch + 1e-9), 1), count.rings
    begin, cells = rings[min(whole, len(rings)) - 1].tolist()
    last, tiles = pattern[:, begin : begin + cells], list[PhotonTile]()
    for ring in range(0, len(rings), ROWS):
        parts = [
            pattern[:, b : b + n] if k < whole else last[:, np.arange(n) * cells // n]
            for k, (b, n) in enumerate(rings[ring : ring + ROWS].tolist(), start=ring)
        ]
        tiles.append(PhotonTile(np.concatenate(parts, axis=1) * np.float32(scale), count.half, arc))
    return tiles
