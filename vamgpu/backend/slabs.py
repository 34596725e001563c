"""Several devices as one: a field is cut along z, and every member stores and computes its own slices.

Slices of a vial interact only in sums, and in operations that spread along z. A kernel that computes each slice
separately runs on every member at once. One that needs a few further slices (see `Kernel`) gets them from the
neighbors. Any other runs only on the first member, on the whole field.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from math import prod
from typing import Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.backend.host_memory import from_host
from vamgpu.errors import DeviceError
from vamgpu.kernels.lanes import copy_slices
from vamgpu.kernels.signature import Field, Kernel, Moved, Scalar, Table

Cuts = list[tuple[int, int]]
"""First slice and the one after the last, a pair per member; empty for members without slices."""
WHOLE = "all"


class Pieces(list[DeviceArray]):
    """A field: the slices that each member stores."""


class Copies:
    """A table: on any member that needed it, or in the parts that the members wrote along an axis."""

    shape: tuple[int, ...]
    dtype: np.dtype

    def __init__(self, shape: tuple[int, ...], dtype: np.dtype) -> None:
        self.shape, self.dtype = shape, dtype
        self._whole: dict[Device, DeviceArray] = {}
        self._parts: list[DeviceArray] = []
        self._axis = 0
        self._bands: dict[Any, tuple[Cuts, list[DeviceArray]]] = {}

    def read(self) -> np.ndarray:
        """The table on the host."""
        if self._whole:
            held = next(iter(self._whole.values()))
            return held.device._load(held)
        if self._parts:
            return np.concatenate([part.device._load(part) for part in self._parts], self._axis)
        return np.zeros(self.shape, self.dtype)

    def keep(self, table: DeviceArray) -> None:
        """Take one member's copy as the table, and drop the other copies."""
        self._whole, self._parts, self._bands = {table.device: table}, [], {}

    def parts(self) -> list[DeviceArray]:
        """The parts that members wrote; none if the table is whole."""
        return [] if self._whole else self._parts

    def on(self, device: Device) -> DeviceArray:
        """The whole table on a member."""
        if device not in self._whole:
            self._whole[device] = _stored(device, self.read(), table=True)
        return self._whole[device]

    def shared(self, members: Sequence[Device], axis: int, cuts: Cuts, use: Moved) -> list[DeviceArray]:
        """Its parts along an axis, one per member, for a kernel that combines them."""
        lengths = [end - begin for begin, end in cuts]
        if self._axis != axis or [part.shape[axis] for part in self._parts] != lengths:
            if use.reads:
                parts = [np.take(self.read(), range(begin, end), axis) for begin, end in cuts]
                self._parts = [_stored(device, part, table=True) for device, part in zip(members, parts, strict=True)]
            else:
                shapes = [(*self.shape[:axis], length, *self.shape[axis + 1 :]) for length in lengths]
                self._parts = [m.empty(shape, self.dtype, table=True) for m, shape in zip(members, shapes, strict=True)]
            self._axis = axis
        if use.writes:
            self._whole, self._bands = {}, {}
        return self._parts

    def band(self, members: Sequence[Device], cuts: Cuts, taps: int, most: int) -> tuple[Cuts, list[DeviceArray]]:
        """Cut first slices: the entries of each cut within ``most``, counted from its start."""
        key = (tuple(cuts), taps, most)
        if key not in self._bands:
            each = [self.read()[begin:end] for begin, end in cuts]
            spans = [(max(int(e.min()), 0), min(int(e.max()) + taps, most)) if e.size else (0, 0) for e in each]
            parts = [(e - first).astype(self.dtype) for e, (first, _) in zip(each, spans, strict=True)]
            self._bands[key] = spans, [_stored(m, p, table=True) for m, p in zip(members, parts, strict=True)]
        return self._bands[key]


def _stored(device: Device, values: np.ndarray, *, table: bool = False) -> DeviceArray:
    array = device.empty(values.shape, values.dtype, table=table)
    device._store(array, values)
    return array


