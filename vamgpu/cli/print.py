"""``vam print`` and ``vam panel``: jobs on real rigs, or in a dry run on emulated ones."""

from __future__ import annotations

import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cyclopts import Parameter
from rich.console import Console
from rich.markup import escape

from vamgpu.cli.commands import app
from vamgpu.cli.options import Settings, Switch, Whole, console, solved_folder
from vamgpu.errors import BadInput, DoseWarning, StorageError, VamError
from vamgpu.quantity import counted

if TYPE_CHECKING:
    import numpy as np

    from vamgpu.hosts.process.live_link import LiveOrder
    from vamgpu.hosts.process.order import PrintOrder
    from vamgpu.hosts.records.state import Board, PrintState
    from vamgpu.hosts.rig import PrintPlan
    from vamgpu.hosts.rigs.config import RigConfig
    from vamgpu.printing.given_dose import ProvedDose

DEMO = ("target.pitch=400 um", "beam.pitch=400 um", "turntable.angles=120", "solve.iterations=10")
"""A small boat: the demo shows the process, not the part."""
LIVE_TURNS = 16  # number of turns in which a watched print gives fresh resin the job's dose
CANCELLED = 130  # exit status of a print that the user stopped, as of any other command
JOBS = (".vam", ".zip", ".sl1", ".sl1s")
"""Endings of jobs that are removed for the names of runs; any other dot, as in "part-0.2", belongs to the name."""
FAILED, INCOMPLETE, HELD = 1, 3, 4
"""Exit statuses of a print that failed, of one that ended with underexposed frames, and of one that is still held."""


@Parameter(name="*")
@dataclass(frozen=True)
class PrintOptions:
    """Options of a print.

    Args:
        speed: speed of vials [deg/s], by default 40 or the fastest below that fits a video cable; of webs [mm/s] and of
            slices [mm/h], by default that of the job; or with a unit, such as "9 rpm" or "48 mm/min"
        turns: number of turns of a vial, or the maximum if the print stops by itself; by default as many as the proved
            exposure needs, with the light dimmed to give the proved dose
        stop: scatter density in the camera's images at which the print of a vial ends [gray levels/voxel], such as 0.35
        out: folder of the run; by default the job's name with .run, or .dry-run for a dry run, then with -2.run, -3.run
        resume: folder of an interrupted run to continue
        unattended: number of times that a held print resumes by itself; by default it asks the operator
        device: device that makes the frames; by default the best one, or NumPy for a dry run
        dry_run: print on emulated machines with a simulated clock, for any rig; with a page in real time
        live: watch a vial with the rig's camera, and replan the remaining patterns after every turn; --turns is then
            the number of turns in which fresh resin gets the job's dose, 16 by default
        anyway: print a job even if its simulation fails; by default, you are asked at a terminal
        mend: repeat frames of a vial that were cut short, in an added turn, if the proved dose and the budget of light
            allow it
        host: address that serves the page; other machines need a token
    """

    speed: str | None = None
    turns: Whole = None
    stop: float | None = None
    out: Path | None = None
    resume: Path | None = None
    unattended: int = 0
    settings: Settings = None
    device: str | None = None
    dry_run: Switch = False
    live: Switch = False
    anyway: Switch = False
    mend: Switch = False
    host: str = "127.0.0.1"


