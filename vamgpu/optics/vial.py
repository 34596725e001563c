"""A cylindrical vial that turns in air or in a bath."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from vamgpu.backend.cores import pointwise
from vamgpu.card import card
from vamgpu.errors import BadInput, OpticsWarning, TargetTooLarge
from vamgpu.geometry import Chords, centers, positive
from vamgpu.optics.faces import Face, transmit, turn
from vamgpu.optics.inputs import LOW_TRANSMITTANCE, Container, Floats, absorbed_share, as_offsets
from vamgpu.optics.interface import Polarization, impact_after, polarized
from vamgpu.optics.raymap import first_columns
from vamgpu.schema import check, write
from vamgpu.schema.quantities import Absorption, Index, Thickness, VesselRadius

# On the caustics outside the printable radius the density is unbounded; it is limited to this value there.
LARGEST_DENSITY = 100.0
PICTURE = 110  # pixels along the side of the picture of a vial


@dataclass(frozen=True)
class Vial(Container):
    """A round vial of resin with a clear wall; light refracts at the outer and at the inner face of the wall.

    Fixed frame: at the angle θ, a voxel at (x, y) lies at X = y·cos θ − x·sin θ, the direction in which the beam's
    columns are counted, and Y = −(x·cos θ + y·sin θ), along which light travels. A column at offset u in the bath
    becomes the chord X·cos d + Y·sin d = u · bath_index / resin_index. If the resin is denser than the bath, the
    deviation d(u) has the sign of u and rays converge: the chord's direction (−sin d, cos d) leans towards the axis.

    Layers follow Snell's invariant index · distance from the axis, with Fresnel loss at both faces of the wall and
    Beer-Lambert absorption in the resin from the inner face on.

    Args:
        radius: Outer radius [mm].
        wall: Thickness of the wall [mm]; 0 for no wall, then wall_index has no effect.
        resin_index: Refractive index of the resin.
        wall_index: Refractive index of the wall.
        bath_index: Refractive index around the vial, in which the columns of the beam are counted.
        absorption: Absorption of the resin, natural logarithm [1/mm].
        polarization: Polarization of the light: "none", unpolarized; "s", its field along the axis of the vial; "p",
            across it. Unpolarized light has the mean of the s and p losses over all faces (`transmittance`).

    Raises:
        BadInput: A value is out of its range, or the wall leaves no space for resin.
    """

    radius: VesselRadius
    wall: Thickness
    resin_index: Index
    wall_index: Index
    bath_index: Index = 1.0
    absorption: Absorption = 0.0  # pyright: ignore[reportIncompatibleMethodOverride] - a field
    polarization: Polarization = "none"
    barrier: ClassVar[str] = "wall"

    def __post_init__(self) -> None:
        check(self)
        polarized("Vial polarization", self.polarization)
        if self.wall >= self.radius:
            raise BadInput(
                f"wall is {self.wall:g} mm in a vial of outer radius {self.radius:g} mm; expected a wall "
                "thinner than the radius; radius and wall are both in mm, and radius is half the diameter"
            )

    def _repr_html_(self) -> str:
        across = centers(PICTURE, 2.0 * self.radius / PICTURE)
        x, y = across[:, None], across[None, :]  # light travels up
        away = np.hypot(x, y)
        light = np.where(away < self.lit_radius, self.illuminate(x, y)[1], 0.0)
        light[(away >= self.inner_radius) & (away < self.radius)] = 0.5 * light.max()
        reached = f"{self.lit_radius:.4g} of {self.inner_radius:.4g} mm"
        numbers = {**write(self, units=True), "resin lit at every angle, out to": reached}
        return card("Vial", numbers, {"light of even columns, from above": light})

    @property
    def inner_radius(self) -> float:
        """Radius of the resin [mm]."""
        return self.radius - self.wall

    @property
    def faces(self) -> tuple[Face, ...]:
        """The refracting faces, from the outside in."""
        if self.wall == 0:
            return (Face(self.radius, self.bath_index, self.resin_index, self.bath_index),)
        return (
            Face(self.radius, self.bath_index, self.wall_index, self.bath_index),
            Face(self.inner_radius, self.wall_index, self.resin_index, self.bath_index),
        )

    @property
    def aperture(self) -> float:
        """Largest column offset whose ray reaches the resin [mm]."""
        return min(self.radius, *(face.aperture for face in self.faces))

    @property
    def printable_radius(self) -> float:
        """min(inner radius, outer radius * bath_index / resin_index) [mm]."""
        return min(self.inner_radius, self.radius * self.bath_index / self.resin_index)

    @property
    def lit_radius(self) -> float:
        """Radius that light reaches at every angle [mm]; less than printable_radius if the wall reflects totally."""
        return min(self.printable_radius, self.aperture * self.bath_index / self.resin_index)

    def transmitted(self, u: Floats) -> Floats:
        """Share of the power of columns that reaches the resin, for columns that do.

        Args:
            u: Offsets of the columns, [...] [mm].

        Returns:
            Shares, [...].
        """
        return transmit(self.faces, u, self.polarization)

    def chords(self, u: ArrayLike) -> Chords:
        offsets = as_offsets("u", u)
        reaches = np.abs(offsets) < self.aperture
        kept = np.clip(offsets, -self.aperture, self.aperture)
        cos_d, sin_d, spread = turn(self.faces, kept)
        p = impact_after(kept, self.bath_index, self.resin_index)
        half = np.sqrt(np.maximum((self.inner_radius - p) * (self.inner_radius + p), 0.0))
        return Chords(
            p=p,
            angle=np.arctan2(sin_d, cos_d),
            spread=spread,
            transmittance=np.where(reaches, self.transmitted(kept), 0.0),
            length=np.where(reaches, 2.0 * half, 0.0),
        )

    def illuminate(self, across: ArrayLike, along: ArrayLike) -> tuple[Floats, Floats]:
        # columns per mm across the chord, 1 / |p'(u) − t·d'(u)|; where rays meet, that of the smallest |u| counts
        columns, inside, x, y, spacing = self._columns(across, along)
        weight = np.zeros(inside.shape)
        (weight[inside],) = pointwise(self._weights, columns[inside], x, y, spacing)
        return columns, weight

    def columns(self, across: ArrayLike, along: ArrayLike) -> Floats:
        """The ray through each point, as `illuminate` finds it, without its weight; this takes half of the time.

        Args:
            across: Position X across the light [mm], (...,).
            along: Position Y along the light [mm], (...,), broadcast with ``across``.

        Returns:
            Columns u [mm], (...,).

        Raises:
            BadInput: A coordinate is not finite.
        """
        return self._columns(across, along)[0]

    def _columns(self, across: ArrayLike, along: ArrayLike) -> tuple[Floats, np.ndarray, Floats, Floats, Floats]:
        """Columns of points, which of these lie in the resin, their positions, and the spacing of columns there."""
        points_x, points_y = np.broadcast_arrays(as_offsets("across", across), as_offsets("along", along))
        inside = points_x**2 + points_y**2 < self.inner_radius**2
        u = np.asarray(np.copysign(self.aperture, points_x))  # makes a single point writable, too
        x, y = points_x[inside], points_y[inside]
        u[inside], spacing = first_columns(self.faces, self.aperture, self.bath_index / self.resin_index, x, y)
        return u, inside, x, y, spacing

    def _weights(self, u: Floats, x: Floats, y: Floats, spacing: Floats) -> tuple[Floats]:
        ratio = self.bath_index / self.resin_index
        p = u * ratio
        half = np.sqrt(np.maximum((self.inner_radius - p) * (self.inner_radius + p), 0.0))
        cos_d, sin_d, _ = turn(self.faces, u)
        path = half + y * cos_d - x * sin_d
        density = 1.0 / np.maximum(np.abs(spacing), ratio / LARGEST_DENSITY)
        share = self.transmitted(u) * density * absorbed_share(self.absorption, path)
        return (np.where(spacing != 0.0, share, 0.0),)

    def check_fits(self, radius: float) -> None:
        radius = positive("target radius [mm]", radius)
        if radius > self.printable_radius:
            raise TargetTooLarge(
                f"the target reaches {radius:.4g} mm from the axis, but the printable radius of this vial is "
                f"{self.printable_radius:.4g} mm, the smaller of its inner radius {self.inner_radius:.4g} mm and "
                f"{self.radius:.4g} mm * {self.bath_index:g} / {self.resin_index:g}; scale or center the target, use "
                "a wider vial, or bring the bath's index closer to the resin's"
            )
        if radius > self.lit_radius:
            raise TargetTooLarge(
                f"the target reaches {radius:.4g} mm from the axis, but beyond {self.lit_radius:.4g} mm the "
                f"{self.barrier} of index {min(face.inner_index for face in self.faces):g} keeps the light out of the "
                f"resin of index {self.resin_index:g} by total reflection; scale or center the target, or use a "
                f"{self.barrier} of higher index"
            )
        p = np.linspace(0.0, radius, 2049)
        share = self.chords(impact_after(p, self.resin_index, self.bath_index)).transmittance
        if (dim := p[share < LOW_TRANSMITTANCE]).size:
            warnings.warn(
                f"beyond {dim[0]:.3g} mm from the axis the faces of the vial transmit less than {LOW_TRANSMITTANCE:g} "
                f"of the light, but the target reaches {radius:.4g} mm; expect dimmer edges, or bring the bath's index "
                "closer to the resin's",
                OpticsWarning,
                stacklevel=2,
            )
