"""The medium that turns with the resin: a refractive index, an extinction, opaque inserts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.geometry import Grid, positive
from vamgpu.kernels.medium import ABSORBS, BENDS, BLOCKS, DARK, MARGIN, WHOLE

FILLED = 2.0 * DARK
"""Parts of `WHOLE` of a voxel full of insert, if shares are given: surfaces are then where shares pass 0.45, and walls
one voxel thick still stop all light."""
FINE = 2.0**17  # number of steps of extinction in inserts that float32 can hold together with the share


@dataclass(frozen=True, eq=False)
class CoRotatingMedium:
    """A medium that turns with the resin: fields on voxels, [x, y] if nothing depends on z, otherwise [x, y, z].

    Args:
        index: Refractive index, [x, y] or [x, y, z]; None if it is uniform.
        extinction: Absorbed share per length [1/mm], natural logarithm, [x, y] or [x, y, z], or one number for all
            voxels; None if nothing is absorbed.
        opaque: Share of every voxel that an opaque insert fills, 0..1, or booleans, [x, y] or [x, y, z]; light ends
            where the interpolated share passes 0.45, or 0.4 for booleans. Voxels of one half or more get no dose.
        bath: Refractive index beyond the grid; None for the median of the index on the grid's faces, or 1.

    Raises:
        BadInput: A value is not finite or out of its range.
        ShapeMismatch: A field has neither two nor three axes.
    """

    index: np.ndarray | None = None
    extinction: np.ndarray | float | None = None
    opaque: np.ndarray | None = None
    bath: float | None = None

    def __post_init__(self) -> None:
        index = _real("index", self.index)
        extinction = _real("extinction [1/mm]", self.extinction)
        _refuse_below("index", index, 1.0)
        _refuse_below("extinction [1/mm]", extinction, 0.0)
        opaque = None if self.opaque is None else np.asarray(self.opaque)
        if opaque is not None and not (
            opaque.dtype == bool or (opaque.dtype.kind == "f" and ((opaque >= 0.0) & (opaque <= 1.0)).all())
        ):
            raise BadInput(
                f"opaque holds {opaque.dtype}, or values beyond 0..1; expected the share of every voxel that the "
                "insert fills, or booleans"
            )
        for name, value in (("index", index), ("opaque", opaque), ("extinction", extinction)):
            if value is not None and value.ndim not in ((0, 2, 3) if name == "extinction" else (2, 3)):
                raise ShapeMismatch(f"medium {name} has {value.ndim} axes; expected [x, y] or [x, y, z]")
        if self.bath is not None:
            object.__setattr__(self, "bath", positive("bath index", self.bath))
            _refuse_below("bath index", np.asarray(self.bath), 1.0)
        for name, value in (("index", index), ("extinction", extinction), ("opaque", opaque)):
            object.__setattr__(self, name, value)

    def fields(self) -> dict[str, np.ndarray]:
        """The fields that are given.

        Returns:
            Arrays [x, y] or [x, y, z] by name.
        """
        named = {"index": self.index, "extinction": self.extinction, "opaque": self.opaque}
        return {name: np.asarray(value) for name, value in named.items() if value is not None and np.ndim(value) > 0}

    @property
    def is_level(self) -> bool:
        """Whether nothing depends on z."""
        return all(values.ndim == 2 for values in self.fields().values())

    @property
    def kind(self) -> int:
        """Which of the three fields exist, in the form for kernels."""
        bends = BENDS * (self.index is not None)
        return bends | ABSORBS * (self.extinction is not None) | BLOCKS * (self.opaque is not None)

    @property
    def dark(self) -> np.ndarray | None:
        """Voxels that get no dose, booleans [x, y] or [x, y, z]."""
        return None if self.opaque is None else self._stands >= DARK

    @property
    def _stands(self) -> np.ndarray:
        """Share of each voxel that is insert, as whole numbers up to `WHOLE`."""
        opaque = np.asarray(self.opaque)
        return opaque * WHOLE if opaque.dtype == bool else np.rint(opaque * FILLED)

    def check(self, grid: Grid) -> None:
        """Check that every field has the shape of a grid.

        Args:
            grid: The grid.

        Raises:
            ShapeMismatch: A field has another shape.
        """
        for name, values in self.fields().items():
            if values.shape not in (grid.shape, grid.shape[:2]):
                raise ShapeMismatch(
                    f"medium {name} has shape {values.shape}; expected {grid.shape[:2]} = [x, y] or {grid.shape} = "
                    "[x, y, z]: sample it on the voxels of the grid"
                )

    def surroundings(self) -> float:
        """Refractive index beyond the grid.

        Returns:
            The index.
        """
        if self.bath is not None:
            return self.bath
        if self.index is None:
            return 1.0
        faces = [np.take(self.index, end, axis=axis).ravel() for axis in (0, 1) for end in (0, -1)]
        return float(np.median(np.concatenate(faces)))

    def samples(self, grid: Grid) -> np.ndarray:
        """The samples that the kernels of `trace` interpolate.

        Args:
            grid: Voxels of the fields.

        Returns:
            Float64 (x + 4, y + 4, z + 4 or 1, 4).

        Raises:
            ShapeMismatch: A field does not fit the grid.
        """
        self.check(grid)
        shape = (*grid.shape[:2], 1) if self.is_level else grid.shape
        table = np.zeros((*(n + 2 * MARGIN * (n > 1 or axis < 2) for axis, n in enumerate(shape)), 4))
        if not self.is_level and shape[2] == 1:
            raise ShapeMismatch(f"the fields depend on z, the grid {grid.shape} has one slice; give them as [x, y]")
        if self.index is not None:
            table[..., :3] = _pull(_spread(self.index, shape) / self.surroundings())
        if self.extinction is not None:
            values = np.broadcast_to(self.extinction, shape) if np.ndim(self.extinction) == 0 else self.extinction
            table[_inner(shape)][..., 3] = grid.pitch * _spread(np.asarray(values), shape)
        if self.opaque is not None:
            part, stands = table[_inner(shape)][..., 3], _spread(self._stands, shape)
            rest = np.floor(part / (1.0 + part) * FINE) / FINE
            part[...] = np.where(stands > 0.0, -(stands + rest), part)
        return table


def _real(name: str, values: Any) -> np.ndarray | None:
    if values is None:
        return None
    array = np.asarray(values)
    if array.dtype.kind not in "fiu" or not np.isfinite(array).all():
        raise BadInput(f"{name} holds {array.dtype} or values that are not finite; expected real numbers")
    return array.astype(np.float64)


def _refuse_below(name: str, values: np.ndarray | None, least: float) -> None:
    if values is not None and values.size and float(values.min()) < least:
        raise BadInput(f"{name} falls to {float(values.min()):g}; expected ≥ {least:g} everywhere")


def _spread(values: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """A field over all of ``shape``."""
    return np.broadcast_to(values[..., None] if values.ndim == 2 else values, shape)


def _inner(shape: tuple[int, ...]) -> tuple[slice, ...]:
    """The voxels among the samples."""
    return tuple(slice(MARGIN, MARGIN + n) if axis < 2 or n > 1 else slice(None) for axis, n in enumerate(shape))


def _pull(index: np.ndarray) -> np.ndarray:
    """½∇n² [1/voxel] by central differences, with ``MARGIN`` samples of bath (n = 1) around; (…, 3)."""
    depth = MARGIN + 1
    flat = index.shape[2] == 1
    padded = np.pad(index**2, [(depth, depth), (depth, depth), (0, 0) if flat else (depth, depth)], constant_values=1.0)
    axes = (0, 1) if flat else (0, 1, 2)
    inner = (slice(1, -1), slice(1, -1), slice(None) if flat else slice(1, -1))
    pull = np.zeros((*padded[inner].shape, 3))
    for axis in axes:
        ahead, behind = list(inner), list(inner)
        ahead[axis], behind[axis] = slice(2, None), slice(None, -2)
        pull[..., axis] = 0.25 * (padded[tuple(ahead)] - padded[tuple(behind)])
    return pull
