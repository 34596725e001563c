"""Several devices as one: a field is cut along z; every member stores and computes its own slices, with a few more of
its neighbors if a kernel needs them (see `Kernel`). The first member runs other kernels, on the whole field.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, wraps
from math import prod
from typing import Any, Concatenate, ParamSpec, TypeVar

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import DeviceError, OutOfMemory
from vamgpu.kernels.signature import Field, Kernel, Moved, Scalar, Table
from vamgpu.kernels.stack import put_slices

Cuts = list[tuple[int, int]]
"""First slice and the one after the last, a pair per member; empty for members without slices."""
WHOLE = "all"
SPARE = 8  # shapes of which each member keeps temporary fields for later launches
Passed = ParamSpec("Passed")
Found = TypeVar("Found")


class Pieces(list[DeviceArray]):
    """A field: the slices that each member stores."""


class Copies:
    """A table: on any member that needed it, in parts that the members wrote along an axis, or joined when read."""

    def __init__(self, shape: tuple[int, ...], dtype: np.dtype) -> None:
        self.shape: tuple[int, ...] = shape
        self.dtype: np.dtype = dtype
        self._whole: dict[Device, DeviceArray] = {}
        self._parts: list[DeviceArray] = []
        self._axis = 0
        self._bands: dict[Any, tuple[Cuts, list[DeviceArray]]] = {}
        self._joined: Callable[[], np.ndarray] | None = None

    def read(self) -> np.ndarray:
        """The table on the host."""
        if self._whole:
            held = next(iter(self._whole.values()))
            return held.device._load(held)
        if self._joined is not None:
            return self._joined()
        return np.concatenate(_loaded(self._parts), self._axis) if self._parts else np.zeros(self.shape, self.dtype)

    def keep(self, table: DeviceArray | None, joined: Callable[[], np.ndarray] | None = None) -> None:
        """Take one member's copy as the table, or what a function reads, and drop the other copies."""
        self._whole, self._joined = {} if table is None else {table.device: table}, joined
        self._parts, self._bands = [], {}

    def parts(self) -> list[DeviceArray]:
        """The parts that members wrote; none if the table is whole."""
        return [] if self._whole else self._parts

    def on(self, device: Device) -> DeviceArray:
        """The whole table on a member."""
        if device not in self._whole:
            copy, held = device.empty(self.shape, self.dtype, table=True), next(iter(self._whole.values()), None)
            offer = None if held is None else held.device._offer(held.handle, device)
            if held is None or offer is None:
                device._store(copy, self.read())
            else:
                device._take(copy.handle, held.device, offer)
            self._whole[device] = copy
        return self._whole[device]

    def shared(self, members: Sequence[Device], axis: int, cuts: Cuts, use: Moved) -> list[DeviceArray]:
        """Its parts along an axis, one per member, for a kernel that combines them."""
        lengths = [end - begin for begin, end in cuts]
        if self._axis != axis or [part.shape[axis] for part in self._parts] != lengths:
            if use.reads:
                whole = self.read()
                parts = [np.take(whole, range(begin, end), axis) for begin, end in cuts]
                self._parts = [_stored(device, part, table=True) for device, part in zip(members, parts, strict=True)]
            else:
                shapes = [(*self.shape[:axis], length, *self.shape[axis + 1 :]) for length in lengths]
                self._parts = [m.empty(shape, self.dtype, table=True) for m, shape in zip(members, shapes, strict=True)]
            self._axis = axis
        if use.writes:
            self._whole, self._bands, self._joined = {}, {}, None
        return self._parts

    def band(self, members: Sequence[Device], cuts: Cuts, taps: int, most: int) -> tuple[Cuts, list[DeviceArray]]:
        """A table of slice numbers by member: the slices that each needs, and its entries counted from the first."""
        key = (tuple(cuts), taps, most)
        if key not in self._bands:
            whole = self.read()
            each = [whole[begin:end] for begin, end in cuts]
            spans = [(max(int(e.min()), 0), min(int(e.max()) + taps, most)) if e.size else (0, 0) for e in each]
            parts = [(e - first).astype(self.dtype) for e, (first, _) in zip(each, spans, strict=True)]
            self._bands[key] = spans, [_stored(m, p, table=True) for m, p in zip(members, parts, strict=True)]
        return self._bands[key]


def _loaded(arrays: list[DeviceArray], *entries: int | None) -> list[np.ndarray]:
    """Arrays, or some entries of their first axes, of several members: all are asked before the first one answers."""
    return [answer() for answer in [array.device._asked(array, *entries) for array in arrays]]


def _stored(device: Device, values: np.ndarray, *, table: bool = False) -> DeviceArray:
    array = device.empty(values.shape, values.dtype, table=table)
    device._store(array, values)
    return array