@app.command(name="print")
def print_(
    *jobs: str, rig: str, given: PrintOptions = PrintOptions(), panel: Switch = False, stay: Switch = False,
    port: int = 0,
) -> int:  # fmt: skip
    """Print jobs on a rig, one for each of its projectors. "demo" makes and prints a small job; "demo live" prints one
    that a camera watches, in resin that differs from the plan.

    Exit status: 0, the print is complete; 1, it failed; 3, it is incomplete (some views or part of the exposure are
    missing); 4, it is still held; 130, it was cancelled.

    Args:
        jobs: folders of vials, of webs or of corrected slices, or demo
        rig: the TOML file of the rig, or emulated
        panel: serve the live page; a dry run then takes as long as a print
        stay: serve the page after the print as well, until Ctrl-C
        port: port of the page; by default a free one
    """
    if jobs == ("demo", "live"):
        return _live_demo(rig, given, plain=not panel)
    from vamgpu.cli.progress import recording_board
    from vamgpu.hosts.process.order import PrintOrder
    from vamgpu.hosts.rig import plan, stopping
    from vamgpu.hosts.rigs.config import read_rig
    from vamgpu.jobs.progress import recorded
    from vamgpu.storage.atomic import named

    screen, config = console(), read_rig(rig, given.settings or ())
    _check_options(jobs, rig, config, given, panel, stay)
    place = given.resume or _place(given.out, jobs[0], given.dry_run)
    folders = tuple(
        _demo(screen, place.with_suffix(".job")) if job == "demo" else solved_folder(Path(job), "print") for job in jobs
    )
    with recorded(named(place), "dry run" if given.dry_run else "print") as events:
        board = recording_board(events, " ".join(jobs))
        exposure = planner = None
        if given.live:
            planned, planner, turns = _watching(screen, folders[0], config, given)
        else:
            turns, exposure = (given.turns, None) if given.resume is None else _begun(given.resume, given.turns)
            with warnings.catch_warnings():
                if given.stop is not None:  # its turns are a maximum; the scatter decides on the dose
                    warnings.simplefilter("ignore", DoseWarning)
                planned = plan(folders, config, speed=given.speed, turns=turns, rehearsed=given.dry_run,
                               device=given.device, exposure=exposure)  # fmt: skip
        exposure = False if planned.dose is None else planned.dose.proved
        if given.dry_run and not config.setup.emulated:  # check the rig itself as well
            plan(folders, config, speed=given.speed, turns=turns, device="numpy", exposure=exposure)
        planned = planned if given.stop is None else stopping(planned, given.stop)
        for name, value in planned.lines():
            _show_line(screen, name, value)
        order = PrintOrder.of(
            folders, config, place, speed=given.speed, turns=turns, exposure=exposure, stop=given.stop,
            device=given.device, rehearsed=given.dry_run, resume=given.resume is not None, page=panel,
            unattended=given.unattended, mend=given.mend, asks=sys.stdin.isatty(), live=planner,
        )  # fmt: skip
        if not (planned.rehearsed or order.resume or given.anyway):
            _consented(planned, order.asks)
        with _page(screen, board, given.host, port, place, stay) if panel else nullcontext():
            return _printed(screen, planned, order, board)


@contextmanager
def _page(screen: Console, board: Board, host: str, port: int, place: Path, stay: bool) -> Iterator[None]:
    """Serve the live page of a print, and with ``stay`` until Ctrl-C."""
    from vamgpu.hosts.panel import Panel

    with Panel(board, host, port, runs=place.resolve().parent, run=place.name) as page:
        screen.print(f"page    [bold]{escape(page.url)}[/]")
        with _outlived(screen) if stay else nullcontext():
            yield


def _check_options(
    jobs: tuple[str, ...], rig: str, config: RigConfig, given: PrintOptions, panel: bool, stay: bool
) -> None:
    """Reject options that exclude each other. Raises `BadInput`."""
    if not jobs:
        raise BadInput("there is no job; expected the folder of a job for each projector, or the word demo")
    if given.resume is not None and given.out is not None:
        raise BadInput("--out is the folder of a new run, --resume that of a run to continue; give one of them")
    if given.resume is not None and (given.dry_run or config.setup.emulated):
        raise BadInput("a dry run cannot be resumed; expected --resume with the rig that began the print")
    if "demo" in jobs and config.setup.rig.machine not in ("vial", "any"):
        raise BadInput(f"the demo is a vial, but the rig {rig!r} prints {config.setup.rig.machine}; give a job for it")
    if given.unattended < 0:
        raise BadInput(f"--unattended is {given.unattended}; expected how many times a held print resumes, 0 or more")
    if stay and not panel:
        raise BadInput("--stay serves the page after the print, but there is no page; add --panel, or use vam panel")
    if given.live and (given.stop is not None or given.mend or len(jobs) != 1):
        raise BadInput("a print with --live takes one job, and its planner plans every turn and the end; "
                       "leave out other jobs, --stop and --mend")  # fmt: skip


def _consented(planned: PrintPlan, asks: bool) -> None:
    """Ask before a real print of a job whose simulation fails. Raises `BadInput` unless someone agrees."""
    job, faults = planned.jobs[0].path, planned.faults()
    if not faults:
        return
    if not (asks and _agreed(f"{job} does not print in the simulation: {faults}\nprint it anyway? [y/N]  ")):
        raise BadInput(f"{job!r} does not print in the simulation: {faults}; expected a job that prints: correct it "
                       f"as `vam prove {job}` says, or print it with --anyway")  # fmt: skip


def _agreed(question: str) -> bool:
    """Ask a question at the terminal."""
    try:
        return input(question).strip().lower() in ("y", "yes")
    except EOFError:
        return False


