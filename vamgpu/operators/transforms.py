"""Fourier transforms of rings over the angles, pass after pass."""

from __future__ import annotations

from collections.abc import Callable
from math import prod
from typing import Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.geometry import FULL_TURN
from vamgpu.kernels.spectrum import AT_ONCE, FACTOR, ONE_SUM, factors, fourier, in_groups, is_even

MOST = 4  # largest number of passes
Place = tuple[int, int, int, int]
"""First sample, n, and steps a and b, as of `vamgpu.kernels.spectrum.RingBands`."""


class Passes:
    """Fourier transforms of rings, one pass after another."""

    # bands: (samples, rings, place in the source, in the sink).  radices: of the passes of each; chosen if left out.

    def __init__(
        self, device: Device, bands: list[tuple[int, int, Place, Place]], radices: list[tuple[int, ...]] | None = None
    ) -> None:
        self._device = device
        radices = radices or passes([n for n, *_ in bands], _fits(device))
        waves = [FULL_TURN * np.arange(n) / n for n, *_ in bands]
        self._waves = device.table(np.concatenate([np.stack([np.cos(w), np.sin(w)], axis=1) for w in waves]))
        self._tables = [self._pass(bands, radices, number) for number in range(len(radices[0]))]

    @property
    def count(self) -> int:
        """The number of passes."""
        return len(self._tables)

    def _pass(
        self, bands: list[tuple[int, int, Place, Place]], radices: list[tuple[int, ...]], number: int
    ) -> dict[str, Any]:
        """The arguments of one pass; the first reads where the source lies, all others where the sink does."""
        found, item, wave = [], 0, 0
        for (n, rings, source, sink), own in zip(bands, radices, strict=True):
            read = sink if number else source
            found.append((item, n, rings, own[number], prod(own[:number]), wave, *read, *sink))
            item, wave = item + n * rings, wave + n
        radix = radices[0][number]
        alike = radix > FACTOR and all(own[number] == radix for own in radices) and all(map(is_even, found))
        fixed = factors(radix) if alike and on_gpu(self._device) else (0, 0, 0, 0)
        bands_of_pass = self._device.table(in_groups(found, whole=any(fixed)), "int32")
        return {"bands": bands_of_pass, **dict(zip(("first", "second", "third", "last"), fixed, strict=True))}

    def run(
        self, sign: float, source: DeviceArray, work: Callable[[int], DeviceArray], last: DeviceArray | None = None
    ) -> DeviceArray:
        """Transform by way of work(0) and work(1), which may be the source; return where the result is."""
        for number, own in enumerate(self._tables):
            sink = last if last is not None and number == self.count - 1 else work(number % 2)
            self._device.launch(fourier, source=source, **own, waves=self._waves, sign=sign, sink=sink)
            source = sink
        return source


def straight_passes(device: Device, angles: int, width: int, given: int | None = None) -> Passes:
    """Transforms over the angles of light [angle, r, z] of ``width`` columns, the first of those ``given``."""
    return Passes(device, [(angles, width, (0, angles, given or width, 0), (0, angles, width, 0))])


def ring_band(angles: int, samples: int, rings: int, cell: int, width: int) -> tuple[int, int, Place, Place]:
    """Samples and rings of a band, and where they lie in cells of a width, and by frequency."""
    return angles * samples, rings, (cell, samples, rings, width), (cell, angles, width, rings)


def ring_radices(device: Device, angles: int, samples: list[int]) -> list[tuple[int, ...]] | None:
    """Radices of bands on GPUs: over the angles first, as light, then over the cells between two angles; else None."""
    if not on_gpu(device) or not any(factors(angles)):
        return None
    return [(angles, each) if samples[-1] > 1 else (angles,) for each in samples]


def on_gpu(device: Device) -> bool:
    """Whether a device is a GPU in OpenCL, which has its own kernels for some transforms."""
    return device.name.startswith("opencl") and getattr(device, "is_gpu", False)


def _fits(device: Device) -> Callable[[int], bool]:
    """Whether a device computes a radix fast, as a function of the radix."""
    if not device.name.startswith("opencl"):
        return ONE_SUM.__ge__
    return (lambda radix: any(factors(radix))) if on_gpu(device) else AT_ONCE.__ge__


def passes(lengths: list[int], fits: Callable[[int], bool]) -> list[tuple[int, ...]]:
    """Radices of each transform, equally many for all: the fewest that are all fast, else those of the least work."""
    for count in range(1, MOST + 1):
        short = [_radices(n, count, fits) for n in lengths]
        if all(short):
            return short
    choices = [found for count in range(1, MOST + 1) if all(found := [_radices(n, count) for n in lengths])]
    return min(choices, key=lambda found: sum(map(sum, found)))


def _radices(n: int, passes: int, fits: Callable[[int], bool] = bool) -> tuple[int, ...]:
    """Factors of n above 1 that fit, one per pass, with the least sum; empty if there are none."""
    if passes == 1:
        return (n,) if n > 1 and fits(n) else ()
    rest = ((d, *_radices(n // d, passes - 1, fits)) for d in range(2, n) if n % d == 0 and fits(d))
    return min((found for found in rest if len(found) == passes), key=sum, default=())
