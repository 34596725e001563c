"""Results of any number of jobs take the memory of a few."""

from __future__ import annotations

import gc
import tracemalloc
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import pytest

from vamgpu import Beam, Projection, Target, Turntable, Vial, pack, simulate
from vamgpu.printing.pack import Solved
from vamgpu.studio import volumes
from vamgpu.studio.results import Results
from vamgpu.studio.volumes import Volumes
from vamgpu.studio.workspace import Refused, Workspace
from vamgpu.targets import shapes

JOBS = 10
VIAL = Vial(radius=12.4, wall=1.0, resin_index=1.5, wall_index=1.47, bath_index=1.0, absorption=0.05)


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Workspace]:
    place = tmp_path_factory.mktemp("lab")
    target = Target.from_mesh(shapes.build("boat"), height=6.0, pitch=0.5, device="numpy")
    A = Projection(target.grid, Beam((24, 16), 0.5), Turntable(12), VIAL, "numpy")
    frames = pack(Solved(A(target.fraction), A, target))
    proof = simulate(A, frames, target, coarse=True)
    for number in range(JOBS):
        frames.save(place / f"boat-{number}.vam")
        proof.save(place / f"boat-{number}.proof")
    found = Workspace(place)
    yield found
    found.close()


def opened(results: Results, number: int) -> None:
    """What the page asks for when it opens a result."""
    name = f"boat-{number}.vam"
    results.described(name)
    results.volume(name, None, "dose", 128, "uint8")
    results.histogram(name, None, 64)
    for index in range(4):
        results.slice(name, None, "printed", "z", index, 1.0)
    results.surface(name, None, "printed", 1.0)
    results.frame(name, 0)
    results.sinogram(name, None)


@pytest.mark.slow
def test_ten_jobs_opened_in_a_loop_take_no_more_memory(workspace: Workspace) -> None:
    results = Results(workspace)

    def around() -> int:
        for number in range(JOBS):
            opened(results, number)
        gc.collect()
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    try:
        first = around()
        mapped = len(results._volumes._known)
        assert [around() <= 1.05 * first for _ in range(2)] == [True] * 2
    finally:
        tracemalloc.stop()
    assert mapped == len(results._volumes._known) == volumes.KEPT


def test_an_array_is_read_while_another_one_is_mapped(workspace: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, known, free, begun = workspace.manifest(workspace.folder / "boat-0.proof"), Volumes(), Event(), Event()
    known.of(folder, "target")
    made = volumes._mapped

    def slowly(*given: Any) -> np.ndarray:
        begun.set()
        free.wait(60.0)
        return made(*given)

    monkeypatch.setattr(volumes, "_mapped", slowly)
    with ThreadPoolExecutor(3) as pool:
        doses = [pool.submit(known.of, folder, "dose") for _ in range(2)]
        assert begun.wait(60.0)
        target = pool.submit(known.of, folder, "target").result(60.0)
        assert target.shape and not any(dose.done() for dose in doses)
        free.set()
        assert doses[0].result(60.0) is doses[1].result(60.0)


def test_slices_are_those_of_the_array(workspace: Workspace) -> None:
    results = Results(workspace)
    folder = workspace.manifest(workspace.folder / "boat-0.proof")
    dose, target = folder.array("dose"), folder.array("target")
    threshold = float(folder.manifest.details["proof"]["scores"]["threshold"])
    for axis, k in (("x", 0), ("y", 1), ("z", 2)):
        found = results.slice("boat-0.vam", None, "dose", axis, 5, 1.0)
        np.testing.assert_allclose(found.arrays["values"], np.take(dose, 5, k).T[::-1] / threshold, rtol=1e-6)
        verdict = results.slice("boat-0.vam", None, "printed", axis, 5, 2.0).arrays["values"]
        inside, solid = (np.take(values, 5, k).T[::-1] for values in (target >= 0.5, dose * 2.0 >= threshold))
        judged = verdict != 4
        assert judged.any() and ((verdict == 2) == (inside & ~solid & judged)).all()
        assert ((verdict == 3) == (~inside & solid & judged)).all()
    exposed = results.exposure("boat-0.vam", None, 2.0)
    cylinder = np.hypot(*np.meshgrid(*[np.arange(n) - 0.5 * (n - 1) for n in dose.shape[:2]], indexing="ij"))
    judged = (cylinder <= 0.5 * (min(dose.shape[:2]) - 1))[:, :, None]
    assert exposed["missing"] == int(((target >= 0.5) & (2.0 * dose < threshold) & judged).sum())
    assert exposed["excess"] == int(((target < 0.5) & (2.0 * dose >= threshold) & judged).sum())
    coarse = results.volume("boat-0.vam", None, "target", 8, "float16")
    assert max(coarse.arrays["values"].shape) <= 8 and coarse.arrays["values"].shape[::-1] != dose.shape
    with pytest.raises(Refused, match="expected 0 to"):
        results.slice("boat-0.vam", None, "dose", "x", dose.shape[0], 1.0)


def test_a_proof_older_than_its_job_does_not_count(workspace: Workspace, tmp_path: Path) -> None:
    place = workspace.folder / "boat-9.vam"
    assert workspace.proof_of(place) == workspace.folder / "boat-9.proof"
    (place / "manifest.json").touch()
    assert workspace.proof_of(place) is None
    with pytest.raises(Refused, match="no proof yet"):
        Results(workspace).histogram("boat-9.vam", None, 64)


def test_two_results_are_compared_line_by_line(workspace: Workspace) -> None:
    found = Results(workspace).compare("boat-1.vam", "boat-2.vam")
    assert found["keys"] == [] and all(row["a"] == row["b"] for row in found["rows"])
