"""``vam print`` and ``vam panel``: jobs on rigs, rehearsed or real."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from rich.console import Console
from rich.markup import escape

from vamgpu.cli.commands import app
from vamgpu.cli.options import Settings, console

if TYPE_CHECKING:
    from vamgpu.hosts.board import Board
    from vamgpu.hosts.rig import Plan, Rehearsal

Switch = Annotated[bool, Parameter(negative="")]
DEMO = ("target.pitch=400 um", "beam.pitch=400 um", "turntable.angles=120", "solve.iterations=10")
"""A small boat: the chain counts here, not the part."""
CANCELLED = 130
"""The exit status of a print that somebody stopped, as of any other command."""


@app.command(name="print")
def print_(
    *jobs: str, rig: str, speed: str | None = None, turns: int = 1, stop: float | None = None, out: Path | None = None,
    resume: Path | None = None, settings: Settings = None, device: str | None = None, dry_run: Switch = False,
    panel: Switch = False, host: str = "127.0.0.1", port: int = 0,
) -> int:  # fmt: skip
    """Print jobs on a rig, one for each of its projectors; the word demo makes and prints a small one.

    Args:
        jobs: folders of vials, of webs or of corrected slices, or demo
        rig: the TOML file of the rig, or emulated
        speed: of vials [deg/s], 40 by default, of webs [mm/s] and of slices [mm/h], or with its unit, such as
            "48 mm/min"; by default what the job was made for
        turns: how often each picture of a vial is shown, at most where it stops by itself
        stop: density of scatter at which a vial is done [gray levels/voxel], such as 0.35, by the rig's camera
        out: folder of the run; the job's name with .run by default, with .rehearsal for a dry run
        resume: folder of a run that a host left in the midst, to go on with
        device: that makes the pictures; the best one by default, NumPy for a rehearsal
        dry_run: rehearse on emulated machines and a program's clock, whatever the rig
        panel: serve the live page; a rehearsal then takes as long as a print
        host: where the page is served; a token is wanted beyond this machine
        port: of the page; a free one by default
    """
    from vamgpu.errors import BadInput
    from vamgpu.hosts.rig import plan, stopping
    from vamgpu.hosts.rigs.config import read_rig

    screen, config = console(), read_rig(rig, settings or ())
    if not jobs:
        raise BadInput("no job was given; wanted the folder of a job for each projector, or the word demo")
    if resume is not None and out is not None:
        raise BadInput("--out names the folder of a new run, --resume one to go on with; give one of them")
    if resume is not None and (dry_run or config.wanted.emulated):
        raise BadInput("a rehearsal has no machines that remember a print; wanted --resume with the rig that began it")
    place = resume or _place(out, jobs[0], dry_run)
    folders = tuple(_demo(screen, place.with_suffix(".job")) if job == "demo" else Path(job) for job in jobs)
    if dry_run and not config.wanted.emulated:
        plan(folders, config, speed=speed, turns=turns, device="numpy")  # the rig itself is judged too
    planned = plan(folders, config, speed=speed, turns=turns, rehearsed=dry_run, device=device)
    planned = planned if stop is None else stopping(planned, stop)
    for name, value in planned.lines():
        screen.print(f"  {name:<27} [bold]{escape(value)}[/]")
    if not panel:
        return _printed(screen, planned, place, None, resume is not None)
    from vamgpu.hosts.board import Board
    from vamgpu.hosts.panel import Panel

    board = Board(job=" ".join(jobs))
    with Panel(board, host, port) as page:
        screen.print(f"page    [bold]{escape(page.url)}[/]")
        return _printed(screen, planned, place, board, resume is not None)


@app.command
def panel(
    *jobs: str, rig: str, speed: str | None = None, turns: int = 1, stop: float | None = None, out: Path | None = None,
    resume: Path | None = None, settings: Settings = None, device: str | None = None, dry_run: Switch = False,
    host: str = "127.0.0.1", port: int = 8521,
) -> int:  # fmt: skip
    """Print jobs on a rig with the live page, as ``vam print --panel`` does.

    Args:
        jobs: folders of vials, of webs or of corrected slices, or demo
        rig: the TOML file of the rig, or emulated
        speed: as for ``vam print``
        turns: how often each picture of a vial is shown
        stop: as for ``vam print``
        out: folder of the run
        resume: folder of a run to go on with
        device: as for ``vam print``
        dry_run: rehearse in the time that a print takes, whatever the rig
        host: where the page is served; a token is wanted beyond this machine
        port: of the page
    """
    return print_(
        *jobs, rig=rig, speed=speed, turns=turns, stop=stop, out=out, resume=resume, settings=settings, device=device,
        dry_run=dry_run, panel=True, host=host, port=port,
    )  # fmt: skip


def _place(out: Path | None, job: str, dry_run: bool) -> Path:
    """The folder of a run, which must not exist. Raises `BadInput`, `StorageError`."""
    from vamgpu.errors import BadInput, StorageError

    first = Path("vamgpu-demo" if job == "demo" else job)
    if out is None and not first.name:
        raise BadInput(f"the job {job!r} has no name to call its run by; give the folder of the job, or --out")
    place = out or first.with_suffix(".rehearsal" if dry_run else ".run")
    if place.exists():
        raise StorageError(f"{str(place)!r} exists; a run wants a folder of its own: choose another with --out")
    return place


def _demo(screen: Console, place: Path) -> Path:
    from vamgpu.cli.progress import shown
    from vamgpu.jobs.demo import demo

    with shown(screen) as told:
        return demo(place, DEMO, told=told).folder


def _printed(screen: Console, planned: Plan, place: Path, board: Board | None, resume: bool) -> int:
    """Print, and say what became of it; the exit status."""
    from vamgpu.hosts.record import read_run, timing
    from vamgpu.hosts.rig import carry_out, check, close, may_go_on, opened, rehearsal
    from vamgpu.hosts.state import State

    if resume:
        may_go_on(planned, place)
    stand = rehearsal(planned, paced=board is not None) if planned.rehearsed else None
    machines = opened(planned.rig, camera=planned.stop is not None) if stand is None else stand.machines
    try:
        found = check(planned, machines)
        if found is not None:
            screen.print(f"  {'preflight':<27} [bold]{escape(str(found))}[/]")
        state, _ = carry_out(planned, machines, place, board, found, resume)
    finally:
        close(machines)
    run = read_run(place)
    late = timing(run.shown)["late_ns"]["max"] * 1e-6
    told = f"at the mirrors {-late:.1f} ms early or more" if late < 0 else f"{late:.1f} ms late at most"
    screen.print(f"{state.value}: {len(run.shown)} pictures" + (f", {told}" if len(run.shown) else ""))
    if run.message:
        missed = planned.stop is not None and not any(event["event"] == "enough" for event in run.events)
        screen.print(f"stop    [{'yellow' if missed else 'bold'}]{escape(run.message)}[/]")
    screen.print(f"run     [bold]{escape(str(place))}[/]")
    if stand is not None and len(run.shown):
        lit = run.shown[(run.shown["engine"] == 0) & (run.shown["dark"] == 0)]
        seen = None if planned.stop is None else lit["frame"]
        screen.print(f"resin   {escape(str(stand.witness.verdict(seen)))}")
        _report(screen, planned, stand, place, None if seen is None else -(-len(seen) // planned.schedule.frames))
    return CANCELLED if state is State.CANCELLED else 0


def _report(screen: Console, planned: Plan, stand: Rehearsal, place: Path, turns: int | None) -> None:
    """Prove what emulated resin saw of vials whose folders say what they were to print."""
    from vamgpu.errors import StorageError
    from vamgpu.jobs.run import prove
    from vamgpu.printing.simulate import simulate

    for number, work in enumerate(planned.works if planned.kind == "vial" else ()):
        try:
            known = prove(work.path)
        except StorageError as error:
            screen.print(f"report  none: {escape(str(error))}")
            continue
        proof = simulate(known.proof.operator, stand.seen(planned, number, turns), known.proof.target)
        page = proof.report(place / f"report{f'-{number + 1}' if number else ''}.html", known.plan)
        screen.print(f"report  [bold]{escape(str(page.resolve()))}[/]")
