"""Figure of merit of a print of the calibration disk, from its connected parts: A. Orth et al., Automatic exposure
volumetric additive manufacturing, Fig. 2 and eq. 2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, pi, sin

import numpy as np
import numpy.typing as npt

from vamgpu.errors import BadInput
from vamgpu.geometry import centers, positive
from vamgpu.targets.shapes.calibration import GAPS_PX, SPOKES_PX

FORMED = 0.5  # share of a half disk that must be solid for it to count as formed


@dataclass(frozen=True)
class Merit:
    """Half disks of a print. spokes, gaps: one boolean each, True if it is connected to the disk."""

    spokes: tuple[bool, ...]
    gaps: tuple[bool, ...]

    @property
    def figure(self) -> int:
        """Spoked half disks connected − gapped half disks connected; 7 for an ideal print (eq. 2)."""
        return sum(self.spokes) - sum(self.gaps)

    @property
    def least_spoke(self) -> int | None:
        """Width [pixels] of the thinnest spokes that hold, or None."""
        return min((w for w, held in zip(SPOKES_PX, self.spokes, strict=True) if held), default=None)

    @property
    def least_gap(self) -> int | None:
        """Width [pixels] of the narrowest gap that stayed open, or None."""
        return min((w for w, held in zip(GAPS_PX, self.gaps, strict=True) if not held), default=None)


def merit(
    printed: npt.ArrayLike, pitch: float, diameter: float = 12.0, pixel: float = 0.067, half_disk_radius: float = 1.0
) -> Merit:
    """Judge a print of `exposure_disk` by connected components of solid voxels; the disk is the component at the axis.

    A half disk counts as connected if at least half of it is solid and part of the component of the disk.

    Args:
        printed: Boolean [x, y] or [x, y, z]; voxels that share a face are connected.
        pitch: Pitch of the voxels [mm].
        diameter: Diameter of the disk [mm].
        pixel: Width of a pixel [mm].
        half_disk_radius: Radius of the half disks [mm].

    Returns:
        The half disks that are connected.

    Raises:
        BadInput: The shape is wrong, or the middle of the disk is not solid.
    """
    from scipy.ndimage import label

    solid = np.asarray(printed, bool)
    if solid.ndim not in (2, 3):
        raise BadInput(f"the print has shape {solid.shape}; expected [x, y] or [x, y, z]")
    solid = solid if solid.ndim == 3 else solid[:, :, None]
    pitch = positive("pitch [mm]", pitch)
    labels = np.asarray(label(solid)[0])  # type: ignore[index]
    x, y = (centers(n, pitch) for n in solid.shape[:2])
    middle = (x[:, None] ** 2 + y[None, :] ** 2) < (0.25 * diameter) ** 2
    found = labels[middle & solid.any(axis=2)]
    found = found[found > 0]
    if not len(found):
        raise BadInput("no voxel of the middle of the disk is solid; expose longer, or center the print on the axis")
    whole = labels == np.bincount(found).argmax()
    rim, standoff, turn = 0.5 * diameter, max(GAPS_PX) * pixel, 2 * pi / (len(SPOKES_PX) + len(GAPS_PX))
    starts = [rim + standoff] * len(SPOKES_PX) + [rim + gap * pixel for gap in GAPS_PX]
    held = []
    for k, start in enumerate(starts):
        flat = _half(x, y, turn * k, start, half_disk_radius)
        held.append(bool(whole[flat].mean() >= FORMED))
    return Merit(tuple(held[: len(SPOKES_PX)]), tuple(held[len(SPOKES_PX) :]))


def _half(x: npt.NDArray[np.float64], y: npt.NDArray[np.float64], angle: float, start: float,
          radius: float) -> npt.NDArray[np.bool_]:  # fmt: skip
    """Boolean [x, y]: the half disk whose straight side is ``start`` [mm] from the axis."""
    out = x[:, None] * cos(angle) + y[None, :] * sin(angle)
    across = y[None, :] * cos(angle) - x[:, None] * sin(angle)
    return (np.hypot(out - start, across) <= radius) & (np.hypot(out, across) >= start)


def acceptable(stops: Sequence[float], figures: npt.ArrayLike, above: float = 2.0) -> tuple[float, float] | None:
    """Ends of the longest run of rising stops whose mean figure [stop, replicate] is above FOM 2. Raises `BadInput`."""
    values = np.asarray(figures, np.float64)
    if values.ndim != 2 or len(values) != len(stops) or np.any(np.diff(stops) <= 0):
        raise BadInput(f"{len(stops)} stops and figures {values.shape}; expected rising stops and [stop, replicate]")
    good, best, start = values.mean(axis=1) > above, (0, 0), 0
    for k in range(len(good) + 1):
        if k == len(good) or not good[k]:
            best = max(best, (k - start, start), key=lambda run: run[0])
            start = k + 1
    return (float(stops[best[1]]), float(stops[best[1] + best[0] - 1])) if best[0] else None
