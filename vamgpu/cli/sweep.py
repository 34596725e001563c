"""``vam sweep``: a job with several values of its keys."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from vamgpu.cli.options import Settings, console, continued
from vamgpu.errors import BadInput

Vary = Annotated[list[str], Parameter(name="--vary", negative="", help="key=value,value,… to combine with the others")]


def sweep(
    job: Path, /, *, vary: Vary, out: Path | None = None, cluster: str | None = None, settings: Settings = None
) -> None:
    """Solve and prove a job for every combination of values; finished combinations are not solved again.

    Args:
        job: the TOML file
        out: folder of the job folders and of sweep.csv; the file's name with -sweep by default
        cluster: local:4 for four processes on this machine, tcp://host:8786 for a Dask cluster that sees the same files
    """
    from vamgpu.jobs.sweep import Point, values_of
    from vamgpu.jobs.sweep import sweep as run

    read = [values_of(text) for text in vary]
    if len(dict(read)) < len(read):
        raise BadInput(f"a key varies twice in {', '.join(vary)}; give all its values at once")
    place, screen = out or job.with_name(f"{job.stem}-sweep"), console()
    columns = (TextColumn("solving and proving"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with (
        Progress(*columns, console=screen, transient=True, disable=not screen.is_terminal) as bar,
        continued((place / "sweep.csv").is_file),
    ):
        task = bar.add_task("", total=None)

        def advance(point: Point, count: int) -> None:
            bar.update(task, total=count, advance=1)

        points = run(job, dict(read), place, settings=settings or (), cluster=cluster, progress=advance)
    sheet = Table(*(key for key, _ in read), "window", "IoU", "exposure", "folder")
    for point in points:
        seconds = "" if point.seconds != point.seconds else f"{point.seconds:.3g} s"
        found = ("", "", escape(point.error)) if point.error else (f"{point.window:+.4f}", f"{point.iou:.5f}", seconds)
        sheet.add_row(*map(escape, point.values.values()), *found, escape(point.folder.name))
    screen.print(sheet)
    screen.print(f"wrote [bold]{escape(str(place / 'sweep.csv'))}[/]")
