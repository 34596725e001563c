"""The commands of ``vam``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from cyclopts import App
from rich.console import Console
from rich.markup import escape
from rich.table import Table

import vamgpu
from vamgpu.cli import curethrough
from vamgpu.cli.options import Overwrite, Settings, console

if TYPE_CHECKING:
    from vamgpu.jobs.run import Proven
    from vamgpu.webs.proof import WebProof

app = App(
    name="vam",
    help="Tomographic volumetric 3D printing: from a mesh to frames and a proof of the print.",
    version=vamgpu.__version__,
    suppress_keyboard_interrupt=False,
)
app.command(curethrough.group)


@app.command
def demo(
    what: Literal["boat", "web"] = "boat", /, *, out: Path = Path("vamgpu-demo"), settings: Settings = None
) -> None:
    """Print the bundled boat, or a gyroid film on an endless web, in simulation and draw a report.

    Args:
        what: boat or web
        out: folder of the demo's files
    """
    if what == "web":
        return _demo_web(out, settings)
    from vamgpu.cli.progress import shown
    from vamgpu.jobs.demo import demo as run

    screen = console()
    with shown(screen) as told:
        done = run(out, settings or (), told=told)
    _scores(screen, done.proven)
    screen.print(f"job     {_path(done.file)}\nframes  {_path(done.folder)}")
    screen.print(f"report  [bold]{_path(done.report.resolve())}[/]")


@app.command
def solve(job: Path, *, out: Path | None = None, settings: Settings = None, overwrite: Overwrite = False) -> None:
    """Find light for a TOML job file and write its frames to a job folder.

    Args:
        job: the TOML file
        out: the folder; the file's name with .vam by default
    """
    from vamgpu.cli.progress import shown
    from vamgpu.jobs.read import read_job
    from vamgpu.jobs.run import solve as run
    from vamgpu.jobs.web import is_web

    if is_web(job):
        return _solve_web(job, out, settings, overwrite)
    place = out if out is not None else job.with_suffix(".vam")
    wanted = read_job(job, settings or ())
    screen = console()
    with shown(screen) as told:
        folder = run(wanted, place, overwrite=overwrite, told=told)
    screen.print(f"wrote [bold]{_path(folder.path)}[/]; prove it with: vam prove {_path(folder.path)}")


@app.command
def prove(job: Path, *, report: Path | None = None, device: str | None = None) -> None:
    """Simulate a written job from its frames alone and draw a report.

    Args:
        job: the job folder
        report: the HTML file; the folder's name with .html by default
        device: where to compute; the best device here by default
    """
    from vamgpu.cli.progress import shown
    from vamgpu.jobs.run import prove as run
    from vamgpu.jobs.web import is_web_folder
    from vamgpu.storage.atomic import named, page_path

    job = named(job)
    place = page_path(report or job.with_suffix(".html"))
    if is_web_folder(job):
        return _prove_web(job, place, device)
    screen = console()
    with shown(screen) as told:
        told("proof", 0.0)
        proven = run(job, device)
        told("report", 0.0)
        page = proven.report(place)
    _scores(screen, proven)
    screen.print(f"report  [bold]{_path(page.resolve())}[/]")


@app.command
def export(
    job: Path,
    *,
    png: Path | None = None,
    tiff: Path | None = None,
    npz: Path | None = None,
    mp4: Path | None = None,
    fps: float = 30.0,
    overwrite: Overwrite = False,
) -> None:
    """Write the frames of a job as files that other programs read.

    Args:
        job: the job folder
        png: a folder of PNG pictures
        tiff: one file, a page a frame
        npz: bytes, curve and settings for NumPy
        mp4: a lossless film
        fps: frames a second of the film
    """
    from vamgpu.errors import BadInput
    from vamgpu.jobs.web import is_web_folder
    from vamgpu.printing.export import export as write
    from vamgpu.printing.folder import load_frames

    wanted = {"": png, ".tiff": tiff, ".npz": npz, ".mp4": mp4}
    places = {ending: place for ending, place in wanted.items() if place is not None}
    if not places:
        raise BadInput("no format was given; wanted at least one of --png, --tiff, --npz, --mp4 with a path")
    for ending, place in places.items():
        if place.suffix.lower() not in {ending, ending.replace("tiff", "tif")}:
            raise BadInput(f"got {str(place)!r}; wanted a path with {f'ending {ending}' if ending else 'no ending'}")
    if is_web_folder(job):
        raise BadInput(
            f"{str(job)!r} is a web, whose frames have no end; wanted the folder of a vial's job: read frames of a web "
            "one by one in Python, with vamgpu.webs.store.WebFolder.open(path).frame(number)"
        )
    frames = load_frames(job, "numpy")
    screen = console()
    for place in places.values():
        screen.print(f"wrote [bold]{_path(write(frames, place, fps=fps, overwrite=overwrite))}[/]")


@app.command
def limits(machine: Path, *, png: Path | None = None, settings: Settings = None) -> None:
    """Tell what a web machine can do, how fast at most, and what binds it.

    Args:
        machine: the TOML file with the machine's tables, such as that of a web job
        png: a picture of the limits
    """
    from vamgpu.jobs.limits import read_limits
    from vamgpu.webs.limits_table import lines

    found = read_limits(machine, settings or ())
    screen = console()
    for line in lines(found):
        screen.print(f"  {line.name:<27} [bold]{line.value:<16}[/] [dim]{line.meaning}[/]")
    for reason in found.broken:
        screen.print(f"[yellow]cannot[/] {escape(reason)}")
    if png is not None:
        from vamgpu.webs.limits_picture import draw

        screen.print(f"drew [bold]{_path(draw(found, png))}[/]")


@app.command
def keys(table: str | None = None, /) -> None:
    """List the keys that job files may have, what they hold and what they mean.

    Args:
        table: one of a file, such as beam or web.beam, or a noun, such as vessel.fan; all, as markdown, by default
    """
    from vamgpu.jobs.keys import keys_of, reference

    if table is None:
        return print(reference(), end="")
    sheet = Table("key", "holds", "default", "meaning", title=table)
    for key in keys_of(table):
        sheet.add_row(key.name, escape(key.what), escape(key.default or "wanted"), escape(key.doc))
    console().print(sheet)


@app.command
def schema(file: Literal["vial", "web", "machine", "slices"] = "vial", /) -> None:
    """Write the JSON Schema of a job file, by which editors complete and check TOML.

    Args:
        file: what the job file is for
    """
    from vamgpu.jobs.keys import schema_of

    print(json.dumps(schema_of(file), indent=2, ensure_ascii=False))


@app.command
def devices() -> None:
    """List the devices that work here, the best first."""
    screen = console()
    for name in vamgpu.devices():
        screen.print(name)


@app.command
def doctor(*, limit: float = 120.0) -> int:
    """Run a kernel on every device here, and say why one is missing and what to install.

    Args:
        limit: seconds a driver gets to answer
    """
    from vamgpu.cli.doctor import examine

    screen = console()
    found = examine(limit)
    for finding in found:
        mark = "[green]works  [/]" if finding.works else "[yellow]missing[/]"
        screen.print(f"{mark} [bold]{escape(finding.name)}[/]  {escape(finding.description)}")
        if finding.remedy:
            screen.print(f"        → {escape(finding.remedy)}")
    return 0 if any(finding.works and finding.name != "numpy" for finding in found) else 1


@app.command
def bench(
    *, size: int = 128, angles: int = 360, repeats: int = 5, device: list[str] | None = None, record: Path | None = None
) -> None:
    """Time the projectors on the devices here.

    Args:
        size: voxels along each axis
        angles: poses over a full turn
        repeats: runs that a median is taken of
        device: devices to time; all but the reference by default
        record: JSON file to keep the table and the machine's description in
    """
    from vamgpu.jobs.bench import bench as run
    from vamgpu.jobs.bench import machine
    from vamgpu.jobs.bench import table as records
    from vamgpu.storage.atomic import replacing

    timings = list(run(size, angles, repeats, device))
    sheet = Table("device", "projector", "forward [ms]", "back [ms]", title=f"{size}³ × {angles}, medians of {repeats}")
    for timing in timings:
        cells = (timing.device, timing.operator, f"{1e3 * timing.forward:.1f}", f"{1e3 * timing.back:.1f}")
        sheet.add_row(*cells)
    console().print(sheet)
    if record is not None:
        text = json.dumps({"machine": machine(), "timings": records(timings)}, indent=2) + "\n"
        with replacing(record, overwrite=True) as draft:
            draft.write_text(text, encoding="utf-8")


def _path(path: Path) -> str:
    """A path as it is: brackets in it are no markup."""
    return escape(str(path))


def _scores(screen: Console, proven: Proven) -> None:
    """The numbers of a proof."""
    for line in proven.proof.lines():
        screen.print(f"  {line.name:<27} [bold]{line.value:<22}[/] [dim]{line.meaning}[/]")


def _demo_web(out: Path, settings: list[str] | None) -> None:
    from vamgpu.cli.progress import shown
    from vamgpu.jobs.demo_web import demo_web

    screen = console()
    with shown(screen) as told:
        done = demo_web(out, settings or (), told=told)
    _web_scores(screen, done.proof)
    screen.print(f"job     {_path(done.file)}\nframes  {_path(done.folder)}")
    screen.print(f"report  [bold]{_path(done.report.resolve())}[/]")


def _solve_web(job: Path, out: Path | None, settings: list[str] | None, overwrite: bool) -> None:
    """Solve a web, or go on with one that was interrupted."""
    from vamgpu.cli.progress import shown
    from vamgpu.jobs.web import read_web, solve_web

    wanted, screen = read_web(job, settings or ()), console()
    with shown(screen) as told:
        folder = solve_web(wanted, out or job.with_suffix(".vam"), overwrite=overwrite, told=told)
    screen.print(f"wrote [bold]{_path(folder.path)}[/]; prove it with: vam prove {_path(folder.path)}")


def _prove_web(job: Path, report: Path, device: str | None) -> None:
    from vamgpu.cli.progress import shown
    from vamgpu.webs.proof import prove_web

    screen = console()
    with shown(screen) as told:
        told("proof", 0.0)
        proof = prove_web(job, device)
        told("report", 0.0)
        page = proof.report(report)
    _web_scores(screen, proof)
    screen.print(f"report  [bold]{_path(page.resolve())}[/]")


def _web_scores(screen: Console, proof: WebProof) -> None:
    """The numbers of a web."""
    last = proof.segments[-1].columns[1]
    rows = (
        ("overlap (IoU)", f"{proof.iou:.4f}", f"at one threshold, {proof.threshold:.3f} of the wanted dose"),
        ("narrowest window", f"{proof.window:+.4f}", "least dose in the part - greatest out of it, over the greatest"),
        ("printed", f"{last * proof.grid.edges[0]:.4g} mm", f"{len(proof.segments)} segments, {last} columns"),
    )
    for name, value, meaning in rows:
        screen.print(f"  {name:<27} [bold]{value:<22}[/] [dim]{meaning}[/]")
