"""Projection in a resin that scatters: light that was not scattered, and photons counted at one angle."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from math import ceil
from typing import Any, final

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import positive
from vamgpu.kernels.gather import gather_rows
from vamgpu.kernels.resample import resample
from vamgpu.operators.compose import Derived, combine, inherit
from vamgpu.operators.photon_table import PhotonCount, Scatterer, scattered_light, tiles_of
from vamgpu.operators.polar import PolarGrid
from vamgpu.operators.projection import Projection
from vamgpu.operators.ring_projection import FAINT, RingProjection, in_voxels, rings_of, unsupported_reason
from vamgpu.operators.row_resampler import banded
from vamgpu.operators.spectral import SpectralProjection
from vamgpu.operators.traced_projection import BLOCK
from vamgpu.schema.quantities import Count, Positive

WIDE = 1.5  # ratio of the width of rings for scattered light to that of voxels
PHOTONS = 1 << 22  # photons that are followed by default


@final
class ScatteringRings(Derived):
    """A projector in a resin that scatters light, on rings.

    At evenly spaced angles, the scattered light of each is that of the first, rotated. Photons of the first angle,
    through resin, wall and bath, are counted on rings and along z. The table is a sum of few patterns on rings, each
    with a profile along z, so that its products take about as long as those of light that is not scattered. Light that
    was not scattered is that of a `RingProjection` with absorption and scattering as its losses. The transpose is
    exact. As for other rings, direct light that a face reflects back into the resin does not count; scattered light is
    followed until it is absorbed or leaves the vessel.

    Args:
        operator: A `Projection` or `RingProjection` in a round vial, without scattering.
        scattering: Its resin.
        tolerance: Root mean square error that is allowed, of the terms over the table, and of the photons' noise over
            the greatest dose of scattered light.
        photons: Number of photons.
        seed: Number that selects the photons; other seeds give other noise.

    Raises:
        BadInput: An argument is of another type, rings do not support the operator, its vessel is not a round vial
            with clear walls, or the photons are too few for the tolerance.
    """

    def __init__(
        self, operator: Projection | RingProjection, scattering: Scatterer, tolerance: Positive = 0.01,
        photons: Count = PHOTONS, seed: int = 1,
    ) -> None:  # fmt: skip
        A: Any = operator.direct if isinstance(operator, RingProjection) else operator
        if why := _unsupported(A):
            raise BadInput(f"scattered light is computed on rings: {why}")
        if not isinstance(scattering, Scatterer):
            raise BadInput(f"ScatteringRings got {scattering!r}; expected Scattering(coefficient=…)")
        if not positive("tolerance", tolerance) < 1.0:
            raise BadInput(f"tolerance is {tolerance:g}; expected below 1: it is relative to the greatest dose")
        self.operator: Projection = A
        self.scattering: Scatterer = scattering
        self.tolerance: float = tolerance
        self.photons: int = photons
        self.seed: int = seed
        self._set_spaces(A.domain, A.range, A.device)
        inherit(self, A)
        self._direct = RingProjection(A.grid, A.beam, A.motion, self.attenuated, A.device)
        self._scattered = self.scattered(rings_of(A.grid, A.motion.angles, WIDE), photons, seed)
        rings, table = self._scattered.rings, in_voxels(self._scattered.rings, A.grid, A.vessel.lit_radius)
        self._to_voxels = table.table(A.device, A.grid.shape[:2], BLOCK)
        self._to_rings = table.transposed().table(A.device, rings.shape[:2], BLOCK)

    @property
    def attenuated(self) -> Any:
        """The vessel of a clear resin that absorbs all that this one absorbs and scatters."""
        return replace(self.vessel, absorption=self.vessel.absorption + self.scattering.coefficient)

    @property
    def absorbed_share(self) -> float:
        """Ratio of the dose to that in the attenuated vessel."""
        return (self.vessel.absorption or 1.0) / self.attenuated.absorption

    def scattered(self, rings: PolarGrid, photons: int, seed: int) -> ScatteredRings:
        """Its scattered light on other rings, by other photons.

        Args:
            rings: The rings.
            photons: Number of photons.
            seed: Number that selects them.

        Returns:
            The light, whose dose is that in the attenuated vessel.

        Raises:
            BadInput: The photons are too few for the tolerance.
        """
        return ScatteredRings(self.operator, self.scattering, rings, self.tolerance, photons, seed)

    def __repr__(self) -> str:
        return f"ScatteringRings({self.operator!r}, {self.scattering!r})"

    @property
    def terms(self) -> int:
        """Number of patterns on rings."""
        return len(self._scattered.terms)

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        scattered, profiles = self._scattered, self._profiles
        cells = scattered.field("cells")
        self.device.launch(gather_rows, source=x, **self._to_rings, out=cells)
        others = [
            (term, scattered.along(profiles[number], cells, scattered.field(f"own {number}")))
            for number, term in enumerate(scattered.terms)
        ]
        together = self._direct.takes_with(scattered.rings)
        self._direct.forward_with(x, others if together else (), out)
        part = out if together else self.device.empty(out.shape)
        for term, own in () if together else others:
            term.forward(own, part)
            combine(1.0, out, 1.0, part, out)
        combine(self.absorbed_share, out, 0.0, out, out)

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        scattered = self._scattered
        together = self._direct.takes_with(scattered.rings)
        cells = scattered.cells() if together else scattered.lit(y)
        self._direct.transposed_with(y, out, list(zip(scattered.terms, cells, strict=True)) if together else ())
        total = scattered.summed(self._profiles, cells, *(scattered.field(name) for name in ("cells", "part")))
        voxels = self.device.empty(out.shape)
        self.device.launch(gather_rows, source=total, **self._to_voxels, out=voxels)
        combine(self.absorbed_share, out, self.absorbed_share, voxels, out)

    @cached_property
    def _profiles(self) -> list[Profile]:
        return self._scattered.profiles(np.arange(self.grid.shape[2]))


Profile = dict[str, DeviceArray]
"""Tables of `resample`: weights of slices."""


class ScatteredRings:
    """Scattered light of a projection on rings: patterns, each blurred along z by a profile."""

    def __init__(
        self, A: Projection, scattering: Scatterer, rings: PolarGrid, tolerance: float, photons: int, seed: int
    ) -> None:
        self.rings: PolarGrid = rings
        self.device: Device = A.device
        count = PhotonCount(rings, A.beam, A.vessel, scattering, photons)
        found = scattered_light(count, A.device, tolerance, seed)
        if found.noise > tolerance:
            more = 2.0 * max(photons, count.least) * (found.noise / tolerance) ** 2
            raise BadInput(f"the noise of {photons:_} photons is {found.noise:.3g} of the greatest dose of scattered "
                           f"light; expected at most {tolerance:g}: use photons={ceil(more):_}")  # fmt: skip
        self._shapes, self._flat = found.profiles, A.beam.flat
        scale, arc = count.extinction * A.grid.pitch**2 / A.beam.pitch, float(A.motion.arcs[0])
        self.terms: list[SpectralProjection] = [
            SpectralProjection(
                rings, A.beam, A.vessel, A.device, square=A.grid.pitch, faint=FAINT, splines=True, motion=A.motion,
                tiles=tiles_of(count, pattern, scale, arc),
            )
            for pattern in found.patterns
        ]  # fmt: skip
        for term in self.terms[1:]:
            term._held = self.terms[0]._held  # one after another, they share their work fields

    def profiles(self, z: np.ndarray) -> list[Profile]:
        """Weights of the slices of the rings at some z [slices from the lowest one], for each term."""
        away = np.abs(z[:, None] - np.arange(self.rings.slices))
        if self._flat:  # every slice represents all heights
            return [banded(self.device, shape[0] * (away < 0.5)) for shape in self._shapes]
        lags = np.arange(self._shapes.shape[1])
        return [banded(self.device, np.interp(away, lags, shape, right=0.0)) for shape in self._shapes]

    def field(self, name: str) -> DeviceArray:
        """A work field of the cells."""
        return self.terms[0]._work(name, self.rings.shape)

    def cells(self) -> list[DeviceArray]:
        """A field for the cells of each term."""
        return [self.field(f"own {number}") for number in range(len(self.terms))]

    def lit(self, light: DeviceArray) -> list[DeviceArray]:
        """Cells of each term in light [angle, r, z]."""
        for term, own in zip(self.terms, found := self.cells(), strict=True):
            term.transposed(light, own)
        return found

    def along(self, profile: Profile, cells: DeviceArray, out: DeviceArray) -> DeviceArray:
        """Cells blurred along z, in a field of the profile's heights."""
        self.device.launch(resample, source=cells, lanes=cells, target=out, **profile)
        return out

    def summed(
        self, profiles: list[Profile], cells: list[DeviceArray], total: DeviceArray, part: DeviceArray
    ) -> DeviceArray:
        """The sum of all terms, each blurred along z."""
        self.along(profiles[0], cells[0], total)
        for profile, own in zip(profiles[1:], cells[1:], strict=True):
            combine(1.0, total, 1.0, self.along(profile, own, part), total)
        return total


def _unsupported(A: Any) -> str:
    """Reason why scattered light cannot be computed on rings; empty if it can."""
    if why := unsupported_reason(A):
        return why
    vessel = A.vessel
    if not all(hasattr(vessel, name) for name in ("faces", "inner_radius")):
        got = "no vessel" if vessel is None else f"a {type(vessel).__name__}"
        return f"got {got}; expected a round vial: only there are photons followed"
    if getattr(vessel, "wall_absorption", 0.0) or getattr(vessel, "liquid_absorption", 0.0):
        return "the walls absorb; expected clear ones"
    return ""
