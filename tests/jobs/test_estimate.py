"""What a run takes is told before it."""

from __future__ import annotations

import gc
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vamgpu as vam
import vamgpu.jobs.estimate
from vamgpu.backend.device import Device
from vamgpu.jobs.demo import JOB
from vamgpu.jobs.estimate import COMPILED, PASSES, Expected, expected
from vamgpu.jobs.read import Job
from vamgpu.jobs.run import solve
from vamgpu.methods.choice import chosen
from vamgpu.methods.surface import as_fine_as_light


@pytest.mark.parametrize("method", ["default", "lbfgs"])
def test_memory_is_what_a_run_takes(fast_device: Device, method: str) -> None:
    part = np.zeros((24, 24, 16))
    part[8:16, 6:16, 4:12] = 1.0
    target = vam.Target.from_array(part, 0.1)
    vial = vam.Vial(radius=4.0, wall=0.3, resin_index=1.5, wall_index=1.47, absorption=0.1)
    A = vam.Projection(target.grid, vam.Beam((40, 18), 0.1), vam.Turntable(30), vial, fast_device)
    told, ledger = expected(A, target, chosen(method), 8), A.device.ledger
    gc.collect()  # arrays of other tests, which the run would free
    ledger.peak = before = ledger.allocated
    vam.optimize(A, target, method, iterations=8)
    assert 0.6 * told.nbytes < ledger.peak - before < 1.1 * told.nbytes
    assert told.evaluations == 8 and told.seconds > 0.0


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ([], " of memory, 2 evaluations of "),
        (["tolerances.axis=50 um"], " of memory, 6 evaluations of "),
        (["tolerances.axis=50 um", "solve.evaluations=5"], " of memory, 5 evaluations of "),
    ],
)
def test_it_is_told_before_the_light_is_found(tmp_path: Path, more: list[str], said: str) -> None:
    told: list[str] = []

    class Watching:
        def __call__(self, stage: str, share: float) -> None:
            if not told or told[-1] != stage:
                told.append(stage)

        def tell(self, text: str) -> None:
            told.append(text)

    small = ["target.pitch=900 um", "beam.pitch=1200 um", "turntable.angles=20", "solve.iterations=2", *more]
    solve(Job.parse(JOB, small), tmp_path / "a.vam", progress=Watching())
    assert told.index("rays") + 1 == told.index("light") - 1
    assert said in told[told.index("light") - 1]
    assert ("at 3 corners" in told[told.index("light") - 1]) == bool(more)


@pytest.mark.parametrize(("seconds", "lasts"), [(0.5, "about 68 s"), (5.0, "about 11.3 min")])
def test_times_as_people_read_them(seconds: float, lasts: str) -> None:
    assert str(Expected(3_000_000_000, 120.0, seconds)) == (
        f"about 3 GB of memory, 120 evaluations of {seconds:.2g} s: {lasts} from here to the verdict"
    )


def test_each_corner_begins_by_itself() -> None:
    one, many = Expected(1, 90.0, 1.0), Expected(1, 90.0, 1.0, corners=9)
    assert str(one).endswith("about 1.77 min from here to the verdict")
    assert str(many).endswith("90 evaluations of 1 s, at 9 corners: about 2.83 min from here to the verdict")
    assert "about 5.1 min" in str(Expected(1, 90.0, 1.0, compiling=200.0)), "kernels compile once, not at each corner"


@pytest.mark.parametrize(("across", "kind"), [(20, "Projection"), (44, "RingProjection")])
def test_what_is_timed_is_of_the_kind_that_finds_the_light(
    across: int, kind: str, opencl_name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The quickest of some times, on the default's voxels; on rings where these are many, which are made once."""
    part = np.zeros((across, across, 12))
    part[8:12, 6:12, 4:8] = 1.0
    target = vam.Target.from_array(part, 0.1)
    A = vam.Projection(target.grid, vam.Beam((60, 18), 0.1), vam.Turntable(90), device=opencl_name)
    if A.device.is_gpu:
        pytest.skip("rings pay for larger volumes there")
    seen: list[str] = []
    told, timed = vamgpu.jobs.estimate.total, iter([9.0, 5.0, 2.0, 4.0, 9.0, 0.75, 1.0, 0.5] * 2)
    clock = [0.0]

    def counted(field: Any) -> float:
        clock[0] += next(timed)
        return told(field)

    monkeypatch.setattr(vamgpu.jobs.estimate, "total", counted)
    monkeypatch.setattr(vamgpu.jobs.estimate.time, "perf_counter", lambda: clock[0])
    for made in (vam.Projection, vam.RingProjection):
        forward = made.forward
        monkeypatch.setattr(made, "forward", lambda self, *given, run=forward: seen.append(type(self).__name__) or run(
            self, *given))  # fmt: skip
    fine = as_fine_as_light(A)
    assert fine is not None and type(fine).__name__ == kind
    found = expected(A, target, chosen("lbfgs"), 8)
    assert found.seconds == 2.0 + PASSES * 0.5
    assert found.compiling == COMPILED * (9.0 - 2.0), "what the first run takes longer"
    seen.clear()
    assert expected(A, target, chosen("default"), 8).seconds == 2.0 + PASSES * 0.5
    assert set(seen) == {kind} and len(seen) == 4
    kept = as_fine_as_light(A, keep=True)
    assert kept is not fine and as_fine_as_light(A) is kept and as_fine_as_light(A) is not kept
