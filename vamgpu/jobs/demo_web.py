"""A gyroid film on the roller of the roll-to-roll paper: frames, proof and report within two minutes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from vamgpu.jobs.demo import lay_out
from vamgpu.jobs.run import Told, _quietly
from vamgpu.jobs.web import contrasts, parse_web, solve_web

if TYPE_CHECKING:
    from vamgpu.webs.proof import WebProof

JOB = """\
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
class WebDemo:
    """What a demo of a web left: the job file, the folder of frames, the report, and the proof it shows."""

    file: Path
    folder: Path
    report: Path
    proof: WebProof


def demo_web(out: str | Path, settings: Iterable[str] = (), *, told: Told = _quietly) -> WebDemo:
    """Solve, write and prove a gyroid film in the folder ``out``; ``settings`` as for `read_web`.

    An earlier demo there is replaced; its report goes first. Raises `StorageError` and what the parts raise.
    """
    from vamgpu.webs.proof import prove_web

    place = Path(out)
    job = parse_web(JOB, settings, source="the demo's job", folder=place, name="gyroid")
    file, folder, report = place / "gyroid.toml", place / "gyroid.vam", place / "web.html"
    lay_out(file, JOB, report)
    solve_web(job, folder, overwrite=True, told=told)
    told("proof", 0.0)
    proof = prove_web(folder, job.wanted.solve.device)
    told("contrast", 0.0)
    found = contrasts(device=job.wanted.solve.device)
    told("report", 0.0)
    return WebDemo(file, folder, proof.report(report, title="A gyroid film", contrast=found), proof)
