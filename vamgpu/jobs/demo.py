"""The main job on a part of our own, in the vial of the air-bath paper: something to look at within a minute."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from vamgpu.errors import StorageError
from vamgpu.jobs.read import parse_job
from vamgpu.jobs.run import Proven, Told, _quietly, prove, solve

JOB = """\
# A boat in a vial of 24.8 mm that turns in air. The pitch of the beam is measured in air: refraction narrows its
# columns to 60 um in the resin, while its rows stay as high as the voxels. The lens blurs by half a pixel unless
# beam.spread says what it does: a length, or the result of `vam calibrate mtf`.
#
# Vial and resin index are those of automatic exposure (A. Orth et al.), which prints a boat of this height in 57 s in
# fresh resin, and states neither irradiance nor absorption. 65 mW/cm2 is what another tomographic printer shines into
# its vial (B. Wang et al.), and the absorption is assumed. The critical dose is not measured: with it this boat takes
# about as long as theirs. Measure your own; times grow with critical_dose / irradiance.

[target]
shape = "boat"
height = "11.5 mm"
pitch = "90 um"

[beam]
pitch = "90 um"

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


@dataclass(frozen=True, eq=False)
class Demo:
    """What a demo left: the job file, the job folder, the report, and the proof it shows."""

    file: Path
    folder: Path
    report: Path
    proven: Proven


def demo(out: str | Path, settings: Iterable[str] = (), *, told: Told = _quietly) -> Demo:
    """Solve, write and prove the bundled boat in the folder ``out``; ``settings`` as for `read_job`.

    An earlier demo there is replaced; its report goes first, so that no report stands beside another job. Raises
    `StorageError` and what `solve` and `prove` raise.
    """
    place = Path(out)
    job = parse_job(JOB, settings, source="the demo's job", folder=place, name="boat")
    file, folder, report = place / "boat.toml", place / "boat.vam", place / "report.html"
    lay_out(file, JOB, report)
    solve(job, folder, overwrite=True, told=told)
    told("proof", 0.0)
    proven = prove(folder, job.wanted.solve.device)
    told("report", 0.0)
    return Demo(file, folder, proven.report(report), proven)


def lay_out(file: Path, text: str, report: Path) -> None:
    """Write a demo's job file into its folder, and remove the report of an earlier one. Raises `StorageError`."""
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        report.unlink(missing_ok=True)
        file.write_text(text, encoding="utf-8")
    except OSError as error:
        where = str(file.parent)
        raise StorageError(f"cannot write in {where!r}: {error.strerror}; choose another folder (--out)") from error
