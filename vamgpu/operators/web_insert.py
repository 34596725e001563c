"""Light on a moving web that carries things in its film: what each ray meets on its way shades what comes after."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, final

import numpy as np
import numpy.typing as npt

from vamgpu.backend import open_device
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, OutOfMemory, ShapeMismatch
from vamgpu.geometry import Beam
from vamgpu.kernels.gather import gather_rows
from vamgpu.kernels.update import multiply
from vamgpu.operators.compose import combine
from vamgpu.operators.linear import LinearOperator
from vamgpu.operators.row_resampler import RowResampler
from vamgpu.operators.space import WebSinogramSpace, WebSpace
from vamgpu.operators.traced import PLANES, POSES, WHOLE, SparseEntries
from vamgpu.operators.web import WebProjection
from vamgpu.operators.web_motion import WebMotion
from vamgpu.web import Propagation, WebGrid, WebRays, Wrap, where_marched

LARGEST = 1 << 29
"""Entries of all matrices together: 4 GB of tables, each entry being kept by rows and by columns."""


@final
class WebInsertProjection(LinearOperator):
    """The light of one pose at every pose of a web, past things that the film carries.

    As `WebProjection`, but the light of a ray in a voxel is what everything before it on its way has left, and the
    things move with the web: they shade other rays at every pose. Opaque voxels get no dose. In a voxel that absorbs
    otherwise than the resin, the dose is that of resin in it. Light does not bend at them.

    A film that moves while it is lit takes its things along, and light is linear between whole columns of its way.

    Rays stay in their slice. Slices in which the same stands in the light share one sparse matrix, and those without
    anything take the windows of `WebProjection`; memory grows with the number of unlike slices.

    Args:
        grid: The web.
        beam: The light; it must leave ``fill`` and ``spread`` out.
        wrap: The machine, such as a `Roller`; it must tell its light ray by ray.
        opaque: Where an insert stops the light, booleans [l, rho, z].
        extinction: Absorption of the film with what is in it, [l, rho, z] [1/mm]; None where it is the resin's.
        device: A name or a device; the best one here by default.
        poses: How many poses; by default all that see any of the web.
        start: Where the first window begins [columns]; by default the first that sees any of the web.

    Attributes:
        light: The `Propagation` of one pose in a film with nothing in it.
        motion: The `WebMotion`: poses, and step and start in columns.

    Raises:
        BadInput: An argument is of another kind or out of its range.
        ShapeMismatch: A field does not fit the grid.
        SkippedColumns: Some columns are never lit.
        OutOfMemory: Too many slices are unlike.
        DeviceError: There is no such device.
    """

    domain: WebSpace
    range: WebSinogramSpace
    grid: WebGrid
    beam: Beam
    light: Propagation
    vessel: None
    wrap: Wrap
    motion: WebMotion
    device: Device

    def __init__(
        self,
        grid: WebGrid,
        beam: Beam,
        wrap: Wrap,
        opaque: npt.NDArray[np.bool_] | None = None,
        extinction: npt.ArrayLike | None = None,
        device: str | Device | None = None,
        poses: int | None = None,
        start: float | None = None,
    ) -> None:
        plain = WebProjection(grid, beam, wrap, device, poses, start)
        if not hasattr(wrap, "rays_of"):
            raise BadInput(f"got {wrap!r} with inserts; expected a machine that tells its light ray by ray, such as a "
                           "Roller, whose rays_of(grid, beam) does")  # fmt: skip
        rays: WebRays = wrap.rays_of(grid, beam, **where_marched(wrap, device))  # type: ignore[attr-defined]
        self.grid, self.beam, self.light, self.vessel, self.wrap = grid, beam, plain.light, None, wrap
        self.domain, self.range = plain.domain, plain.range  # pyright: ignore[reportIncompatibleVariableOverride]
        self.motion, self.device = plain.motion, open_device(device)
        self._rows = RowResampler(beam.pixels[1], beam.pitch, grid.shape[2], grid.edges[2], self.device)
        blocks, excess = _blocks(grid, opaque), _excess(grid, extinction, rays.absorption)
        self.opaque: npt.NDArray[np.bool_] = blocks
        level = Beam((beam.pixels[0], grid.shape[2]), grid.edges[2])
        self._parts: list[_Slices] = []
        for slices in _alike(blocks, excess):
            z = int(np.flatnonzero(slices)[0])
            if blocks[:, :, z].any() or excess[:, :, z].any():
                way: Any = _Shaded(self, rays, blocks[:, :, z], excess[:, :, z])
            else:
                step, first = self.motion.step, self.motion.start
                way = WebProjection.from_light(grid, self.light, step, level, self.device, self.motion.poses, first)
            self._parts.append(_Slices(self, way, slices))
            if self.entries > LARGEST:
                raise OutOfMemory(f"{len(self._parts)} unlike slices have {self.entries:,} entries; expected at most "
                                  f"{LARGEST:,}: take coarser voxels or a shorter web, or let inserts be the same over "
                                  "more slices")  # fmt: skip

    def __repr__(self) -> str:
        return f"WebInsertProjection({self.grid!r}, {self.beam!r}, {self.motion!r}, device={self.device.name!r})"

    @property
    def entries(self) -> int:
        """Pairs of all sparse matrices."""
        return sum(getattr(part.way, "entries", 0) for part in self._parts)

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        with self._rows.filling(out) as slices:
            self._sum([part.forward for part in self._parts], x, slices)

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        self._sum([part.transposed for part in self._parts], self._rows.in_slices(y), out)

    def _sum(self, ways: list[Any], given: DeviceArray, out: DeviceArray) -> None:
        ways[0](given, out)
        part = self.device.empty(out.shape) if len(ways) > 1 else out
        for way in ways[1:]:
            way(given, part)
            combine(1.0, out, 1.0, part, out)


class _Slices:
    """The light in some slices of the web; the others stay as they are."""

    def __init__(self, owner: WebInsertProjection, way: Any, slices: npt.NDArray[np.bool_]) -> None:
        self.way, self.device, self.shape = way, owner.device, owner.domain.shape
        mask = np.broadcast_to(slices.astype(np.float32), self.shape)
        self.mask = None if slices.all() else self.device.upload(mask)

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        if self.mask is None:
            return self.way.forward(x, out)
        part = self.device.empty(self.shape)
        self.device.launch(multiply, x=x, y=self.mask, out=part)
        return self.way.forward(part, out)

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        self.way.transposed(y, out)
        if self.mask is not None:
            self.device.launch(multiply, x=out, y=self.mask, out=out)


class _Shaded:
    """The unfolded matrix of one slice, by rows and by columns."""

    def __init__(
        self, owner: WebInsertProjection, rays: WebRays, opaque: npt.NDArray[np.bool_], excess: npt.NDArray[np.float64]
    ) -> None:
        grid, poses, columns = owner.grid, owner.motion.poses, owner.beam.pixels[0]
        cells = grid.shape[0] * grid.shape[1]
        if max(cells, poses * columns) > WHOLE:
            raise BadInput(f"{cells} voxels a slice and {poses * columns} rays; at most {WHOLE} of each past inserts: "
                           "use a shorter web or a coarser geometry")  # fmt: skip
        found = SparseEntries(
            *(
                np.concatenate(part)
                for part in zip(*_entries(owner.motion, owner.light.way, grid, rays, opaque, excess), strict=True)
            )
        )
        self.device, self.entries = owner.device, found.weight.size
        self.rows = found.table(self.device, (poses, columns), PLANES * grid.shape[1])
        self.columns = found.transposed().table(self.device, grid.shape[:2], POSES * columns)

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        self.device.launch(gather_rows, source=x, **self.rows, out=out)

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        self.device.launch(gather_rows, source=y, **self.columns, out=out)


def _entries(
    motion: WebMotion,
    way: float,
    grid: WebGrid,
    rays: WebRays,
    opaque: npt.NDArray[np.bool_],
    excess: npt.NDArray[np.float64],
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Row (pose, r), column (l, rho) and weight of the light at each pose, about which the film moves a way."""
    (columns, layers, window), length = rays.shape, grid.shape[0]
    place = np.ravel_multi_index((rays.r, rays.rho, rays.l), rays.shape)
    voxels, entry = np.unique(place, return_inverse=True)
    r, rho, l = np.unravel_index(voxels, rays.shape)  # noqa: E741 - the web's axis
    first = np.searchsorted(rays.ray, rays.ray)  # of the pieces of the same ray
    plain = np.bincount(entry, rays.weight, voxels.size)
    stands = np.pad(opaque, ((window, window), (0, 0)))
    more = np.pad(excess, ((window, window), (0, 0)))
    pose_of, column_of, share_of = motion.taps(way)
    for at in np.unique(column_of):
        seen = (l + at >= 0) & (l + at < length)
        if not seen.any():
            continue
        begin = int(at) + window  # in the padded film; windows that see any of the web begin in it
        blocks, adds = stands[begin : begin + window].T, more[begin : begin + window].T
        if blocks.any() or adds.any():
            shaded = rays.weight * _left(rays, first, blocks[rays.rho, rays.l], adds[rays.rho, rays.l])
            weight = np.bincount(entry, shaded, voxels.size)
        else:
            weight = plain
        seen &= weight != 0.0
        cells = ((l[seen] + at) * layers + rho[seen]).astype(np.int32)
        for pose, part in zip(pose_of[column_of == at], share_of[column_of == at], strict=True):
            yield (pose * columns + r[seen]).astype(np.int32), cells, weight[seen] * part


