"""Concentric cylindrical faces that a ray crosses on its way to the resin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vamgpu.optics.inputs import Floats
from vamgpu.optics.interface import transmittance

# Keeps the slope of the deviation finite at grazing incidence; far below the rounding error of a cosine there.
SMALLEST_COSINE = 1e-9


@dataclass(frozen=True)
class Face:
    """A cylinder about the axis, of a radius [mm], crossed inwards; columns are counted in the bath."""

    radius: float
    outer_index: float
    inner_index: float
    bath_index: float

    @property
    def aperture(self) -> float:
        """Largest column offset that crosses this face: a ray beyond it misses or is totally reflected [mm]."""
        return self.radius * min(self.outer_index, self.inner_index) / self.bath_index

    def sines(self, u: Floats) -> tuple[Floats, Floats]:
        """Sines of the angles of incidence and refraction for the columns u [mm]."""
        scale = self.bath_index / self.radius
        return u * (scale / self.outer_index), u * (scale / self.inner_index)


def _cosine(sine: Floats) -> Floats:
    return np.maximum(np.sqrt(np.maximum((1.0 - sine) * (1.0 + sine), 0.0)), SMALLEST_COSINE)


def turn(faces: Sequence[Face], u: Floats) -> tuple[Floats, Floats, Floats]:
    """Cosine and sine of the total deviation, a product of unit complex numbers, and its slope [rad/mm] for u [mm]."""
    cos_all, sin_all, slope = np.ones_like(u), np.zeros_like(u), np.zeros_like(u)
    for face in faces:
        sin_in, sin_out = face.sines(u)
        cos_in, cos_out = _cosine(sin_in), _cosine(sin_out)
        cos_one, sin_one = cos_in * cos_out + sin_in * sin_out, sin_in * cos_out - cos_in * sin_out
        cos_all, sin_all = cos_all * cos_one - sin_all * sin_one, sin_all * cos_one + cos_all * sin_one
        scale = face.bath_index / face.radius
        slope += scale / (face.outer_index * cos_in) - scale / (face.inner_index * cos_out)
    return cos_all, sin_all, slope


def transmit(faces: Sequence[Face], u: Floats, polarization: str = "none") -> Floats:
    """Share of the power that crosses all the faces, for the columns u [mm]; ``polarization`` as in `transmittance`."""
    sines = (face.sines(u) for face in faces)
    return transmittance(
        [(_cosine(sin_in), _cosine(sin_out), face.outer_index, face.inner_index)
         for face, (sin_in, sin_out) in zip(faces, sines, strict=True)], polarization)  # fmt: skip
