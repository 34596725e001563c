"""The two domains of a web: wrapped about its roller, where light travels straight, and flat, where it is printed.

Wrapped: light towards +y, points (r·sinφ, −r·cosφ) with |φ| ≤ 90° about (0, 0), then straight runs. Flat: (l, rho).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np
from numpy.typing import ArrayLike

from vamgpu.errors import BadInput
from vamgpu.optics.inputs import Floats, as_offsets
from vamgpu.schema import check
from vamgpu.schema.quantities import Length, Thickness


@dataclass(frozen=True)
class WrapMap:
    """Wrapped (x, y) ↔ flat (l, rho), Toombs et al., Fig. 2A. Raises `BadInput`."""

    # l runs along the line that bending neither stretches nor shortens: l = middle + neutral·φ on the roller, and the
    # length itself along the straight runs; rho is the distance from the roller's side of the film. inner, outer: radii
    # of the film's faces [mm]. neutral: radius of the neutral line [mm]. leg: length of each straight run [mm].

    inner: Length
    outer: Length
    neutral: Length
    leg: Thickness

    def __post_init__(self) -> None:
        check(self)
        if not self.inner < self.outer or not self.inner <= self.neutral <= self.outer:
            raise BadInput(
                f"WrapMap has inner {self.inner:g}, neutral {self.neutral:g} and outer radius "
                f"{self.outer:g} mm; expected inner < outer and the neutral line between them"
            )

    @property
    def arc(self) -> float:
        """Length [mm] of the curved film along its neutral line."""
        return pi * self.neutral

    @property
    def length(self) -> float:
        """Length [mm] of the flat window: both straight runs and the curved film."""
        return self.arc + 2.0 * self.leg

    @property
    def middle(self) -> float:
        """l [mm] of the point nearest the light."""
        return 0.5 * self.length

    def wrapped(self, l: ArrayLike, rho: ArrayLike) -> tuple[Floats, Floats]:  # noqa: E741 - the web's axis
        """x, y [mm] of flat positions l, rho [mm], any shapes that broadcast."""
        along, depth = np.broadcast_arrays(as_offsets("l", l) - self.middle, as_offsets("rho", rho))
        phi = np.clip(along / self.neutral, -0.5 * pi, 0.5 * pi)
        beyond = np.maximum(np.abs(along) - 0.5 * self.arc, 0.0)
        radius = self.inner + depth
        return radius * np.sin(phi), beyond - radius * np.cos(phi)

    def flat(self, x: ArrayLike, y: ArrayLike) -> tuple[Floats, Floats]:
        """l, rho [mm] of wrapped positions x, y [mm], any shapes that broadcast; the inverse of `wrapped`."""
        across, down = np.broadcast_arrays(as_offsets("x", x), as_offsets("y", y))
        front = np.minimum(down, 0.0)
        along = self.neutral * np.arctan2(across, -front) + np.copysign(np.maximum(down, 0.0), across)
        return self.middle + along, np.hypot(across, front) - self.inner

    def inside(self, x: ArrayLike, y: ArrayLike) -> np.ndarray:
        """Boolean: whether wrapped positions lie in the film or its straight runs."""
        _, rho = self.flat(x, y)
        return (rho >= 0) & (rho <= self.outer - self.inner) & (np.asarray(y) <= self.leg)

    def jacobian(self, l: ArrayLike, rho: ArrayLike) -> Floats:  # noqa: E741 - the web's axis
        """Ratio of wrapped to flat area, and of flat to wrapped dose, at flat positions: r/neutral; straight: 1."""
        along, depth = np.broadcast_arrays(as_offsets("l", l) - self.middle, as_offsets("rho", rho))
        return np.where(np.abs(along) <= 0.5 * self.arc, (self.inner + depth) / self.neutral, 1.0)

    def path(self, x: ArrayLike, y: ArrayLike) -> Floats:
        """β = √(r_o² − x²) + y [mm]: path of unrefracted light to wrapped positions (S11); NaN outside the film."""
        across, down = np.broadcast_arrays(as_offsets("x", x), as_offsets("y", y))
        beta = np.sqrt(np.maximum(self.outer**2 - across**2, 0.0)) + down
        return np.where(self.inside(across, down), beta, np.nan)

    def absorbed(self, x: ArrayLike, y: ArrayLike, absorption: float) -> Floats:
        """α_V = α·exp(−α·β) [1/mm]: power per volume for unit irradiance, unrefracted (S15, S16); NaN outside."""
        return absorption * np.exp(-absorption * self.path(x, y))