def _left(
    rays: WebRays, first: np.ndarray, opaque: npt.NDArray[np.bool_], excess: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Share of the light in each piece of a film of resin alone that inserts leave."""
    # Before a piece the light falls by exp(−Σ excess · length); in it the resin absorbs along a way on which the light
    # falls by its absorption and the excess together.
    met = np.cumsum(opaque)
    dark = met > (met - opaque)[first]
    depth = excess * rays.length
    passed = np.cumsum(depth) - depth
    own = rays.absorption * rays.length
    return np.where(dark, 0.0, np.exp(passed[first] - passed) * _mean_fall(own + depth) / _mean_fall(own))


def _mean_fall(depth: np.ndarray) -> npt.NDArray[np.float64]:
    """Mean of exp(−s) over s in 0..depth."""
    return np.divide(-np.expm1(-depth), depth, out=np.ones(depth.shape), where=depth > 1e-12)


def _blocks(grid: WebGrid, opaque: Any) -> npt.NDArray[np.bool_]:
    if opaque is None:
        return np.zeros(grid.shape, bool)
    values = np.asarray(opaque)
    if values.dtype != bool:
        raise BadInput(f"opaque holds {values.dtype}; expected booleans: true where the insert is")
    return _fits("opaque", grid, values)


def _excess(grid: WebGrid, extinction: Any, absorption: float) -> npt.NDArray[np.float64]:
    if extinction is None:
        return np.zeros(grid.shape)
    values = np.asarray(extinction)
    if values.dtype.kind not in "fiu" or not np.isfinite(values).all() or (values.size and values.min() < 0.0):
        raise BadInput("extinction [1/mm] holds values below 0 or no numbers; expected finite values ≥ 0")
    return _fits("extinction", grid, values.astype(np.float64)) - absorption


def _fits(name: str, grid: WebGrid, values: Any) -> Any:
    if values.shape != grid.shape:
        raise ShapeMismatch(f"{name} has shape {values.shape}; expected {grid.shape} = [l, rho, z]")
    return values


def _alike(opaque: npt.NDArray[np.bool_], excess: npt.NDArray[np.float64]) -> Iterator[npt.NDArray[np.bool_]]:
    """Which slices have the same in the light: one mask (z,) for each kind."""
    said: dict[bytes, list[int]] = {}
    for z in range(opaque.shape[2]):
        said.setdefault(opaque[:, :, z].tobytes() + excess[:, :, z].tobytes(), []).append(z)
    for found in said.values():
        yield np.isin(np.arange(opaque.shape[2]), found)