def _yields(
    act: Callable[Concatenate[SlabDevice, Passed], Found],
) -> Callable[Concatenate[SlabDevice, Passed], Found]:
    """A method that gives spare fields back without memory; another process may not even have made them."""

    @wraps(act)
    def tried(self: SlabDevice, *given: Passed.args, **named: Passed.kwargs) -> Found:
        try:
            return act(self, *given, **named)
        except OutOfMemory:
            self._spare.clear()
            raise

    return tried


class SlabDevice(Device):
    """Devices that divide the slices of every field; a device may be a member more than once."""

    def __init__(self, name: str, members: Sequence[Device]) -> None:
        if len({(type(member), member.is_gpu, member.real) for member in members}) != 1:
            raise DeviceError(
                f"{name!r} is {', '.join(map(str, members)) or 'no device'}; expected devices of one kind, which "
                "divide work in the same way"
            )
        super().__init__(name, " and ".join(member.description for member in members))
        self.members: tuple[Device, ...] = tuple(members)
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

    @_yields
    def _allocate(self, shape: tuple[int, ...], dtype: np.dtype, lanes: int) -> Pieces | Copies:
        if not lanes:
            return Copies(shape, dtype)
        nz, major, minor, _ = shape
        cuts = zip(self.members, self.cuts(nz), strict=True)
        return Pieces(member.empty((major, minor, end - begin), dtype) for member, (begin, end) in cuts)

    @_yields
    def _write(self, handle: Copies, stored: np.ndarray, first: int = 0) -> None:
        member = self.members[0]
        if first == 0 and stored.size == prod(handle.shape):
            return handle.keep(_stored(member, stored.reshape(handle.shape), table=True))
        table = handle.on(member)
        member._write(table.handle, stored, first)
        handle.keep(table)

    @_yields
    def _read(self, handle: Copies, stored: np.ndarray, first: int = 0) -> None:
        stored.reshape(-1)[...] = handle.read().reshape(-1)[first : first + stored.size]

    @_yields
    def _store(self, array: DeviceArray, source: np.ndarray, first: int = 0) -> None:
        if not array.lanes:
            return super()._store(array, source, first)
        for piece, (begin, end) in zip(array.handle, self.cuts(array.shape[2]), strict=True):
            piece.device._store(piece, source[:, :, begin:end], first)

    @_yields
    def _load(self, array: DeviceArray, first: int = 0, last: int | None = None) -> np.ndarray:
        if not array.lanes:
            return super()._load(array, first, last)
        return np.concatenate(_loaded(array.handle, first, last), axis=2)

    def _lanes_of(self, array: DeviceArray) -> Pieces:
        return array.handle

    @_yields
    def _launch(self, kernel: Kernel, bound: dict[str, Any], sizes: dict[str, int], lanes: int) -> None:
        if kernel.reach == "part":
            self._run_twice(kernel, bound)
        elif not _is_cut(kernel):
            self._run_whole(kernel, bound)
        elif not kernel.reach or _is_counted(kernel):
            self._run_apart(kernel, bound, sizes)
        else:
            self._run_among(kernel, bound, sizes)

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
                member._begin(kernel, given | ({kernel.reach: begin + given[kernel.reach]} if kernel.reach else {}))

    def _shares(self, spec: Field | Table | Scalar, value: Any, cuts: dict[str, Cuts]) -> Sequence[Any]:
        if isinstance(value, Pieces):
            return value
        if not isinstance(spec, Table):
            return [value] * len(self.members)
        axis = next((axis for axis in spec.axes if axis in cuts), None)
        if axis is None:
            return [value.on(member) for member in self.members]
        return value.shared(self.members, spec.axes.index(axis), cuts[axis], spec)

    def _run_among(self, kernel: Kernel, bound: dict[str, Any], sizes: dict[str, int]) -> None:
        """Every member computes its own slices from more: those near them, or those that a table or a number names."""
        over: Any = kernel.arguments[kernel.over]
        fields = {n: spec for n, spec in kernel.arguments.items() if isinstance(spec, Field)}
        other = next((bound[n] for n, spec in fields.items() if spec.axes != over.axes), None)
        cuts, reach = self.cuts(sizes[over.axes[2]]), bound.get(kernel.reach, 0)
        active, more = [begin < end for begin, end in cuts], {}
        if other is None:
            far, most = sizes[kernel.reach] - 1, sizes[over.axes[2]]
            spans = [(max(b - far, 0), min(e + far, most)) if b < e else (b, e) for b, e in cuts]
        elif isinstance(reach, Copies):
            spans, more[kernel.reach] = reach.band(self.members, cuts, sizes["tap"], _height(other))
        else:
            ends = np.clip(np.subtract(cuts, reach), 0, _height(other)).tolist()
            spans, active = [(low, high) for low, high in ends], [low < high for low, high in ends]
            more[kernel.reach] = [np.int32(reach + low - b) for (low, _), (b, _) in zip(spans, cuts, strict=True)]
        read = {id(bound[n]) for n, spec in fields.items() if spec.reads}
        spread = {id(bound[n]): bound[n] for n in fields if other is None or bound[n] is other}
        wide = {key: self._spanned(pieces, spans, key in read) for key, pieces in spread.items()}
        along = {} if other is None else {over.axes[2]: cuts}
        shares = {n: wide.get(id(v)) or self._shares(kernel.arguments[n], v, along) for n, v in bound.items()} | more
        for k in np.flatnonzero(active).tolist():
            given = {n: share[k] for n, share in shares.items()}
            self.members[k]._begin(kernel, given)
            for name, spec in fields.items():
                if spec.writes and given[name] is not bound[name][k]:
                    _copy(given[name], cuts[k][0] - spans[k][0], bound[name][k])
        for key, pieces in spread.items():
            self._keep(*(array for array, piece in zip(wide[key], pieces, strict=True) if array is not piece))

    def _scratch(self, member: Device, shape: tuple[int, ...]) -> DeviceArray:
        """A temporary field of a member for one launch: drivers take as long to allocate memory as to project."""
        spare = self._spare.get((member, shape))
        return spare.pop() if spare else member.empty(shape)

    def _keep(self, *arrays: DeviceArray) -> None:
        """Return temporary fields, for later launches; a member's launches run one after another."""
        for array in arrays:
            key = array.device, array.shape
            self._spare[key] = [*self._spare.pop(key, []), array]  # the last one used is the last one dropped
            if len(self._spare) > SPARE * len(self.members):
                del self._spare[next(iter(self._spare))]

    def _spanned(self, pieces: Pieces, spans: Cuts, read: bool) -> list[DeviceArray]:
        """Slices of a field on each member, by first slice and the one after the last; empty unless they are read."""
        (major, minor, _), wide, moves = pieces[0].shape, list[DeviceArray](), []
        for member, own, cut, (first, last) in zip(
            self.members, pieces, cuts := self.cuts(_height(pieces)), spans, strict=True
        ):
            wide.append(own if (first, last) == cut else self._scratch(member, (major, minor, max(last - first, 0))))
            for piece, (low, high) in zip(pieces, cuts, strict=True):
                begin, end = max(low, first), min(high, last)
                if wide[-1] is not own and begin < end:
                    moves.append((piece, begin - low, end - begin, begin - first, wide[-1]))
        self._move(moves if read else [])
        return wide

    def _move(self, moves: list[tuple[DeviceArray, int, int, int, DeviceArray]]) -> None:
        """Copy slices: a piece, its first one, their number, and the first one there and the field."""
        # every member first offers what others need, then copies its own, then takes: none waits for its neighbor
        across = [move for move in moves if move[0].device is not move[-1].device]
        strips = [self._scratch(move[0].device, (*move[0].shape[:2], move[2])) for move in across]
        for (piece, begin, *_), strip in zip(across, strips, strict=True):
            _copy(piece, begin, strip)
        offers = [
            strip.device._offer(strip.handle, move[-1].device) for strip, move in zip(strips, across, strict=True)
        ]
        for piece, begin, _, first, wide in moves:
            if piece.device is wide.device:
                _copy(piece, begin - first, wide)
        for strip, offer, (*_, first, wide) in zip(strips, offers, across, strict=True):
            taken = self._scratch(wide.device, strip.shape)
            if offer is None:
                wide.device._store(taken, strip.device._load(strip))
            else:
                wide.device._take(taken.handle, strip.device, offer)
            _copy(taken, -first, wide)
            self._keep(strip, taken)

    def _run_twice(self, kernel: Kernel, bound: dict[str, Any]) -> None:
        """Every member combines its partial results; the host combines these when they are read, in a single wait."""
        (source,) = (n for n, spec in kernel.arguments.items() if isinstance(spec, Table) and "part" in spec.axes)
        shape, dtype = bound[kernel.over].shape, bound[kernel.over].dtype
        parts = [part for part in bound[source].parts() if part.shape[0]]
        if not parts:
            return self._run_whole(kernel, bound)
        results = [part.device.empty(shape, dtype, table=True) for part in parts]
        for part, result in zip(parts, results, strict=True):
            part.device._begin(kernel, {**bound, source: part, kernel.over: result})

        numbers = {name: value for name, value in bound.items() if not isinstance(value, Copies)}

        def joined() -> np.ndarray:
            found = np.empty(shape, dtype)
            kernel.definition(**numbers, **{source: np.concatenate(_loaded(results)), kernel.over: found})
            return found

        return bound[kernel.over].keep(None, joined)

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

    @_yields
    def synchronize(self) -> None:
        for member in self.members:
            member.synchronize()

    def _native(self, table: DeviceArray) -> Any:
        raise DeviceError(f"{self.name} keeps an array on several devices; for other libraries, use .numpy()")


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
    """Slices of a field of the same member, from ``first`` on."""
    given = {"source": source, "first": np.int32(-first), "factor": source.dtype.type(1), "keep": np.int32(0)}
    field.device._begin(put_slices, {**given, "lanes": source, "stack": field})
