"""The commands of ``vam``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import App, Parameter
from rich.console import Console
from rich.markup import escape
from rich.table import Table

import vamgpu
from vamgpu.cli import curethrough, live, sweep
from vamgpu.cli.options import Overwrite, Settings, Switch, console
from vamgpu.errors import BadInput

if TYPE_CHECKING:
    from vamgpu.jobs.run import Proven
    from vamgpu.printing.frames import Frames
    from vamgpu.webs.proof import WebProof

app: App = App(
    name="vam",
    help="Tomographic volumetric 3D printing: from a mesh to frames and a proof of the print.",
    version=vamgpu.__version__,
    suppress_keyboard_interrupt=False,
)
app.command(curethrough.group)
app.command(live.group)
app.command(sweep.sweep)


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
    with shown(screen) as progress:
        done = run(out, settings or (), progress=progress)
    _scores(screen, done.proven)
    screen.print(f"job     {_path(done.file)}\nframes  {_path(done.folder)}")
    screen.print(f"report  [bold]{_path(done.report.resolve())}[/]")


@app.command
def solve(
    job: Path, *, out: Path | None = None, start: Path | None = None, rig: Path | None = None,
    settings: Settings = None, overwrite: Overwrite = False,
    pareto: Annotated[bool, Parameter(negative="")] = False, memory: str | None = None, cluster: str | None = None,
) -> None:  # fmt: skip
    """Find light for a TOML job file and write it to a job folder, or go on with one that was stopped by Ctrl-C.

    Args:
        job: the TOML file
        out: the folder; the file's name with .vam by default
        start: folder of a plan whose light is the first guess, of as many angles and pixels, whatever else has changed
        rig: the TOML file of the rig that will print it, whose measured point spread counts where the job has none
        pareto: find the widest windows of shorter and shorter exposures too, by the lamp and resin of [print]
        memory: what the process may take, such as 8GB; fields beyond it lie in files, in the folder TMPDIR
        cluster: whose workers share the slices of a vial, or the segments of a web: local:4 for four processes of this
            machine, tcp://host:8786 for a Dask cluster that sees the same files
    """
    from vamgpu.backend import within
    from vamgpu.cli.progress import shown
    from vamgpu.jobs.read import read_job
    from vamgpu.jobs.run import solve as run
    from vamgpu.jobs.web import is_web, read_web

    if rig is not None:
        settings = [*(settings or ()), *_measured(job, rig, settings)]
    if memory is not None:
        read = read_web if is_web(job) else read_job
        device = within(read(job, settings or ()).file.solve.device, memory)
        settings = [*(settings or ()), f"solve.device={device}"]
    if is_web(job):
        if start is not None:
            raise BadInput(f"{str(job)!r} is a web, which goes on with its own folder; leave --start out")
        if pareto:
            raise BadInput(f"{str(job)!r} is a web, which moves as fast as its limits allow; leave --pareto out")
        return _solve_web(job, out, settings, overwrite, cluster)
    place = out if out is not None else job.with_suffix(".vam")
    wanted, screen = read_job(job, settings or ()), console()
    with shown(screen) as progress:
        folder = run(
            wanted, place, overwrite=overwrite, start=start, pareto=pareto, cluster=cluster, progress=progress
        )  # fmt: skip
    if pareto:
        sheet = Table("exposure", "window", "dose outside over inside")
        for point in folder.manifest.inputs["pareto"]:
            sheet.add_row(f"{point['seconds']:.3g} s", f"{point['window']:+.4f}", f"{point['outside']:.3f}")
        screen.print(sheet)
    screen.print(f"wrote [bold]{_path(folder.path)}[/]; prove it with: vam prove {_path(folder.path)}")


def _measured(job: Path, rig: Path, settings: Settings) -> list[str]:
    """What a rig's calibrations say of a job's light, as settings; and tell it."""
    from vamgpu.hosts.calibrating.store import calibration_of, in_force, place_of
    from vamgpu.hosts.rigs.config import read_rig
    from vamgpu.jobs.read import read_job
    from vamgpu.jobs.web import is_web

    if is_web(job):
        raise BadInput(f"{str(job)!r} is a web, whose light has no point spread to measure; leave --rig out")
    config, screen = read_rig(rig), console()
    place_of(config)  # a rig without a file has none
    found, known = in_force(config), calibration_of(config)
    for note in known.notes:
        screen.print(f"[yellow]note[/]  {escape(note)}")
    if known.runout is not None:
        runs = known.runout.found
        screen.print(
            f"axis    known to {runs.axis_error:.2g} columns, turns true to {runs.left:.2g}, by {found['runout'].name}"
        )
    own = read_job(job, settings or ()).file.beam.spread
    if own is not None or "mtf" not in found:
        why = "the job says it" if own is not None else "half a pixel, as the rig has no calibration mtf"
        screen.print(f"spread  {why}")
        return []
    screen.print(f"spread  as measured by {found['mtf'].name}")
    return [f"beam.spread={json.dumps(str((found['mtf'].path / 'result.toml').resolve()))}"]


@app.command
def prove(
    job: Path, /, *, report: Path | None = None, device: str | None = None,
    bound: Annotated[bool, Parameter(negative="")] = False,
    tolerances: Annotated[bool, Parameter(negative="")] = False, slices: tuple[int, int] | None = None,
    printed: Annotated[list[Path] | None, Parameter(name="--job", negative="")] = None, memory: str | None = None,
) -> None:  # fmt: skip
    """Simulate a written job from its frames alone, or what a run has really shown, and draw a report.

    Args:
        job: the job folder, or the folder of a vial's run
        report: the HTML file; the folder's name with .html by default
        device: where to compute; the best device here by default
        bound: find the widest window that any light can have too, by 1500 projector evaluations, of each corner with
            --tolerances
        tolerances: prove it at every corner of the job's [tolerances] too, with one threshold for all
        slices: first slice, and the one behind the last, that alone are looked at for --bound: sooner, and the bound
            of some slices holds for all
        printed: folder of a job that a run printed, where it was moved since; one for each that was
        memory: what the proof may take, such as 8GB; fields beyond it lie in files, in the folder TMPDIR, and a report
            that takes more is left out
    """
    from vamgpu.backend import within
    from vamgpu.cli.progress import shown
    from vamgpu.jobs.run import prove as run
    from vamgpu.jobs.web import is_web_folder
    from vamgpu.printing.report import report_bytes
    from vamgpu.quantity import bytes_of
    from vamgpu.storage.atomic import named, page_path
    from vamgpu.storage.memory import size

    job = named(job)
    device = device if memory is None else within(device, memory)
    place = page_path(report or job.with_suffix(".html"))
    if bound and ((job / "run.json").is_file() or is_web_folder(job)):
        raise BadInput(f"--bound is for the job of a vial, and {str(job)!r} is none; leave it out")
    if slices is not None and not bound:
        raise BadInput(f"--slices {slices[0]} {slices[1]} are those of --bound; give it too, or leave them out")
    if tolerances and ((job / "run.json").is_file() or is_web_folder(job)):
        raise BadInput(f"--tolerances is for the job of a vial, and {str(job)!r} is none; leave it out")
    if (job / "run.json").is_file():
        return _prove_run(job, place, device, printed or ())
    if printed:
        raise BadInput(f"--job says where the jobs of a run are, and {str(job)!r} is no folder of one; leave it out")
    if is_web_folder(job):
        return _prove_web(job, place, device)
    screen = console()
    with shown(screen) as progress:
        evaluations = 1500.0 if bound else 0.0
        proven = run(job, device, evaluations=evaluations, tolerances=tolerances, slices=slices, progress=progress)
        needs = report_bytes(proven.proof)
        fits = memory is None or needs <= (bytes_of(memory) or 0)
        if fits:
            progress("report", 0.0)
            proven.report(place)
    _scores(screen, proven)
    if fits:
        screen.print(f"report  [bold]{_path(place.resolve())}[/]")
    else:
        screen.print(f"[yellow]note[/]  no report, which takes {size(needs)} of memory; leave --memory out to draw it")


def _prove_run(run: Path, place: Path, device: str | None, printed: Sequence[Path]) -> None:
    """What a run showed, beside what was planned."""
    from vamgpu.hosts.proof import prove_run

    screen = console()
    for number, found in enumerate(prove_run(run, device, printed)):
        page = place.with_stem(f"{place.stem}-{number + 1}") if number else place
        found.least.report(page, found.planned.plan)
        proofs = (found.planned.proof, found.least, found.most)
        screen.print(f"run     {found.run.state.value}: {found.light}")
        for name, value in (("window", lambda proof: proof.scores.window), ("IoU", lambda proof: proof.scores.iou)):
            planned, least, most = (f"{value(proof):+.4f}" for proof in proofs)
            band = least if least == most else f"{least} to {most}, as nobody knows all of the light"
            screen.print(f"{name:<7} planned {planned}, shown [bold]{band}[/]")
        screen.print(f"report  [bold]{_path(page.resolve())}[/]")


@app.command(name="import")
def import_(
    source: Path, /, *, out: Path | None = None, job: Path | None = None, patterns: Path | None = None,
    target: Path | None = None, flip_r: Switch = False, flip_z: Switch = False, reverse: Switch = False,
    axis: float | None = None, level: float | None = None, angles: int | None = None, gray: Path | None = None,
    device: str | None = None, settings: Settings = None, overwrite: Overwrite = False,
) -> None:  # fmt: skip
    """Make a job of another program's patterns, to be proven, printed, or solved on.

    Args:
        source: configuration of Dr.TVAM (JSON), sinogram of VAMToolbox (.sino, .npy), folder of PNG, TIFF or EXR
            images, or a film, such as those that OpenCAL plays
        out: the folder; the source's name with .vam by default. Ending in .toml, a job file of what Dr.TVAM was to
            solve, for vam solve; it needs no patterns
        job: TOML file of what the source does not say: part, vessel, pixels
        patterns: of Dr.TVAM, where they are not beside its configuration
        target: voxels that VAMToolbox solved for, in place of a mesh in the job
        flip_r: column 0 of images is the largest r
        flip_z: row 0 of images is the smallest z, as in films of VAMToolbox
        reverse: images are in the order of falling angles
        axis: column of the axis in images, counted from 0; their middle by default
        level: row of the part's middle; the images' middle by default
        angles: images of a turn, where a film has several turns
        gray: TOML file with the gray curve that images were made for
        device: where to compute; the best device here by default
    """
    from vamgpu.cli.progress import shown
    from vamgpu.jobs.foreign.importing import import_patterns, import_task
    from vamgpu.jobs.foreign.pictures import Layout
    from vamgpu.printing.gray import GrayCurve
    from vamgpu.storage.atomic import named

    if out is not None and out.suffix.lower() == ".toml":
        if beside := [name for name, value in (("--job", job), ("--patterns", patterns), ("--target", target),
                                               ("--set", settings)) if value is not None]:  # fmt: skip
            raise BadInput(f"{', '.join(beside)} beside --out {out}, which takes no patterns; expected the "
                           "configuration alone: leave it out")  # fmt: skip
        for note in import_task(source, out, overwrite=overwrite):
            console().print(f"[yellow]note[/]  {escape(note)}")
        console().print(f"wrote [bold]{_path(out)}[/]; solve it with: vam solve {_path(out)}")
        return
    curve = None if gray is None else GrayCurve.load(gray)
    layout, screen = Layout(flip_r, flip_z, reverse, axis, level, angles, curve), console()
    place = out if out is not None else named(source).with_suffix(".vam")
    with shown(screen) as progress:
        done = import_patterns(
            source, place, job=job, settings=settings or (), patterns=patterns, target=target, layout=layout,
            device=device, overwrite=overwrite, progress=progress,
        )  # fmt: skip
    for note in done.notes:
        screen.print(f"[yellow]note[/]  {escape(note)}")
    screen.print(f"wrote [bold]{_path(place)}[/] from {done.program}; prove it with: vam prove {_path(place)}")


@app.command
def export(
    job: Path, *, png: Path | None = None, tiff: Path | None = None, npz: Path | None = None, mp4: Path | None = None,
    drtvam: Path | None = None, fps: float = 30.0, players: Switch = False, canvas: str | None = None,
    offset: tuple[int, int] = (0, 0), rotation: float = 0.0, flip_r: Switch = False, flip_z: Switch = False,
    repeats: int = 1, rig: Path | None = None, projector: int = 1, overwrite: Overwrite = False,
) -> None:  # fmt: skip
    """Write the frames of a job as files that other programs read.

    Args:
        job: the job folder
        png: a folder of PNG pictures
        tiff: one file, a page a frame
        npz: bytes, curve and settings for NumPy
        mp4: a film, lossless in gray, or for any player with --players
        drtvam: a folder with configuration, patterns and part for Dr.TVAM
        fps: frames a second of the film
        players: write the film in yuv420p, which projectors and common players decode
        canvas: columns and rows of pictures, such as 1920x1080, in whose middle frames lie
        offset: columns to the right and rows upwards off that middle
        rotation: of frames, counterclockwise [deg]
        flip_r: mirror frames left to right
        flip_z: mirror frames top to bottom
        repeats: how often the turn is shown
        rig: TOML file of a rig, whose gray curve, flat field and axis frames are made for
        projector: of that rig, counted from 1
    """
    from vamgpu.jobs.foreign.drtvam import export_drtvam
    from vamgpu.jobs.web import is_web_folder
    from vamgpu.methods.saved import load_plan
    from vamgpu.printing.export import Canvas
    from vamgpu.printing.export import export as write
    from vamgpu.printing.folder import frames_of, load_frames
    from vamgpu.storage.atomic import named
    from vamgpu.storage.folder import Folder

    wanted = {"": png, ".tiff": tiff, ".npz": npz, ".mp4": mp4}
    places = {ending: place for ending, place in wanted.items() if place is not None}
    if not places and drtvam is None:
        raise BadInput(
            "no format was given; expected at least one of --png, --tiff, --npz, --mp4, --drtvam with a path"
        )
    for ending, place in places.items():
        if place.suffix.lower() not in {ending, ending.replace("tiff", "tif")}:
            raise BadInput(f"got {str(place)!r}; expected a path with {f'ending {ending}' if ending else 'no ending'}")
    job = named(job)
    if is_web_folder(job):
        raise BadInput(
            f"{str(job)!r} is a web, whose frames have no end; expected the folder of a vial's job: read frames of a "
            "web one by one in Python, with vamgpu.webs.store.WebFolder.open(path).frame(number)"
        )
    screen, frames = console(), load_frames(job, "numpy")
    if rig is not None:
        frames = _on_rig(frames, rig, projector)
    placed = Canvas(_size(canvas), offset, rotation, flip_r, flip_z, repeats)
    for ending, place in places.items():
        on = None if placed == Canvas() or ending == ".npz" else placed
        done = write(frames, place, fps=fps, overwrite=overwrite, canvas=on, players=players and ending == ".mp4")
        screen.print(f"wrote [bold]{_path(done)}[/]")
    if drtvam is not None:
        whole = frames_of(Folder.open(job), frames.device, load_plan(job, frames.device))
        screen.print(f"wrote [bold]{_path(export_drtvam(whole, drtvam))}[/]")


def _size(canvas: str | None) -> tuple[int, int] | None:
    """Columns and rows of text such as 1920x1080. Raises `BadInput`."""
    if canvas is None:
        return None
    columns, _, rows = canvas.lower().replace("×", "x").partition("x")
    if not (columns.strip().isdecimal() and rows.strip().isdecimal()):
        raise BadInput(f"--canvas is {canvas!r}; expected columns and rows, such as 1920x1080")
    return int(columns), int(rows)


def _on_rig(frames: Frames, rig: Path, projector: int) -> Frames:
    """Frames as a projector of a rig shows them, by its calibrations."""
    from vamgpu.hosts.calibrating.store import calibration_of
    from vamgpu.hosts.rigs.config import read_rig

    config = read_rig(rig)
    if not 1 <= projector <= len(config.setup.projector):
        raise BadInput(f"--projector is {projector}; the rig has {len(config.setup.projector)}, counted from 1")
    return calibration_of(config).frames(frames, projector - 1)


@app.command
def limits(machine: Path, *, png: Path | None = None, settings: Settings = None) -> None:
    """Tell what a web machine can do, how fast at most, and what limits it.

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
def init(
    file: Path = Path("job.toml"), /, *, what: Literal["vial", "web", "machine", "slices"] = "vial",
    overwrite: Overwrite = False,
) -> None:  # fmt: skip
    """Write a job file that can be solved as it is, with a remark for every key there is.

    Args:
        file: where to
        what: what the job file is for
    """
    from vamgpu.jobs.keys import commented
    from vamgpu.printing.export import check_folder
    from vamgpu.storage.atomic import replacing

    if file.suffix.lower() != ".toml":
        raise BadInput(f"got {str(file)!r}; expected a path ending in .toml")
    check_folder(file)
    with replacing(file, overwrite=overwrite) as draft:
        draft.write_text(commented(what), encoding="utf-8")
    onward = {"machine": "limits", "slices": "curethrough correct"}.get(what, "solve")
    console().print(f"wrote [bold]{_path(file)}[/]; go on with: vam {onward} {_path(file)}")