def _begun(run: Path, turns: int | None) -> tuple[int | None, ProvedDose | None]:
    """Turns and exposure of the run to resume; the rest then gets the same dose per turn."""
    from vamgpu.hosts.records.record import read_run
    from vamgpu.printing.given_dose import GivenDose

    asked = read_run(run).asked
    dose, views = GivenDose.read(asked.get("dose")), asked.get("views")
    if turns is None and views and asked.get("kind") == "vial" and (dose is None or dose.asked):
        turns = asked["slots"] // views["frames"]
    return turns, None if dose is None else dose.proved


def _watching(screen: Console, job: Path, config: RigConfig, given: PrintOptions) -> tuple[PrintPlan, LiveOrder, int]:
    """The plan of a print that the camera watches, new or resumed, the order of its planner, and its turns."""
    from vamgpu.hosts.live.cameras import unmeasured
    from vamgpu.hosts.live.live_print import PLACE, watched_plan
    from vamgpu.live import LiveRecord

    turns, longest = LIVE_TURNS if given.turns is None else given.turns, None
    if given.resume is not None:
        setup = LiveRecord(given.resume / PLACE).setup()
        turns, longest = setup.planned, setup.longest
    made = watched_plan(
        job, config, turns=turns, longest=longest, speed=given.speed, rehearsed=given.dry_run, device=given.device
    )
    if note := unmeasured(made.planned):
        screen.print(f"camera  [yellow]{escape(note)}[/]")
    return made.planned, made.order, made.setup.longest


def _live_demo(rig: str, given: PrintOptions, plain: bool) -> int:
    """Print the demo with and without monitoring; show deviations, what was found, and the outcome."""
    from vamgpu.hosts.live.live_print import live

    screen, turns = console(), LIVE_TURNS if given.turns is None else given.turns
    if not plain or replace(given, turns=None, out=None) != PrintOptions():
        raise BadInput("the demo with --live takes --rig, --turns and --out; leave out the rest")
    place = _place(given.out, "demo", False)
    from vamgpu.cli.progress import shown
    from vamgpu.jobs.live_demo import AGED, demo_job
    from vamgpu.live import Truth

    if rig != "emulated":
        raise BadInput(f"the demo's resin is emulated, but the rig is {rig!r}; expected --rig emulated")
    with shown(screen) as progress:
        job = demo_job(place.with_suffix(".job"), progress=progress)
    truth = Truth(**AGED)
    unwatched = live(job, truth=truth, turns=turns, watched=False)
    ended = live(job, truth=truth, turns=turns, folder=place)
    off = ", ".join(f"{name} {value:g}" for name, value in AGED.items())
    screen.print(f"differs {escape(off)}")
    screen.print(f"overlap without monitoring {unwatched.iou:.4f}, with monitoring [bold]{ended.iou:.4f}[/]")
    overlaps = unwatched.iou or 0.0, ended.iou or 0.0
    screen.print(escape(str(ended)))
    _live_report(screen, ended.folder, truth=truth, overlaps=overlaps, conversion=ended.conversion)
    screen.print(f"run     [bold]{escape(str(ended.folder))}[/]")
    return _status(ended.state)


def _live_report(screen: Console, run: Path, **facts: Any) -> None:
    """Write the report of a monitored print, if anything was decided."""
    from vamgpu.hosts.live.live_print import PLACE
    from vamgpu.live import LiveRecord
    from vamgpu.live.report import page

    record = LiveRecord(run / PLACE)
    if record.begun and record.decisions:
        screen.print(f"report  [bold]{escape(str(page(record, **facts).write(run / 'live.html')))}[/]")


@app.command
def panel(
    *jobs: str, rig: str | None = None, given: PrintOptions = PrintOptions(), attach: Path | None = None,
    port: int = 8521,
) -> int:  # fmt: skip
    """Print jobs on a rig and serve the live page until Ctrl-C, or watch a print that is running.

    Args:
        jobs: folders of vials, of webs or of corrected slices, or demo
        rig: the TOML file of the rig, or emulated
        attach: folder of a run that another process is printing; watch it, or stop it
        port: port of the page
    """
    if attach is not None:
        if jobs or rig is not None:
            raise BadInput("--attach watches a print that is running; leave out jobs and --rig")
        return _attached(attach, given.host, port)
    if rig is None:
        raise BadInput("there is no rig; expected --rig with its TOML file or the word emulated")
    return print_(*jobs, rig=rig, given=given, panel=True, stay=True, port=port)


