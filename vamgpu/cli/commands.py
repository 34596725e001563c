"""The commands of ``vam``."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from cyclopts import App, CycloptsError, CycloptsPanel, UnusedCliTokensError
from rich.console import Group
from rich.markup import escape
from rich.table import Table

import vamgpu
from vamgpu.cli import curethrough, live, sweep
from vamgpu.cli.options import Overwrite, Settings, Switch, console, continued
from vamgpu.cli.show import report_memory, show_rows, show_verdict, show_web, shown_path
from vamgpu.errors import BadInput

if TYPE_CHECKING:
    from rich.console import Console

    from vamgpu.jobs.progress import RunEvents


def _refusal(error: CycloptsError) -> Any:
    """What is wrong with a command line, and the remedy if an option got several values."""
    several = isinstance(error, UnusedCliTokensError) and "=" in " ".join(error.unused_tokens or ())
    remedy = "An option takes one value; repeat it for each: --set a=1 --set b=2" if several else ""
    return Group(CycloptsPanel(error), remedy) if several else CycloptsPanel(error)


app: App = App(
    name="vam",
    help="Tomographic volumetric 3D printing: from a mesh to frames and a proof of the print.",
    version=vamgpu.__version__,
    suppress_keyboard_interrupt=False,
    error_formatter=_refusal,
)
app.command(curethrough.group)
app.command(live.group)
app.command(sweep.sweep)


@app.command
def demo(
    what: Literal["boat", "web"] = "boat", /, *, out: Path = Path("vamgpu-demo"), settings: Settings = None
) -> None:
    """Simulate the print of the bundled boat, or of a gyroid film on an endless web, and write a report.

    Args:
        what: demo to run: boat or web
        out: folder of the demo's files
    """
    from vamgpu.cli.progress import shown
    from vamgpu.jobs.demo import demo as vial
    from vamgpu.jobs.demo import demo_web

    screen = console()
    with shown(screen) as progress:
        done: Any = (demo_web if what == "web" else vial)(out, settings or (), progress=progress)
    if what == "web":
        show_web(screen, done.proven)
    else:
        show_verdict(screen, done.proven.proof.verdict)
        show_rows(screen, done.proven.proof.lines())
        show_rows(screen, done.proven.proof.judgement.lines())
    screen.print(f"job     {shown_path(done.file)}\nframes  {shown_path(done.folder)}")
    screen.print(f"report  [bold]{shown_path(done.report.resolve())}[/]")


@app.command
def solve(
    job: Path, *, out: Path | None = None, start: Path | None = None, rig: Path | None = None,
    settings: Settings = None, overwrite: Overwrite = False,
    pareto: Switch = False, memory: str | None = None, cluster: str | None = None, slices: Switch = False,
) -> None:  # fmt: skip
    """Optimize the patterns of a TOML job file and write them to a job folder, or resume a run that Ctrl-C stopped.

    Args:
        job: the TOML file
        out: the job folder; the file's name with .vam by default
        start: folder of a plan whose patterns are the starting point; it must have the same number of angles and pixels
        rig: TOML file of the rig that will print the job; its measured point spread is used if the job has none
        pareto: also find the widest windows of a series of shorter exposures, with the lamp and resin of [print]
        memory: memory limit of the process, such as 8GB; fields that exceed it are kept in files in the folder TMPDIR,
            and a verdict that needs more is skipped
        cluster: cluster whose workers share the slices of a vial or the segments of a web: local:4 for four processes
            on this machine, tcp://host:8786 for a Dask cluster that sees the same files
        slices: also store a slice of the dose beside the job folder every few seconds, for `vam studio`
    """
    from vamgpu.backend import within
    from vamgpu.cli.progress import shown
    from vamgpu.jobs.progress import recorded
    from vamgpu.jobs.read import read_job
    from vamgpu.jobs.run import is_interrupted
    from vamgpu.jobs.run import solve as run
    from vamgpu.jobs.web import is_web, read_web
    from vamgpu.storage.atomic import named

    if rig is not None:
        settings = [*(settings or ()), *_measured(job, rig, settings)]
    if memory is not None:
        read = read_web if is_web(job) else read_job
        device = within(read(job, settings or ()).file.solve.device, memory)
        settings = [*(settings or ()), f"solve.device={device}"]
    if is_web(job):
        if start is not None:
            raise BadInput(f"{str(job)!r} is a web, which resumes from its own folder; leave out --start")
        if pareto:
            raise BadInput(f"{str(job)!r} is a web, which moves as fast as its limits allow; leave out --pareto")
        return _solve_web(job, out, settings, overwrite, cluster)
    place = out if out is not None else job.with_suffix(".vam")
    checked, screen = read_job(job, settings or ()), console()
    again = "" if not overwrite and start is None else "without " + " and ".join(
        name for name, value in (("--overwrite", overwrite), ("--start", start)) if value)  # fmt: skip
    with recorded(named(place), "solve", slices) as events:
        with shown(screen, events) as progress, continued(lambda: is_interrupted(place), again):
            folder = run(
                checked, place, overwrite=overwrite, start=start, pareto=pareto, cluster=cluster, progress=progress
            )  # fmt: skip
        screen.print(f"wrote [bold]{shown_path(folder.path)}[/]; prove it with: vam prove {shown_path(folder.path)}")
        if pareto:
            screen.print(_exposures(folder.manifest.inputs["pareto"]))
        if checked.file.colors is None:
            _verdict(screen, folder.path, checked.file.solve.device, memory, events)


def _verdict(screen: Console, folder: Path, device: str | None, memory: str | None, events: RunEvents) -> None:
    """Judge a solved folder by the solver's own dose; Ctrl-C leaves it complete, without a verdict."""
    from vamgpu.cli.progress import shown
    from vamgpu.jobs.run import prove
    from vamgpu.storage.memory import size

    with shown(screen, events) as progress, suppress(KeyboardInterrupt):
        progress("verdict", 0.0)
        proof = prove(folder, device, coarse=True).proof
        if needs := report_memory(memory, proof):
            screen.print(f"[yellow]note[/]  no verdict: it needs {size(needs)} of memory; leave out --memory to get it")
            return
        found = proof.verdict
        events.verdict(found.prints, found.sentence)
        show_verdict(screen, found)


