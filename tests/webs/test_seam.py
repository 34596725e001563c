"""A web solved in segments is the web solved in one piece."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from vamgpu.geometry import Beam
from vamgpu.operators.web import WebProjection
from vamgpu.optics.film import Film
from vamgpu.optics.roller import Roller
from vamgpu.targets.lattices import SheetGyroid
from vamgpu.web import WebGrid
from vamgpu.webs.stream import Stream

PITCH, SLICES, LENGTH = 0.3, 2, 250.0
ROLLER = Roller(7.5, Film(3.0, 1.49, 1.33, 0.22), PITCH / 9.0, lit_share=0.0)
BEAM = Beam((70, SLICES), PITCH)
CELLS = SheetGyroid(3.0)


def drifting(l: np.ndarray, rho: np.ndarray, z: np.ndarray) -> np.ndarray:  # noqa: E741 - the web's axis
    """Cells whose length changes along the web, which so never repeats."""
    return CELLS(l + 2.0 * np.sin(l / 17.0), rho, z + 0.4)


def solved(core: float, overlap: float = Stream.overlap) -> tuple[Stream, np.ndarray]:
    """The light of the whole web, [pose, r, z], by the paper's 100 iterations."""
    job = Stream(
        drifting, ROLLER, BEAM, length=LENGTH, pitch=(ROLLER.advance, PITCH, PITCH), core=core, overlap=overlap
    )
    own = slice(job.layout.overlap, None)
    light = [job.solver.buffer().numpy()[own][: len(segment.images)] for segment in job]
    return job, np.concatenate(light)


@cache
def whole() -> tuple[WebProjection, np.ndarray, np.ndarray]:
    """Projector of the whole web, and light and dose of the web in one piece."""
    job, light = solved(core=10.0)
    assert job.total == 1
    columns = int(np.ceil(LENGTH / job.grid.edges[0] - 1e-6))
    grid = WebGrid((columns, *job.grid.shape[1:]), job.grid.pitch)
    A = WebProjection(grid, BEAM, ROLLER, job.device, poses=len(light), start=-job.layout.lead)
    return A, light, np.asarray(A.T(light))


@pytest.mark.slow
@pytest.mark.parametrize("core", [1.0, 2.0])
def test_segments_meet_without_a_seam(core: float) -> None:
    A, light, dose = whole()
    job, pieces = solved(core)
    assert job.total is not None and job.total >= 3
    assert pieces.shape == light.shape
    assert np.abs(np.asarray(A.T(pieces)) - dose).max() < 1e-3  # of the target dose, 1, at every seam and elsewhere


@pytest.mark.slow
def test_influence_fades_with_the_overlap() -> None:
    A, _, dose = whole()
    half, more = (np.abs(np.asarray(A.T(solved(2.0, overlap)[1])) - dose).max() for overlap in (0.5, 1.5))
    assert half > 1e-3 > 1e-4 > more


@pytest.mark.slow
def test_what_comes_later_does_not_change_what_was_decided() -> None:
    _, light, _ = whole()
    job = Stream(drifting, ROLLER, BEAM, length=1.5 * LENGTH, pitch=(ROLLER.advance, PITCH, PITCH), core=10.0)
    next(iter(job))
    longer = job.solver.buffer().numpy()[job.layout.overlap :][: len(light)]
    far = len(light) - 2 * job.layout.window
    assert np.abs(longer[:far] - light[:far]).max() < 1e-3 * light.max()
