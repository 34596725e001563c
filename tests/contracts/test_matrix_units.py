"""Products on matrix units by a processor, which does, slowly, what their instructions do."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vamgpu.kernels.signature import Kernel
from vamgpu.kernels.spectrum import ROWS, gather_rings, light_rings, most_lit_first

cl = pytest.importorskip("pyopencl")
LANES = 32
PTX = Path(__file__).parents[1] / "emulated_ptx.h"
PAIRS = [0, 48, 8, 80, 80, 16, 24, 0, 8, 72, 32, 40, 8, 64, 56, 72, 24, 40, 16]
"""Of each tile, so that two groups share them."""


@pytest.fixture(scope="module")
def queue() -> Any:
    """Of PoCL, in whose OpenCL 2.0 functions may have memory that items share."""
    for platform in cl.get_platforms():
        if platform.name == "Portable Computing Language":
            return cl.CommandQueue(cl.Context(platform.get_devices()[:1]))
    pytest.skip("no PoCL")


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The kernels, with instructions that a processor has, and loops left as they are, to be compiled sooner."""
    folder = tmp_path_factory.mktemp("kernels")
    for path in (light_rings.source, *light_rings.source.parent.glob("*.h")):
        shutil.copy(path, folder)
    shutil.copy(PTX, folder / "ptx.h")
    common = folder / "common.h"
    common.write_text(common.read_text().replace('#define UNROLL _Pragma("unroll")', "#define UNROLL"))
    return folder


def laid(field: np.ndarray) -> np.ndarray:
    """A field as devices keep it, in slabs of LANES slices."""
    major, minor, slices = field.shape
    padded = np.pad(field, ((0, 0), (0, 0), (0, -slices % LANES)))
    return np.ascontiguousarray(padded.reshape(major, minor, -1, LANES).transpose(2, 0, 1, 3))


def launched(queue: Any, sources: Path, kernel: Kernel, given: dict[str, Any], fields: tuple[str, str]) -> np.ndarray:
    """What a kernel for matrix units makes of its arguments, two of them fields, of which it writes the second."""
    tiling = kernel.nvidia
    assert tiling is not None
    defined = {"LANES": LANES, "WIDTH": 4, "THREADS": LANES // 4, "VECTORS": 1, "TILE_SLABS": 1}
    defined |= {"TILE_MAJOR": tiling.major, "TILE_MINOR": tiling.minor} | kernel.constants["nvidia"]
    options = ["-cl-std=CL2.0", f"-I{sources}", "-DGPU", "-DMATRIX_UNITS", "-cl-opt-disable"]
    options += [f"-DCOMPILE_{kernel.name}", *(f"-D{name}={value}" for name, value in defined.items())]
    program = cl.Program(queue.context, (sources / kernel.source.name).read_text()).build(options)
    stored = {name: laid(value) if name in fields else value for name, value in given.items()}
    flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
    arguments = {
        name: cl.Buffer(queue.context, flags, hostbuf=value) if isinstance(value, np.ndarray) else value
        for name, value in stored.items()
    }
    sizes = kernel.sizes({name: value.shape for name, value in given.items() if isinstance(value, np.ndarray)})
    major, minor, slices = given[fields[1]].shape
    found = stored[fields[1]]
    items = (-(-minor // tiling.minor) * LANES // 4, major // tiling.major + 1, len(found))
    counts = tuple(-(-n // group) * group for n, group in zip(items, tiling.group, strict=True))
    extents = [np.int32(sizes[axis]) for axis in kernel.axes]
    getattr(program, kernel.name)(queue, counts, tiling.group, *arguments.values(), *extents)
    cl.enqueue_copy(queue, found, arguments[fields[1]])
    return found.transpose(1, 2, 0, 3).reshape(major, minor, -1)[..., :slices]


@pytest.mark.slow
@pytest.mark.parametrize(("angles", "slices", "tf32", "mirrored"), [(5, 38, 0, 1), (4, 70, 0, 0), (4, 32, 1, 1)])
@pytest.mark.parametrize("kernel", [light_rings, gather_rings], ids=lambda kernel: kernel.name)
def test_matrix_units_keep_the_bits_that_they_are_asked_for(
    queue: Any, sources: Path, kernel: Kernel, angles: int, slices: int, tf32: int, mirrored: int
) -> None:
    rng = np.random.default_rng(angles)
    pairs, number = np.array(PAIRS), np.arange(len(PAIRS))
    mates = number.copy()
    mates[[0, 7, 3, 4]] = [7, 0, 4, 3]
    first = np.cumsum(2 * ROWS * pairs) - 2 * ROWS * pairs
    tiles = np.column_stack([first, mates]).astype(np.int32)
    lit = np.tile(pairs, (angles // 2 + 1, 1))
    lit[1:] = np.where(lit[1:] % 16, lit[1:] // 2 // ROWS * ROWS, lit[1:])
    lit = lit.astype(np.int32)
    entries = rng.normal(size=(angles // 2 + 1) * 2 * ROWS * pairs.sum()).astype(np.float32)
    columns = (max(PAIRS) - 3) * (1 + mirrored) - mirrored * (angles % 2)
    light = rng.normal(size=(angles, columns, slices)) * 1e-12
    for first_entry, count in zip(first, pairs, strict=True):  # of what columns beyond all would show
        values = entries.reshape(angles // 2 + 1, -1)[:, first_entry : first_entry + 2 * ROWS * count]
        values.reshape(len(values), count, 2 * ROWS)[:, max(PAIRS) - 3 :] = 0.0
    rings = (
        rng.normal(size=(angles, ROWS * len(PAIRS), slices)) * 10.0 ** rng.uniform(-9, 9, ROWS * len(PAIRS))[:, None]
    )
    fields = ("light", "spectrum") if kernel is light_rings else ("spectrum", "light")
    held = {"light": light.astype(np.float32), "spectrum": rings.astype(np.float32)}
    held[fields[1]][:] = np.nan
    given = {
        fields[0]: held[fields[0]], "entries": entries, "greatest": np.float32(np.abs(entries).max()), "tiles": tiles,
        "lit": lit, "order": most_lit_first(tiles, lit), "mirrored": np.int32(mirrored), "tf32": np.int32(tf32),
        fields[1]: held[fields[1]],
    }  # fmt: skip
    found = launched(queue, sources, kernel, given, fields)
    wanted = held[fields[1]].astype(np.float64)
    kernel.definition(**given | {fields[0]: held[fields[0]].astype(np.float64), fields[1]: wanted})
    assert np.abs(found - wanted).max() <= (2e-3 if tf32 else 1e-6) * np.abs(wanted).max()


def test_tiles_are_ordered_by_what_lights_them_at_each_frequency() -> None:
    tiles = np.array([(0, 0), (128, 2), (384, 1), (640, 3)])
    lit = np.array([(8, 16, 0, 24), (8, 0, 16, 24), (8, 16, 16, 24)])
    order = most_lit_first(tiles, lit)
    assert order[:, :, 2].tolist() == [[3, 1, 0, 2], [3, 2, 0, 1], [3, 1, 2, 0]]
    assert order[1].tolist() == [[640, 24, 3, 3], [384, 16, 2, 1], [0, 8, 0, 0], [128, 0, 1, 2]]
