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
    from vamgpu.hosts.rig import Plan

Switch = Annotated[bool, Parameter(negative="")]
DEMO = ("target.pitch=400 um", "beam.pitch=400 um", "turntable.angles=120", "solve.iterations=10")
"""A small boat: the chain counts here, not the part."""


@app.command(name="print")
def print_(
    job: str, *, rig: str, speed: float = 40.0, turns: int = 1, out: Path | None = None, settings: Settings = None,
    dry_run: Switch = False, panel: Switch = False, host: str = "127.0.0.1", port: int = 0,
) -> None:  # fmt: skip
    """Print a job folder on a rig; the word demo makes and prints a small one.

    Args:
        job: the folder of a vial's job, or demo
        rig: the TOML file of the rig, or emulated
        speed: of the vial [deg/s]
        turns: how often each picture is shown
        out: folder of the run; the job's name with .run by default
        dry_run: rehearse on emulated machines and a program's clock, whatever the rig
        panel: serve the live page
        host: where the page is served; a token is wanted beyond this machine
        port: of the page; a free one by default
    """
    from vamgpu.hosts.config import read_rig
    from vamgpu.hosts.rig import plan

    screen, config = console(), read_rig(rig, settings or ())
    place = out or Path("vamgpu-demo.run" if job == "demo" else Path(job).with_suffix(".run"))
    folder = _demo(screen, place.with_suffix(".job")) if job == "demo" else Path(job)
    planned = plan(folder, config, speed=speed, turns=turns)
    for name, value in planned.lines():
        screen.print(f"  {name:<27} [bold]{escape(value)}[/]")
    if not panel:
        return _printed(screen, planned, place, dry_run, None)
    from vamgpu.hosts.board import Board
    from vamgpu.hosts.panel import Panel

    board = Board(job=str(job))
    with Panel(board, host, port) as page:
        screen.print(f"page    [bold]{escape(page.url)}[/]")
        _printed(screen, planned, place, dry_run, board)


@app.command
def panel(
    job: str, *, rig: str, speed: float = 40.0, turns: int = 1, out: Path | None = None, host: str = "127.0.0.1",
    port: int = 8521,
) -> None:  # fmt: skip
    """Print a job folder with the live page, as ``vam print --panel`` does.

    Args:
        job: the folder of a vial's job, or demo
        rig: the TOML file of the rig, or emulated
        speed: of the vial [deg/s]
        turns: how often each picture is shown
        out: folder of the run
        host: where the page is served; a token is wanted beyond this machine
        port: of the page
    """
    print_(job, rig=rig, speed=speed, turns=turns, out=out, panel=True, host=host, port=port)


def _demo(screen: Console, place: Path) -> Path:
    from vamgpu.cli.progress import shown
    from vamgpu.jobs.demo import demo

    with shown(screen) as told:
        return demo(place, DEMO, told=told).folder


def _printed(screen: Console, planned: Plan, place: Path, dry: bool, board: Board | None) -> None:
    from vamgpu.hosts.record import read_run, timing
    from vamgpu.hosts.rig import carry_out, check, opened, rehearsal

    emulated = dry or planned.rig.wanted.emulated
    machines, bench = rehearsal(planned) if emulated else (opened(planned.rig), None)
    try:
        checked = check(planned, machines)
        screen.print(f"  {'preflight':<27} [bold]{escape(str(checked))}[/]")
        state, _ = carry_out(planned, machines, place, board, checked.depth)
    finally:
        machines.controller.close()
    run = read_run(place)
    early = -timing(run.shown)["late_ns"]["max"] * 1e-6
    screen.print(f"{state.value}: {len(run.shown)} pictures, at the mirrors {early:.1f} ms early or more")
    screen.print(f"run     [bold]{escape(str(place))}[/]")
    if bench is not None:
        _report(screen, planned, bench, place)


def _report(screen: Console, planned: Plan, bench: object, place: Path) -> None:
    """Prove what emulated resin saw."""
    from vamgpu.hosts.rig import seen
    from vamgpu.jobs.run import prove
    from vamgpu.printing.simulate import simulate

    known = prove(planned.job)
    proof = simulate(known.proof.operator, seen(planned, bench), known.proof.target)
    page = proof.report(place / "report.html", known.plan)
    screen.print(f"report  [bold]{escape(str(page.resolve()))}[/]")

