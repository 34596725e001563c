"""The vial correction of the papers' recipes: light for straight rays, re-sorted to the rays that a vessel bends."""

from __future__ import annotations

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput
from vamgpu.geometry import Vessel
from vamgpu.kernels.rebin import rebin_rays
from vamgpu.methods.plan import Plan
from vamgpu.operators.projection import Projection

WEAKEST = 0.2
"""Transmittance below which light is not compensated further: at grazing incidence 1 / T grows without limit."""


def rebin(plan: Plan, operator: Projection) -> DeviceArray:
    """Light [angle, r, z] for ``operator``, which has a vessel, from a plan made for straight rays of the same motion.

    Column u at angle θ shines along the straight ray at distance p(u) from the axis and angle θ + d(u). Its power per
    column is reduced by p′(u) and by the transmittance; both are compensated. Absorption is not compensated. Source: A.
    Orth et al., Opt. Express 29 (2021) 11037.

    Args:
        plan: A plan for straight rays.
        operator: An operator with a vessel, of the same motion and rows.

    Returns:
        Light [angle, r, z] for the operator.

    Raises:
        BadInput: The plan itself has a vessel, other angles or other rows; or the angles are not even over a full turn,
            which is needed to move light by the same number of steps at every angle.
    """
    source, vessel = plan.operator, operator.vessel
    if not isinstance(source, Projection) or source.vessel is not None or vessel is None:
        raise BadInput("rebin takes a plan for straight rays (vessel=None) to an operator with a vessel")
    if source.motion.stepped != operator.motion.stepped or source.beam.pixels[1] != operator.beam.pixels[1]:
        raise BadInput(
            f"the plan has {source.motion} and {source.beam.pixels[1]} rows; expected {operator.motion} and "
            f"{operator.beam.pixels[1]}: plan for the same angles and rows"
        )
    if not source.motion.is_even:
        raise BadInput(
            f"rebin got {source.motion} angles; expected even ones over a full turn, each lit equally long, because a "
            "ray that a vessel turns belongs to another angle: otherwise optimize with the vessel in the operator"
        )
    if source.device is not operator.device:
        raise BadInput(f"the plan is on {source.device}, the operator on {operator.device}; use one device for both")
    light = operator.device.empty(operator.range.shape)
    rays = operator.device.table(_rays(source, operator, vessel))
    operator.device.launch(rebin_rays, parallel=plan.sinogram, rays=rays, light=light)
    return light


def _rays(source: Projection, operator: Projection, vessel: Vessel) -> np.ndarray:
    """(columns, 3): turn in steps of the angle, column of the straight beam, gain."""
    u, pitch = operator.beam.columns(), operator.beam.pitch
    chords = vessel.chords(u)
    below, above = (vessel.chords(u + 0.5 * side * pitch).p for side in (-1, 1))
    spacing = (above - below) / pitch
    turn = chords.angle / (2.0 * np.pi) * operator.motion.angles
    column = chords.p / source.beam.pitch + 0.5 * (source.beam.pixels[0] - 1)
    gain = np.where(chords.transmittance > 0, spacing / np.maximum(chords.transmittance, WEAKEST), 0.0)
    return np.stack([turn, column, gain], axis=-1)
