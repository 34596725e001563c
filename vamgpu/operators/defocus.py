"""Depth of focus: light that is blurred according to its distance from the focus."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from math import hypot, log, pi, sqrt
from typing import Any, final, overload

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput
from vamgpu.geometry import Beam, Chords, Vessel, columns_of, positive
from vamgpu.operators.blur import Blur, gaussian
from vamgpu.operators.compose import Composed, Derived, Sum, inherit
from vamgpu.operators.linear import LinearOperator
from vamgpu.operators.oblique import Oblique, Rising
from vamgpu.operators.projection import Projection
from vamgpu.operators.ray_table import EQUAL, OpenAir
from vamgpu.operators.ring_projection import RingProjection
from vamgpu.schema import check
from vamgpu.schema.quantities import Length, Place, Positive

TO_SIGMA = 1.0 / sqrt(8.0 * log(2.0))
MIXED = 0.07, 0.3
"""Halfway between two round Gaussians whose widths differ by exp(0.3), their mixture is 7 % narrower than its variance
suggests; the difference grows with the square of the exponent."""


@dataclass(frozen=True)
class Defocus:
    """The width of one pixel's light at every depth: FWHM(depth) = fwhm · sqrt(1 + (2·depth / depth_of_focus)²).

    It follows the waist of any beam: at the ends of the depth of focus, light is √2 times as wide as in focus.
    A projector's two numbers rarely match an ideal Gaussian beam; `quality` gives the deviation.

    Args:
        fwhm: Full width at half maximum of one pixel's light in focus, in the plane of the beam's pixels [mm].
        depth_of_focus: Length along the light over which it is narrower than √2·fwhm, in the resin [mm].
        focus: Position of the focus downstream of the axis [mm]: a number, or a function of the columns' offsets [mm]
            for a curved focus.

    Raises:
        BadInput: A width or a depth is not above 0.
    """

    fwhm: Length
    depth_of_focus: Length
    focus: Place | Callable[[np.ndarray], Any] = 0.0

    def __post_init__(self) -> None:
        check(self)

    def width(self, depth: Any) -> np.ndarray:
        """Full width at half maximum at some depths.

        Args:
            depth: Distance before or behind the focus [mm].

        Returns:
            FWHM [mm], (...,) as ``depth``.
        """
        return self.fwhm * np.sqrt(1.0 + (2.0 * np.asarray(depth) / self.depth_of_focus) ** 2)

    def variance(self, u: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """Variance of the light of some columns at some depths.

        Args:
            u: Offsets of the columns [mm], (...,).
            depth: Distance downstream of the axis [mm], (...,).

        Returns:
            σ² [mm²], (...,).
        """
        focus = self.focus(u) if callable(self.focus) else self.focus
        return (TO_SIGMA * self.width(depth - np.asarray(focus))) ** 2

    def quality(self, wavelength: float) -> float:
        """Beam quality M²: 1 for an ideal Gaussian beam of this width.

        Args:
            wavelength: Wavelength of the light [mm].

        Returns:
            M², dimensionless.
        """
        waist = self.fwhm / sqrt(2.0 * log(2.0))
        return pi * waist**2 / (positive("wavelength [mm]", wavelength) * 0.5 * self.depth_of_focus)


@dataclass(frozen=True, eq=False)
class WeightedVessel(Vessel):
    """A vessel whose light is multiplied by a share that depends on the position: share(u, across, along)."""

    vessel: Vessel
    share: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]

    @property
    def bare(self) -> Vessel:
        return self.vessel

    @property
    def absorption(self) -> float:
        return self.vessel.absorption

    @property
    def lit_radius(self) -> float:
        return self.vessel.lit_radius

    def chords(self, u: np.ndarray) -> Chords:
        return self.vessel.chords(u)

    def columns(self, across: np.ndarray, along: np.ndarray) -> np.ndarray:
        return columns_of(self.vessel, across, along)

    def illuminate(self, across: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        u, weight = self.vessel.illuminate(across, along)
        return u, weight * self.share(u, across, along)


def _depth(plane: Vessel, u: np.ndarray, across: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Distance [mm] of points along their rays, downstream of where a ray passes the axis."""
    angle = plane.chords(u).angle
    return along * np.cos(angle) - across * np.sin(angle)


@dataclass(frozen=True, eq=False)
class _WeightedRows:
    """The same for rising light."""

    plane: WeightedVessel
    rows: Callable[..., Any]


