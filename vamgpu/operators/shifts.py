"""Moved images: an axis that wobbles with its vessel, and tiles of a beam that moves along z."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, floor
from typing import Any, ClassVar, final

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import Beam
from vamgpu.kernels.shift import shift_images
from vamgpu.operators.compose import Derived, inherit
from vamgpu.operators.linear import LinearOperator
from vamgpu.operators.space import require
from vamgpu.operators.wobble import Wobble, check_reach
from vamgpu.schema.quantities import Count, Place
from vamgpu.travel import at_rest


class Shift:
    """Moves images by fractions of a pixel, forward and back, by linear interpolation."""

    # moves: (images, 2), distance in columns and rows from a moved pixel to its place in the source, counted from the
    # middle. source, moved: shapes (columns, rows) of the images.

    def __init__(self, device: Device, moves: np.ndarray, source: tuple[int, int], moved: tuple[int, int]) -> None:
        start = moves + 0.5 * (np.array(source) - 1) - 0.5 * (np.array(moved) - 1)
        start = np.where(np.abs(start - np.round(start)) < 1e-6, np.round(start), start)
        self.device = device
        self._there, self._back = (  # the whole and the part of each move
            device.table(np.stack([np.floor(s), s - np.floor(s)], axis=2).reshape(-1, 4)) for s in (start, -start)
        )

    def there(self, source: DeviceArray, tapers: DeviceArray, moved: DeviceArray) -> None:
        """moved = tapers × the source's images, moved."""
        self._launch(source, self._there, tapers, 1, moved)

    def back(self, moved: DeviceArray, tapers: DeviceArray, source: DeviceArray) -> None:
        """The transpose of ``there``."""
        self._launch(moved, self._back, tapers, 0, source)

    def _launch(self, source: Any, moves: DeviceArray, tapers: DeviceArray, after: int, out: DeviceArray) -> None:
        given = {"source": source, "moves": moves, "tapers": tapers, "after": after, "moved": out}
        self.device.launch(shift_images, **given, lanes=source)


class _Moved(Derived):
    """A projector whose images are moved."""

    _shift: Shift
    _tapers: DeviceArray

    def __init__(self, operator: LinearOperator) -> None:
        if not isinstance(operator, LinearOperator) or not hasattr(operator.range, "beam"):
            raise BadInput(
                f"{type(self).__name__} got {operator!r}; expected a projector from a volume to the pixels of a beam"
            )
        self.operator: LinearOperator = operator
        self._set_spaces(operator.domain, operator.range, operator.device)
        inherit(self, operator)

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        still = self.device.empty(self.operator.range.shape)
        self.operator.forward(x, still)
        self._shift.there(still, self._tapers, out)

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        still = self.device.empty(self.operator.range.shape)
        self._shift.back(y, self._tapers, still)
        self.operator.transposed(still, out)


@final
class Wobbled(_Moved):
    """A projector whose axis moves with its vessel from angle to angle: its images move along r.

    Only `Wobble.across` moves them, by fractions of a pixel: parallel light is the same along its whole path. For other
    light, give the wobble to `Oblique`, which also needs no interpolation.

    Args:
        operator: Any projector to [angle, r, z].
        wobble: Positions of the axis.

    Raises:
        BadInput: The axis leaves the beam.
    """

    def __init__(self, operator: LinearOperator, wobble: Wobble) -> None:
        super().__init__(operator)
        self.wobble: Wobble = wobble
        images: Any = operator.range
        beam, poses = images.beam, images.shape[0]
        across = wobble.places(poses)[:, 0]
        check_reach(across, beam)
        moves = np.stack([-across / beam.pitch, np.zeros(poses)], axis=1)
        self._shift = Shift(self.device, moves, beam.pixels, beam.pixels)
        self._tapers = self.device.table(np.ones((1, beam.pixels[1])))

    def __repr__(self) -> str:
        return f"Wobbled({self.operator!r}, {self.wobble!r})"


