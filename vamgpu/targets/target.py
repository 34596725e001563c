"""Targets: the fraction of every voxel that a part fills."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from math import ceil, prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from vamgpu.backend import open_device
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.card import card, drawable
from vamgpu.errors import BadInput, EmptyMesh, MeshWarning, OutOfMemory, TargetTooLarge
from vamgpu.geometry import Grid, counts, positive
from vamgpu.operators.polar import PolarGrid
from vamgpu.quantity import meant
from vamgpu.schema.quantities import Length, measured
from vamgpu.storage.memory import installed
from vamgpu.targets.mesh import solid_of
from vamgpu.targets.resampling import averaged
from vamgpu.targets.solid import Solid
from vamgpu.targets.voxelize import voxelize
from vamgpu.units import NAMES

if TYPE_CHECKING:
    import trimesh

    from vamgpu.targets.limits import Limits

MARGIN = 2  # voxels between the part and the rim of the inscribed cylinder, by default
SMALLEST, LARGEST = 0.1, 1000.0
"""Limits of the longest edge [mm] of a part's box; outside of them its unit is probably wrong."""
_MULTIPLE = 4  # default grids have multiples of this many voxels along every axis
_SLACK = 1e-6
"""Voxels by which a part may exceed the grid, because rounding errors of a length must not add a row of voxels."""