@final
class Defocused(Derived):
    """A projector whose light widens away from the focus, across columns and across rows.

    A = Σ Bₖ·Pₖ over nodes k of the blur's variance: Pₖ projects depths near the variance of node k, with linear
    weights between nodes; Bₖ blurs by that variance. A pixel's light therefore has the width of ``defocus`` at every
    depth. This includes the interpolation between pixels: light is never narrower than that. Depths are counted along
    the rays from the axis. Each product takes one projection per node.

    Args:
        operator: A `Projection`, a `RingProjection` or an `Oblique`.
        defocus: Width of its light at every depth.
        tolerance: Largest relative deviation of the FWHM from the formula between nodes.

    Raises:
        BadInput: An argument is of another type or out of its range.
    """

    def __init__(
        self, operator: Projection | RingProjection | Oblique, defocus: Defocus, tolerance: Positive = 0.02
    ) -> None:
        if not isinstance(operator, (Projection, RingProjection, Oblique)):
            raise BadInput(
                f"Defocused got {operator!r}; expected a Projection, a RingProjection or an Oblique; "
                "wrap the result afterwards"
            )
        if not isinstance(defocus, Defocus):
            raise BadInput(f"Defocused got {defocus!r}; expected Defocus(fwhm=…, depth_of_focus=…)")
        self.operator: Projection | RingProjection | Oblique = operator
        self.defocus: Defocus = defocus
        self.tolerance: float = positive("tolerance", tolerance)
        self._set_spaces(operator.domain, operator.range, operator.device)
        inherit(self, operator)
        self.nodes: np.ndarray = self._chosen(self.tolerance)
        self._sum = Sum([self._part(k) for k in range(len(self.nodes))])

    def __repr__(self) -> str:
        return f"Defocused({self.operator!r}, {self.defocus!r})"

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        self._sum.forward(x, out)

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        self._sum.transposed(y, out)

    @property
    def _plane(self) -> Vessel:
        return self.operator.vessel or OpenAir()

    def _chosen(self, tolerance: float) -> np.ndarray:
        """Variances [mm²] by which light is sorted, from the sharpest to the widest in the volume."""
        A, grid = self.operator, self.operator.grid
        corner = hypot(*(0.5 * (n + 3) * grid.pitch for n in grid.shape[:2]))
        if isinstance(A, RingProjection):
            corner = A.rings.rings * A.rings.pitch
        reach = min(self._plane.lit_radius, corner)
        position = np.linspace(-reach, reach, 257)
        across, along = np.meshgrid(position, position, indexing="ij")
        lit = np.hypot(across, along) <= reach
        u, _ = self._plane.illuminate(across[lit], along[lit])
        variance = self.defocus.variance(u, _depth(self._plane, u, across[lit], along[lit]))
        if not np.isfinite(variance).all():
            raise BadInput("the focus is not finite everywhere in the volume; expected a depth [mm] for every column")
        low, high = float(variance.min()), float(variance.max())
        largest, step = MIXED
        count = int(np.ceil(0.5 * log(high / low) / (step * sqrt(tolerance / largest)))) if high > low else 0
        return np.geomspace(low, high, count + 1)

    def _part(self, k: int) -> LinearOperator:
        """The projector of the light near node k."""
        nodes, defocus, A = self.nodes, self.defocus, self.operator

        def share(u: np.ndarray, across: np.ndarray, along: np.ndarray) -> np.ndarray:
            hat = np.zeros(len(nodes))
            hat[k] = 1.0
            return np.interp(defocus.variance(u, _depth(A.vessel or OpenAir(), u, across, along)), nodes, hat)

        plane = WeightedVessel(self._plane, share)
        if isinstance(A, Projection):
            part = Projection(A.grid, self._blurred(k), A.motion, plane, A.device)
        elif isinstance(A, RingProjection):
            part = RingProjection(A.grid, self._blurred(k), A.motion, plane, A.device, rings=A.rings)
        else:
            light = _WeightedRows(plane, A.light.rows) if isinstance(A.light, Rising) else plane
            return Composed(self._blur(nodes[k]), Oblique(A.grid, A.beam, A.motion, light, A.wobble, A.device))
        part.range = A.range  # the same images, regardless of the lens that each part of their light passes
        return part

    def _blurred(self, k: int) -> Beam:
        """Pixels whose point spread, with the boxes of pixel and voxel, is as wide as the node requires; or sharp."""
        beam, ratio = self.operator.beam, self.operator.grid.pitch / self.operator.beam.pitch
        variance = self.nodes[k] - (beam.fill + ratio**2) * beam.pitch**2 / 12.0
        return replace(beam, spread=sqrt(max(variance, 0.0)))

    @cached_property
    def direct(self) -> Defocused:
        """The same operator, by rays through voxels."""
        A = self.operator
        return Defocused(A.direct, self.defocus, self.tolerance) if isinstance(A, RingProjection) else self

    def _blur(self, variance: float) -> Blur:
        """The blur of a node, for images whose pixels have no other blur."""
        ratio = self.operator.grid.pitch / self.operator.beam.pitch
        taps = gaussian(sqrt(variance) / TO_SIGMA / self.operator.beam.pitch, 1.0 if ratio <= EQUAL else ratio)
        return Blur(self.range, self.device, taps, taps)


@overload
def direct(A: Projection | RingProjection) -> Projection: ...
@overload
def direct(A: Any) -> Any: ...
def direct(A: Any) -> Any:
    """For an operator on rings, its version on voxels; any other operator itself."""
    return A.direct if isinstance(A, RingProjection | Defocused) else A
