"""Fixtures of prints."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vamgpu.printing.folder import save_frames
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """Where a run's folder will be."""
    return tmp_path / "run"


@pytest.fixture
def job(tmp_path: Path) -> Path:
    """The folder of a vial's job, of 36 small frames."""
    images = np.random.default_rng(4).integers(0, 256, (36, 6, 10), dtype=np.uint8)
    frames = Frames.from_bytes(images, "numpy", bits=8, gray=GrayCurve.linear(), scale=1.0, columns=10)
    return save_frames(tmp_path / "part.vam", frames).path