@dataclass(frozen=True, eq=False)
class Target:
    """The part to print on a voxel grid centered on the axis of rotation.

    Args:
        grid: Its voxels.
        name: Name in messages and reports.
        fraction: Filled share of each voxel, 0..1, [x, y, z]: on a device, or a NumPy array.
        radius: Largest distance from the axis [mm].
        volume: Filled volume [mm³].
        height: Extent along z [mm]; twice the reach of a part that is not in the middle.
        solid: The surface that was voxelized, as placed for the print; None for a target from an array.
        limits: Limits of single voxels, from a `Scene`; None if all of the part must simply print.
    """

    grid: Grid
    name: str
    fraction: DeviceArray | npt.NDArray[np.floating] = field(repr=False)
    radius: float
    volume: float
    height: float
    solid: Solid | None = field(default=None, repr=False)
    limits: Limits | None = field(default=None, repr=False)
    _copies: dict[Any, DeviceArray] = field(default_factory=dict, init=False, repr=False)

    @classmethod
    def from_mesh(
        cls,
        source: str | Path | Solid | trimesh.Trimesh,
        height: float | str | None = None,
        factor: float | None = None,
        *,
        pitch: float | str | None = None,
        orientation: npt.ArrayLike | None = None,
        margin: int = MARGIN,
        shape: tuple[int, int, int] | None = None,
        grid: Grid | PolarGrid | None = None,
        device: str | Device | None = None,
        name: str | None = None,
    ) -> Target:
        """Voxelize a mesh, repaired where needed, on a device.

        The part is turned, scaled by either ``height`` or ``factor``, and centered: its smallest enclosing circle on
        the axis, its middle at z = 0. A `Solid` that was read with ``center=False`` keeps its place about the axis.
        ``mended`` lists the changes of a repair.

        Args:
            source: Path of an STL, PLY, OBJ, 3MF or STEP file, a `Solid`, or a `trimesh.Trimesh`, by default in mm.
            height: Height along z [mm]; like ``pitch`` also text with its unit, ``"11.5 mm"``.
            factor: Scale of the mesh, dimensionless.
            pitch: Voxel edge [mm].
            orientation: Rotation matrix, (3, 3).
            margin: Empty voxels between the part and the inscribed cylinder.
            shape: Voxels of the grid; by default the smallest multiples of 4 that hold the part and the margin.
            grid: A grid in place of pitch and shape, or rings, whose box is used.
            device: A name or a device; the best available one by default.
            name: Name in messages and reports; by default the file's.

        Returns:
            The target; its fractions are on the device.

        Raises:
            BadInput: An argument is out of its range.
            MeshError: The mesh cannot be read or repaired.
            TargetTooLarge: The part does not fit ``shape``.
            EmptyMesh: No voxel is filled.
            OutOfMemory: The grid does not fit the device.

        Warns:
            MeshWarning: The mesh was repaired, or its walls are thinner than a voxel.
        """
        pitch, shape = _pitch_and_shape(pitch, shape, grid)
        height = _one_scale(height, factor)
        given = solid_of(source, name or "solid")
        if given is None:
            raise BadInput(f"got a {type(source).__name__}; expected the path of a mesh file, a Solid or a "
                           "trimesh.Trimesh")  # fmt: skip
        drawn = given.drawn and isinstance(source, Solid)
        solid = given.placed(rotation=orientation, height=height, factor=factor, center=not drawn)
        solid = solid.leveled() if drawn else solid
        _check_size(solid, height, factor, pitch)
        check_thickness(solid, pitch)
        if positive("margin [voxels]", margin, zero=True) != int(margin):
            raise BadInput(f"margin is {margin!r}; expected a whole number of voxels")
        box = _grid(solid, pitch, int(margin), shape)
        place = open_device(device)
        _check_memory(box, place)
        fraction, volume = voxelize(solid, box, place)
        if volume <= 0.0:
            raise EmptyMesh(
                f"{solid.name}: no voxel of {pitch:g} mm is filled ({solid.volume:.3g} mm³ in the mesh); expected a "
                "part not much thinner than a voxel: use a smaller pitch or a larger part"
            )
        return cls(box, name or solid.name, fraction, solid.radius, volume, solid.height, solid)

    @classmethod
    def from_array(cls, values: npt.ArrayLike, pitch: float | str, name: str = "array") -> Target:
        """A target from fractions. Its radius is that of the outermost voxel center that is not empty.

        Args:
            values: Fractions in 0..1, or booleans, [x, y, z], centered on the axis.
            pitch: Voxel edge [mm], or text with its unit.
            name: Name in messages and reports.

        Returns:
            The target.

        Raises:
            BadInput: The array does not hold fractions.
            EmptyMesh: No voxel is filled.
        """
        fraction = _fractions(values)
        grid = Grid(fraction.shape, pitch)  # type: ignore[arg-type]  # pyright: ignore[reportArgumentType] - read there
        footprint, slices = fraction.any(axis=2), np.flatnonzero(fraction.any(axis=(0, 1)))
        if not len(slices):
            raise EmptyMesh(f"{name}: every voxel of the array is 0; expected some that are filled")
        x, y, _ = grid.axes()
        radius = float(np.hypot(x[:, None], y[None, :])[footprint].max())
        volume = float(fraction.sum(dtype=np.float64)) * grid.voxel_volume
        return cls(grid, name, fraction, radius, volume, float(slices[-1] - slices[0] + 1) * grid.pitch)

    def __getstate__(self) -> dict[str, Any]:
        return vars(self) | {"_copies": {}}

    def _repr_html_(self) -> str:
        fraction = self.numpy() if drawable(self.grid.shape) else None
        numbers = {
            "voxels x × y × z": " × ".join(f"{n:,}" for n in self.grid.shape),
            "pitch": f"{1000 * self.grid.pitch:.4g} µm",
            "radius about the axis": f"{self.radius:.4g} mm",
            "height": f"{self.height:.4g} mm",
            "volume": f"{self.volume:.4g} mm³",
            **({"mended": "; ".join(self.mended)} if self.mended else {}),
        }
        planes = {"from the side": None, "from above": None} if fraction is None else {
            "from the side, mean along y": fraction.mean(axis=1), "from above, mean along z": fraction.mean(axis=2),
        }  # fmt: skip
        return card(f"Target {self.name!r}", numbers, planes)

    @property
    def mended(self) -> tuple[str, ...]:
        """Changes of a mesh by its repair, one sentence each; empty for a sound mesh and for arrays."""
        return () if self.solid is None else self.solid.mended

    def on(self, device: str | Device | None = None) -> DeviceArray:
        """The fractions as a field on a device; copied only once.

        Args:
            device: A name or a device; the best available one by default.

        Returns:
            Fractions [x, y, z].
        """
        place = open_device(device)
        if isinstance(self.fraction, DeviceArray) and self.fraction.device is place:
            return self.fraction
        if place.name not in self._copies:
            self._copies[place.name] = place.upload(self.numpy())
        return self._copies[place.name]

    def resampled(
        self, grid: Grid, shift: tuple[float, float, float] = (0.0, 0.0, 0.0), device: str | Device | None = None
    ) -> DeviceArray:
        """The part on other voxels: the filled share of every voxel of ``grid``, whose middle is moved by ``shift``.

        A target with a ``solid`` is voxelized again; finer voxels then show more detail. For a target from an array,
        the fractions, constant within each voxel and 0 outside, are averaged exactly over the new voxels.

        Args:
            grid: The new voxels; also a slab of them, which ``shift`` moves to its place.
            shift: New position of the middle of ``grid``, (x, y, z) [mm] in the part's frame.
            device: A name or a device; the best available one by default.

        Returns:
            Fractions [x, y, z] on the device; parts of the object outside are cut off.

        Raises:
            BadInput: The shift is not three finite lengths.
            OutOfMemory: The grid does not fit the device.
        """
        place, move = open_device(device), np.asarray(shift, np.float64)
        if move.shape != (3,) or not np.isfinite(move).all():
            raise BadInput(f"shift is {shift!r}; expected three finite lengths (x, y, z) [mm]")
        if self.solid is not None:
            return voxelize(self.solid.translated(-move), grid, place).fraction
        return place.upload(averaged(self.numpy(), self.grid, grid, tuple(move.tolist())))

    def numpy(self) -> npt.NDArray[np.floating]:
        """The fractions in NumPy.

        Returns:
            Fractions [x, y, z].
        """
        return self.fraction.numpy() if isinstance(self.fraction, DeviceArray) else self.fraction


