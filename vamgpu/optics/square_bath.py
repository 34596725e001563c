"""A square bath with flat windows, which does not turn, with a round vial that turns in it."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from vamgpu.errors import BadInput, OpticsWarning, TargetTooLarge
from vamgpu.geometry import Chords
from vamgpu.optics.double_walled_vial import DoubleWalledVial
from vamgpu.optics.inputs import LOW_TRANSMITTANCE, Container, Floats, as_offsets
from vamgpu.optics.interface import POLARIZATIONS, fresnel
from vamgpu.optics.vial import Vial
from vamgpu.schema import check
from vamgpu.schema.quantities import Absorption, HalfTilt, Index, Length, Thickness


@dataclass(frozen=True)
class SquareBath(Container):
    """A round vial that turns in a fixed square bath of liquid; light enters through one flat window.

    The index of the liquid is the vial's bath_index. Parallel light stays parallel behind a flat window. At normal
    incidence it continues straight; a window tilted by τ turns it by τ − asin(sin τ · front_index / liquid index) and
    makes it narrower. Both faces of the window have Fresnel's loss; window and liquid absorb. Light through the other
    sides is ignored: the beam must not be wider than the window.

    This class is not for a square vial that turns with the part: its light enters through two faces at once, and two
    rays meet in most points, which differ at every angle. `TracedProjection` traces such rays, with the index of the
    square as ``CoRotatingMedium(index=…)``. For a square vat full of resin that does not turn, use `Vat`.

    Args:
        vessel: the round vial; its bath_index is that of the liquid.
        width: inner width of the bath [mm].
        wall: thickness of the window [mm].
        wall_index: refractive index of the window.
        front_index: refractive index in front of the window, where the columns of the beam are counted.
        tilt: rotation of the bath relative to the light, about the axis [rad].
        wall_absorption: absorption of the window, natural logarithm [1/mm].
        liquid_absorption: absorption of the liquid, natural logarithm [1/mm].

    Raises:
        BadInput: a value is not finite or negative, an index is below 1, the vial does not fit into the bath, or no
            light passes the tilted window.
    """

    vessel: Vial | DoubleWalledVial
    width: Length
    wall: Thickness
    wall_index: Index
    front_index: Index = 1.0
    tilt: HalfTilt = 0.0
    wall_absorption: Absorption = 0.0
    liquid_absorption: Absorption = 0.0

    def __post_init__(self) -> None:
        check(self)
        if not isinstance(self.vessel, Vial):
            raise BadInput(f"SquareBath got {self.vessel!r} as vessel; expected a Vial or a DoubleWalledVial")
        if self.vessel.radius > 0.5 * self.width:
            raise BadInput(
                f"a vial of radius {self.vessel.radius:g} mm stands in a bath {self.width:g} mm wide inside; expected "
                f"a radius of at most {0.5 * self.width:g} mm; correct the radius or the width"
            )
        least = min(self.wall_index, self.vessel.bath_index)
        if abs(np.sin(self.tilt)) * self.front_index >= least:
            raise BadInput(
                f"the window is tilted by {np.degrees(self.tilt):g}° in front of an index of {least:g}; expected less "
                f"than {np.degrees(np.arcsin(min(least / self.front_index, 1.0))):.4g}°, above which all is reflected"
            )

    @property
    def is_round(self) -> bool:
        """Always False: the window differs for light from another direction."""
        return False

    @property
    def absorption(self) -> float:
        """Absorption of the resin, natural logarithm [1/mm]."""
        return self.vessel.absorption

    @property
    def inner_radius(self) -> float:
        """Radius of the resin [mm]."""
        return self.vessel.inner_radius

    @cached_property
    def lit_radius(self) -> float:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Radius that light from the window reaches at every angle [mm]."""
        low, high = self.vessel.chords(self._across(np.array(self._window))).p
        return max(min(self.vessel.lit_radius, float(high), float(-low)), 0.0)

    @cached_property
    def _sines(self) -> tuple[float, float, float]:
        """Sines of the angles to the window's normal in front of it, in it, and behind it."""
        sine = float(np.sin(self.tilt)) * self.front_index
        return sine / self.front_index, sine / self.wall_index, sine / self.vessel.bath_index

    @cached_property
    def _cosines(self) -> tuple[float, float, float]:
        front, wall, liquid = (float(np.sqrt(1.0 - sine**2)) for sine in self._sines)
        return front, wall, liquid

    @cached_property
    def _turn(self) -> float:
        """Turn of the light behind the window [rad]."""
        return self.tilt - float(np.arcsin(self._sines[2]))

    @cached_property
    def _line(self) -> tuple[float, float]:
        """slope and offset [mm] of q = slope·u + offset, the distance from the axis of column u behind the window."""
        (front, wall, liquid), (sine, sine_wall, sine_liquid) = self._cosines, self._sines
        half = 0.5 * self.width
        shift = -(half + self.wall) * sine / front + self.wall * sine_wall / wall
        return liquid / front, liquid * shift + half * sine_liquid

    @cached_property
    def _window(self) -> tuple[float, float]:
        """First and last column [mm] that enters through the window and leaves it within the bath."""
        (front, wall, _), (sine, sine_wall, _) = self._cosines, self._sines
        half, slope = 0.5 * self.width, self.wall * sine_wall / wall
        outer = front * half, (half + self.wall) * sine  # u = outer x · cos + (half + wall) · sin
        shift = min(slope, 0.0), max(slope, 0.0)
        return -outer[0] - front * shift[0] + outer[1], outer[0] - front * shift[1] + outer[1]

    def _across(self, u: Floats) -> Floats:
        slope, offset = self._line
        return slope * u + offset

    @cached_property
    def _faces(self) -> Floats:
        """Shares of s and of p light that cross both faces of the window and its glass."""
        indices = (self.front_index, self.wall_index, self.vessel.bath_index)
        pairs = (
            fresnel(np.array(self._cosines[k]), np.array(self._cosines[k + 1]), indices[k], indices[k + 1])
            for k in range(2)
        )
        return np.prod(list(pairs), axis=0) * np.exp(-self.wall_absorption * self.wall / self._cosines[1])

    def _share(self, u: Floats, q: Floats) -> Floats:
        """The share of the vial's light at q that window and liquid transmit; s stays s and p stays p at all faces."""
        shares, kind = self._faces, self.vessel.polarization
        if kind != "none" or self.tilt == 0.0:
            left = np.full_like(q, shares["sp".index(kind)] if kind != "none" else shares.mean())
        else:
            s, p = (replace(self.vessel, polarization=kind).transmitted(q) for kind in POLARIZATIONS[1:])
            both = np.maximum(s + p, np.finfo(np.float64).tiny)
            left = (shares[0] * s + shares[1] * p) / both
        if self.liquid_absorption > 0:
            left = left * np.exp(-self.liquid_absorption * self._path(q))
        low, high = self._window
        return np.where((u >= low) & (u <= high), left, 0.0)

    def _path(self, q: Floats) -> Floats:
        """Path length in the liquid from the window to the vial [mm]."""
        sine, cosine, half = self._sines[2], self._cosines[2], 0.5 * self.width
        place = (q - half * sine) / cosine  # along the window, where the ray leaves it
        start, radius = place * sine - half * cosine, self.vessel.radius
        return np.maximum(-np.sqrt(np.maximum((radius - q) * (radius + q), 0.0)) - start, 0.0)

    def chords(self, u: ArrayLike) -> Chords:
        offsets = as_offsets("u", u)
        q = self._across(offsets)
        inner = self.vessel.chords(q)
        return Chords(
            p=inner.p,
            angle=inner.angle + self._turn,
            spread=inner.spread * self._line[0],
            transmittance=inner.transmittance * self._share(offsets, q),
            length=inner.length,
        )

    def illuminate(self, across: ArrayLike, along: ArrayLike) -> tuple[Floats, Floats]:
        x, y = np.broadcast_arrays(as_offsets("across", across), as_offsets("along", along))
        c, s = np.cos(self._turn), np.sin(self._turn)
        q, weight = self.vessel.illuminate(x * c + y * s, y * c - x * s)
        slope, offset = self._line
        u = (q - offset) / slope
        return u, weight * self._share(u, q) / slope

    def check_fits(self, radius: float) -> None:
        self.vessel.check_fits(radius)
        if radius > self.lit_radius:
            raise TargetTooLarge(
                f"the target reaches {radius:.4g} mm from the axis, but light from the window {self.width:g} mm wide "
                f"reaches {self.lit_radius:.4g} mm; scale or center the target, use a wider bath, or tilt it less"
            )
        slope, offset = self._line
        left = float(self._share(np.array([-offset / slope]), np.zeros(1))[0])
        if left < LOW_TRANSMITTANCE:
            warnings.warn(
                f"window and liquid transmit {left:.3g} of the light, less than {LOW_TRANSMITTANCE:g}; use a longer "
                "exposure, or a clearer liquid",
                OpticsWarning,
                stacklevel=2,
            )
