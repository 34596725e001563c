"""Two channels that cross over each other.

Source: A. Orth et al., Automatic exposure volumetric additive manufacturing, Fig. S4.
"""

from __future__ import annotations

from itertools import pairwise

from manifold3d import Manifold

from vamgpu.targets.shapes.csg import Point, box, rod, to_solid, union
from vamgpu.targets.solid import Solid


def crossing_channels(width: float = 0.3, size: float = 8.0, thickness: float = 2.4, bridge: float = 0.6) -> Solid:
    """A block with two square channels; the second climbs over the first on a bridge.

    Each channel ends in two round ports that open to the top, for flushing.

    Args:
        width: Side of the square cross section [mm].
        size: Edge of the block [mm].
        thickness: Thickness of the block [mm].
        bridge: Solid material between the channels where they cross [mm].

    Returns:
        The block.
    """
    half, reach, base, top = 0.5 * size, 0.5 * size - 1.0, -0.25 * thickness, 0.5 * thickness
    high, ramp = base + width + bridge, 1.5
    block = box((-half, -half, -top), (half, half, top))
    lower: list[Point] = [(-reach, 0.0, base), (reach, 0.0, base)]
    upper: list[Point] = [
        (0.0, -reach, base),
        (0.0, -ramp, base),
        (0.0, -ramp, high),
        (0.0, ramp, high),
        (0.0, ramp, base),
        (0.0, reach, base),
    ]
    ports = [
        rod((x, y, base - 0.5 * width), (x, y, top + 1.0), 2.0 * width) for x, y, _ in (*lower, upper[0], upper[-1])
    ]
    return to_solid(block - union([_duct(lower, width), _duct(upper, width), *ports]), "crossing_channels")


def _duct(path: list[Point], width: float) -> Manifold:
    reach = 0.5 * width
    pieces = []
    for start, end in pairwise(path):
        low = (min(start[0], end[0]) - reach, min(start[1], end[1]) - reach, min(start[2], end[2]) - reach)
        high = (max(start[0], end[0]) + reach, max(start[1], end[1]) + reach, max(start[2], end[2]) + reach)
        pieces.append(box(low, high))
    return union(pieces)
