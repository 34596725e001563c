"""Refraction and reflection at one face between two clear media."""

from __future__ import annotations

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.optics.inputs import Floats


def impact_after(impact: Floats, index_before: float, index_after: float) -> Floats:
    """Distance of a ray from the axis of a cylinder after refraction [mm].

    Snell's law at a surface of revolution keeps index * distance, whatever the radius of the surface.
    """
    return impact * (index_before / index_after)


def refract(direction: Floats, normal: Floats, index_before: float, index_after: float) -> Floats:
    """Unit direction after refraction, by Snell's law in vector form.

    Args:
        direction: unit vectors of travel, shape (..., dimensions).
        normal: unit normals of the face, either side, same shape.
        index_before: refractive index on the side the light comes from.
        index_after: refractive index on the other side.

    Raises:
        BadInput: a ray is totally reflected.
    """
    ratio = index_before / index_after
    along = np.sum(direction * normal, axis=-1, keepdims=True)
    facing = np.where(along < 0, -normal, normal)
    cos_before = np.abs(along)
    square = 1.0 - ratio**2 * (1.0 - cos_before**2)
    if np.any(square < 0):
        steepest = np.degrees(np.arccos(np.min(cos_before)))
        raise BadInput(f"a ray meets the face at {steepest:.2f} degrees from index {index_before:g} into "
                       f"{index_after:g} and is totally reflected; wanted at most "
                       f"{np.degrees(np.arcsin(1.0 / ratio)):.2f} degrees; bring the indices closer together")
    return ratio * direction + (np.sqrt(square) - ratio * cos_before) * facing


def transmittance(cos_before: Floats, cos_after: Floats, index_before: float, index_after: float) -> Floats:
    """Share of unpolarized power that crosses the face (Fresnel), the mean of both polarizations.

    Args:
        cos_before: cosine of the angle of incidence, at least 0.
        cos_after: cosine of the angle of refraction, at least 0.
        index_before: refractive index on the side the light comes from.
        index_after: refractive index on the other side.
    """
    across_in, across_out = index_before * cos_before, index_after * cos_after
    along_in, along_out = index_after * cos_before, index_before * cos_after
    both = 4.0 * across_in * across_out
    # Grazing rays make both sums vanish together; they transmit nothing.
    tiny = np.finfo(np.float64).tiny
    across = both / np.maximum((across_in + across_out) ** 2, tiny)
    along = both / np.maximum((along_in + along_out) ** 2, tiny)
    return 0.5 * (across + along)
