"""Valid inputs for every declared kernel, at any size: what the profiler times and the contract of devices compares."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.kernels.catalog import kernels
from vamgpu.kernels.depth import NO_CUT, SIDE, cut_voxels, nearest_cut
from vamgpu.kernels.histogram import tally
from vamgpu.kernels.photons import WAYS
from vamgpu.kernels.signature import Field, Kernel, Moved, Scalar, Table
from vamgpu.kernels.spectrum import ROWS, in_groups, most_lit_first


@dataclass(frozen=True)
class Example:
    """Inputs of a kernel.

    sizes: of its named axes; 0 where the device decides.  given: arrays and scalars by name, or a function of the
    device and the arguments before it; what is not given is random.  combine: how partial results add up, by name.
    below: what random fields, from 0 to 1 without, are lowered by.
    """

    sizes: dict[str, int]
    given: dict[str, Any] = field(default_factory=dict)
    combine: dict[str, Callable[[np.ndarray], Any]] = field(default_factory=dict)
    below: float = 0.0


@dataclass(frozen=True)
class Bound:
    """A kernel with arrays on a device, ready to launch again and again."""

    device: Device
    kernel: Kernel
    arguments: dict[str, Any]
    combine: dict[str, Callable[[np.ndarray], Any]]

    def launch(self) -> None:
        self.device.launch(self.kernel, **self.arguments)

    def written(self) -> dict[str, np.ndarray]:
        """What the kernel wrote, partial results combined, in float64."""
        out = {}
        for name, spec in self.kernel.arguments.items():
            if getattr(spec, "writes", False):
                values = self.arguments[name].numpy().astype(np.float64)
                out[name] = np.asarray(self.combine[name](values) if name in self.combine else values)
        return out

    def error(self, reference: Bound) -> float:
        """Greatest difference from a reference over its greatest value; for counts, the share that differs."""
        worst, wanted = 0.0, reference.written()
        for name, values in self.written().items():
            apart = np.abs(values - wanted[name])
            whole = self.arguments[name].dtype.kind in "iu"
            scale = np.abs(wanted[name]).sum() if whole else np.abs(wanted[name]).max()
            worst = max(worst, float((apart.sum() if whole else apart.max()) / max(scale, 1e-30)))
            if not np.isfinite(values).all() and np.isfinite(wanted[name]).all():
                return float("inf")
        return worst

    @property
    def nbytes(self) -> int:
        """Bytes of what is read and of what is written; arrays that are updated count twice."""
        arrays = [(a, self.kernel.arguments[name]) for name, a in self.arguments.items() if isinstance(a, DeviceArray)]
        return sum(array.nbytes * (spec.reads + spec.writes) for array, spec in arrays if isinstance(spec, Moved))


def bind(device: Device, kernel: Kernel, size: int, seed: int = 0) -> Bound:
    """The example of a kernel on a device; the same numbers on every device."""
    example, rng = EXAMPLES[kernel.name](size), np.random.default_rng(seed)
    over = kernel.arguments[kernel.over]
    sizes = dict(example.sizes)
    if "part" in sizes and isinstance(over, Field):
        major, minor, z = (sizes[axis] for axis in over.axes)
        sizes["part"] = device.items(kernel, (major, minor, z))
    if sizes.get("strip") == 0:
        sizes["strip"] = device.items(tally, (sizes["i"], 1, 1))
    arguments: dict[str, Any] = {}
    for name, spec in kernel.arguments.items():
        if not isinstance(spec, Scalar):
            shape = tuple(sizes[axis] if not axis.isdigit() else int(axis) for axis in spec.axes)
            arguments[name] = _array(device, spec, shape, name, example, rng)
    for name in kernel.arguments.keys() - arguments.keys():
        value = example.given[name]
        arguments[name] = value(device, arguments) if callable(value) else value
    return Bound(device, kernel, arguments, example.combine)


def _array(
    device: Device, spec: Field | Table, shape: tuple[int, ...], name: str, example: Example, rng: np.random.Generator
) -> DeviceArray:
    if isinstance(spec, Field):
        values = example.given[name] if name in example.given else rng.random(shape) - example.below
        return _field(device, np.asarray(values, np.float32))
    if name in example.given:
        return device.table(np.asarray(example.given[name]), spec.dtype)
    if spec.writes:
        return device.table(np.zeros(shape), spec.dtype)
    if spec.dtype == "float32":
        return device.table(rng.random(shape).astype(np.float32), spec.dtype)
    highest = 50 if spec.dtype != "uint8" else 256 if spec.axes[-1] == "byte" else 2
    return device.table(rng.integers(0, highest, shape), spec.dtype)


def _field(device: Device, values: np.ndarray) -> DeviceArray:
    """A field whose padding is not a number: no kernel may let that reach a slice or a result."""
    array = device.upload(values)
    if array.lanes and values.shape[2] % array.lanes:
        stored = np.full(device.stored_shape(values.shape, array.lanes), np.nan, np.float32)
        for z in range(values.shape[2]):
            stored[z // array.lanes, :, :, z % array.lanes] = values[:, :, z]
        device._write(array.handle, stored)  # the padding is out of reach of upload
    return array


# ---- what the kernels take -----------------------------------------------------------------------------------------
def _poses(count: int) -> np.ndarray:
    angles = 2.0 * np.pi * np.arange(count) / count
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


def _slices(n: int) -> int:
    return n // 2 + 1 if n % 2 else n


def _volume(n: int) -> dict[str, int]:
    return {"x": n, "y": n - n % 2, "z": _slices(n)}


def _light(n: int) -> dict[str, int]:
    return {"angle": n + n % 2, "r": n + 2 * (n % 2), "z": _slices(n)}


def _watched(n: int, **given: Any) -> Example:
    sizes = {**_light(n), **({"shot": 1} if given else {})}
    return Example(sizes, {"reached": np.linspace(-0.2, 1.0, sizes["r"]).clip(0.0), **given})


def _footprint(n: int) -> Example:
    """Refracted light of pixels narrower than their pitch, blurred, into a vial that turns by arcs."""
    arc = 0.03
    light, sizes = _tabulated(n, None, arc)
    count = sizes["angle"]
    arcs = arc * (np.arange(count) % 4 / 3.0 if count % 4 else np.ones(count))  # unlike ones do not fold
    poses = np.concatenate([_poses(count), arcs[:, None]], axis=1)
    tables = {"light": light.map, "edges": light.edges, "directions": poses}
    numbers = {"bent": 1, "ratio": light.steepest, "strength": 0.0, "fill": light.fill, "sigma": light.sigma}
    return Example(sizes, {**tables, **numbers, "radius": light.radius, "taps": light.taps, "cells": light.cells})


def _tabulated(n: int, half: float | None, arc: float = 0.0) -> tuple[Any, dict[str, int]]:
    """Tables of a vial and the sizes of what they serve."""
    from vamgpu.geometry import Beam, Grid
    from vamgpu.operators.ray_table import tabulate
    from vamgpu.optics.vial import Vial

    pitch = 12.0 / n
    vial = Vial(radius=12.4, wall=1.0, resin_index=1.49962, wall_index=1.473, absorption=0.05)
    sizes = {**_volume(n), **_light(n)}
    light = tabulate(Grid((n, sizes["y"], 1), pitch), Beam((sizes["r"], 1), 1.2 * pitch, fill=0.9), vial, half, arc)
    return light, {**sizes, "across": light.map.shape[0], "along": light.map.shape[1]}


def _spread_rows(n: int) -> Example:
    """Two rows and a part of the next ones light every slice; four taps light every column's bins."""
    z, row = _slices(n), n + 3
    slices = -(-z // 64) * 64
    first = np.minimum(np.arange(slices), row - 3)
    near = np.arange(row)[:, None] - first
    shares = np.where((near >= 0) & (near < 3), 0.2 + 0.1 * near, 0.0)
    given = {"shares": shares, "span": np.stack([first, first + 3], axis=1), "lanes": lambda _, arrays: arrays["light"]}
    return Example({"angle": n, "r": n + 1, "row": row, "slice": slices, "z": z}, given)


def _spread_columns(n: int) -> Example:
    first = np.minimum(np.arange(2 * n) // 2, n - 4)
    return Example({"angle": n, "r": n, "bin": 2 * n, "tap": 4, "z": _slices(n)}, {"first": first})


def _exposed(n: int) -> Example:
    """Light that a caustic folds and that turns; an odd square of voxels and poses by fours fold by symmetry too."""
    odd, angles, across = n | 1, n - n % 4 or 4, n + 4
    place = (np.arange(across) - 0.5 * (across - 1)) * 1.3
    middle = 1.0 * n + 1.4 * place[:, None] * (1.0 + 0.002 * place[None, :])
    share, other, zero = np.full_like(middle, 0.3), 1.9 * n - middle, np.zeros_like(middle)
    plain = np.stack([middle - 0.8, middle + 0.8, share, zero], axis=-1)
    folded = np.stack([other, other + 0.4, 0.7 * share, zero], axis=-1)
    arcs = angles * (1 + n % 2)
    poses = np.concatenate([_poses(arcs), np.ones((arcs, 1)), np.full((arcs, 1), 0.2 * (n % 2))], axis=1)
    sizes = {"angle": angles, "arc": arcs, "bin": 2 * n, "branch": 2, "across": across, "along": across}
    given = {"poses": poses, "pose": np.stack([plain, folded]), "scale": 1 / 1.3, "single": 0.3 * n, "radius": 0.48 * n}
    return Example({**sizes, "x": odd, "y": odd, "z": _slices(n)}, given)


def _averaged(n: int) -> Example:
    sizes = {"u": 2 * n + 3, "v": 2 * n + 1, "level": n, "tap": 5, "x": n, "y": n + 1, "z": n}
    return Example(sizes, {"finer": 2, "corner_x": -2, "corner_y": 1, "first": 0})


def _oblique(n: int, source: str) -> Example:
    """Refracted light that also climbs, past an axis that wobbles."""
    width = 1.25
    tables, sizes = _tabulated(n, 0.5 * (1.0 + width))
    volume, rows = sizes["z"], sizes["z"] + 3
    light, poses = tables.map[..., :2], _poses(sizes["angle"])
    climb = np.broadcast_to(0.3 * np.arange(light.shape[1]) - 0.15 * light.shape[1], light.shape[:2])
    table = np.concatenate([light, np.stack([climb, np.full_like(climb, 0.9)], axis=-1)], axis=-1)
    places = 0.3 * np.stack([poses[:, 1], poses[:, 0]], axis=1)
    given = {"light": table, "edges": tables.edges, "poses": np.concatenate([poses, places], axis=1), "width": width}
    given |= {"radius": tables.radius - 0.5, "lanes": lambda _, arrays: arrays[source]}
    written = volume if source == "sinogram" else rows
    return Example({**sizes, "z": written, "row": rows, "slice": volume}, given)


def _resampled(n: int) -> Example:
    """To more slices, or from more than items hold to each where they are 25."""
    source, taps = (16 * n, 41) if n == 25 else (n - n // 3, 3)
    first = np.arange(n) * source // n - taps // 2
    given = {"first": first, "lanes": lambda _, arrays: arrays["source"]}
    return Example({"i": n, "j": n + n % 2, "source": source, "z": n, "tap": taps}, given)


def _stacked(n: int) -> Example:
    """Slices that begin and end within slabs of the stack, added to what stands there."""
    source, first = n // 2 + 1, n // 3 + 1
    given = {"first": first, "factor": 0.7, "keep": 1, "lanes": lambda _, arguments: arguments["source"]}
    return Example({"i": n, "j": n + n % 2, "source": source, "z": source + first + n}, given)


def _shifted(n: int) -> Example:
    """Two overlapping tiles, each a part of a pixel off."""
    angles, rows = n + n % 2, n // 2 + 2
    moves = np.stack([np.arange(2 * angles) % 3 - 1.0, np.linspace(0.0, 0.9, 2 * angles)] * 2, axis=1)
    moves[angles:, 2] += rows - 3
    tapers = np.linspace(0.2, 1.0, 2 * rows).reshape(2, rows)
    sizes = {"image": angles, "column": n, "row": n, "move": 2 * angles, "angle": 2 * angles, "r": n + 1, "z": rows}
    given = {"moves": moves, "tapers": tapers, "after": 1, "lanes": lambda _, arrays: arrays["source"]}
    return Example({**sizes, "tile": 2, "taper": rows}, given)


def _array_sizes(n: int) -> dict[str, int]:
    return {"i": n, "j": n + n % 2, "z": _slices(n)}


def _partial(n: int, **given: Any) -> Example:
    kinds: dict[str, Callable[[np.ndarray], Any]] = {"lows": np.min, "highs": np.max}
    kinds |= dict.fromkeys(
        ("parts", "moved", "crossed", "inside", "outside", "below", "shorts", "above", "over", "slopes", "bends"),
        np.sum,
    )
    return Example({**_array_sizes(n), "part": 0, "sample": 2}, given, combine=kinds)


def _elementwise(n: int, **given: Any) -> Example:
    return Example(_array_sizes(n), given)


def _voxels(n: int, **given: Any) -> Example:
    """Doses about those of a curve; knots as far apart as values reach."""
    sizes = _array_sizes(n)
    tables = {"knots": [0.0, 0.3, 0.7, 0.9], "values": [0.1, 0.5, 0.4, 0.8], "slopes": [1.0, 0.4, 2.0, 0.7]}
    curve = {"samples": np.tanh(np.linspace(-1.0, 2.0, 40)), "start": -1.0, "density": 13.0}
    rng = np.random.default_rng(3)
    places = np.stack([rng.integers(0, count, 37) for count in sizes.values()], axis=1)
    judged = np.hypot(*np.meshgrid(np.arange(sizes["i"]), np.arange(sizes["j"]), indexing="ij")) < 1.1 * n
    given = {**tables, **curve, "places": places, "judged": judged, "up": np.linspace(-1, 1, sizes["z"]), **given}
    return Example({**sizes, "pick": 37, "knot": 4, "sample": 40}, given)


def _filtered(n: int, **given: Any) -> Example:
    taps = np.cos(np.arange(n // 2)) / (1.0 + np.arange(n // 2))
    sizes = {**_light(n), "tap": len(taps), "part": 0}
    return Example(sizes, {"taps": taps, "stride": 1, **given}, combine={"parts": np.sum})


def _band(n: int) -> Example:
    response = np.tanh(np.linspace(-1.0, 2.0, 40))
    given = {"weighted": 1, "response": response, "start": -1.0, "density": 13.0, "low": 0.2, "high": 0.9}
    given |= {"slack_low": 0.1, "slack_high": 0.05, "gain_low": 0.7, "gain_high": 1.3, "power": 2.0, "ridge": 0.2}
    example = _partial(n, **given, binary=0, reach=0.4 * n)
    return Example({**example.sizes, "sample": 40}, example.given, combine=example.combine)


def _sampled(n: int) -> Example:
    curve = np.tanh(np.linspace(-1.0, 2.0, 40))
    given = {"weighted": 1, "outer": curve, "inner": curve[::-1] ** 2, "start": -1.0, "density": 13.0, "binary": 0}
    example = _partial(n, **given, reach=0.4 * n)
    return Example({**example.sizes, "sample": 40}, example.given, combine=example.combine)


def _counted(n: int) -> Example:
    ranges = np.broadcast_to(np.array([0.05, 0.9, 62 / 0.85]), (1, 2, 3))
    given = {"ranges": ranges, "level": 0.5, "radius": 0.45 * n}
    sizes = {**_array_sizes(n), "slice": 1, "strip": 0, "bin": 64}
    return Example(sizes, given, combine={"partial": lambda p: p.sum(axis=0)})


def _surveyed(n: int) -> Example:
    def over_strips(parts: np.ndarray) -> np.ndarray:
        return np.stack([parts[..., 0].min(0), parts[..., 1].max(0), parts[..., 2].sum(0)], axis=-1)

    sizes = {**_array_sizes(n), "strip": 0}
    return Example(sizes, {"level": 0.5, "radius": 0.45 * n}, combine={"parts": over_strips})


def _folded(n: int) -> Example:
    return Example({"strip": n // 8 + 1, "z": n, "slice": n, "bin": 64})


def _cut(n: int) -> tuple[dict[str, int], dict[str, np.ndarray]]:
    """A ball beside a plate that ends at the grid's edge, and the voxels that their surfaces cut."""
    sizes = _volume(n)
    x, y, z = np.meshgrid(*(np.arange(count) / n for count in sizes.values()), indexing="ij")
    ball = 0.3 - np.sqrt((x - 0.4) ** 2 + (y - 0.45) ** 2 + (z - 0.5) ** 2)
    fraction = np.clip(0.5 + n * np.maximum(ball, 0.13 - np.abs(x + 0.4 * y - 1.2)), 0.0, 1.0).astype(np.float32)
    found = {"fraction": fraction, "place": np.empty_like(fraction), "steps": np.empty_like(fraction)}
    cut_voxels.definition(*found.values())
    return sizes, found


def _cut_voxels(n: int) -> Example:
    sizes, cut = _cut(n)
    combine = {"place": lambda place: np.minimum(place, 9.0), "steps": lambda steps: 1.0 * (steps < NO_CUT)}
    return Example(sizes, {"fraction": cut["fraction"]}, combine)


def _nearest(n: int, axis: int) -> Example:
    """Steps along each axis, and squared distances, are compared: packed numbers are much greater."""

    def unpacked(steps: np.ndarray) -> np.ndarray:
        return np.stack([steps // SIDE**k % SIDE for k in range(3)] + [steps // SIDE**3]) * (steps < NO_CUT)

    sizes, cut = _cut(n)
    return Example(sizes, {"steps": cut["steps"], "axis": axis, "span": 5}, {"nearest": unpacked})


def _measured(n: int) -> Example:
    """All slices but the first and the last two."""
    sizes, cut = _cut(n)
    for axis in range(3):
        nearest_cut.definition(cut["steps"].copy(), axis, 5, cut["steps"])
    given = {"first": 1, "lanes": lambda _, arrays: arrays["fraction"], "reach": 4.0, "pitch": 0.3}
    return Example({**sizes, "source": sizes["z"], "z": sizes["z"] - 3}, {**cut, **given})


def _by_depth(n: int) -> Example:
    """Depths to both sides of the surface, also beyond the last step; rows without and with voxels that count."""
    sizes = _array_sizes(n)
    row = np.arange(sizes["i"])
    ends = np.stack([row % 5, np.where(row % 4, sizes["j"] - row % 3, 0)], axis=1)
    combine = {
        "least": lambda each: np.minimum(each.min(axis=0), 9.0), "counts": lambda each: each.sum(axis=0),
        "greatest": lambda each: np.maximum(each.max(axis=0), -9.0),
    }  # fmt: skip
    return Example({**sizes, "part": 0, "bin": 14}, {"ends": ends, "width": 0.037, "rounding": 1e-4}, combine, 0.5)


PLACE = {"shift_r": 2, "shift_z": -1, "part_r": 0.25, "part_z": 0.5, "flip_r": 1, "flip_z": 0}
CURVE = np.linspace(0.01, 1.0, 256) ** 1.8


def _frames(n: int, **given: Any) -> Example:
    light = _light(n)
    sizes = {**light, "flat_row": 1, "flat_column": 1, "level": 256, "byte": light["r"]}
    bounds = np.append(0.5 * (CURVE[1:] + CURVE[:-1]), 1e30)
    tables = {"flat": np.ones((1, 1)), "curve": CURVE, "bounds": bounds}
    return Example(sizes, {**tables, **PLACE, **given})


def _bits(n: int) -> Example:
    light = _light(n)
    return Example({**light, "byte": -(-light["r"] // 8)})


def _planes(n: int, bits: int = 8) -> Example:
    """Pictures off the middle of larger mirrors; an odd n has more strips than rows."""
    rng = np.random.default_rng(5)
    columns = 3 * n + 5
    chosen = np.stack([np.arange(6) % 4, np.arange(6) % 3], axis=1)
    given = {"masks": 255 * rng.integers(0, 2, (3, columns)), "chosen": chosen, "top": 2, "left": 3,
             "images": rng.integers(0, 256, (4, n, columns))}  # fmt: skip
    width = 8 * -(-(columns + 3) // 64) if bits == 8 else columns + 4
    sizes = {"angle": 4, "line": n, "byte": columns, "bin": 3, "frame": 6, "row": n + 3, "width": width}
    return Example({**sizes, "strip": width // 8 * (n + 3) if n % 2 and bits == 8 else n}, given)


def _rebinned(n: int) -> Example:
    column = np.linspace(-1.0, n + 1.0, _light(n)["r"])
    rays = np.stack([0.02 * (column - 0.5 * n), column, 1.0 - 0.3 * np.abs(column / n - 0.5)], axis=1)
    return Example({**_light(n), "column": n}, {"rays": rays})


def _solid(n: int, *, listed: bool = True) -> Example:
    """Two tilted cubes that overlap, in one list of triangles for every tile, and room for the rays' crossings."""
    from vamgpu.geometry import Grid
    from vamgpu.kernels.voxelize import count_crossings
    from vamgpu.targets.solid import Solid
    from vamgpu.targets.voxelize import binned, oriented, snapped
    from vamgpu.targets.voxelize import listed as share_lists

    corners = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], float)
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))], np.int32)
    turn = np.linalg.qr(np.array([[1.0, 0.3, 0.2], [0.1, 1.0, 0.4], [0.3, 0.2, 1.0]]))[0]
    turn *= np.sign(np.linalg.det(turn))
    sizes = _volume(n)
    grid, tile = Grid((sizes["x"], sizes["y"], sizes["z"]), 1.0), 4
    cube, faces = corners @ turn.T * 0.2 * n, np.concatenate([faces, faces + len(corners)])
    placed, bits = snapped(Solid(np.concatenate([cube, cube + 0.1 * n]), faces, "cubes"), grid)
    triangles = oriented(placed, faces)
    members, first, last = binned(triangles, grid, bits, tile)
    sizes |= {"triangle": len(triangles), "member": len(members)}
    sizes |= {"tile_x": first.shape[0], "tile_y": first.shape[1]}
    given = {"triangles": triangles, "members": members, "first": first, "last": last, "tile": tile, "bits": bits}
    if not listed:
        return Example(sizes, given)
    counts = np.zeros((sizes["x"], sizes["y"]), np.int32)
    count_crossings.definition(**given, counts=counts)
    _, start, entries = share_lists(counts, tile, room=1 << 20)
    return Example({**sizes, "entry": entries}, {**given, "start": start, "row": 0})


def _banded(n: int) -> Example:
    """The transpose at every second column: two phases, bands that leave the light at both ends, gaps between bands."""
    from vamgpu.operators.bands import Bands
    from vamgpu.web import Propagation

    sizes = _array_sizes(n)
    columns, layers, window = sizes["j"], n // 3 + 1, n // 2 + 2
    r, rho, l = np.nonzero(np.random.default_rng(1).random((columns, layers, window)) < 0.3)  # noqa: E741 - the axis
    light = Propagation((columns, layers, window), r, rho, l, np.cos(np.arange(r.size)) + 1.1)
    tables = Bands.transposed(light, 1 - window, 2)
    sizes = {"source_major": n, "source_minor": columns, "z": sizes["z"]}
    sizes |= {"target_major": 2 * n - 1, "target_minor": layers}
    sizes |= {"row": len(tables.rows), "band": len(tables.bands), "chunk": len(tables.weights)}
    given = {"rows": tables.rows, "bands": tables.bands, "weights": tables.weights}
    return Example(sizes, {**given, "step": tables.step, "phases": tables.phases})


def _mixed(n: int) -> Example:
    sizes = _array_sizes(n)
    indices, shares = np.arange(2 * n) * 7 % sizes["j"], np.cos(np.arange(2 * n)) + 1.1
    sizes = {"source_major": sizes["j"], "i": n, "target_major": n, "z": sizes["z"], "row": n + 1, "entry": 2 * n}
    return Example(sizes, {"rows": 2 * np.arange(n + 1), "indices": indices, "shares": shares})


def _carried(n: int, depth: int) -> np.ndarray:
    """A bent, absorbing medium with an insert, two samples of bath around n × (n even) × depth voxels."""
    shape = (n, n - n % 2, depth)
    x, y, z = np.meshgrid(*(np.linspace(-1.0, 1.0, k) if k > 1 else np.zeros(1) for k in shape), indexing="ij")
    blob = np.exp(-8.0 * ((x - 0.3) ** 2 + (y + 0.2) ** 2 + 0.3 * z**2))
    medium = np.zeros((shape[0] + 4, shape[1] + 4, depth + 4 * (depth > 1), 4))
    inner = medium[2:-2, 2:-2, 2:-2] if depth > 1 else medium[2:-2, 2:-2]
    for axis, along in enumerate((x - 0.3, y + 0.2, 0.3 * z)):
        inner[..., axis] = -1.6 / n * along * blob
    beside = (x + 0.4) ** 2 + (y - 0.37) ** 2
    stands = np.clip(np.rint(64.0 * (1.5 - 25.0 * beside)), 0.0, 64.0)
    inner[..., 3] = np.where(stands > 0.0, -(stands + 0.0625), 3.0 / n * (1.0 + blob))
    return medium


def _marched(n: int, depth: int, rows: int, **more: int) -> Example:
    columns, bundle, poses = n + 2 * (n % 2), 2, np.array([0.1, 1.3, 4.0])
    start = np.zeros((columns, rows, bundle, 8))
    start[..., 0] = (np.arange(columns) - 0.5 * (columns - 1) + 0.013)[:, None, None]
    start[..., 1], start[..., 2] = -n, 0.37 + np.arange(rows)[:, None]
    start[..., 3], start[..., 5] = (0.1, -0.05), 0.07 * (depth > 1)
    start[..., 4] = np.sqrt(1.0 - start[..., 3] ** 2 - start[..., 5] ** 2)
    start[..., 6] = 0.05
    sizes = {"p": n + 4, "q": n - n % 2 + 4, "s": depth + 4 * (depth > 1), "ray": columns * rows * bundle}
    sizes |= {"angle": len(poses), "pixel": columns * rows, "r": columns, "row": rows, **more}
    given = {"medium": _carried(n, depth), "starts": start.reshape(-1, 8), "step": 0.5, "kind": 7}
    given |= {"directions": np.stack([np.cos(poses), np.sin(poses)], axis=1)}
    given |= {"most": 20 * n, "top": depth + 1.0, "steps": np.full((len(poses), columns * rows), 20 * n)}
    return Example(sizes, {**given, "lanes": lambda _, arrays: arrays["sinogram"]})


def _entries(n: int) -> Example:
    def dense(pairs: np.ndarray) -> np.ndarray:
        matrix = np.zeros((pairs.shape[0] * pairs.shape[1], n * n))
        ray = np.arange(len(matrix))[:, None]
        flat = pairs.reshape(len(matrix), -1, 2)
        np.add.at(matrix, (ray, flat[..., 0].astype(int)), flat[..., 1])
        return matrix

    example = _marched(n, 1, 1, capacity=6 * n + 16)
    return Example(example.sizes, example.given, combine={"entries": dense})


def _through(n: int) -> Example:
    depth = _slices(n)
    return _marched(n, depth, 5, x=n, y=n - n % 2, z=depth)


def _gathered(n: int) -> Example:
    rng, columns = np.random.default_rng(3), n * (n + 1)
    first = np.concatenate([[0], np.cumsum(rng.integers(0, 5, 3 * n * (n + n % 2)))])
    entries = np.stack([rng.integers(0, columns, first[-1]), rng.random(first[-1])], axis=1)
    sizes = {"u": n, "v": n + 1, "z": _slices(n), "row": len(first), "entry": len(entries)}
    return Example({**sizes, "i": n, "j": n + n % 2}, {"first": first, "entries": entries})


def _bent(n: int, *shape: int) -> Example:
    """Rays that cross a box of a medium of mild index and leave it before their last step."""
    rng = np.random.default_rng(n)
    place, heading = rng.uniform(-1.0, 1.0, (n, 3)), rng.standard_normal((n, 3))
    heading *= 1.5 / np.linalg.norm(heading, axis=1, keepdims=True)
    region = np.array([1.0, 1.0, 0.0, 4.0, -1.9, -1.9, -1.7, 1.9, 1.9, 1.7])
    given = {"starts": np.concatenate([place, heading], axis=1), "region": region, "step": 0.11, "steps": 60}
    given |= {"scheme": n % 3, "every": 2, "corner": [-2.0, -2.0, -2.0, (8 + n % 3) / 4.0]}
    given["formula"] = np.array([1.0, 0.8, 0.3, 2.3, -0.2, 0.01, 0.0, 1.0, 0.1, 0.0, 0.0, 0.0])
    ramps = np.ix_(*(np.linspace(0.0, 1.0, size) for size in shape))
    given["coefficients"] = 2.2 + 0.3 * np.sin(sum(ramps, np.zeros(shape)) * 2.0)
    return Example({"ray": n, "row": 7, **dict(zip("ijk", shape, strict=False))}, given)


def _transported(n: int) -> Example:
    """One step in a box: open and closed columns, fixed values at some faces, radicals left over here and there."""
    walls = np.zeros((3, 6, 2))
    walls[..., 1] = 1.0
    walls[0, 1], walls[1, 4], walls[2, 5], walls[0, 2] = (0.6, -1.0), (1.4, -1.0), (0.8, -1.0), (0.2, -1.0)
    given = {"spread": np.array([[0.11, 0.1, 0.05], [0.03, 0.04, 0.02], [0.0, 0.01, 0.02]]), "walls": walls}
    given |= {"rates": np.array([0.8, 0.6, 0.3, 0.2, 0.1, 0.1]), "order": n % 2, "reacting": 1, "steps": 1}
    given |= {"optical": 0.4, "mechanical": 0.6, "time": 5.0}
    return Example({**_volume(n), "part": 0, "room": 1}, given, combine={"scratch": lambda _: 0.0})


def _inhibited(n: int) -> Example:
    """Resins of both orders under light of four intervals, some of it dark; most items are used up before the end."""
    rng, resins, items = np.random.default_rng(n), 3, 3 * n
    rates = np.ones((resins, 8))
    rates[:, :4] = [[0.1, 0.05, 0.04, 0.2], [0.1, 0.3, 0.1, 0.01], [0.1, 0.02, 0.005, 1.0]]
    rates[:, 5] = [0.0, 2.0, 0.5]
    before = np.zeros((items, 4))
    before[:, 0], before[:, 1] = rng.uniform(0.5, 1.0, items), 0.3 * rng.integers(0, 2, items)
    before[:, 2] = rng.uniform(0.2, 2.0, items)
    light = rng.uniform(0.5, 2.0, (n, 4, 2))
    light[:, 1, 0] = light[:, 3, 1] = 0.0
    given = {"before": before, "rates": rates, "light": light, "lengths": [2.0, 1.0, 3.0, 2.5]}
    given |= {"first": 1, "count": 14, "every": 4, "tolerance": 1e-6}
    return Example({"item": items, "resin": resins, "source": n, "interval": 4, "row": 3}, given)


def _lit_through(n: int) -> Example:
    """One pose through a cylinder that leaves some corners dark and some of its rays without resin."""
    sizes = {**_volume(n), **_light(n)}
    cosine, sine = np.cos(0.7), np.sin(0.7)
    radius = 0.47 * n
    given = {"pose": np.array([cosine, sine, 1.0, 1.1, 1.05, 0.9, radius, 0.0]), "angle": 2}
    given["extinction"] = np.array([[0.5, 0.2], [0.3, 1.5]]) / n
    return Example({**sizes, "s": int(2 * radius / 0.9) + 2}, given)


def _whole(n: int) -> np.ndarray:
    """Whole numbers 2 to 4."""
    return np.random.default_rng(5).integers(2, 5, tuple(_array_sizes(n).values())).astype(float)


def _resin(n: int) -> Example:
    given = {"visible_gain": 0.4, "ultraviolet_gain": 0.7, "cross_gain": 0.05, "alpha": 0.8, "pairing": 0.3}
    return _elementwise(n, **given, floor=0.05)


def _scattered(n: int) -> Example:
    """Photons of rays across half a vial, forward scattering, in resin, wall and air; some bins hold several slices."""
    columns, count, radius = n // 4 + 1, 8, 1.0
    u = 0.97 * radius * (np.arange(columns * count) + 0.5).reshape(columns, count) / (columns * count)
    half = np.sqrt(radius**2 - u**2)
    rays = np.zeros((columns, count, 8))
    rays[..., 0], rays[..., 1], rays[..., 2] = half, u, -1.0
    rays[..., 5] = -np.expm1(-2.0 * 3.0 * half)
    rays[..., 6] = rays[..., 5] * (np.arange(count) > 0)
    azimuth = 2.0 * np.pi * np.arange(WAYS) / WAYS
    ring = np.arange(n // 3 + 3)
    given = {"rays": rays, "faces": [[radius, 1.5, 1.47, 0.0], [1.1, 1.47, 1.0, 0.0]], "lags": [0, 1, 2, 2, 3, 3, 3]}
    given |= {"rings": np.stack([12 * ring, 0 * ring + 12], axis=1), "cosines": np.linspace(-1.0, 1.0, 33) ** 3}
    given |= {"ways": np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1), "extinction": 3.0, "albedo": 0.9}
    given |= {"per_ring": len(ring) / radius, "per_slice": 9.0, "first": 11, "each": 20, "most": 200, "seed": 3}
    sizes = {"column": columns, "ray": count, "face": 2, "ring": len(ring), "lag": 7, "quantile": 33, "way": WAYS}
    return Example({**sizes, "item": n, "cell": 12 * len(ring), "bin": 4}, given)


def _run_of_poses(n: int) -> Example:
    sizes = _light(n)
    return Example({**sizes, "pose": sizes["angle"] // 3}, {"first": sizes["angle"] // 2})


def _stack(n: int, **given: Any) -> Example:
    """Columns of features whose void and solid runs are a few slices long; strips of two pixels."""
    rng = np.random.default_rng(1)
    solid = rng.random((3, n, n + 3, 8)) < 0.5
    words = (np.repeat(solid, 4, axis=-1) * 2.0 ** np.arange(32)).sum(axis=-1)
    light = np.linspace(0.002, 0.35, 256)
    edges = np.append(0.5 * (light[1:] + light[:-1]), 1e30)
    bins = 64 / (light[-1] - light[0])
    first = np.searchsorted(edges, light[0] + (np.arange(64) - 0.01) / bins)
    back = np.append(6.25 - 5.25 * 10.0 ** (0.025 * np.arange(4)), -1e30)
    inner = np.minimum(10.0 ** (0.025 * np.arange(12)), 1.3) + np.zeros((5, 1))
    given |= {"words": words.astype(np.uint32), "light": light, "edges": edges, "first": first, "bins": bins,
              "decay": 0.056, "inner": inner, "back": back, "platform": 1, "reached": 0.999, "opened": 0.99,
              "spread": 0.0, "levels": rng.integers(0, 256, (32, n, n + 3)),
              "state": np.zeros((4 if "reach" in given else 2, n, n + 3)), "block": 1}  # fmt: skip
    sizes = {"slice": 32, "word": 3, "y": n, "x": n + 3, "kept": 20, "bin": 64, "below": 5, "above": 12, "void": 5}
    combine = {"solid": np.sum, "missed": np.sum, "peaks": np.max}
    return Example({**sizes, "strip": (n + 3) // 2}, {k: v for k, v in given.items() if k != "reach"}, combine)


def _in_bands(size: int) -> Example:
    """Two bands of four turns: two rings of twice as many samples, and one of three times as many; the first pass."""
    bands = [
        (0, 8, 2, 4, 1, 0, 0, 2, 2, 7, 0, 4, 7, 2),
        (16, 12, 1, 4, 1, 8, 4, 3, 1, 7, 4, 4, 7, 1),
    ]
    waves = np.concatenate([2.0 * np.pi * np.arange(n) / n for n in (8, 12)])
    given = {"bands": in_groups(bands), "waves": np.stack([np.cos(waves), np.sin(waves)], axis=1), "sign": -1.0}
    given |= {"first": 0, "second": 0, "third": 0, "last": 0}
    return Example({"a": 4, "b": 7, "i": 4, "j": 7, "z": size + size % 2, "band": 2, "wave": 20}, given)


def _on_rings(size: int, pairs: int = 16, mirrored: int = 1) -> Example:
    """Three tiles of cells, two of which stand in for each other, lit by all pairs of columns or half of them."""
    k, tiles = 6 + size % 3, np.array([(0, 1), (256, 0), (512, 2)])
    columns = (pairs - 2) * (1 + mirrored) - mirrored * (size % 2)
    sizes = {"k": k, "r": columns, "cell": 24, "z": size + size % 2, "tile": 3}
    lit = np.array([(16, 16, 8), (16, 8, 0), (8, 0, 0), (0, 16, 0), (0, 0, 8)])[: k // 2 + 1]
    order = most_lit_first(tiles, lit)
    entries = np.random.default_rng(size).normal(size=(k // 2 + 1, 40, 2 * ROWS))
    entries[:, [pairs - 2, pairs - 1, 2 * pairs - 2, 2 * pairs - 1]] = 0.0  # beyond all columns
    sizes |= {"entry": entries.size, "frequency": len(order)}
    given = {"entries": entries.ravel(), "tiles": tiles, "lit": lit, "order": order, "greatest": 1.0}
    return Example(sizes, {**given, "mirrored": mirrored, "tf32": 0})


def _pose_of_rings(size: int) -> Example:
    """Cells of two parts, some of them dark, lit by all columns but the last two."""
    sizes = {"angle": 3, "cell": 2 * ROWS, "foot": 2, "z": size + size % 2}
    rng = np.random.default_rng(size)
    feet = rng.random((3, 2 * ROWS, 2, 5)) * (size + 6, 1.0, 1.0, 2.0, 2.0) - (0.0, 0.5, 0.2, 0.0, 0.0)
    feet[..., 0] = np.round(feet[..., 0])
    feet[..., 2] = np.maximum(feet[..., 2], 0.0)
    given = {"feet": feet, "first": 3, "columns": sizes["z"] - 2, "factor": 0.5, "fill": 0.9, "sigma": 0.4}
    return Example(sizes, given)


def _ring_entries(size: int) -> Example:
    """Tiles of three samples between two angles, before and behind which other tiles lie."""
    k, z = 6 + size % 3, size + size % 2
    begins = 2 * ROWS * (1 + z * np.arange(3))
    sizes = {"k": k, "cell": 3 * ROWS, "z": z, "sample": 3, "entry": (k // 2 + 1) * 2 * ROWS * (3 * z + 2)}
    return Example(sizes, {"begins": begins, "arcs": np.outer((0.2, 0.1), np.arange(ROWS)), "columns": z - 2})


def _ring_coefficients(size: int) -> Example:
    """Three rings of tiles: one sample between two angles, then two, whose tracks begin there; unlike widths."""
    wide = 8, 24, 16, 24, 16
    first = 2 * ROWS * np.cumsum((0, *wide))
    places = [(0, 1, 0, -1, 1), (8, 2, 0, 0, 2), (16, 2, 0, 1, -1), (8, 2, -1, -1, 4), (16, 2, -1, 3, -1)]
    steps = [(begin, pairs, *place, 0) for begin, pairs, place in zip(first.tolist(), wide, places, strict=False)]
    kept, angles = 4 + size % 2, 6 + 2 * (size % 2)
    sizes = {"tile": 5, "ring": 24, "entry": kept * int(first[-1]), "frequency": kept, "block": 3}
    entries = np.random.default_rng(size).normal(size=sizes["entry"])
    given = {"steps": steps, "pivots": 0.5 + np.random.default_rng(size).random((24, 2)), "entries": entries}
    return Example(sizes, {**given, "angles": angles, "own": 13 / 21, "beside": 4 / 21})


EXAMPLES: dict[str, Callable[[int], Example]] = {
    "fourier": _in_bands,
    "light_rings": _on_rings,
    "gather_rings": _on_rings,
    "ring_pose": _pose_of_rings,
    "ring_entries": _ring_entries,
    "ring_coefficients": _ring_coefficients,
    "spread_rows": _spread_rows,
    "spread_columns": _spread_columns,
    "expose_voxels": _exposed,
    "average_voxels": _averaged,
    "pack_slices": lambda n: _stack(n, threshold=1),
    "expose_slices": lambda n: _stack(n, part=0.6, fade=0.9),
    "correct_slices": lambda n: _stack(n, reach=1),
    "judge_slices": lambda n: _stack(n, scale=-17.4, layered=0, critical=0.3),
    "transport": _transported,
    "column_density": _lit_through,
    "expose": _lit_through,
    "forward_footprint": _footprint,
    "back_footprint": _footprint,
    "forward_oblique": lambda n: _oblique(n, "volume"),
    "back_oblique": lambda n: _oblique(n, "sinogram"),
    "resample": _resampled,
    "put_slices": _stacked,
    "to_lanes": lambda n: Example(_array_sizes(n)),
    "from_lanes": lambda n: Example(_array_sizes(n)),
    "shift_images": _shifted,
    "blur_planes": lambda n: Example({**_array_sizes(n), "tap": 9}),
    "blur_slices": lambda n: Example({**_array_sizes(n), "tap": 9}),
    "partial_sum": _partial,
    "partial_dot": _partial,
    "partial_extent": lambda n: _partial(n, lower=0.2, upper=0.8, reach=0.4 * n),
    "fold": lambda n: Example({"part": 64 * n, "folded": 512}, {"kind": 0}),
    "linear": lambda n: _elementwise(n, a=0.5, b=-1.5, floor=-0.4),
    "multiply": lambda n: _elementwise(n),
    "apply_penalty": lambda n: _partial(n, weight=0.1, power=3.0, hold=1, most=0.9),
    "primal_step": lambda n: _partial(n, step=0.7, most=0.6),
    "dual_step": lambda n: _partial(n, step=0.7, least=0.6, leak=0.3, reach=0.4 * n),
    "find_levels": lambda n: _partial(n, least=0.8, leak=1.7, reach=0.4 * n, rim=0.3),
    "clip_dose": lambda n: _elementwise(n, least=0.8, leak=1.7, relax=1.6, reach=0.4 * n, rim=0.3),
    "clip_light": lambda n: _elementwise(n, push=0.3, base=0.3, relax=1.6),
    "dual_dose": _elementwise,
    "divide_prices": lambda n: _elementwise(n, inside=0.3, outside=0.7),
    "light_short_pixels": lambda n: _elementwise(n, scale=2.0),
    "level_cover": lambda n: _elementwise(n, reach=0.4 * n),
    "cover_scale": lambda n: _partial(n, keep=0.9),
    "fill_background": lambda n: _elementwise(n, low=0.6, high=1.0, reach=0.4 * n),
    "correct_by_ratio": lambda n: _elementwise(n, scale=1.2, low=0.6, high=1.0, most=3.0),
    "correct_by_difference": lambda n: _elementwise(
        n, scale=1.1, low=0.3, high=0.9, gain_outside=1.0, gain_inside=0.5, reach=0.4 * n
    ),
    "price_flips": lambda n: Example(_array_sizes(n), {"least": 0.2, "most": 0.4, "leak": 0.1, "step": 0.1}, below=0.5),
    "flip_pixels": lambda n: Example(_array_sizes(n), below=0.5),
    "step_pixels": lambda n: Example(
        _array_sizes(n), {"worth": 0.6, "seed": 5, "first": 3, "step": 0.2, "most": 0.9}, below=0.5
    ),
    "filter_rows": lambda n: _filtered(n, floor=0.0),
    "filtered_step": lambda n: _filtered(n, step=0.3, momentum=0.8),
    "band_loss": _band,
    "sampled_loss": _sampled,
    "ramp_loss": lambda n: _partial(n, weighted=1, outside=0.3, inside=0.8, most=0.9, hold=0, reach=0.4 * n),
    "dark_loss": lambda n: _partial(n, most=0.6),
    "tally": _counted,
    "fold_counts": _folded,
    "survey": _surveyed,
    "fold_survey": _folded,
    "cut_voxels": _cut_voxels,
    "nearest_cut": lambda n: _nearest(n, axis=n % 3),
    "signed_depths": _measured,
    "tally_depths": _by_depth,
    "count_light": lambda n: _frames(n, drop=20, prefix=0),
    "quantize": lambda n: _frames(n, gain=0.8, carry=0.0),
    "fold_bits": _bits,
    "split_planes": _planes,
    "pick_frames": lambda n: _planes(n, 1),
    "unpack": lambda n: _frames(n, bits=8, scale=1.5),
    "mask_bytes": lambda n: Example({**_light(n), "byte": _light(n)["r"]}),
    "mask_rays": lambda n: Example(_light(n)),
    "measure_depth": lambda n: _watched(n, floor=0.01, gain=0.02, brightest=0.95),
    "dim_light": _watched,
    "take_bias": _watched,
    "draw_noise": lambda n: Example(_light(n), {"slices": np.arange(_slices(n)), "seed": 7}),
    "pick_voxels": _voxels,
    "interpolate": _voxels,
    "tilted_gain": lambda n: _voxels(n, level=0.8, along=0.1, across=-0.3),
    "match_dose": lambda n: _voxels(n, least=0.2, most=1.5),
    "spare_voxels": lambda n: _voxels(n, share=0.3, margin=0.1, inside=0.5, greatest=0.6),
    "likelihood_weights": _voxels,
    "share_gain": lambda n: _voxels(n, least=0.3, shared=0.4, strength=5.0),
    "conversion_deviation": lambda n: _voxels(n, model=0.1),
    "weigh_poses": lambda n: Example({**_light(n), "pose": _light(n)["angle"] // 2}),
    "rebin_rays": _rebinned,
    "count_crossings": lambda n: _solid(n, listed=False),
    "voxelize": _solid,
    "photons": _scattered,
    "sum_bins": lambda n: Example({"column": 3, "cell": 8 * n + 5, "bin": 7, "term": 3}),
    "trace_entries": _entries,
    "survey_rays": lambda n: _marched(n, _slices(n), 5),
    "forward_traced": _through,
    "back_traced": _through,
    "clear_volume": lambda n: Example(_volume(n)),
    "gather_rows": _gathered,
    "march_formula": _bent,
    "march_plane": lambda n: _bent(n, 11, 12),
    "march_volume": lambda n: _bent(n, 11, 12, 13),
    "inhibit": _inhibited,
    "inhibition_step": _resin,
    "inhibition_adjoint": _resin,
    "raise_peak": lambda n: _elementwise(n, alpha=0.8, number=3.5, when=_whole(n)),
    "add_peak_slope": lambda n: _elementwise(n, alpha=0.8, number=3.0, when=_whole(n)),
    "oxygen_step": lambda n: _elementwise(n, gain=0.7, floor=0.05),
    "oxygen_adjoint": lambda n: _elementwise(n, gain=0.7, floor=0.05),
    "consume_oxygen": lambda n: _elementwise(n, gain=0.7, floor=0.05),
    "take_poses": _run_of_poses,
    "put_poses": _run_of_poses,
    "shift_window": _banded,
    "mix_poses": _mixed,
}
"""Kernel → its example of ``size`` samples along each axis; odd sizes give axes that differ."""


def missing() -> list[str]:
    """Declared kernels that have no example."""
    return [kernel.name for kernel in kernels() if kernel.name not in EXAMPLES]