@app.command
def keys(table: str | None = None, /) -> None:
    """List the keys that job files may have, what they hold and what they mean.

    Args:
        table: one of a file, such as beam or web.beam, one key of it, such as beam.pitch, a noun, such as vessel.fan,
            or all nouns of a family, such as vessel; everything, as markdown, by default
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
        angles: how many over a full turn
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
    from vamgpu.jobs.demo import demo_web

    screen = console()
    with shown(screen) as progress:
        done = demo_web(out, settings or (), progress=progress)
    _web_scores(screen, done.proven)
    screen.print(f"job     {_path(done.file)}\nframes  {_path(done.folder)}")
    screen.print(f"report  [bold]{_path(done.report.resolve())}[/]")


def _solve_web(
    job: Path, out: Path | None, settings: list[str] | None, overwrite: bool, cluster: str | None
) -> None:  # fmt: skip
    """Solve a web, or go on with one that was interrupted."""
    from vamgpu.cli.progress import shown
    from vamgpu.jobs.web import read_web, solve_web

    wanted, screen = read_web(job, settings or ()), console()
    with shown(screen) as progress:
        place = out or job.with_suffix(".vam")
        folder = solve_web(wanted, place, overwrite=overwrite, cluster=cluster, progress=progress)
    screen.print(f"wrote [bold]{_path(folder.path)}[/]; prove it with: vam prove {_path(folder.path)}")


def _prove_web(job: Path, report: Path, device: str | None) -> None:
    from vamgpu.cli.progress import shown
    from vamgpu.webs.proof import prove_web

    screen = console()
    with shown(screen) as progress:
        progress("proof", 0.0)
        proof = prove_web(job, device)
        progress("report", 0.0)
        page = proof.report(report)
    _web_scores(screen, proof)
    screen.print(f"report  [bold]{_path(page.resolve())}[/]")


def _web_scores(screen: Console, proof: WebProof) -> None:
    """The numbers of a web."""
    last = proof.segments[-1].columns[1]
    rows = (
        ("overlap (IoU)", f"{proof.iou:.4f}", f"at one threshold, {proof.threshold:.3f} of the expected dose"),
        ("narrowest window", f"{proof.window:+.4f}", "least dose in the part - greatest out of it, over the greatest"),
        ("printed", f"{last * proof.grid.edges[0]:.4g} mm", f"{len(proof.segments)} segments, {last} columns"),
    )
    for name, value, meaning in rows:
        screen.print(f"  {name:<27} [bold]{value:<22}[/] [dim]{meaning}[/]")
