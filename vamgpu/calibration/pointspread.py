"""The point spread of a projector, from its picture of an edge."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.calibration.fits import read_result
from vamgpu.errors import BadInput
from vamgpu.geometry import positive


@dataclass(frozen=True)
class PointSpread:
    """Blur of only the optics, for `Beam`: ``Beam(pixels, pitch, spread=PointSpread.load("mtf", pitch))``.

    Args:
        width: standard deviation of the blur [mm].

    Raises:
        BadInput: the width is not finite or below 0.
    """

    width: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "width", positive("PointSpread width [mm]", self.width, zero=True))

    @classmethod
    def behind(cls, blur: float, pitch: float, fill: float = 1.0, pixel: float = 0.0) -> PointSpread:
        """Subtract the blur of the pixels themselves from that of a measured edge.

        An edge of mirrors is a staircase: averaged along the edge, it is a step blurred by the lit box of one mirror,
        of variance fill · pitch² / 12; a camera's pixel adds pixel² / 12. A `Beam` already includes that box.

        Args:
            blur: standard deviation of the measured edge [mm], `EdgeResponse.width`.
            pitch: edge of the projector's pixel in the plane of the measurement [mm].
            fill: share of a pixel's area that is lit.
            pixel: of the camera, in the plane on which it focuses [mm].

        Raises:
            BadInput: a value out of its range, or a blur finer than the pixels alone make it.

        Returns:
            The blur of the optics alone.
        """
        seen, edge = positive("blur [mm]", blur), positive("pitch [mm]", pitch)
        boxes = (positive("fill", fill) * edge**2 + positive("pixel [mm]", pixel, zero=True) ** 2) / 12.0
        if seen**2 < boxes:
            raise BadInput(
                f"the edge is blurred by {1e3 * seen:.3g} µm, but projector pixels of {1e3 * edge:.3g} µm and camera "
                f"pixels of {1e3 * pixel:.3g} µm alone blur it by {1e3 * boxes**0.5:.3g} µm; expected a calibration "
                "made with this beam's pixels in this plane: correct the beam's pitch or measure again"
            )
        return cls(float((seen**2 - boxes) ** 0.5))

    @classmethod
    def load(cls, path: str | Path, pitch: float, fill: float = 1.0, at: float = 0.0) -> PointSpread:
        """Read the result of ``vam calibrate mtf``, at the position nearest to ``at`` [mm] along the light.

        Args:
            path: the folder of the result, or its ``result.toml``.
            pitch: edge of the projector's pixel at the camera's position [mm].
            fill: share of a pixel's area that is lit.
            at: position of the camera from the middle of its stage [mm]; 0 is where the axis of rotation will be.

        Raises:
            StorageError: the file cannot be read.
            BadInput: it holds no calibration of this kind, or a blur finer than the pixels.

        Returns:
            The blur there.
        """
        positions, blurs, pixel, _ = _measured(path)
        return cls.behind(float(blurs[np.argmin(np.abs(positions - at))]), pitch, fill, pixel)

    @classmethod
    def between(cls, path: str | Path, pitch: float, fill: float = 1.0, reach: float = inf) -> tuple[float, float]:
        """The least and the greatest blur along the light, from the result of ``vam calibrate mtf``.

        Args:
            path: the folder of the result, or its ``result.toml``.
            pitch: edge of the projector's pixel at the camera's position [mm].
            fill: share of a pixel's area that is lit.
            reach: extent of the part before and behind the axis [mm]; at least one position must be within it.

        Raises:
            StorageError: the file cannot be read.
            BadInput: it holds no calibration of this kind or near this position, or the blur is finer than the pixels.

        Returns:
            Both standard deviations [mm].
        """
        positions, blurs, pixel, file = _measured(path)
        near = blurs[np.abs(positions) <= reach]
        if not near.size:
            raise BadInput(
                f"{file!r} was measured at {positions.tolist()} mm; expected one within {reach:g} mm of the "
                "axis: use a greater reach, or measure there"
            )
        least, greatest = (cls.behind(float(blur), pitch, fill, pixel).width for blur in (near.min(), near.max()))
        return least, greatest


def _measured(path: str | Path) -> tuple[np.ndarray, np.ndarray, float, str]:
    """Positions, blurs and the camera's pixel [mm] of a result, and its file."""

    def numbers(found: dict[str, Any]) -> tuple[np.ndarray, np.ndarray, float]:
        positions, blurs = (np.array(found[name], dtype=np.float64) for name in ("positions_mm", "blur_mm"))
        return positions, blurs, float(found["pixel_mm"])

    (positions, blurs, pixel), file = read_result(path, "mtf", numbers)
    if positions.ndim != 1 or positions.shape != blurs.shape or not positions.size:
        raise BadInput(
            f"{file!r} has {positions.size} positions and {blurs.size} blurs; expected the same number of "
            "each, at least one: run vam calibrate mtf again"
        )
    return positions, blurs, pixel, file