class SlabDevice(Device):
    """Devices that divide the slices of every field; a device may be a member more than once."""

    members: tuple[Device, ...]

    def __init__(self, name: str, members: Sequence[Device]) -> None:
        if len({(type(member), member.is_gpu, member.real) for member in members}) != 1:
            raise DeviceError(
                f"{name!r} is {', '.join(map(str, members)) or 'no device'}; expected devices of one kind, which "
                "divide work in the same way"
            )
        super().__init__(name, " and ".join(member.description for member in members))
        self.members = tuple(members)
        self._spare: dict[tuple[Device, tuple[int, ...]], list[DeviceArray]] = {}
        self.is_gpu: bool = all(member.is_gpu for member in members)

    @property
    def real(self) -> np.dtype:
        return self.members[0].real

    def lanes_for(self, nz: int) -> int:
        return 1

    def cuts(self, nz: int) -> Cuts:
        """Slices of each member: as equal as whole slabs of a GPU allow, or whole vectors if there are few slices."""
        step = 32 if nz >= 128 * len(self.members) else 4
        most = -(-nz // (step * len(self.members))) * step
        return [(min(k * most, nz), min((k + 1) * most, nz)) for k in range(len(self.members))]

    def items(self, kernel: Kernel, shape: tuple[int, int, int]) -> int:
        return sum(self._items(kernel, shape))

    def _items(self, kernel: Kernel, shape: tuple[int, int, int]) -> list[int]:
        if not _is_cut(kernel):
            return [self.members[0].items(kernel, shape)]
        cuts = zip(self.members, self.cuts(shape[2]), strict=True)
        return [member.items(kernel, (*shape[:2], end - begin)) if begin < end else 0 for member, (begin, end) in cuts]

    def hold(self, table: DeviceArray) -> DeviceArray:
        copies = Copies(table.shape, table.dtype)
        copies.keep(table)
        return DeviceArray(self, copies, table.shape, table.dtype, 0)

    # ---- memory ----------------------------------------------------------------------------------------------
    def _allocate(self, shape: tuple[int, ...], dtype: np.dtype, lanes: int) -> Pieces | Copies:
        if not lanes:
            return Copies(shape, dtype)
        nz, major, minor, _ = shape
        cuts = zip(self.members, self.cuts(nz), strict=True)
        return Pieces(member.empty((major, minor, end - begin), dtype) for member, (begin, end) in cuts)

    def _write(self, handle: Copies, stored: np.ndarray, first: int = 0) -> None:
        member = self.members[0]
        if first == 0 and stored.size == prod(handle.shape):
            return handle.keep(_stored(member, stored.reshape(handle.shape), table=True))
        table = handle.on(member)
        member._write(table.handle, stored, first)
        handle.keep(table)

    def _read(self, handle: Copies, stored: np.ndarray, first: int = 0) -> None:
        stored.reshape(-1)[...] = handle.read().reshape(-1)[first : first + stored.size]

    def _store(self, array: DeviceArray, source: np.ndarray, first: int = 0) -> None:
        if not array.lanes:
            return super()._store(array, source, first)
        for piece, (begin, end) in zip(array.handle, self.cuts(array.shape[2]), strict=True):
            piece.device._store(piece, source[:, :, begin:end], first)

    def _load(self, array: DeviceArray, first: int = 0, last: int | None = None) -> np.ndarray:
        if not array.lanes:
            return super()._load(array, first, last)
        return np.concatenate([piece.device._load(piece, first, last) for piece in array.handle], axis=2)

    def _relaid(self, array: DeviceArray, lanes: int) -> None:
        return None

    def _lanes_of(self, array: DeviceArray) -> Pieces:
        return array.handle

    # ---- work ------------------------------------------------------------------------------------------------
    def _launch(self, kernel: Kernel, bound: dict[str, Any], sizes: dict[str, int], lanes: int) -> None:
        if kernel.reach == "part":
            self._run_twice(kernel, bound)
        elif not _is_cut(kernel):
            self._run_whole(kernel, bound)
        elif not kernel.reach or _is_counted(kernel):
            self._run_apart(kernel, bound, sizes)
        elif isinstance(kernel.arguments.get(kernel.reach), Scalar):
            self._run_placed(kernel, bound, sizes)
        elif kernel.reach in kernel.arguments:
            self._run_band(kernel, bound, sizes)
        else:
            self._run_near(kernel, bound, sizes[kernel.reach] - 1)

    def _run_apart(self, kernel: Kernel, bound: dict[str, Any], sizes: dict[str, int]) -> None:
        """Every member computes its own slices; it gets their number if the kernel needs it."""
        spec: Any = kernel.arguments[kernel.over]
        shape = tuple(sizes[axis] for axis in spec.axes)
        cuts = {spec.axes[2]: self.cuts(shape[2])}
        if "part" in sizes:
            ends = np.cumsum([0, *self._items(kernel, shape)])  # type: ignore[arg-type]
            cuts["part"] = list(zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True))
        shares = [self._shares(kernel.arguments[name], value, cuts) for name, value in bound.items()]
        for member, (begin, end), *mine in zip(self.members, cuts[spec.axes[2]], *shares, strict=True):
            if begin < end:
                given = dict(zip(bound, mine, strict=True))
                member.launch(kernel, **given | ({kernel.reach: begin + given[kernel.reach]} if kernel.reach else {}))
                member.flush()

    def _shares(self, spec: Field | Table | Scalar, value: Any, cuts: dict[str, Cuts]) -> Sequence[Any]:
        if isinstance(value, Pieces):
            return value
        if not isinstance(spec, Table):
            return [value] * len(self.members)
        axis = next((axis for axis in spec.axes if axis in cuts), None)
        if axis is None:
            return [value.on(member) for member in self.members]
        return value.shared(self.members, spec.axes.index(axis), cuts[axis], spec)

    def _run_near(self, kernel: Kernel, bound: dict[str, Any], reach: int) -> None:
        """Every member computes its own slices among those of its neighbors."""
        cuts = self.cuts(_height(bound[kernel.over]))
        spans = [(max(begin - reach, 0), min(end + reach, cuts[-1][1])) for begin, end in cuts]
        wide = {n: self._spanned(v, spans) for n, v in bound.items() if isinstance(v, Pieces)}
        for k, (member, (begin, end)) in enumerate(zip(self.members, cuts, strict=True)):
            if begin < end:
                given = {n: v.on(member) if isinstance(v, Copies) else v for n, v in bound.items()}
                given |= {n: pieces[k] for n, pieces in wide.items()}
                member.launch(kernel, **given)
                for name, spec in kernel.arguments.items():
                    if isinstance(spec, Field) and spec.writes and given[name] is not bound[name][k]:
                        _copy(given[name], begin - spans[k][0], bound[name][k])
                member.flush()
        for name, arrays in wide.items():
            self._done(arrays, bound[name])

    def _run_band(self, kernel: Kernel, bound: dict[str, Any], sizes: dict[str, int]) -> None:
        """Every member computes its own slices from slices of another field that a table names."""
        over: Any = kernel.arguments[kernel.over]
        (source,) = (n for n, spec in kernel.arguments.items() if isinstance(spec, Field) and spec.axes != over.axes)
        cuts = self.cuts(sizes[over.axes[2]])
        spans, firsts = bound[kernel.reach].band(self.members, cuts, sizes["tap"], _height(bound[source]))
        spanned = self._spanned(bound[source], spans)
        shares = {n: self._shares(kernel.arguments[n], v, {over.axes[2]: cuts}) for n, v in bound.items()}
        shares[kernel.reach] = firsts
        for k, (begin, end) in enumerate(cuts):
            if begin < end:
                given = {n: spanned[k] if v is bound[source] else shares[n][k] for n, v in bound.items()}
                self.members[k].launch(kernel, **given)
                self.members[k].flush()
        self._done(spanned, bound[source])

    def _run_placed(self, kernel: Kernel, bound: dict[str, Any], sizes: dict[str, int]) -> None:
        """Every member computes those of its own slices to which another field is moved, from a first one on."""
        over: Any = kernel.arguments[kernel.over]
        (source,) = (n for n, spec in kernel.arguments.items() if isinstance(spec, Field) and spec.axes != over.axes)
        cuts, first, height = self.cuts(sizes[over.axes[2]]), int(bound[kernel.reach]), _height(bound[source])
        spans = [(min(max(begin - first, 0), height), min(max(end - first, 0), height)) for begin, end in cuts]
        spanned = self._spanned(bound[source], spans)
        shares = {n: self._shares(kernel.arguments[n], v, {over.axes[2]: cuts}) for n, v in bound.items()}
        for k, ((begin, _), (low, high)) in enumerate(zip(cuts, spans, strict=True)):
            if low < high:
                given = {n: spanned[k] if v is bound[source] else shares[n][k] for n, v in bound.items()}
                self.members[k].launch(kernel, **{**given, kernel.reach: first + low - begin})
                self.members[k].flush()
        self._done(spanned, bound[source])

    def _bring(self, piece: DeviceArray, begin: int, end: int, first: int, wide: DeviceArray) -> None:
        """Copy slices of a piece to a field, perhaps of another member, that begins with the slice ``first``."""
        if piece.device is wide.device:
            return _copy(piece, first, wide)
        strips = [self._scratch(array.device, (*piece.shape[:2], end - begin)) for array in (piece, wide)]
        _copy(piece, begin, strips[0])
        piece.device.flush()
        if not wide.device._fetch(strips[1].handle, piece.device, strips[0].handle):
            wide.device._store(strips[1], piece.device._load(strips[0]))
        _copy(strips[1], first - begin, wide)
        self._keep(*strips)

    def _scratch(self, member: Device, shape: tuple[int, ...]) -> DeviceArray:
        """A temporary field of a member for one launch: drivers take as long to allocate memory as to project."""
        spare = self._spare.setdefault((member, shape), [])
        return spare.pop() if spare else member.empty(shape)

    def _done(self, wide: list[DeviceArray], own: Pieces) -> None:
        """Return the memory that `_spanned` took, for later launches; a member's launches run one after another."""
        self._keep(*(array for array, piece in zip(wide, own, strict=True) if array is not piece))

    def _keep(self, *arrays: DeviceArray) -> None:
        for array in arrays:
            self._spare[array.device, array.shape].append(array)

    def _spanned(self, pieces: Pieces, spans: Cuts) -> list[DeviceArray]:
        """Slices of a field on each member, by first slice and the one after the last."""
        major, minor, _ = pieces[0].shape
        cuts, wide = self.cuts(_height(pieces)), []
        for member, own, cut, (first, last) in zip(self.members, pieces, cuts, spans, strict=True):
            wide.append(own if (first, last) == cut else self._scratch(member, (major, minor, max(last - first, 0))))
            for piece, (low, high) in zip(pieces, cuts, strict=True):
                if wide[-1] is not own and max(low, first) < min(high, last):
                    self._bring(piece, max(low, first) - low, min(high, last) - low, first - low, wide[-1])
        return wide

    def _run_twice(self, kernel: Kernel, bound: dict[str, Any]) -> None:
        """Every member combines its partial results, and the first member combines these."""
        (source,) = (n for n, spec in kernel.arguments.items() if isinstance(spec, Table) and "part" in spec.axes)
        target, results = bound[kernel.over], []
        for part in bound[source].parts():
            if part.shape[0]:
                results.append(part.device.empty(target.shape, target.dtype, table=True))
                part.device.launch(kernel, **{**bound, source: part, kernel.over: results[-1]})
                part.device.flush()
        if results:
            combined = Copies((len(results) * target.shape[0],), target.dtype)
            combined.keep(_stored(self.members[0], np.concatenate([r.device._load(r) for r in results]), table=True))
            bound = {**bound, source: combined}
        self._run_whole(kernel, bound)

    def _run_whole(self, kernel: Kernel, bound: dict[str, Any]) -> None:
        """The first member computes everything, and the others receive their slices."""
        first, joined = self.members[0], {}
        for value in bound.values():
            if isinstance(value, Pieces) and id(value) not in joined:
                whole = np.concatenate([piece.device._load(piece) for piece in value], axis=2)
                joined[id(value)] = _stored(first, whole)
            elif isinstance(value, Copies):
                joined[id(value)] = value.on(first)
        first.launch(kernel, **{name: joined.get(id(value), value) for name, value in bound.items()})
        for name, spec in kernel.arguments.items():
            value = bound[name]
            if isinstance(value, Copies) and spec.writes:  # type: ignore[union-attr]
                value.keep(joined[id(value)])
            elif isinstance(value, Pieces) and isinstance(spec, Field) and spec.writes:
                whole = first._load(joined[id(value)])
                for piece, (begin, end) in zip(value, self.cuts(whole.shape[2]), strict=True):
                    piece.device._store(piece, whole[:, :, begin:end])

    def synchronize(self) -> None:
        for member in self.members:
            member.synchronize()

    # ---- arrays of other libraries --------------------------------------------------------------------------
    def adopt(self, foreign: Any) -> DeviceArray:
        return self.upload(from_host(self, foreign), table=True)

    def _native(self, table: DeviceArray) -> Any:
        raise DeviceError(f"{self.name} keeps an array on several devices, and no library does; use .numpy()")

    def _exported(self, table: DeviceArray, copy: bool) -> np.ndarray:
        return table.numpy()


@cache
def _is_cut(kernel: Kernel) -> bool:
    """Whether members can compute their slices separately, or with a few slices of their neighbors."""
    over = kernel.arguments[kernel.over]
    if not isinstance(over, Field) or kernel.reach == WHOLE:
        return False
    for spec in kernel.arguments.values():
        if isinstance(spec, Field) and spec.axes[2] != over.axes[2] and kernel.reach not in kernel.arguments:
            return False
        if isinstance(spec, Table) and spec.writes and not {"part", over.axes[2]} & set(spec.axes):
            return False
    return True


@cache
def _is_counted(kernel: Kernel) -> bool:
    """Whether a slice's result depends only on its number."""
    over: Any = kernel.arguments[kernel.over]
    fields = [spec for spec in kernel.arguments.values() if isinstance(spec, Field)]
    return isinstance(kernel.arguments.get(kernel.reach), Scalar) and all(spec.axes == over.axes for spec in fields)


def _height(pieces: Pieces) -> int:
    return sum(piece.shape[2] for piece in pieces)


def _copy(source: DeviceArray, first: int, field: DeviceArray) -> None:
    field.device.launch(copy_slices, source=source, first=first, lanes=source, field=field)
