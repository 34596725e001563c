"""The commands ``vam curethrough model | correct | fit``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter
from rich.markup import escape

from vamgpu.cli.options import Overwrite, Settings, console
from vamgpu.cli.show import show_rows
from vamgpu.errors import BadInput

if TYPE_CHECKING:
    from vamgpu.curethrough.job import Outcome
    from vamgpu.jobs.curethrough import CurethroughJob
    from vamgpu.jobs.run import StageProgress

group: App = App(
    name="curethrough", help="Stereolithography: model what light cures behind features, and correct the slices."
)


@group.default
def _without_command(*given: Annotated[str, Parameter(show=False)]) -> None:
    if given:
        raise BadInput(f"got {given[0]!r} in place of model, correct or fit; slices need a job file that states the "
                       f"printer and its resin: vam curethrough correct job.toml --slices {given[0]}")  # fmt: skip
    group.help_print()


@group.command
def model(
    job: Path, *, slices: Path | None = None, doses: Path | None = None, report: Path | None = None,
    settings: Settings = None, overwrite: Overwrite = False,
) -> None:  # fmt: skip
    """Predict what the uncorrected slices print, and write a report.

    Args:
        job: the TOML file
        slices: a folder, zip or SL1 file that replaces the job's slices
        doses: a folder or zip for images of the dose, with 51 gray levels per critical dose
        report: the HTML file; the job's name with -model.html by default
    """
    from vamgpu.jobs.curethrough import check_output, model_job, read_curethrough
    from vamgpu.storage.atomic import named, page_path

    job = named(job)
    page = page_path(report or job.with_name(f"{job.stem}-model.html"))
    checked = read_curethrough(job, settings or ())
    if doses is not None:
        check_output(checked, doses, slices=slices, overwrite=overwrite, report=page)
    _run("model", checked, page, lambda progress: model_job(
        checked, slices=slices, doses=doses, overwrite=overwrite, report=page, progress=progress))  # fmt: skip
    if doses is not None:
        console().print(f"doses   [bold]{escape(str(doses))}[/]")
    console().print(f"report  [bold]{escape(str(page.resolve()))}[/]")


@group.command
def correct(
    job: Path, *, slices: Path | None = None, out: Path | None = None, report: Path | None = None,
    settings: Settings = None, overwrite: Overwrite = False,
) -> None:  # fmt: skip
    """Write corrected slices beside the originals, and a report of both.

    Args:
        job: the TOML file
        slices: a folder, zip or SL1 file that replaces the job's slices
        out: folder or zip for the corrected slices; by default the slices' name with -corrected
        report: the HTML file; beside the corrected slices by default
    """
    from vamgpu.jobs.curethrough import check_output, correct_job, read_curethrough
    from vamgpu.storage.atomic import page_path

    checked, screen = read_curethrough(job, settings or ()), console()
    place = out if out is not None else checked.beside(slices)
    page = page_path(report or place.with_name(f"{place.stem}.html"))
    check_output(checked, place, slices=slices, overwrite=overwrite, report=page)
    found = _run("correct", checked, page, lambda progress: correct_job(
        checked, place, slices=slices, overwrite=overwrite, report=page, progress=progress))  # fmt: skip
    added = found.correction.added if found.correction is not None else 0
    screen.print(f"slices  [bold]{escape(str(place))}[/]{f', {added} added after the last' if added else ''}")
    screen.print(f"report  [bold]{escape(str(page.resolve()))}[/]")


@group.command
def fit(
    plugs: Path | None = None, *, irradiance: str | None = None, gray: Path | None = None, pieces: int | None = None,
    confidence: float = 0.95, gels: float = 5.0, lamp: Path | None = None, out: Path | None = None,
    overwrite: Overwrite = False,
) -> None:  # fmt: skip
    """Fit a resin's working curve to cured plugs, and a projector's light to readings of its gray levels.

    Args:
        plugs: CSV file with columns height_mm and exposure_mJ_cm2, or time_s and irradiance_mW_cm2
        irradiance: irradiance of all plugs, such as "20 mW/cm2", if the file gives only times
        gray: CSV file with columns level and intensity_mW_cm2
        pieces: straight pieces of the gray curve; by default one between every two levels read, at most 32
        confidence: confidence of the intervals
        gels: critical dose divided by the dose that just gels
        lamp: CSV file with columns light and absorption, a line for each wavelength of a lamp that has several
        out: TOML file for the fitted tables [printer] and [gray]
    """
    from vamgpu.jobs.fit import fit_files

    fitted, screen = fit_files(plugs, irradiance, gray, pieces, confidence, gels, out, lamp), console()
    show_rows(screen, fitted.lines(), 16)
    if out is not None:
        screen.print(f"wrote [bold]{escape(str(fitted.write(out, overwrite=overwrite)))}[/]")


def _run(kind: str, job: CurethroughJob, page: Path, work: Callable[[StageProgress], Outcome]) -> Outcome:
    """Model or correct slices, write the report and show the numbers."""
    from vamgpu.cli.progress import shown
    from vamgpu.curethrough.report import lines, page_of
    from vamgpu.jobs.progress import recorded
    from vamgpu.storage.atomic import named

    screen = console()
    with recorded(named(page), kind, job=job.given) as events, shown(screen, events) as progress:
        found = work(progress)
        progress("report", 0.0)
        page_of(found, job.name).write(page)
        events.verdict(*found.verdict)
    show_rows(screen, lines(found), 16)
    return found
