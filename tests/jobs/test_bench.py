"""The bench times what it says it times."""

from __future__ import annotations

from vamgpu.jobs.bench import bench, machine, table


def test_every_projector_is_timed() -> None:
    timings = list(bench(8, 6, 1, ["numpy", "warp:cpu"]))
    assert [(t.device, t.operator) for t in timings] == [
        (device, operator) for device in ("numpy", "warp:cpu") for operator in ("straight", "vial")
    ]
    assert all(row["forward"] > 0 and row["back"] > 0 for row in table(timings))
    assert machine()["cores"]
