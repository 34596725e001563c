"""A camera of any size, orientation and exposure: its images, on the pixels of the beam."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil, floor, log2
from typing import Any

import numpy as np

from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.live.camera import Bits, SensorNoise
from vamgpu.printing.placement import Placement
from vamgpu.schema import check
from vamgpu.schema.quantities import NonNegative

Pair = tuple[float, float]
REACH = 1.5  # number of neighboring beam pixels, on either side, from which a pixel gets light
SHARPNESS = 0.5  # standard deviation of the point spread that a `MonitoringCamera` has by default [pixels of the beam]
SIXTEEN = 16  # most bits of a resampled image


@dataclass(frozen=True)
class SensorView:
    """Where the images of a camera show the pixels of the beam, or of the mirrors, and what its levels mean."""

    shape: tuple[int, int]  # rows and columns of an image
    matrix: tuple[Pair, Pair]  # camera pixels per beam pixel, ((row per row, row per column), (column per row, …))
    origin: Pair  # row and column of the camera that show pixel (0, 0) of the beam
    dark: NonNegative = 0.0  # gray level without light
    bits: Bits = 8  # per pixel

    def __post_init__(self) -> None:
        shape = tuple(int(length) for length in self.shape)
        if len(shape) != 2 or min(shape) < 1:
            raise BadInput(f"the shape of images is {self.shape}; expected rows and columns of at least 1")
        matrix, origin = np.array(self.matrix, float), np.array(self.origin, float)
        if matrix.shape != (2, 2) or origin.shape != (2,) or not abs(np.linalg.det(matrix)) > 0.0:
            raise BadInput(f"the camera's place is {self.matrix} and {self.origin}; expected a matrix [2, 2] that has "
                           "an inverse, and two numbers: run vam calibrate live again")  # fmt: skip
        for name, value in (("shape", shape), ("matrix", matrix.tolist()), ("origin", origin.tolist())):
            object.__setattr__(self, name, tuple(tuple(v) if isinstance(v, list) else v for v in value))
        check(self)

    @classmethod
    def described(
        cls, shape: tuple[int, int], pixels: tuple[int, int], scale: float, *, flip: bool = False, rotation: int = 0,
        dark: float = 0.0, bits: int = 8,
    ) -> SensorView:  # fmt: skip
        """The view of a camera centered on the mirrors; flip: mirrored left-right, then turned clockwise [deg]."""
        turns = round(rotation / 90) % 4
        cosine, sine = ((1, 0), (0, 1), (-1, 0), (0, -1))[turns]  # a point at the top goes to the right
        turn = np.array([[cosine, sine], [-sine, cosine]]) @ np.diag([1.0, -1.0 if flip else 1.0])
        matrix = scale * turn
        middles = (0.5 * (np.array(each, float) - 1.0) for each in (shape, pixels))
        origin = next(middles) - matrix @ next(middles)
        return cls(shape, _pairs(matrix), (float(origin[0]), float(origin[1])), dark, bits)

    def of_beam(self, settings: Placement, pixels: tuple[int, int], corner: tuple[int, int]) -> SensorView:
        """The view of a job's beam of ``pixels`` (columns, rows), from that of the mirrors; corner: row and column."""
        columns, rows = pixels
        (down, top), (across, left) = (
            _placed(rows, settings.shift[1], not settings.flip_z), _placed(columns, settings.shift[0], settings.flip_r)
        )  # fmt: skip
        matrix = np.array(self.matrix)
        origin = np.array(self.origin) + matrix @ (np.array([top, left]) + corner)
        return replace(self, matrix=_pairs(matrix * [down, across]), origin=(float(origin[0]), float(origin[1])))

    def finer(self, parts: int) -> SensorView:
        """The view of smaller pixels, ``parts`` along an edge of each."""
        matrix = np.array(self.matrix)
        origin = np.array(self.origin) + matrix @ np.full(2, 0.5 / parts - 0.5)
        return replace(self, matrix=_pairs(matrix / parts), origin=(float(origin[0]), float(origin[1])))

    def shown(self, image: np.ndarray) -> np.ndarray:
        """The camera's view [row, column] of an image on the beam's pixels, by the nearest one, also beyond edges."""
        row, column = self._nearest
        return image[np.clip(row, 0, image.shape[0] - 1), np.clip(column, 0, image.shape[1] - 1)]

    @cached_property
    def _nearest(self) -> np.ndarray:
        """Row and column of the beam nearest to each pixel of the camera, [2, row, column]."""
        at = np.indices(self.shape).reshape(2, -1) - np.array(self.origin)[:, None]
        return np.rint(np.linalg.inv(np.array(self.matrix)) @ at).astype(int).reshape(2, *self.shape)

    @property
    def orientation(self) -> str:
        """How the images are mirrored and turned, in words."""
        matrix = np.array(self.matrix)
        flipped = float(np.linalg.det(matrix)) < 0.0
        turn = matrix @ np.diag([1.0, -1.0 if flipped else 1.0])
        angle = float(np.degrees(np.arctan2(turn[0, 1] - turn[1, 0], turn[0, 0] + turn[1, 1])))
        return f"{'mirrored, ' if flipped else ''}turned by {angle:.2f}°"