def _pitch_and_shape(
    pitch: float | str | None, shape: tuple[int, int, int] | None, grid: Grid | PolarGrid | None
) -> tuple[float, tuple[int, int, int] | None]:
    """Pitch and shape of the grid if there is one, or the given ones; for rings, those of their box."""
    if grid is None:
        if pitch is None:
            raise BadInput("got neither pitch nor grid; give one: pitch= [mm], or grid= of voxels or rings")
        return measured("pitch", pitch, Length), shape
    if pitch is not None or shape is not None:
        raise BadInput(f"got pitch={pitch!r} and shape={shape!r} with a grid, which has both; leave them out")
    if not isinstance(grid, Grid | PolarGrid):
        raise BadInput(f"got {grid!r} as grid; expected a Grid or a PolarGrid")
    box = grid.box if isinstance(grid, PolarGrid) else grid
    return box.pitch, box.shape


def _one_scale(height: float | str | None, factor: float | None) -> float | None:
    """The height as a number; `BadInput` unless exactly one of height and factor is given."""
    if height is None and factor is None:
        raise BadInput("got neither height nor factor; give one: height= [mm] along z, or factor=1 for the mesh's size")
    if height is not None and factor is not None:
        raise BadInput(f"got height={height} and factor={factor}; give one of them")
    if factor is not None:
        positive("factor", factor)
        return None
    return measured("height", height, Length)


