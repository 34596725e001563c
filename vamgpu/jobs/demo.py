"""Demos of a few minutes: a boat in the vial of the air-bath paper, a film on a roller."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Generic, TypeVar

from vamgpu.errors import StorageError
from vamgpu.jobs.read import CheckedJob, Job
from vamgpu.jobs.run import Proven, StageProgress, prove, quiet, solve
from vamgpu.jobs.web import WebJob, contrasts, solve_web
from vamgpu.webs.proof import WebProof, prove_web

Proof = TypeVar("Proof")
Checked = TypeVar("Checked", bound=CheckedJob[Any])

JOB = """\
# A boat in a vial of 24.8 mm that turns in air while each frame is lit. The beam's pitch is measured in air;
# refraction narrows its columns to 80 um in the resin, which is also the width of voxels unless target.pitch sets it.
# The lens blurs by half a pixel unless beam.spread sets the blur: a length, or the result of `vam calibrate mtf`.
#
# Vial and resin index are those of automatic exposure (A. Orth et al.), which prints a boat of this height in 57 s in
# fresh resin; they do not state irradiance or absorption. Another tomographic printer (B. Wang et al.) shines 65 mW/cm2
# into its vial. Absorption and critical dose are assumed: measure your own. The exposure time is proportional to
# critical_dose / irradiance.

[target]
shape = "boat"
height = "11.5 mm"

[beam]
pitch = "120 um"

[turntable]
angles = 360

[vial]
radius = "12.4 mm"
wall = "1.0 mm"
resin_index = 1.49962
wall_index = 1.473
bath_index = 1.0
absorption = "0.05 1/mm"

[solve]
iterations = 40

[frames]
bits = 8

[print]
irradiance = "65 mW/cm2"
critical_dose = "50 mJ/cm3"
"""


WEB_JOB = """\
# A film of 3 mm on a roller of 15 mm in water: a gyroid of endless length, of which 80 mm are printed here.

[film]
thickness = "3 mm"
resin_index = 1.49
bath_index = 1.33
absorption = "2.2 1/cm"

[roller]
radius = "7.5 mm"
step = "0.6 deg"

[lens]
bins = 3

[web]
length = "80 mm"
speed = "48 mm/min"

[target]
lattice = "SheetGyroid"
cell = "6 mm"

[beam]
pitch = "100 um"
height = "3 mm"

[solve]
iterations = 100
core = 1.0
"""


@dataclass(frozen=True, eq=False)
class Demo(Generic[Proof]):
    """Files of a demo, and the proof in its report."""

    file: Path
    folder: Path
    report: Path
    proven: Proof


def demo(out: str | Path, settings: Iterable[str] = (), *, progress: StageProgress = quiet) -> Demo[Proven]:
    """Solve, write and prove the bundled boat. Raises `StorageError`."""
    job, left = _begun(Job, JOB, out, "boat", settings, "report.html")
    solve(job, left.folder, overwrite=True, progress=progress)
    proven = prove(left.folder, job.file.solve.device, progress=progress)
    progress("report", 0.0)
    proven.report(left.report)
    return replace(left, proven=proven)


def demo_web(out: str | Path, settings: Iterable[str] = (), *, progress: StageProgress = quiet) -> Demo[WebProof]:
    """Solve, write and prove a gyroid film; replaces an earlier demo, as `demo` does. Raises `StorageError`."""
    job, left = _begun(WebJob, WEB_JOB, out, "gyroid", settings, "web.html")
    solve_web(job, left.folder, overwrite=True, progress=progress)
    progress("proof", 0.0)
    proof = prove_web(left.folder, job.file.solve.device)
    progress("contrast", 0.0)
    found = contrasts(device=job.file.solve.device)
    progress("report", 0.0)
    proof.report(left.report, title="A gyroid film", contrast=found)
    return replace(left, proven=proof)


def _begun(
    kind: type[Checked], text: str, out: str | Path, name: str, settings: Iterable[str], page: str
) -> tuple[Checked, Demo[Any]]:
    """Write the job file of a demo, and remove the report of an earlier one. Raises `StorageError`."""
    place = Path(out)
    job = kind.parse(text, settings, source="the demo's job", folder=place, name=name)
    left = Demo(place / f"{name}.toml", place / f"{name}.vam", place / page, None)
    try:
        place.mkdir(parents=True, exist_ok=True)
        left.report.unlink(missing_ok=True)
        left.file.write_text(text, encoding="utf-8")
    except OSError as error:
        problem = f"cannot write in {str(place)!r}: {error.strerror}; choose another folder (--out)"
        raise StorageError(problem) from error
    return job, left
