"""Webs by the method that maximizes the window: segments over decided frames come near the web in one piece."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from slanted import BEAM, SECTION, WINDOW, Slanted, part, stream, tiled

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.jobs.demo import WEB_JOB
from vamgpu.jobs.web import WebJob, stream_of
from vamgpu.methods import bound, optimize
from vamgpu.methods.pdhg import PDHG
from vamgpu.operators.web import WebProjection
from vamgpu.web import WebGrid
from vamgpu.webs.proof import prove_web
from vamgpu.webs.stream import Stream
from vamgpu.webs.window_solver import WindowSolver

LONG = 6 * WINDOW


def blobs(length: int) -> np.ndarray:
    """A target that some light prints."""
    l, rho, z = np.meshgrid(np.arange(length), *(np.arange(n) for n in SECTION), indexing="ij")  # noqa: E741
    return (np.sin(0.3 * l + 0.02 * l * np.sin(0.05 * l) + 0.7 * z) > 0.25 + 0.1 * (rho > 3)).astype(np.float32)


def dense_and_sparse(length: int) -> np.ndarray:
    """A target whose halves would choose thresholds far apart: light bars, then dense ones."""
    l, rho, z = np.meshgrid(np.arange(length), *(np.arange(n) for n in SECTION), indexing="ij")  # noqa: E741
    wave = np.sin(0.3 * l + 0.02 * l * np.sin(0.05 * l) + 0.7 * z)
    return (wave > np.where(l < length / 2, 0.7, -0.5)).astype(np.float32)


def whole(device: Device | str) -> WebProjection:
    """The projector of the whole web."""
    grid = WebGrid((LONG, *SECTION), Slanted().advance)
    return WebProjection(grid, BEAM, Slanted(), device, poses=LONG + WINDOW - 1, start=1.0 - WINDOW)


def proven(job: Stream, place: Path) -> float:
    """The window of all frames at one threshold, from their bytes."""
    pieces = list(prove_web(job.write(place), device="numpy", wrap=Slanted()).pieces())
    dose, target = (np.concatenate([getattr(one, name) for one in pieces]) for name in ("dose", "target"))
    assert dose.shape == (LONG, *SECTION)
    return float((dose[target].min() - dose[~target].max()) / dose.max())


@pytest.mark.slow
def test_a_web_in_segments_is_as_wide_as_the_web_in_one_piece(fast_device: Device, tmp_path: Path) -> None:
    target = blobs(LONG)
    limit = bound(whole(fast_device), target, evaluations=1000)
    found = {
        core: proven(stream(target, method="best", core=core, iterations=300, device=fast_device),
                     tmp_path / f"{core}.vam")
        for core in (1.0, 30.0)
    }  # fmt: skip
    in_one_piece = found[30.0]
    for window in found.values():
        assert in_one_piece - 0.01 < window <= limit.value, (found, limit.value)
        assert window > 0.65 * limit.value, (found, limit.value)


@pytest.mark.slow
def test_one_threshold_serves_all_segments(fast_device: Device, tmp_path: Path) -> None:
    """Where each would choose its own they would be 0.16 apart."""
    target = dense_and_sparse(LONG)
    alone = optimize(whole(fast_device), target, PDHG(), 300)
    job = stream(target, method="best", core=1.0, iterations=300, device=fast_device)
    assert proven(job, tmp_path / "web.vam") > alone.window - 0.08 > 0.45


def test_a_web_that_is_stopped_goes_on_to_the_same_bytes(fast_device: Device, tmp_path: Path) -> None:
    def job() -> Stream:
        return stream(tiled(blobs(LONG)), method="best", core=1.0, iterations=6, device=fast_device)

    class Stop(Exception):
        pass

    def stop(done: int, of: int | None) -> None:
        if done == 3:
            raise Stop

    alone = job().write(tmp_path / "alone.vam")
    with pytest.raises(Stop):
        job().write(tmp_path / "again.vam", progress=stop)
    again = job().write(tmp_path / "again.vam")
    assert again.complete and again.details == alone.details
    assert np.array_equal(alone.read("frames", 0, alone.frames), again.read("frames", 0, again.frames))


def test_frames_are_decided_a_window_ahead(fast_device: Device) -> None:
    """What comes later changes nothing, what comes within the window of light after a core does."""
    longer = blobs(LONG + 2 * WINDOW)
    jobs = [stream(target, method="best", core=1.0, iterations=6, device=fast_device) for target in
            (longer[:LONG], longer)]  # fmt: skip
    first, other = ([segment.images for segment in job] for job in jobs)
    same = [np.array_equal(one, two) for one, two in zip(first, other, strict=False)]
    assert all(same[:4]) and not all(same)


def test_best_is_by_prices() -> None:
    best = stream(part(60), method="best", iterations=4).solver
    more = ("web.length=60 mm", "beam.pitch=600 um", "beam.height=1.2 mm", "roller.step=4 deg", "solve.method=best")
    assert isinstance(stream_of(WebJob.parse(WEB_JOB, more)).solver, WindowSolver)
    assert isinstance(best, WindowSolver) and best.method == PDHG()


def test_prices_ask_for_a_window_of_light_ahead() -> None:
    with pytest.raises(BadInput, match="overlap of 12 angles is less than a window of light"):
        stream(part(60), method="best", overlap=0.5)


def test_a_web_of_nothing_but_a_beginning_is_dark_where_nothing_is(fast_device: Device) -> None:
    target = np.concatenate([blobs(2 * WINDOW), np.zeros((4 * WINDOW, *SECTION), np.float32)])
    segments = list(stream(target, method="best", core=1.0, iterations=6, device=fast_device))
    assert segments[0].images.any() and not segments[-1].images.any()