def _placed(length: int, shift: float, flipped: bool) -> Pair:
    """Mirrors per pixel and the mirror of pixel 0, along one axis."""
    return (-1.0, length - 1.0 - shift) if flipped else (1.0, shift)


def _pairs(matrix: np.ndarray) -> tuple[Pair, Pair]:
    (a, b), (c, d) = matrix.tolist()
    return (a, b), (c, d)


class BeamImages:
    """Images of a camera on the pixels (columns, rows) of the beam, with the noise of one pixel. Raises `BadInput`."""

    view: SensorView
    pixels: tuple[int, int]

    def __init__(self, view: SensorView, pixels: tuple[int, int]) -> None:
        self.view, self.pixels = view, (int(pixels[0]), int(pixels[1]))
        if not self._known.any():
            raise BadInput(f"the camera's images of {view.shape[0]} × {view.shape[1]} show no pixel of the beam; "
                           "expected a crop, pixel and place for which they do: run vam calibrate live")  # fmt: skip

    def __call__(self, image: np.ndarray) -> np.ndarray:
        """Levels on the pixels of the beam, [row, column], NaN beyond the camera's view. Raises `ShapeMismatch`."""
        given = np.asarray(image)
        if given.shape != self.view.shape:
            raise ShapeMismatch(f"the camera's images have {' × '.join(map(str, given.shape))} pixels; expected "
                                f"{self.view.shape[0]} × {self.view.shape[1]}: set crop and binning in [[feedback]] as "
                                "they were in vam calibrate live")  # fmt: skip
        levels = given.ravel().astype(np.float32)
        seen = self.scale * (self._table @ levels - self.view.dark)
        over = self._table @ (levels >= 2**self.view.bits - 1)
        seen = np.where(over > 0.0, self._brightest, np.clip(seen, 0.0, self._brightest))
        return np.where(self._known, seen, np.nan).astype(np.float32).reshape(self.pixels[::-1])

    def noise(self, noise: SensorNoise) -> SensorNoise:
        """Noise of the levels that a call returns, from that of the camera's levels."""
        share = self.scale / self._most
        return SensorNoise(noise.read * share, noise.gain / self.scale * share**2, self._bits)

    @property
    def _brightest(self) -> float:
        return float(2**self._bits - 1)

    @cached_property
    def _bits(self) -> int:
        return min(ceil(self.view.bits + log2(self._most)), SIXTEEN)

    @cached_property
    def _most(self) -> float:
        """Scale by which the mean of camera pixels has the noise of one."""
        squares = self._table.multiply(self._table).sum(axis=1)
        return 1.0 / float(np.sqrt(np.median(np.asarray(squares).ravel()[self._known])))

    @cached_property
    def scale(self) -> float:
        """Levels of a resampled image per level of the camera."""
        return min(self._most, 2.0 ** (SIXTEEN - self.view.bits))

    @cached_property
    def _known(self) -> np.ndarray:
        return np.asarray(self._table.sum(axis=1)).ravel() > 1.0 - 1e-3

    @cached_property
    def _table(self) -> Any:
        """Weights (beam pixels, camera pixels)."""
        from scipy.sparse import csr_matrix  # takes longer to load than all of vamgpu
        from scipy.special import ndtr

        columns, rows = self.pixels
        matrix, (height, width) = np.array(self.view.matrix), self.view.shape
        per_pixel = ceil(2.0 * max(float(np.linalg.norm(matrix, 2)), 1.0))
        steps = (np.arange(floor((2.0 * REACH + 1.0) * per_pixel)) + 0.5) / per_pixel - (REACH + 0.5)
        spread = ndtr((steps + 0.5) / SHARPNESS) - ndtr((steps - 0.5) / SHARPNESS)
        spread /= spread.sum()
        row, column = (axis.ravel() for axis in np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij"))
        table, number = csr_matrix((rows * columns, height * width), dtype=np.float32), np.arange(rows * columns)
        for down, weight in zip(steps, spread, strict=True):
            places, entries = [], []
            for across, share in zip(steps, spread, strict=True):
                y, x = matrix @ np.stack([row + down, column + across]) + np.array(self.view.origin)[:, None]
                i, k = np.rint(y).astype(int), np.rint(x).astype(int)
                inside = (i >= 0) & (k >= 0) & (i < height) & (k < width)
                places.append((number[inside], (i * width + k)[inside]))
                entries.append(np.full(int(inside.sum()), weight * share, np.float32))
            at = tuple(np.concatenate(each) for each in zip(*places, strict=True))
            table = table + csr_matrix((np.concatenate(entries), at), shape=table.shape)
        return table
