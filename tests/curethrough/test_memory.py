"""Stacks larger than the memory a process may have, and memory that is used again."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from vamgpu.backend import open_device
from vamgpu.curethrough.buffers import SliceBuffers
from vamgpu.curethrough.correction import Correction, Corrector, correct
from vamgpu.curethrough.images import encode
from vamgpu.curethrough.printer import Printer, levels_of
from vamgpu.curethrough.stack import open_stack
from vamgpu.kernels.curethrough import BITS

LIMITED = """
import json, resource, sys
resource.setrlimit(resource.RLIMIT_DATA, (10**9, 10**9))
import numpy as np
from vamgpu.curethrough.correction import Correction
from vamgpu.curethrough.job import correct_stack
from vamgpu.curethrough.printer import Printer, levels_of
from vamgpu.curethrough.stack import open_stack
try:
    np.empty(10**9, np.uint8)
    bites = False
except MemoryError:
    bites = True
machine = Printer(2.0, 0.576, 0.05, 1000 / 3600, levels_of(1.0, 0.01))
with open_stack(sys.argv[1]) as stack:
    found = correct_stack(Correction(machine), stack, sys.argv[2])
status = open("/proc/self/status").read()  # getrusage would count what the parent held when it forked
resident = int(status.split("VmHWM:")[1].split()[0]) * 1024
print(json.dumps([bites, stack.shape, found.ratio, resident]))
"""


class Repeating:
    """Slices of the paper's size, made as they are read: a post of 30 slices above every 66 of void, in a frame."""

    shape = (3000, 800, 1280)
    period = 3 * BITS

    def __init__(self) -> None:
        self._slices = np.zeros((self.period, *self.shape[1:]), np.uint8)
        self._slices[:, :20] = 255
        self._slices[10:40, 100:700, 200:1000] = 255

    def __getitem__(self, key: slice) -> np.ndarray:
        start, stop, _ = key.indices(self.shape[0])
        first = start % self.period
        return self._slices[first : first + stop - start]


@pytest.mark.slow
def test_thousands_of_slices_of_the_papers_size_are_corrected_in_the_memory_of_a_few() -> None:
    """3000 × 800 × 1280: each pixel as alone, and on the device a thirtieth of the stack, however many slices."""
    device, stack = open_device(), Repeating()
    correction = Correction(Printer(2.0, 0.576, 0.05, 1000 / 3600, levels_of(1.0, 0.01)))
    rows, columns = [0, 19, 20, 100, 400, 799], [0, 199, 200, 640, 999, 1279]
    column = np.concatenate([stack[n : n + BITS][:, rows, columns] for n in range(0, stack.shape[0], BITS)])
    wanted = correct(correction, column[: stack.shape[0], None], device)
    before = device.ledger.allocated
    device.ledger.reset_peak()
    corrector, blocks = Corrector(correction, stack.shape, device), 0
    for block in corrector.run(stack):
        if blocks % 8 == 0:
            shown = block.levels[:, rows, columns]
            np.testing.assert_array_equal(shown, wanted[block.start : block.start + len(shown), 0])
        blocks += 1
    assert blocks == -(-corrector.slices // BITS) and wanted.any()
    assert (device.ledger.peak - before) < np.prod(stack.shape) / 30


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits of data are counted by Linux alone")
def test_a_stack_larger_than_the_limit_of_the_system_streams_through(tmp_path: Path) -> None:
    rows, columns, slices = 800, 1280, 1024
    place = tmp_path / "slices"
    place.mkdir()
    picture = np.zeros((rows, columns), np.uint8)
    for k in range(2):
        (place / f"s{k}.png").write_bytes(encode(picture, ".png"))
        picture[100:700, 200:1000] = 255
    for k in range(2, slices):
        os.link(place / f"s{int(k % 100 < 30)}.png", place / f"s{k}.png")
    words = [sys.executable, "-c", LIMITED, str(place), str(tmp_path / "out")]
    run = subprocess.run(words, check=True, capture_output=True, text=True)
    bites, shape, ratio, resident = json.loads(run.stdout)
    assert bites, "the limit counts what NumPy takes"
    assert shape == [slices, rows, columns] and rows * columns * slices > 10**9 > resident
    assert ratio < 0.01
    with open_stack(tmp_path / "out") as stack:
        assert stack.shape == (slices + 4, rows, columns)


def test_memory_is_used_again_only_once_nobody_holds_it() -> None:
    buffers = SliceBuffers(most=2)
    first = buffers.take((4, 5, 6))
    first[...] = 7
    part = first[2:3, 1]
    del first
    second = buffers.take((4, 5, 6))
    second[...] = 9
    assert (part == 7).all() and part.base is not second.base
    kept = second.base
    del second, part
    third = buffers.take((3, 5, 6))
    assert third.base is not kept and third.shape == (3, 5, 6), "kept is a reference too"
    del kept
    assert buffers.take((2, 5, 6)).base is not third.base