@contextmanager
def _outlived(screen: Console) -> Iterator[None]:
    """Keep the page until Ctrl-C, however the print ends; then raise its error."""
    try:
        yield
    except VamError as error:
        screen.print(f"ended   [red]{escape(str(error))}[/]")
        _wait(screen)
        raise
    _wait(screen)


def _wait(screen: Console) -> None:
    screen.print("the page stays; Ctrl-C closes it")
    with suppress(KeyboardInterrupt):
        threading.Event().wait()


def _place(out: Path | None, job: str, dry_run: bool) -> Path:
    """The folder of a run, which must not exist; by default the first free one. Raises `BadInput`, `StorageError`."""
    first = Path("vamgpu-demo" if job == "demo" else job)
    if out is None and first.name in ("", ".."):
        raise BadInput(f"the job {job!r} has no name for its run; give the folder of the job, or --out")
    name = first.stem if first.suffix in JOBS else first.name
    ending = ".dry-run" if dry_run else ".run"
    names = (name + number + ending for number in chain([""], (f"-{number}" for number in count(2))))
    place = out or next(first.parent / each for each in names if not (first.parent / each).exists())
    if job == "demo" and place.suffix == ".job":
        raise BadInput(f"{str(place)!r} is the folder of the demo's job; end the name of its run in .run")
    if place.exists():
        raise StorageError(f"{str(place)!r} exists; a run needs a new folder: choose another with --out")
    return place


def _demo(screen: Console, place: Path) -> Path:
    from vamgpu.cli.progress import shown
    from vamgpu.jobs.demo import demo

    with shown(screen) as progress:
        return demo(place, DEMO, progress=progress).folder


def _attached(run: Path, host: str, port: int) -> int:
    """Serve the page of a running print, to its end."""
    from vamgpu.hosts.panel import Panel
    from vamgpu.hosts.process.watch import attached, watched
    from vamgpu.hosts.records.state import Board, PrintState

    screen, board = console(), Board(job=run.name)
    with attached(run, board) as watch:
        try:
            watch.viewed(watch.order.planned())
        except VamError as error:
            screen.print(f"images  none: {escape(str(error))}")
        with Panel(board, host, port, runs=run.resolve().parent, run=run.name) as page:
            screen.print(f"page    [bold]{escape(page.url)}[/]")
            asked = _asked(screen) if sys.stdin.isatty() else lambda _: False
            go_on = asked if watch.order.asks and not watch.order.page else None  # otherwise the page asks
            try:
                state = PrintState(watched(watch, lambda name, text: None, go_on)["state"])
            except VamError as error:
                state = _left(error, board, run)
    screen.print(f"{state.value}: [bold]{escape(str(run))}[/]")
    return _status(state)


def _printed(screen: Console, planned: PrintPlan, order: PrintOrder, board: Board) -> int:
    """Print, show the outcome, and return the exit status."""
    from vamgpu.hosts.records.account import account
    from vamgpu.hosts.records.record import read_run, timing
    from vamgpu.hosts.records.state import PrintState
    from vamgpu.hosts.rig import may_go_on

    place = Path(order.folder)
    if order.resume:
        may_go_on(planned, place)
    levels: Sequence[np.ndarray] = ()
    verdict, turns = "", None
    try:
        # a dry run on a simulated clock has no light, and in one process it repeats exactly
        ended = (_rehearsed if planned.rehearsed and not order.page else _watched)(screen, planned, order, board)
        state, verdict, levels = PrintState(ended["state"]), ended.get("resin", ""), ended.get("levels", ())
        turns = ended.get("turns")
    except VamError as error:
        state = _left(error, board, place)
    run = read_run(place)
    late = timing(run.shown)["late_ns"]["max"] * 1e-6
    lateness = f"at the mirrors at least {-late:.1f} ms early" if late < 0 else f"at most {late:.1f} ms late"
    screen.print(f"{state.value}: {counted(len(run.shown), 'frame')}" + (f", {lateness}" if len(run.shown) else ""))
    if (light := account(run)) is not None:
        screen.print(f"views   [{'bold' if light.complete else 'yellow'}]{escape(str(light))}[/]")
    if state is PrintState.HELD:
        screen.print(f"held    {_onward(planned, place)}; {escape(run.message)}")
    elif run.message:
        missed = planned.stop is not None and not any(event["event"] == "enough" for event in run.events)
        screen.print(f"stop    [{'yellow' if missed else 'bold'}]{escape(run.message)}[/]")
    screen.print(f"run     [bold]{escape(str(place))}[/]")
    if verdict:
        screen.print(f"resin   {escape(verdict)}")
    _report(screen, planned, levels, turns, place)
    if order.live is not None:
        _live_report(screen, place)
    return _status(state)


