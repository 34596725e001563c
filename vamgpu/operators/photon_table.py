"""What the scattered light of one angle leaves on rings, counted with photons."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from math import ceil, sqrt
from typing import Any, Protocol, runtime_checkable

import numpy as np

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, OutOfMemory
from vamgpu.geometry import FULL_TURN, Beam
from vamgpu.kernels.photons import UNITS, WAYS, photons
from vamgpu.kernels.spectrum import ROWS
from vamgpu.operators.polar import PolarGrid, WritesPose

QUANTILES = 1 << 12
RAYS = 64
"""Rays of a column, each of an equal part of its light."""
ITEMS = 1 << 12
"""Items of a launch, which follow their photons one after another."""
SEGMENTS = 1 << 14
"""Most segments of a photon."""
TALLY = 1 << 28
"""Bytes of the tally of some columns."""
EXACT_LAGS, GROWTH = 4, 1.25
"""Bins along z: one for each of the nearest slices, then each this much farther than the one before."""


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
    def nbytes(self) -> int:
        """Memory of both halves of the photons."""
        return 8 * (self.beam.pixels[0] - self.half) * int(self.rings[-1].sum()) * self.slices_of_bins.size

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

    def fluence(self, device: Device, seed: int) -> np.ndarray:
        """Fluence rate of scattered light in cells for an irradiance of 1 in one slice, (columns, cells, bins), by half
        of the photons.
        """
        return np.concatenate(list(self._counted(getattr(device, "members", (device,))[0], seed)))

    def _counted(self, device: Device, seed: int) -> Iterator[np.ndarray]:
        rays, rings, bins = self._rays(), self.rings, self.slices_of_bins
        cells = int(rings[-1].sum())
        tables = {
            "faces": [[face.radius, face.inner_index, face.outer_index, 0.0] for face in reversed(self.vessel.faces)],
            "cosines": self.scatterer.cosines(QUANTILES),
            "ways": [[np.cos(way), np.sin(way)] for way in FULL_TURN * np.arange(WAYS) / WAYS],
        }
        given: dict[str, Any] = {name: device.table(np.array(table)) for name, table in tables.items()}
        given |= {"rings": device.table(rings, "int32"), "lags": device.table(self.lags, "int32")}
        given |= {"extinction": self.extinction, "albedo": self.scatterer.coefficient / self.extinction}
        given |= {
            "per_ring": 1.0 / self.grid.pitch,
            "per_slice": 0.0 if self.beam.flat else 1.0 / self.grid.slice_pitch,
        }
        scale = self.beam.pitch / (np.repeat(self.areas, rings[:, 1])[:, None] * bins * UNITS)
        at_once = max(TALLY // (8 * cells * bins.size), 1)
        for first in range(0, len(rays), at_once):
            some = rays[first : first + at_once]
            tally = device.table(np.zeros((len(some), cells, bins.size, 2)), "uint32")
            wanted = max(0.5 * self.photons / len(rays), RAYS)  # from each ray of a column, one at least
            each = ceil(wanted * len(some) / ITEMS)
            ends = [device.empty((ITEMS,), np.dtype(np.uint32), table=True) for _ in range(2)]
            device.launch(photons, rays=device.table(some), **given, first=0, each=each, most=SEGMENTS,
                          seed=(seed * len(rays) + first) & 0x7FFFFFFF, absorbed=ends[0], escaped=ends[1],
                          tally=tally)  # fmt: skip
            low, high = np.moveaxis(tally.numpy().astype(np.float64), -1, 0)
            if (ended := sum(int(each.numpy().sum(dtype=np.int64)) for each in ends)) < 0.999 * ITEMS * each:
                raise BadInput(
                    f"{ended} of {ITEMS * each} photons ended within {SEGMENTS} collisions; expected 99.9 %: a resin "
                    f"with {self.scatterer.coefficient:g} /mm of scattering needs more absorption, or a smaller vial"
                )
            yield ((low + 2.0**32 * high) * (scale * len(some) / (ITEMS * each))).astype(np.float32)

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
    noise: float  # root mean square of its dose for random frames, of the greatest


@lru_cache(maxsize=1)
def scattered_light(count: PhotonCount, device: Device, tolerance: float, seed: int) -> ScatteredLight:
    """The terms of what two halves of the photons count, as many as differ from it by a tolerance."""
    if hasattr(os, "sysconf") and count.nbytes > os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"):
        raise OutOfMemory(f"the photons of each pixel of a row, on rings and along z, take {count.nbytes / 1e9:.0f} GB,"
                          " more than this machine has: use a coarser grid, or wider pixels")  # fmt: skip
    first, second = (count.fluence(device, 2 * seed + half) for half in range(2))
    slices = count.slices_of_bins
    noise = _noise(count, first @ slices, second @ slices)
    weight, area = np.sqrt(slices), np.repeat(count.areas, count.rings[:, 1])
    gram = sum(np.einsum("cb,cd->bd", a * area[:, None], b, dtype=np.float64, optimize=True)
               for a, b in zip(first, second, strict=True)) * np.outer(weight, weight)  # fmt: skip
    power, vectors = np.linalg.eigh(0.5 * (gram + gram.T))  # of both halves, whose noise is not the same
    power, vectors = np.maximum(power[::-1], 0.0), vectors[:, ::-1]
    terms = 1 + int(np.count_nonzero(np.cumsum(power)[:-1] < (1.0 - tolerance**2) * power.sum()))
    mean = first
    mean += second
    patterns = np.moveaxis(mean @ (0.5 * weight[:, None] * vectors[:, :terms]).astype(np.float32), -1, 0)
    return ScatteredLight(patterns, (vectors[:, :terms] / weight[:, None]).T[:, count.lags], noise)


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
        light = self.light.T.reshape(ROWS, shape[0], shape[1] // ROWS, -1).transpose(1, 2, 0, 3).reshape(*shape, -1)

        def write(first: int, factor: float, out: Any) -> None:
            some = light[..., first - self.half : first - self.half + out.shape[2]]
            pose = np.pad(some, ((0, 0), (0, 0), (0, out.shape[2] - some.shape[2])))
            pose[..., 0] *= factor
            device.put(pose, out)

        return write


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
