"""The commands ``vam curethrough model | correct | fit``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from cyclopts import App
from rich.markup import escape

from vamgpu.cli.options import Overwrite, Settings, console
from vamgpu.cli.show import show_rows

if TYPE_CHECKING:
    from rich.console import Console

    from vamgpu.curethrough.job import Outcome

group: App = App(
    name="curethrough", help="Stereolithography: model what light cures behind features, and correct the slices."
)


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
    from vamgpu.cli.progress import shown
    from vamgpu.jobs.curethrough import model_job, read_curethrough
    from vamgpu.storage.atomic import named, page_path

    job = named(job)
    place = page_path(report or job.with_name(f"{job.stem}-model.html"))
    checked, screen = read_curethrough(job, settings or ()), console()
    with shown(screen) as progress:
        found = model_job(checked, slices=slices, doses=doses, overwrite=overwrite, report=place, progress=progress)
        progress("report", 0.0)
        page = _draw(found, place, checked.name)
    _lines(screen, found)
    if doses is not None:
        screen.print(f"doses   [bold]{escape(str(doses))}[/]")
    screen.print(f"report  [bold]{escape(str(page.resolve()))}[/]")


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
    from vamgpu.cli.progress import shown
    from vamgpu.jobs.curethrough import correct_job, read_curethrough
    from vamgpu.storage.atomic import page_path

    checked, screen = read_curethrough(job, settings or ()), console()
    place = out if out is not None else checked.beside(slices)
    page = page_path(report or place.with_name(f"{place.stem}.html"))
    with shown(screen) as progress:
        found = correct_job(checked, place, slices=slices, overwrite=overwrite, report=page, progress=progress)
        progress("report", 0.0)
        _draw(found, page, checked.name)
    _lines(screen, found)
    added = found.correction.added if found.correction is not None else 0
    screen.print(f"slices  [bold]{escape(str(place))}[/]{f', {added} added after the last' if added else ''}")
    screen.print(f"report  [bold]{escape(str(page.resolve()))}[/]")


@group.command
def fit(
    plugs: Path | None = None, *, irradiance: str | None = None, gray: Path | None = None, pieces: int | None = None,
    confidence: float = 0.95, gels: float = 5.0, out: Path | None = None, overwrite: Overwrite = False,
) -> None:  # fmt: skip
    """Fit a resin's working curve to cured plugs, and a projector's light to readings of its gray levels.

    Args:
        plugs: CSV file with columns height_mm and exposure_mJ_cm2, or time_s and irradiance_mW_cm2
        irradiance: irradiance of all plugs, such as "20 mW/cm2", if the file gives only times
        gray: CSV file with columns level and intensity_mW_cm2
        pieces: straight pieces of the gray curve; by default one between every two levels read, at most 32
        confidence: confidence of the intervals
        gels: critical dose divided by the dose that just gels
        out: TOML file for the fitted tables [printer] and [gray]
    """
    from vamgpu.jobs.fit import fit_files

    fitted, screen = fit_files(plugs, irradiance, gray, pieces, confidence, gels, out), console()
    show_rows(screen, fitted.lines(), 16)
    if out is not None:
        screen.print(f"wrote [bold]{escape(str(fitted.write(out, overwrite=overwrite)))}[/]")


def _draw(found: Outcome, path: Path, title: str) -> Path:
    from vamgpu.curethrough.report import write_report

    return write_report(found, path, title=title)


def _lines(screen: Console, found: Outcome) -> None:
    from vamgpu.curethrough.report import lines

    show_rows(screen, lines(found), 16)
