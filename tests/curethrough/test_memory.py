"""Stacks larger than the memory a process may have, and memory that is used again."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from vamgpu.curethrough.buffers import SliceBuffers
from vamgpu.curethrough.images import encode
from vamgpu.curethrough.stack import open_stack

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
