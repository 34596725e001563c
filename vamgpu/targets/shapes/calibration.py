"""The exposure calibration disk of A. Orth et al., Automatic exposure volumetric additive manufacturing (Fig. 2a)."""

from __future__ import annotations

import numpy as np
from manifold3d import CrossSection, OpType

from vamgpu.targets.shapes.csg import to_solid
from vamgpu.targets.solid import Solid

SPOKES_PX = (1, 2, 3, 4, 5, 6, 7)  # widths of the two spokes that hold each of the first seven half disks [pixels]
GAPS_PX = (2, 3, 4, 5, 6, 7, 8)  # widths of the gap behind which each of the other seven half disks floats [pixels]

_SEGMENTS = 256


def exposure_disk(
    diameter: float = 12.0,
    thickness: float = 2.0,
    pixel: float = 0.067,
    half_disk_radius: float = 1.0,
    spoke_spacing: float = 1.0,
) -> Solid:
    """A disk with 14 half disks around it: seven on two spokes of 1..7 pixels, seven behind gaps of 2..8 pixels.

    The gaps are concentric with the disk and therefore have constant widths; the spokes bridge the widest gap. A
    flawless print keeps the seven half disks on spokes and none of the others: a figure of merit of 7 (their eq. 2).

    Args:
        diameter: Diameter of the disk [mm].
        thickness: Thickness of the disk [mm].
        pixel: Unit of the spokes and gaps [mm].
        half_disk_radius: Radius of each half disk [mm].
        spoke_spacing: Distance between the two spokes of a half disk [mm].

    Returns:
        The disk.
    """
    return to_solid(
        exposure_outline(diameter, pixel, half_disk_radius, spoke_spacing).extrude(thickness), "exposure_disk"
    )


def exposure_outline(
    diameter: float = 12.0, pixel: float = 0.067, half_disk_radius: float = 1.0, spoke_spacing: float = 1.0
) -> CrossSection:
    """The plane figure of exposure_disk; arguments in mm."""
    rim = 0.5 * diameter
    parts = [CrossSection.circle(rim, _SEGMENTS)]
    turn = 360.0 / (len(SPOKES_PX) + len(GAPS_PX))
    standoff = max(GAPS_PX) * pixel
    for index, width in enumerate(SPOKES_PX):
        spoked = _half_disk(rim + standoff, half_disk_radius)
        for side in (-0.5, 0.5):
            # From well inside the disk to well inside the half disk.
            spoke = CrossSection.square((standoff + half_disk_radius, width * pixel), True)
            spoked += spoke.translate((rim + 0.5 * standoff, side * spoke_spacing))
        parts.append(spoked.rotate(turn * index))
    for index, gap in enumerate(GAPS_PX, start=len(SPOKES_PX)):
        parts.append(_half_disk(rim + gap * pixel, half_disk_radius).rotate(turn * index))
    return CrossSection.batch_boolean(parts, OpType.Add)


def _half_disk(inner_radius: float, radius: float) -> CrossSection:
    whole = CrossSection.circle(radius, 64).translate((inner_radius, 0.0))
    # A polygon's edges lie inside its circle; the cut uses a polygon around the circle to keep the gap's width.
    return whole - CrossSection.circle(inner_radius / float(np.cos(np.pi / _SEGMENTS)), _SEGMENTS)