def _onward(planned: PrintPlan, place: Path) -> str:
    """Command that continues a held print, or the reason why it cannot continue."""
    from vamgpu.hosts.rig import may_go_on

    if planned.rehearsed:
        return "a dry run cannot be continued: start it again"
    try:
        may_go_on(planned, place)
    except VamError as error:
        return escape(str(error))
    return f"continue with [bold]--resume {escape(str(place))}[/]"


def _left(error: VamError, board: Board, place: Path) -> PrintState:
    """State of a print that an error left held; shows the error. Raises the error if nothing is held."""
    from vamgpu.hosts.records.record import read_run
    from vamgpu.hosts.records.state import PrintState

    kept = read_run(place).state if (place / "state.json").is_file() else None
    if PrintState.HELD not in (board.now.state, kept):
        raise error
    sys.stderr.write(f"held: {error}\n")
    return PrintState.HELD


def _status(state: PrintState) -> int:
    """The exit status for a state."""
    from vamgpu.hosts.records.state import PrintState

    statuses = {
        PrintState.COMPLETE: 0, PrintState.CANCELLED: CANCELLED, PrintState.INCOMPLETE: INCOMPLETE,
        PrintState.HELD: HELD,
    }  # fmt: skip
    return statuses.get(state, FAILED)


def _rehearsed(screen: Console, planned: PrintPlan, order: PrintOrder, board: Board) -> dict[str, Any]:
    """Do a dry run in this process, as fast as it computes; return how it ended."""
    from vamgpu.hosts.process.order import printed

    asked = _asked(screen) if order.asks else None
    return printed(
        order, planned, order.stand(planned), board,
        told=partial(_show_line, screen), go_on=lambda job: asked is not None and asked(job.states.message),
    )  # fmt: skip


def _watched(screen: Console, planned: PrintPlan, order: PrintOrder, board: Board) -> dict[str, Any]:
    """Print in a process that controls the light, and watch it from this one; return how it ended."""
    from vamgpu.hosts.process.watch import may_begin, started, watched

    may_begin(order.folder)
    with started(order, board) as watch:
        if order.page:
            watch.viewed(planned)
        asked = _asked(screen) if order.asks and not order.page else None
        return watched(watch, partial(_show_line, screen), asked)


def _show_line(screen: Console, name: str, text: str) -> None:
    screen.print(f"  {name:<27} [bold]{escape(text)}[/]")


def _asked(screen: Console) -> Callable[[str], bool]:
    """Show why a print is held, and ask at the terminal whether to continue."""

    def go_on(why: str) -> bool:
        screen.print(f"held    [yellow]{escape(why)}[/]")
        return _agreed("continue? [y/N] ")

    return go_on


def _report(screen: Console, planned: PrintPlan, levels: Sequence[np.ndarray], turns: int | None, place: Path) -> None:
    """Prove vials from the gray levels that emulated resin received."""
    from vamgpu.hosts.records.account import account
    from vamgpu.hosts.records.proof import prove_given, shown_frames
    from vamgpu.hosts.records.record import read_run
    from vamgpu.hosts.rigs.rehearsal import as_frames
    from vamgpu.jobs.run import prove

    dose = planned.dose
    if dose is not None and turns is not None:
        dose = replace(dose, share=dose.share * turns / dose.turns, turns=turns)
    for number, (work, seen) in enumerate(zip(planned.jobs, levels, strict=False)):
        try:
            known = planned.proven or prove(work.path)
        except StorageError as error:
            screen.print(f"report  none: {escape(str(error))}")
            continue
        frames: Any = as_frames(planned, seen, number)
        if work.travel is not None and (light := account(run := read_run(place))) is not None:
            frames = shown_frames(run, light, known.proof, number)
        proof = prove_given(known.proof, frames, dose)
        if proof.given is not None:
            tone = "bold" if proof.given.keeps else "yellow"
            screen.print(f"dose    [{tone}]{escape(str(proof.given))}[/]")
        page = proof.report(place / f"report{f'-{number + 1}' if number else ''}.html", known.plan)
        screen.print(f"report  [bold]{escape(str(page.resolve()))}[/]")
