"""A pair of meshing spur gears and their base, to test fits.

Source: A. Orth et al., Automatic exposure volumetric additive manufacturing, Fig. 6c.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from manifold3d import CrossSection

from vamgpu.targets.shapes.csg import polygon, rod, to_solid
from vamgpu.targets.solid import Solid

TEETH = 14
MODULE = 0.45  # pitch diameter per tooth [mm]
PRESSURE_ANGLE = np.radians(25.0)  # wide enough for 14 teeth without undercut
PIN_DIAMETER = 3.0  # pins of the base [mm], as in the source
CENTER_DISTANCE = TEETH * MODULE  # distance between the two pins [mm]


def gears(gap: float = 0.1, thickness: float = 3.0, apart: float = 0.4) -> Solid:
    """Two spur gears side by side; after the print they go on the pins of `gear_base`.

    Args:
        gap: Distance between pin and bore walls, and also the backlash at the pitch circle [mm] (the source prints 0,
            0.05 and 0.1 mm).
        thickness: Face width [mm].
        apart: Distance between the tip circles as printed [mm].

    Returns:
        Both gears.
    """
    outline = gear_outline(gap) - CrossSection.circle((0.5 * PIN_DIAMETER + gap) / np.cos(np.pi / 96), 96)
    gear = outline.extrude(thickness)
    offset = 0.5 * TEETH * MODULE + MODULE + 0.5 * apart
    pair = gear.translate((-offset, 0.0, 0.0)) + gear.translate((offset, 0.0, 0.0))
    return to_solid(pair, f"gears_{round(gap * 1000)}um")


def gear_base(thickness: float = 1.5, pin_height: float = 4.5) -> Solid:
    """A plate with two pins of 3 mm diameter at the gears' center distance.

    Args:
        thickness: Thickness of the plate [mm].
        pin_height: Height of the pins [mm].

    Returns:
        The plate.
    """
    x = 0.5 * CENTER_DISTANCE
    plate = (
        rod((-x, 0, 0), (-x, 0, thickness), 2.5, segments=96) + rod((x, 0, 0), (x, 0, thickness), 2.5, segments=96)
    ).hull()
    for side in (-x, x):
        plate += rod((side, 0.0, 0.0), (side, 0.0, thickness + pin_height), 0.5 * PIN_DIAMETER, segments=96)
    return to_solid(plate, "gear_base")


def gear_outline(backlash: float = 0.0) -> CrossSection:
    """One gear in the plane, without a bore; a pair has the given backlash at the pitch circle [mm]."""
    pitch_radius = 0.5 * TEETH * MODULE
    base, tip, root = pitch_radius * np.cos(PRESSURE_ANGLE), pitch_radius + MODULE, pitch_radius - 1.25 * MODULE
    tooth = 0.5 * np.pi * MODULE - 0.5 * backlash
    radius = np.linspace(base, tip, 12)
    half = 0.5 * tooth / pitch_radius + _involute(PRESSURE_ANGLE) - _involute(np.arccos(base / radius))
    right = np.stack([np.concatenate([[root], radius]), -np.concatenate([[half[0]], half])], axis=1)
    crest = np.stack([np.full(3, tip), np.linspace(-0.5, 0.5, 3) * half[-1]], axis=1)
    left = right[::-1] * (1.0, -1.0)
    one = np.concatenate([right, crest, left])
    turns = 2.0 * np.pi * np.arange(TEETH) / TEETH
    polar = np.concatenate([one + (0.0, turn) for turn in turns])
    return polygon(polar[:, :1] * np.stack([np.cos(polar[:, 1]), np.sin(polar[:, 1])], axis=1))


def _involute(angle: npt.ArrayLike) -> npt.NDArray[np.float64]:
    return np.tan(angle) - np.asarray(angle)
