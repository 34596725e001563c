"""Memory of a web does not depend on its length."""

from __future__ import annotations

import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from slanted import WINDOW

from vamgpu.web import WebGrid
from vamgpu.webs.tiles import Columns

LIMIT = 2 * 2**30
PROGRAM = """
import resource, sys
resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[1]),) * 2)
sys.path.insert(0, sys.argv[2])

from slanted import WINDOW, part, stream

job = stream((part(5, seed=k) for k in range(int(sys.argv[3]) // 5)), core=2.0, device=None, iterations=4)
folder = job.write(sys.argv[4])
print(job.device.ledger.peak, folder.columns, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def peak(tmp_path: Path, columns: int, limit: int = LIMIT) -> tuple[int, int]:
    """Peak of the device's memory [bytes] and of the process [KiB] for a web of that many columns."""
    here = str(Path(__file__).parent)
    command = [sys.executable, "-c", PROGRAM, str(limit), here, str(columns), str(tmp_path / f"{columns}.vam")]
    out = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    assert int(out[1]) == columns
    return int(out[0]), int(out[2])


@pytest.mark.slow
def test_a_long_web_needs_no_more_than_a_short_one(tmp_path: Path) -> None:
    short, long = (peak(tmp_path, count * WINDOW) for count in (5, 50))
    assert long[0] == short[0]
    assert long[1] < 1.1 * short[1]


def test_tiles_are_forgotten_once_they_have_passed() -> None:
    """Memory that reading takes while a web goes by, in tiles thick enough to be seen."""

    def read(tiles: int) -> int:
        columns = Columns((np.full((10, 64, 64), 0.5, np.float32) for _ in range(tiles)), WebGrid((1, 64, 64), 0.1))
        tracemalloc.start()
        for start in range(0, 10 * tiles - 20, 10):
            assert columns.take(start, start + 20).min() == 0.5
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return most

    assert read(100) < 1.2 * read(10)


def test_the_limit_is_one(tmp_path: Path) -> None:
    """A process that may have too little fails: what the system allows is really enforced."""
    with pytest.raises(subprocess.CalledProcessError):
        peak(tmp_path, 5 * WINDOW, limit=100 * 2**20)
