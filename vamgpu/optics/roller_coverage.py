"""From how many angles light reaches a film about a roller, and what Fresnel's loss costs of them."""

from __future__ import annotations

from dataclasses import dataclass
from math import asin, pi, sin

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.optics.faces import transmit
from vamgpu.optics.film import Film


@dataclass(frozen=True)
class Coverage:
    """Angles to the normal of the film, both sides together [rad].

    outer: of light that has just crossed the outer face, 2·asin(m) (Toombs et al., S11).  inner: of light that comes to
    the roller; the normal turns as a ray goes inwards, so that this is more.  limit: largest gain.  clipped: angle of
    incidence in the bath from which on 1/T is above the limit.  lost: part of ``outer`` that is so clipped.
    lost_incidence: the same as a range of angles of incidence.
    """

    outer: float
    inner: float
    limit: float
    clipped: float
    lost: float
    lost_incidence: float


def coverage(film: Film, radius: float, limit: float, polarization: str = "none") -> Coverage:
    """Coverage of a film on a roller of this radius [mm] by light of a polarization.

    Raises `BadInput` for a limit below 1.
    """
    if not limit >= 1.0:
        raise BadInput(f"the largest gain is {limit!r}; wanted at least 1")
    outer, faces = radius + film.thickness, film.faces(radius)
    reach = min(outer, *(face.aperture for face in faces))
    low, high = 0.0, reach
    for _ in range(80):
        middle = 0.5 * (low + high)
        through = float(transmit(faces, np.array(middle), polarization))
        low, high = (middle, high) if through >= 1.0 / limit else (low, middle)
    enters = asin(min(1.0, film.ratio * reach / outer))
    clipped = asin(low / outer)
    kept = asin(min(1.0, film.ratio * sin(clipped)))
    inner = asin(min(1.0, film.ratio * reach / radius))
    return Coverage(2.0 * enters, 2.0 * inner, limit, clipped, 2.0 * (enters - kept), pi - 2.0 * clipped)
