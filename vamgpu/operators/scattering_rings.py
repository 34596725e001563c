"""Projection in a resin that scatters: light that was not scattered, and photons counted at one angle."""

from __future__ import annotations

from dataclasses import replace
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
from vamgpu.operators.photon_table import PhotonCount, ScatteredLight, Scatterer, scattered_light, tiles_of
from vamgpu.operators.projection import Projection
from vamgpu.operators.ring_projection import FAINT, RingProjection, in_voxels, rings_of, unsupported_reason
from vamgpu.operators.row_resampler import banded
from vamgpu.operators.space import Space
from vamgpu.operators.spectral import SpectralProjection
from vamgpu.operators.traced_projection import BLOCK
from vamgpu.schema.quantities import Count, Positive

WIDE = 1.5
"""Ratio of the width of rings for scattered light to that of voxels."""
PHOTONS = 1 << 22
"""Photons that are followed by default."""


@final
class ScatteringRings(Derived):
    """A projector in a resin that scatters light, on rings.

    At even angles, the scattered light of each angle is that of the first one, rotated. Photons of the first angle,
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

    domain: Space
    range: Space
    device: Device
    operator: Projection
    scattering: Scatterer
    tolerance: float
    photons: int
    seed: int

    def __init__(
        self, operator: Projection | RingProjection, scattering: Scatterer, tolerance: Positive = 0.01,
        photons: Count = PHOTONS, seed: int = 1,
    ) -> None:  # fmt: skip
        A: Any = operator.direct if isinstance(operator, RingProjection) else operator
        if why := _unsupported(A):
            raise BadInput(f"scattered light is computed on rings, which do not support {A!r}: {why}")
        if not isinstance(scattering, Scatterer):
            raise BadInput(f"ScatteringRings got {scattering!r}; expected Scattering(coefficient=…)")
        self.operator, self.scattering, self.tolerance = A, scattering, positive("tolerance", tolerance)
        self.photons, self.seed = photons, seed
        self.domain, self.range, self.device = A.domain, A.range, A.device
        inherit(self, A)
        vessel = replace(A.vessel, absorption=A.vessel.absorption + scattering.coefficient)
        self._share: float = (A.vessel.absorption or 1.0) / vessel.absorption
        self._direct = RingProjection(A.grid, A.beam, A.motion, vessel, A.device)
        self._rings = rings_of(A.grid, A.motion.angles, WIDE)
        count = PhotonCount(self._rings, A.beam, A.vessel, scattering, photons)
        found = scattered_light(count, A.device, self.tolerance, seed)
        if found.noise > self.tolerance:
            more = photons * (found.noise / self.tolerance) ** 2
            raise BadInput(f"the noise of {photons:_} photons is {found.noise:.3g} of the greatest dose of scattered "
                           f"light; expected {self.tolerance:g} at most: use photons = {ceil(1.2 * more):_}")  # fmt: skip
        self._spectral = self._terms(count, found)
        self._profiles = [banded(A.device, _along_z(each, A.grid.shape[2])) for each in found.profiles]
        table = in_voxels(self._rings, A.grid, A.vessel.lit_radius)
        self._to_voxels = table.table(A.device, A.grid.shape[:2], BLOCK)
        self._to_rings = table.transposed().table(A.device, self._rings.shape[:2], BLOCK)

    def __repr__(self) -> str:
        return f"ScatteringRings({self.operator!r}, {self.scattering!r})"

    @property
    def terms(self) -> int:
        """Number of patterns on rings."""
        return len(self._spectral)

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        cells = self._field("cells")
        self.device.launch(gather_rows, source=x, **self._to_rings, out=cells)
        others = [(term, self._along(number, cells, f"own {number}")) for number, term in enumerate(self._spectral)]
        together = self._direct.takes_with(self._rings)
        self._direct.forward_with(x, others if together else (), out)
        part = out if together else self.device.empty(out.shape)
        for term, own in () if together else others:
            term.forward(own, part)
            combine(1.0, out, 1.0, part, out)
        combine(self._share, out, 0.0, out, out)

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        others = [(term, self._field(f"own {number}")) for number, term in enumerate(self._spectral)]
        together = self._direct.takes_with(self._rings)
        self._direct.transposed_with(y, out, others if together else ())
        for term, own in () if together else others:
            term.transposed(y, own)
        total = self._along(0, others[0][1], "cells")
        for number, (_, own) in enumerate(others[1:], start=1):
            combine(1.0, total, 1.0, self._along(number, own, "part"), total)
        voxels = self.device.empty(out.shape)
        self.device.launch(gather_rows, source=total, **self._to_voxels, out=voxels)
        combine(self._share, out, self._share, voxels, out)

    def _along(self, number: int, cells: DeviceArray, name: str) -> DeviceArray:
        """Cells blurred along z by the profile of a term, which is its own transpose."""
        out = self._field(name)
        self.device.launch(resample, source=cells, lanes=cells, target=out, **self._profiles[number])
        return out

    def _field(self, name: str) -> DeviceArray:
        """A work field of the cells."""
        return self._spectral[0]._work(name, self._rings.shape)

    def _terms(self, count: PhotonCount, found: ScatteredLight) -> list[SpectralProjection]:
        """The patterns on rings; they share their work fields."""
        A = self.operator
        scale, arc = count.extinction * A.grid.pitch**2 / A.beam.pitch, float(A.motion.arcs[0])
        terms = [
            SpectralProjection(
                self._rings, A.beam, A.vessel, A.device, square=A.grid.pitch, faint=FAINT, splines=True,
                motion=A.motion, tiles=tiles_of(count, pattern, scale, arc),
            )
            for pattern in found.patterns
        ]  # fmt: skip
        for term in terms[1:]:
            term._held = terms[0]._held
        return terms


def _unsupported(A: Any) -> str:
    """Reason why scattered light in an operator is not that of one angle, rotated; empty if it is."""
    if why := unsupported_reason(A):
        return why
    vessel = A.vessel
    if not all(hasattr(vessel, name) for name in ("faces", "inner_radius")):
        return f"photons are followed in a round vial, not in {vessel!r}"
    if getattr(vessel, "wall_absorption", 0.0) or getattr(vessel, "liquid_absorption", 0.0):
        return "photons are followed through clear walls, and these absorb"
    return ""


def _along_z(profile: np.ndarray, slices: int) -> np.ndarray:
    """The matrix (slices, slices) of a profile (lags,); the identity for light that is the same at every height."""
    if profile.size == 1:
        return profile[0] * np.eye(slices)
    z = np.arange(slices)
    return profile[np.abs(z[:, None] - z)]
