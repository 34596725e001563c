"""Resolution of light in the resin, and the voxels and angles that it needs."""

from __future__ import annotations

from math import ceil, isfinite
from typing import Any

import numpy as np

from vamgpu.geometry import FULL_TURN, Beam, Grid, Turntable, positive
from vamgpu.operators.ray_table import OpenAir
from vamgpu.schema.quantities import Length, measured

MOVED = 4.0
"""Largest number of pixels by which a point of the part may move from one angle to the next. A boat with a radius of
165 pixels has the same window one pixel from its surface, +0.12, with 180 angles (its rim moves by 5.8 pixels per step)
as with 1,080; it has +0.115 with 120 angles (8.6 pixels), and +0.08 with 90."""
RESTING = 0.5  # smallest share of a step that is assumed, for a container that rests while a frame is lit
WHOLE = 60
"""Divisor of the number of angles: steps are then whole fractions of a degree, and transforms over angles are fast."""
COARSER = 1.02  # ratio of the widths of a voxel and a pixel in the resin above which voxels count as wider


def resin_pixel(beam: Beam, vessel: Any = None) -> tuple[float, float]:
    """Size of a pixel in the resin, at the axis: refraction narrows columns, not rows.

    Args:
        beam: The pixels.
        vessel: The vessel that the light passes, as for a projector; None for air.

    Returns:
        Width across the light and height along z [mm].

    Raises:
        BadInput: The light does not reach the axis.
    """
    light = getattr(vessel, "plane", vessel) or OpenAir()  # for rising light, the plane is the vessel
    middle = float(light.illuminate(np.zeros(1), np.zeros(1))[0][0])
    edges = light.chords(middle + 0.5 * beam.pitch * np.array([-1.0, 1.0])).p
    rows: Any = getattr(vessel, "rows", None)  # a number if a vessel is graded, otherwise a map of rows
    stretch = 1.0
    if rows is not None and not isinstance(rows, int):
        stretch = float(np.ravel(rows(np.zeros(1), np.zeros(1))[1])[0])
    return float(abs(edges[1] - edges[0])), beam.pitch / stretch


def more_angles(motion: Turntable, width: float, radius: float) -> int:
    """Angles that a part of a radius [mm] needs for pixels of a width [mm]; 0 if those of the motion are enough."""
    turned = radius * float(max(motion.arcs.max(), RESTING * motion.steps.max()))
    if motion.angles < 2 or turned <= COARSER * MOVED * width:
        return 0
    return _whole(motion.angles * turned / (MOVED * width))


def enough_angles(beam: Beam, vessel: Any, radius: float | str, lit_share: float = 1.0) -> int:
    """Number of evenly spaced angles of a turn between which no point of a part moves farther than four pixels.

    The distance, in widths of a pixel in the resin, is how far the farthest point moves while a frame is lit or, if
    that is more, half of how far it moves to the next angle. Patterns optimized with the motion in
    the operator do not need more angles: see `MOVED`.

    Args:
        beam: The pixels.
        vessel: The vessel that the light passes, as for a projector; None for air.
        radius: Radius of the part about the axis [mm], or text with its unit.
        lit_share: Share of each step during which its frame is lit, 0 to 1, as for `Turntable`.

    Returns:
        A multiple of 60.

    Raises:
        BadInput: The radius is not above 0, or the light does not reach the axis.
    """
    way = FULL_TURN * positive("radius [mm]", measured("radius", radius, Length)) * max(lit_share, RESTING)
    return _whole(way / (MOVED * resin_pixel(beam, vessel)[0]))


def _whole(angles: float) -> int:
    """A number of angles, rounded up."""
    return WHOLE * ceil(angles / WHOLE * (1.0 - 1e-9))


def sampling_notes(operator: Any, radius: float) -> tuple[str, ...]:
    """Sentences about voxels or angles too coarse for an operator's pixels and a part of a radius [mm]."""
    grid, motion, beam = operator.grid, operator.motion, operator.beam
    if not (isinstance(grid, Grid) and isinstance(motion, Turntable)):
        return ()
    width, height = resin_pixel(beam, getattr(operator, "vessel", None))
    if not (isfinite(width) and width > 0.0):
        return ()
    found, least = [], width if beam.flat else min(width, height)
    if grid.pitch > COARSER * least:
        found.append(
            f"voxels of {1e3 * grid.pitch:.3g} µm are wider than a pixel in the resin, {1e3 * least:.3g} µm: only "
            "their mean dose is optimized, and the dose within them is unknown; use voxels of at most a pixel "
            "(vam.resin_pixel)"
        )
    if enough := more_angles(motion, width, radius):
        found.append(
            f"{motion.angles} angles are few for a part of {radius:.3g} mm about the axis: it moves by "
            f"{1e3 * radius * float(motion.steps.max()):.4g} µm from one to the next, and pixels are "
            f"{1e3 * width:.3g} µm wide in the resin; use {enough} angles, or wider pixels"
        )
    return tuple(found)
