"""Refraction and reflection at one face between two clear media."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, get_args

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.optics.inputs import Floats

Index = float | Floats
Crossing = tuple[Floats, Floats, Index, Index]
"""Cosines of incidence and refraction at a face, and refractive indices before and behind it."""

Polarization = Literal["none", "s", "p"]
POLARIZATIONS: tuple[Polarization, ...] = get_args(Polarization)
"""Polarizations: none; field along the axis of the vial, parallel to every face; or field across the axis, in the plane
of incidence."""


def impact_after(impact: Floats, index_before: float, index_after: float) -> Floats:
    """Distance [mm] of a ray from a cylinder's axis after refraction: Snell's law conserves index · distance."""
    return impact * (index_before / index_after)


def refract(direction: Floats, normal: Floats, index_before: float, index_after: float) -> Floats:
    """Unit direction after refraction by Snell's law, (…, dimensions). Raises `BadInput` for total reflection."""
    ratio = index_before / index_after
    along = np.sum(direction * normal, axis=-1, keepdims=True)
    facing = np.where(along < 0, -normal, normal)
    cos_before = np.abs(along)
    square = 1.0 - ratio**2 * (1.0 - cos_before**2)
    if np.any(square < 0):
        steepest = np.degrees(np.arccos(np.min(cos_before)))
        raise BadInput(
            f"a ray meets the face at {steepest:.2f} degrees from index {index_before:g} into "
            f"{index_after:g} and is totally reflected; expected at most "
            f"{np.degrees(np.arcsin(1.0 / ratio)):.2f} degrees; bring the indices closer together"
        )
    return ratio * direction + (np.sqrt(square) - ratio * cos_before) * facing


def fresnel(cos_before: Floats, cos_after: Floats, index_before: Index, index_after: Index) -> Floats:
    """Shares of the power of s and of p light that cross a face, (…, 2), from the cosines of both angles."""
    s_in, s_out = index_before * cos_before, index_after * cos_after
    p_in, p_out = index_after * cos_before, index_before * cos_after
    both = 4.0 * s_in * s_out
    # For grazing rays both sums vanish; such rays transmit nothing.
    tiny = np.finfo(np.float64).tiny
    return np.stack([both / np.maximum((s_in + s_out) ** 2, tiny), both / np.maximum((p_in + p_out) ** 2, tiny)], -1)


def left(shares: Floats, polarization: str) -> Floats:
    """Transmitted share of the power, from that of s and p (..., 2); unpolarized light has half of each."""
    return shares.mean(axis=-1) if polarization == "none" else shares[..., POLARIZATIONS.index(polarization) - 1]


def transmittance(crossings: Iterable[Crossing], polarization: str = "none") -> Floats:
    """Share of the power that crosses all faces, each given by its arguments of `fresnel`."""
    # At every face s light stays s and p light stays p; each has its own product over the faces. Unpolarized light
    # keeps the mean of the two products. The product of the means differs: after the first face the light contains more
    # p, which the next face transmits better.
    return left(np.prod([fresnel(*crossing) for crossing in crossings], axis=0), polarization)


def polarized(name: str, value: object) -> str:
    """``value`` if it is one of `POLARIZATIONS`, else `BadInput`."""
    if not isinstance(value, str) or value not in POLARIZATIONS:
        raise BadInput(
            f"{name} is {value!r}; expected 'none' for unpolarized light, 's' for light whose field lies "
            "along the axis of rotation, or 'p' for light whose field lies across it"
        )
    return value
