"""A vat with flat windows whose liquid matches the resin: straight rays."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from vamgpu.errors import BadInput, OpticsWarning, TargetTooLarge
from vamgpu.geometry import Chords, positive
from vamgpu.optics.inputs import LOW_TRANSMITTANCE, Container, Floats, absorbed_share, as_offsets
from vamgpu.optics.interface import Polarization, polarized, transmittance
from vamgpu.schema import check
from vamgpu.schema.quantities import Absorption, Index, Length


@dataclass(frozen=True)
class Vat(Container):
    """A square or rectangular vat with a flat window, lit at right angles, that does not turn while the part turns.

    The resin fills the vat or, if a radius is given, a round vessel in the middle of a clear liquid of the same index.
    Rays are straight along +Y of the fixed frame (see `Vial`): the chord of column u is X = u. The indices only set the
    loss at the two faces of the window; if all are equal, as by default, there is no loss.

    Args:
        width: Inner width of the vat across the beam [mm].
        depth: Inner width of the vat along the beam [mm]; None for a square vat.
        radius: Radius of the round volume of resin [mm]; None if the resin fills the vat.
        absorption: Absorption of the resin, natural logarithm [1/mm].
        resin_index: Refractive index of the resin and of the liquid that matches it.
        wall_index: Refractive index of the window.
        bath_index: Refractive index in front of the window.
        polarization: Polarization of the light, as for `Vial`; it has no effect, because s and p light lose the same at
            normal incidence.

    Raises:
        BadInput: A value is out of its range, or the round volume exceeds the vat.
    """

    width: Length
    depth: Length | None = None
    radius: Length | None = None
    absorption: Absorption = 0.0  # pyright: ignore[reportIncompatibleMethodOverride] - a field
    resin_index: Index = 1.0
    wall_index: Index = 1.0
    bath_index: Index = 1.0
    polarization: Polarization = "none"

    def __post_init__(self) -> None:
        check(self)
        polarized("Vat polarization", self.polarization)
        if self.radius is not None and self.radius > self._inscribed:
            raise BadInput(
                f"radius is {self.radius:g} mm in a vat of {self.width:g} x {self._depth:g} mm; expected "
                f"at most {self._inscribed:g} mm; correct the radius, the width or the depth"
            )

    @property
    def _depth(self) -> float:
        return self.width if self.depth is None else self.depth

    @property
    def _inscribed(self) -> float:
        return 0.5 * min(self.width, self._depth)

    @property
    def aperture(self) -> float:
        """Largest column offset whose ray reaches the resin [mm]."""
        return 0.5 * self.width if self.radius is None else self.radius

    @property
    def printable_radius(self) -> float:
        """Radius of the round volume of resin, or of the largest circle inside the vat [mm]."""
        return self._inscribed if self.radius is None else self.radius

    @property
    def lit_radius(self) -> float:
        return self.printable_radius

    @property
    def window_transmittance(self) -> float:
        """Share of the power that crosses both faces of the window."""
        one = np.ones(())
        faces = ((self.bath_index, self.wall_index), (self.wall_index, self.resin_index))
        return float(transmittance([(one, one, *indices) for indices in faces], self.polarization))

    def _half_path(self, x: Floats) -> Floats:
        if self.radius is None:
            return np.full(x.shape, 0.5 * self._depth)
        return np.sqrt(np.maximum((self.radius - x) * (self.radius + x), 0.0))

    def chords(self, u: ArrayLike) -> Chords:
        offsets = as_offsets("u", u)
        reaches = np.abs(offsets) < self.aperture
        return Chords(
            p=offsets.copy(),
            angle=np.zeros(offsets.shape),
            spread=np.zeros(offsets.shape),
            transmittance=np.where(reaches, self.window_transmittance, 0.0),
            length=np.where(reaches, 2.0 * self._half_path(offsets), 0.0),
        )

    def illuminate(self, across: ArrayLike, along: ArrayLike) -> tuple[Floats, Floats]:
        points_x, points_y = np.broadcast_arrays(as_offsets("across", across), as_offsets("along", along))
        half = self._half_path(points_x)
        inside = (np.abs(points_x) < self.aperture) & (np.abs(points_y) < half)
        path = np.where(inside, points_y + half, 0.0)
        weight = np.where(inside, self.window_transmittance * absorbed_share(self.absorption, path), 0.0)
        return points_x.copy(), weight

    def check_fits(self, radius: float) -> None:
        radius = positive("target radius [mm]", radius)
        if radius > self.printable_radius:
            raise TargetTooLarge(
                f"the target reaches {radius:.4g} mm from the axis, but the printable radius of this vat is "
                f"{self.printable_radius:.4g} mm; scale or center the target, or use a larger vat"
            )
        if self.window_transmittance < LOW_TRANSMITTANCE:
            warnings.warn(
                f"the window transmits {self.window_transmittance:.3g} of the light at every radius up to the "
                f"target's {radius:.4g} mm, less than {LOW_TRANSMITTANCE:g}; use a longer exposure or coat the window",
                OpticsWarning,
                stacklevel=2,
            )
