"""Which orientations of a part are tried at all."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from studio_client import BOAT

from vamgpu.errors import OutOfMemory
from vamgpu.jobs import orient
from vamgpu.jobs.read import Job
from vamgpu.targets import shapes


def test_what_a_projector_is_too_small_for_is_left_out_and_lack_of_memory_is_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def full(*_: Any) -> Any:
        raise OutOfMemory("the device is full")

    monkeypatch.setattr(orient, "target_of", full)
    solid, upright = shapes.build("boat"), np.eye(3)
    factor, fallen = 6.0 / solid.height, np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    rows = 24  # of 0.25 mm, for a part 6 mm high and longer
    assert solid.rotated(fallen).height * factor > 6.5
    job = Job.parse(BOAT.replace("[beam]\n", f"[beam]\npixels = [80, {rows}]\n"))
    assert orient._tried(job, solid, fallen, factor, "numpy") is None
    with pytest.raises(OutOfMemory, match="full"):
        orient._tried(job, solid, upright, factor, "numpy")
