"""Output that is read in part, as by `head`."""

from __future__ import annotations

import os
import subprocess
import sys


def test_a_reader_that_has_enough_is_no_error() -> None:
    reads, writes = os.pipe()
    os.close(reads)
    done = subprocess.run(
        [sys.executable, "-m", "vamgpu.cli", "keys"], stdout=writes, stderr=subprocess.PIPE, text=True
    )
    os.close(writes)
    assert done.returncode == 0
    assert done.stderr == ""