def _exposures(points: list[dict[str, float]]) -> Table:
    """Table of the widest windows of a series of shorter exposures."""
    sheet = Table("exposure", "window", "dose outside / inside")
    for point in points:
        sheet.add_row(f"{point['seconds']:.3g} s", f"{point['window']:+.4f}", f"{point['outside']:.3f}")
    return sheet


def _measured(job: Path, rig: Path, settings: Settings) -> list[str]:
    """Show a rig's calibrations, and return the settings from them."""
    from vamgpu.hosts.rigs.calibrations import calibration_of, in_force, place_of
    from vamgpu.hosts.rigs.config import read_rig
    from vamgpu.jobs.read import read_job
    from vamgpu.jobs.web import is_web

    if is_web(job):
        raise BadInput(f"{str(job)!r} is a web, which has no measured point spread; leave out --rig")
    config, screen = read_rig(rig), console()
    place_of(config)  # a rig without a file has none
    found, known = in_force(config), calibration_of(config)
    for note in known.notes:
        screen.print(f"[yellow]note[/]  {escape(note)}")
    if known.runout is not None:
        runs = known.runout.found
        screen.print(
            f"axis    known to {runs.axis_error:.2g} columns, runout {runs.left:.2g}, from {found['runout'].name}"
        )
    own = read_job(job, settings or ()).file.beam.spread
    if own is not None or "mtf" not in found:
        why = "as the job sets it" if own is not None else "half a pixel, as the rig has no calibration mtf"
        screen.print(f"spread  {why}")
        return []
    screen.print(f"spread  measured by {found['mtf'].name}")
    return [f"beam.spread={json.dumps(str((found['mtf'].path / 'result.toml').resolve()))}"]


@app.command
def limits(machine: Path, *, settings: Settings = None) -> None:
    """Show the maximum speed of a web machine, and what limits it.

    Args:
        machine: the TOML file with the machine's tables, such as that of a web job
    """
    from vamgpu.jobs.limits import read_limits
    from vamgpu.webs.limits_table import lines

    found = read_limits(machine, settings or ())
    screen = console()
    show_rows(screen, lines(found), 16)
    for reason in found.broken:
        screen.print(f"[yellow]cannot[/] {escape(reason)}")


@app.command
def init(
    file: Path = Path("job.toml"), /, *, what: Literal["vial", "web", "machine", "slices"] = "vial",
    overwrite: Overwrite = False,
) -> None:  # fmt: skip
    """Write a job file that can be solved as it is, with a comment for every key.

    Args:
        file: path of the job file
        what: kind of print that the job file describes
    """
    from vamgpu.jobs.keys import commented
    from vamgpu.storage.atomic import check_folder, replacing

    if file.suffix.lower() != ".toml":
        raise BadInput(f"got {str(file)!r}; expected a path ending in .toml")
    check_folder(file)
    with replacing(file, overwrite=overwrite) as draft:
        draft.write_text(commented(what), encoding="utf-8")
    onward = {"machine": "limits", "slices": "curethrough correct"}.get(what, "solve")
    console().print(f"wrote [bold]{shown_path(file)}[/]; next: vam {onward} {shown_path(file)}")


@app.command
def keys(table: str | None = None, /) -> None:
    """List the keys of job files, with their types and meanings.

    Args:
        table: a table, such as beam or web.beam; a key, such as beam.pitch; a component, such as vessel.fan; or all
            components of a family, such as vessel; by default everything, as Markdown
    """
    from vamgpu.jobs.keys import explained, reference

    if table is None:
        return print(reference(), end="")
    sheet = Table("key", "holds", "default", "meaning", title=table)
    for key in explained(table):
        sheet.add_row(key.name, escape(key.what), escape(key.default or "required"), escape(key.doc))
    console().print(sheet)