@dataclass(frozen=True)
class TiledSpace:
    """Images of a beam at several heights, tile after tile, axes ``[tile · angle, r, z]``."""

    beam: Beam
    poses: int
    tiles: int
    axes: ClassVar[tuple[str, str, str]] = ("tile · pose", "r", "z")

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of tiles times angles, columns and rows."""
        return (self.tiles * self.poses, *self.beam.pixels)


@final
class Tiles(_Moved):
    """A volume taller than the beam, exposed in turn with the beam at several heights; range [tile·angle, r, row].

    Optimize with the tall projector, then `split` its light. Tiles overlap with complementary weights: together they
    give the tall light's dose, and a slightly misplaced beam leaves no seam. Or optimize the tiles themselves.

    Args:
        operator: A projector whose tall beam covers the volume.
        rows: Rows of the machine's beam.
        overlap: Smallest number of rows that neighbors share.
        centers: Middles of the tiles along z [mm], in their order, (tiles,); None for even ones at whole rows.

    Raises:
        BadInput: The overlap is at least as high as the beam, tiles leave a gap, or the part moves (`Travel`).
    """

    centers: np.ndarray

    def __init__(
        self, operator: LinearOperator, rows: Count, overlap: int = 0,
        centers: Sequence[Place] | np.ndarray | None = None,
    ) -> None:  # fmt: skip
        super().__init__(operator)
        at_rest("Tiles", getattr(operator, "motion", None))
        if not 0 <= overlap < rows:
            raise BadInput(f"tiles of {rows} rows overlap by {overlap}; expected 0 or more, and fewer than the rows")
        images: Any = operator.range
        tall: Beam = images.beam
        self.centers = _spread(tall, rows, overlap) if centers is None else np.atleast_1d(np.asarray(centers, float))
        self.tapers: np.ndarray = _tapers(tall, rows, self.centers)
        tile, poses = Beam((tall.pixels[0], rows), tall.pitch), operator.range.shape[0]
        self.range: Any = TiledSpace(tile, poses, len(self.centers))
        moves = np.repeat(self.centers / tall.pitch, poses)
        both = np.stack([np.zeros(len(moves)), moves], axis=1)
        self._shift = Shift(self.device, both, tall.pixels, tile.pixels)
        self._tapers, self._tapered = (self.device.table(t) for t in (np.ones_like(self.tapers), self.tapers))

    def __repr__(self) -> str:
        return f"Tiles({self.operator!r}, rows={self.range.beam.pixels[1]}, centers={self.centers.tolist()})"

    def described(self) -> dict[str, Any]:
        """Describe the constructor's arguments.

        Returns:
            Its arguments by name.
        """
        return {"operator": self.operator, "rows": self.range.beam.pixels[1], "centers": self.centers}

    def split(self, light: Any) -> Any:
        """Share the light of the tall beam between tiles: ``T(split(light))`` is the tall light's dose.

        Args:
            light: Light of the tall beam, [angle, r, z].

        Returns:
            Light of the tiles, [tile·angle, r, row]; NumPy for NumPy.
        """
        require(self.operator.range, light, "the light")
        source = light if isinstance(light, DeviceArray) else self.device.upload(light)
        tiles = self.device.empty(self.range.shape)
        self._shift.there(source, self._tapered, tiles)
        return tiles if isinstance(light, DeviceArray) else tiles.numpy()


def _spread(tall: Beam, rows: int, overlap: int) -> np.ndarray:
    """Middles [mm] of the fewest tiles that cover a beam, at whole rows."""
    left = max(tall.pixels[1] - rows, 0)
    count = 1 + ceil(left / (rows - overlap))
    starts = np.array([floor(left * k / max(count - 1, 1)) for k in range(count)])
    return (starts + 0.5 * (rows - 1) - 0.5 * (tall.pixels[1] - 1)) * tall.pitch


def _tapers(tall: Beam, rows: int, centers: np.ndarray) -> np.ndarray:
    """(tile, row): weights that decrease linearly over every overlap and add up to one."""
    if centers.ndim != 1 or not centers.size or not np.isfinite(centers).all() or (np.diff(centers) <= 0).any():
        raise BadInput(f"centers of tiles are {centers}; expected finite heights [mm] that rise from tile to tile")
    low, high = (centers + side * 0.5 * rows * tall.pitch for side in (-1, 1))
    edge = 0.5 * tall.pixels[1] * tall.pitch
    bounds = np.concatenate([[-edge], high]), np.concatenate([low, [edge]])
    for above, below in zip(*bounds, strict=True):
        if below - above > 1e-6 * tall.pitch:
            raise BadInput(f"tiles leave a gap from z = {above:.4g} to {below:.4g} mm; expected neighbors that touch: "
                           "more tiles, or more rows per tile")  # fmt: skip
    z = centers[:, None] + (np.arange(rows) - 0.5 * (rows - 1)) * tall.pitch

    def ramp(tile: int, where: np.ndarray) -> np.ndarray:
        rise = fall = np.ones_like(where)
        if tile > 0 and high[tile - 1] > low[tile]:
            rise = np.interp(where, [low[tile], high[tile - 1]], [0.0, 1.0])
        if tile < len(centers) - 1 and high[tile] > low[tile + 1]:
            fall = np.interp(where, [low[tile + 1], high[tile]], [1.0, 0.0])
        return np.where((where > low[tile]) & (where < high[tile]), np.minimum(rise, fall), 0.0)

    total = sum(ramp(tile, z) for tile in range(len(centers)))
    return np.stack([ramp(tile, z[tile]) for tile in range(len(centers))]) / np.asarray(total)
