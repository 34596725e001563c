"""Measured angles as a vial meets them that turns at a constant speed: forward, and each once a turn."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.geometry import Turntable

FULL = 360
NANODEGREES = 10**9
"""Angles are whole ones of these: what a file writes comes back exactly."""


def rising(motion: Turntable) -> tuple[Fraction, ...]:
    """Angles [deg] of a turn, the first from 0 to below 360 and each beyond the one before it.

    Raises `BadInput` for poses that are lit for unequal times, and for angles that do not rise within one turn.
    """
    if motion.dwell is not None:
        raise BadInput(
            f"a schedule got {motion} angles; expected pictures that are lit as long, for mirrors take one time for "
            "all: solve for a Turntable without dwell"
        )
    degrees = [Fraction(round(angle * NANODEGREES), NANODEGREES) for angle in np.degrees(motion.poses).tolist()]
    late = next((k for k in range(1, len(degrees)) if degrees[k] <= degrees[k - 1]), None)
    if late is not None or degrees[-1] - degrees[0] >= FULL:
        last, first = (degrees[late], degrees[late - 1]) if late else (degrees[-1], degrees[0])
        raise BadInput(
            f"a schedule got angles that go from {float(first):.6g}° to {float(last):.6g}°; expected them to rise "
            "within one turn, as a vial turns forward: sort angles and pictures, and drop angles that come twice"
        )
    return tuple(angle - degrees[0] // FULL * FULL for angle in degrees)


def closest(angles: tuple[Fraction, ...]) -> Fraction:
    """The least way [deg] from one angle to the next, around the turn."""
    following = (*angles[1:], angles[0] + FULL)
    return min(after - angle for angle, after in zip(angles, following, strict=True))


def even_images(images: int | Turntable) -> int:
    """How many images a turn has that are even over it. Raises `BadInput` for a turntable that has others."""
    if not isinstance(images, Turntable):
        return images
    if not images.is_even:
        raise BadInput(
            f"a video cable got {images} angles; expected even ones over a full turn, each lit as long, for its "
            "pictures change at a fixed rate: solve for Turntable(angles=n), or print on triggered mirrors"
        )
    return images.angles