def _check_size(solid: Solid, height: float | None, factor: float | None, pitch: float) -> None:
    """Reject a part or voxels of an improbable size, whose unit is probably wrong. Raises `BadInput`."""
    size = float(np.ptp(solid.bounds, axis=0).max())
    if SMALLEST <= size <= LARGEST:
        if pitch > size:
            raise BadInput(f"{solid.name}: pitch is {pitch:g} mm, and the part is {size:.3g} mm at its longest; "
                           "expected voxels much narrower than the part: check the unit")  # fmt: skip
        return
    unit = meant(size, SMALLEST, LARGEST)
    likely = ""
    if unit is not None:
        name, value = ("factor", factor or 1.0) if height is None else ("height", height)
        right = f"{value * NAMES[unit]:.6g}" if name == "factor" else f'"{value * NAMES[unit]:.6g} mm"'
        likely = f"; if that was meant in {unit}, write {name} = {right}"
    raise BadInput(f"{solid.name}: the part is {size:.3g} mm at its longest; expected {SMALLEST:g} to {LARGEST:g} mm: "
                   f"check the unit{likely}")  # fmt: skip


def check_thickness(solid: Solid, pitch: float) -> None:
    """Warn of a part whose walls are thinner than a voxel, judging by its volume and surface."""
    a, b, c = (solid.vertices[solid.faces[:, k]] for k in range(3))
    surface = 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())
    if (thick := 2.0 * abs(solid.volume) / surface) < pitch:
        warnings.warn(f"{solid.name}: its walls are about {thick:.3g} mm thick, thinner than a voxel of {pitch:g} mm: "
                      "where a wall lies between voxels decides what prints; use a smaller pitch or thicker walls",
                      MeshWarning, stacklevel=3)  # fmt: skip


def _grid(solid: Solid, pitch: float, margin: int, shape: tuple[int, int, int] | None) -> Grid:
    """The given grid, or the smallest one whose inscribed cylinder holds the solid and the margin."""
    across = 2.0 * (solid.radius / pitch + margin) + 1.0 - _SLACK
    along = solid.height / pitch - _SLACK
    if shape is None:
        nx, nz = (_MULTIPLE * ceil(n / _MULTIPLE) for n in (across, along))
        return Grid((nx, nx, max(nz, _MULTIPLE)), pitch)
    grid = Grid(counts("shape", shape, 3), pitch)  # type: ignore[arg-type]
    if across > min(grid.shape[:2]) or along > grid.shape[2]:
        n, nz = ceil(across), ceil(along)
        room = max(grid.inscribed_radius - margin * pitch, 0.0)
        raise TargetTooLarge(
            f"{solid.name} has radius {solid.radius:.4g} mm and height {solid.height:.4g} mm; shape {grid.shape} of "
            f"{pitch:g} mm holds radius {room:.4g} mm (margin {margin}) and height {grid.shape[2] * pitch:.4g} mm: "
            f"use shape ({n}, {n}, {nz}), a larger pitch, or a smaller part"
        )
    return grid


def _check_memory(grid: Grid, device: Device) -> None:
    """Reject a target that does not fit the memory before the machine swaps; devices with memory check it too."""
    size = device.real.itemsize * prod(grid.shape) / 1e9
    room = installed() / 1e9
    if "cuda" not in device.name and not device.is_gpu and size > room:
        raise OutOfMemory(
            f"a target of {grid.shape} voxels of {grid.pitch:g} mm, {grid.shape[2] * grid.pitch:.4g} mm high, takes "
            f"{size:.1f} GB; this machine has {room:.1f} GB: use a larger pitch or a smaller part"
        )


def _fractions(values: npt.ArrayLike) -> npt.NDArray[np.floating]:
    """Values as a read-only float32 copy, or `BadInput`."""
    array = np.asarray(values)
    if array.ndim != 3 or array.size == 0:
        raise BadInput(f"the array has shape {array.shape}; expected [x, y, z] with at least one voxel")
    if array.dtype.kind not in "buif":
        raise BadInput(f"the array holds {array.dtype}; expected numbers in 0..1")
    if not np.isfinite(array).all():
        raise BadInput("the array holds NaN or infinity; expected fractions in 0..1")
    if array.min() < 0 or array.max() > 1:
        raise BadInput(
            f"the array reaches from {array.min():g} to {array.max():g}; expected fractions in 0..1: scale it"
        )
    fraction = np.array(array, np.float32, order="C")
    fraction.setflags(write=False)
    return fraction