@app.command
def schema(file: Literal["vial", "web", "machine", "slices"] = "vial", /) -> None:
    """Write the JSON Schema of a job file, which editors use to complete and check TOML.

    Args:
        file: kind of print that the job file describes
    """
    from vamgpu.jobs.keys import schema_of

    print(json.dumps(schema_of(file), indent=2, ensure_ascii=False))


@app.command
def devices() -> None:
    """List the devices that work on this machine, the best first."""
    screen = console()
    for name in vamgpu.devices():
        screen.print(name)


@app.command
def doctor(*, limit: float = 120.0) -> int:
    """Run a kernel on every device of this machine; for a missing device, show the reason and what to install.

    Args:
        limit: time limit for a driver to answer [s]
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
    *, job: Path | None = None, size: int = 128, angles: int = 360, repeats: int = 5, device: list[str] | None = None,
    record: Path | None = None, settings: Settings = None,
) -> None:  # fmt: skip
    """Time the projection operators on this machine's devices, or measure how long each stage of a job takes.

    Args:
        job: TOML job file of a vial; it is solved, proved and reported in a temporary folder
        size: voxels along each axis
        angles: number of angles over a full turn
        repeats: number of runs; the median is reported
        device: devices to time; by default all but the reference
        record: JSON file for the table and the machine's description
    """
    from vamgpu.jobs.bench import bench as run
    from vamgpu.jobs.bench import table as records

    if job is not None:
        return _bench_job(job, [*(settings or ()), *(f'solve.device="{name}"' for name in device or ())], record)
    if settings:
        raise BadInput(f"--set {settings[0]} sets a key of a job, but there is no job; add --job, or leave out --set")
    timings = list(run(size, angles, repeats, device))
    sheet = Table("device", "projector", "forward [ms]", "back [ms]", title=f"{size}³ × {angles}, medians of {repeats}")
    for timing in timings:
        cells = (timing.device, timing.operator, f"{1e3 * timing.forward:.1f}", f"{1e3 * timing.back:.1f}")
        sheet.add_row(*cells)
    console().print(sheet)
    if record is not None:
        _record(record, {"timings": records(timings)})


def _record(place: Path, found: dict[str, Any]) -> None:
    """Write the timings and the machine's description."""
    from vamgpu.jobs.bench import machine
    from vamgpu.storage.atomic import replacing

    with replacing(place, overwrite=True) as draft:
        draft.write_text(json.dumps({"machine": machine(), **found}, indent=2) + "\n", encoding="utf-8")


def _bench_job(job: Path, settings: list[str] | None, record: Path | None) -> None:
    """Show the stages of a job, with their seconds and shares."""
    from vamgpu.cli.progress import STAGES
    from vamgpu.jobs.bench import stages
    from vamgpu.jobs.read import read_job
    from vamgpu.jobs.web import is_web

    if is_web(job):
        raise BadInput(f"{str(job)!r} is a web; expected the job of a vial")
    checked = read_job(job, settings or ())
    found = stages(checked)
    whole, name = sum(stage.seconds for stage in found), vamgpu.open_device(checked.file.solve.device).name
    sheet = Table("stage", "seconds", "share", "by bandwidth", title=f"{job.name} on {name}: {whole:.1f} s")
    for stage in found:
        least = "" if stage.least is None else f"{stage.least:.2g} s"
        sheet.add_row(STAGES.get(stage.name, stage.name), f"{stage.seconds:.2f}", f"{stage.seconds / whole:.0%}", least)
    console().print(sheet)
    if record is not None:
        _record(
            record, {"job": job.name, "device": name, "seconds": whole, "stages": [asdict(stage) for stage in found]}
        )


def _solve_web(
    job: Path, out: Path | None, settings: list[str] | None, overwrite: bool, cluster: str | None
) -> None:  # fmt: skip
    """Solve a web, or resume a run that was interrupted."""
    from vamgpu.cli.progress import shown
    from vamgpu.jobs.progress import recorded
    from vamgpu.jobs.web import is_web_folder, read_web, solve_web
    from vamgpu.storage.atomic import named

    checked, screen, place = read_web(job, settings or ()), console(), out or job.with_suffix(".vam")
    again = "without --overwrite" if overwrite else ""
    with (
        recorded(named(place), "solve", job=checked.given) as events,
        shown(screen, events) as progress,
        continued(lambda: is_web_folder(place), again),
    ):
        folder = solve_web(checked, place, overwrite=overwrite, cluster=cluster, progress=progress)
    screen.print(f"wrote [bold]{shown_path(folder.path)}[/]; prove it with: vam prove {shown_path(folder.path)}")
