"""Doses of frames at the corners of tolerances."""

from __future__ import annotations

from typing import Any

from vamgpu.methods.part import on_device
from vamgpu.methods.tolerances import Corner, CornerDoses, Tolerances, at, corner_doses
from vamgpu.operators.defocus import direct
from vamgpu.operators.projection import Projection
from vamgpu.operators.reductions import window
from vamgpu.printing.bodies import judged_parts
from vamgpu.printing.independent_exposure import IndependentExposure
from vamgpu.printing.simulate import ShownLight


def prove_corners(A: Any, frames: ShownLight, target: Any, tolerances: Tolerances) -> CornerDoses:
    """Doses of frames at every corner; arguments as for `simulate`. Raises `ToleranceError`, `BadInput`."""
    # Rays are traced for each corner if its operator is a `Projection`; otherwise the operator itself is used.
    A = direct(A)
    fraction, light = on_device(A, target), frames.irradiance(A.device)
    limits = getattr(target, "limits", None)
    reach = A.grid.inscribed_radius / A.grid.pitch * (1.0 + 1e-6)

    def measure(corner: Corner) -> tuple[float, float, float]:
        operator = at(A, corner)
        plain = isinstance(operator, Projection)
        dose = IndependentExposure(operator).averaged(light)[0] if plain else operator.T(light)
        parts = judged_parts(dose, fraction, limits)
        return window(parts.dose, parts.target, reach)

    return corner_doses(tolerances, measure)
