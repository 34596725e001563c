"""The command ``vam prove``."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter
from rich.markup import escape

from vamgpu.cli.commands import app
from vamgpu.cli.options import Overwrite, Switch, console, solved_folder
from vamgpu.cli.show import report_memory, show_rows, show_verdict, show_web, shown_path
from vamgpu.errors import BadInput

if TYPE_CHECKING:
    from vamgpu.jobs.run import Proven
    from vamgpu.methods.tolerances import Corner

NOT_PRINTED = 3  # exit status of ``vam prove --check`` if the frames do not print the part


@app.command
def prove(
    job: Path, /, *, report: Path | None = None, device: str | None = None,
    bound: Switch = False, tolerances: Switch = False, slices: tuple[int, int] | None = None,
    printed: Annotated[list[Path] | None, Parameter(name="--job", negative="")] = None, memory: str | None = None,
    rig: str | None = None, speed: str | None = None, check: Switch = False,
    save: Path | None = None, off: Annotated[list[str] | None, Parameter(negative="")] = None,
    overwrite: Overwrite = False,
) -> int:  # fmt: skip
    """Simulate a job from its frames only, or a run from the frames that it really showed, and write a report.

    Args:
        job: the job folder, or the folder of a vial's run
        report: the HTML file; by default part.html for part.vam, part-off.html with --off, part.run.html for part.run,
            and none for --save with --off
        device: where to compute; the best device here by default
        bound: also bound the window of any patterns, with 1500 projector evaluations; with --tolerances, at all corners
        tolerances: also prove the job at every corner of its [tolerances], with one threshold for all
        slices: first slice, and the one after the last, used for --bound; fewer slices are faster, and their bound
            holds for the whole print
        printed: new folder of a job that was moved after the run; one for each job that was moved
        memory: memory limit of the proof, such as 8GB; fields beyond it are kept in files in the folder TMPDIR, and a
            report that needs more is skipped
        rig: TOML file of a rig, or emulated: also expose each bit plane of a vial at the angles where it is shown
        speed: speed of the rig [deg/s], or with a unit; by default that of vam print
        check: exit with 3 if the part does not print
        save: folder for the proof: its dose and all its numbers
        off: an error of the machine, such as axis="20 um", spread="30 um", absorption="5 %" or dose="-5 %"; repeat
            the option for several
    """
    from vamgpu.backend import within
    from vamgpu.jobs.web import is_web_folder
    from vamgpu.storage.atomic import check_folder, named, page_path

    job = solved_folder(job, "prove")
    device = device if memory is None else within(device, memory)
    is_run, is_web = (job / "run.json").is_file(), is_web_folder(job)
    # the report of a run is beside that of its job
    usual = job.with_name(f"{job.name if is_run else job.stem}{'' if off is None else '-off'}.html")
    place = page_path(report or usual)
    given = {"--bound": bound, "--tolerances": tolerances, "--rig": rig, "--save": save, "--off": off}
    _check_options(job, given, slices, speed, vial=not (is_run or is_web))
    if report is not None:
        check_folder(place)
    if is_run:
        return _checked(_prove_run(job, place, device, printed or ()), check)
    if printed:
        raise BadInput(f"--job gives the folders of a run's jobs, but {str(job)!r} is not a run; leave it out")
    if is_web:
        if check:
            raise BadInput(f"--check is for the job of a vial or of a run, but {str(job)!r} is a web; leave it out")
        _prove_web(job, place, device)
        return 0
    settings = {"evaluations": 1500.0 if bound else 0.0, "tolerances": tolerances, "slices": slices}
    settings["off"] = None if off is None else _errors(off)
    page = None if report is None and save is not None and off is not None else place
    return _prove_vial(job, page, device, settings, rig, speed, memory, None if save is None else named(save),
                       check=check, overwrite=overwrite)  # fmt: skip


def _prove_vial(
    job: Path, place: Path | None, device: str | None, settings: dict[str, Any], rig: str | None, speed: str | None,
    memory: str | None, save: Path | None, *, check: bool, overwrite: bool,
) -> int:  # fmt: skip
    """Simulate the job of a vial, show and store what was found, and return the exit status."""
    from vamgpu.cli.progress import shown
    from vamgpu.jobs.progress import recorded
    from vamgpu.jobs.run import prove as run
    from vamgpu.storage.folder import check_place
    from vamgpu.storage.memory import size

    if save is not None:
        check_place(save, overwrite=overwrite)
    screen = console()
    with nullcontext() if save is None else recorded(save, "prove") as events, shown(screen, events) as progress:
        proven = run(job, device, **settings, progress=progress)
        if rig is not None:
            progress("planes", 0.0)
            proven = _by_planes(proven, job, rig, speed)
        needs = 0 if place is None else report_memory(memory, proven.proof)
        if not needs and place is not None:
            progress("report", 0.0)
            proven.report(place)
        if save is not None:
            progress("folder", 0.0)
            proven.proof.save(save, overwrite=overwrite)
            if events is not None:
                events.verdict(proven.proof.verdict.prints, proven.proof.verdict.sentence)
    if check or not needs:
        show_verdict(screen, proven.proof.verdict)
    show_rows(screen, proven.proof.lines())
    if needs:
        screen.print(f"[yellow]note[/]  no report: it needs {size(needs)} of memory; leave out --memory to get it")
    else:
        show_rows(screen, proven.proof.judgement.lines())
        if place is not None:
            screen.print(f"report  [bold]{shown_path(place.resolve())}[/]")
    return _checked(not check or proven.proof.all_correct, check)


def _errors(off: Sequence[str]) -> Corner:
    """The errors of a machine from texts such as axis="20 um". Raises `BadInput`."""
    from vamgpu.methods.tolerances import Corner
    from vamgpu.schema.quantities import Place, Quantity, Thickness, measured

    share = Annotated[float, Quantity("a share", above=-1.0)]
    kinds: dict[str, Any] = {"axis": Place, "spread": Thickness, "absorption": share, "dose": share}
    given: dict[str, Any] = {}
    for text in off:
        name, _, amount = text.partition("=")
        if name not in kinds:
            raise BadInput(f'--off is {text!r}; expected one of {", ".join(kinds)} with an amount: axis="20 um"')
        given[name] = measured(f"--off {name}", amount.strip(' "'), kinds[name])
    return Corner(**given)


def _check_options(
    job: Path, given: dict[str, Any], slices: tuple[int, int] | None, speed: str | None, *, vial: bool
) -> None:
    """Reject options that exclude each other, or do not suit the job. Raises `BadInput`."""
    if (option := next((name for name, value in given.items() if value), None)) is not None and not vial:
        raise BadInput(f"{option} is for the job of a vial, but {str(job)!r} is not one; leave it out")
    if slices is not None and not given["--bound"]:
        raise BadInput(f"--slices {slices[0]} {slices[1]} is only for --bound; add --bound, or leave out --slices")
    if given["--rig"] is None and speed is not None:
        raise BadInput(f"--speed {speed} is for a rig, but there is none; add --rig, or leave out --speed")


def _checked(prints: bool, check: bool) -> int:
    return NOT_PRINTED if check and not prints else 0


def _by_planes(proven: Proven, job: Path, rig: str, speed: str | None) -> Proven:
    """A proof that includes the bit planes of a rig."""
    from vamgpu.hosts.rig import plan
    from vamgpu.hosts.rigs.config import read_rig
    from vamgpu.hosts.schedules.schedule import plane_times
    from vamgpu.printing.planes import prove_planes

    travel = getattr(getattr(proven.proof.operator, "motion", None), "travel", None)
    turns = 1 if travel is None else travel.turns
    planned = plan((job,), read_rig(rig, ()), speed=speed, turns=turns, device="numpy", exposure=False)
    times = plane_times(planned.schedule, planned.bits, planned.display)
    return replace(proven, proof=replace(proven.proof, planes=prove_planes(proven.proof, times)))


def _prove_run(run: Path, place: Path, device: str | None, printed: Sequence[Path]) -> bool:
    """Compare a run with its plan; return whether the part prints, with and without uncertain light."""
    from vamgpu.hosts.records.proof import prove_run

    screen, prints = console(), True
    for number, found in enumerate(prove_run(run, device, printed)):
        page = place.with_stem(f"{place.stem}-{number + 1}") if number else place
        found.least.report(page, found.planned.plan)
        proofs = (found.planned.proof, found.least, found.most)
        screen.print(f"run     {found.run.state.value}: {found.light}")
        screen.print(f"print   {escape(found.least.verdict.sentence)}")
        prints = prints and found.least.all_correct and found.most.all_correct
        for name, value in (("window", lambda proof: proof.scores.window), ("IoU", lambda proof: proof.scores.iou)):
            planned, least, most = (f"{value(proof):+.4f}" for proof in proofs)
            band = least if least == most else f"{least} to {most}, because some of the light is uncertain"
            screen.print(f"{name:<7} planned {planned}, shown [bold]{band}[/]")
        screen.print(f"report  [bold]{shown_path(page.resolve())}[/]")
    return prints


def _prove_web(job: Path, report: Path, device: str | None) -> None:
    from vamgpu.cli.progress import shown
    from vamgpu.jobs.progress import recorded
    from vamgpu.storage.atomic import named
    from vamgpu.webs.proof import prove_web

    screen = console()
    with recorded(named(report), "prove") as events, shown(screen, events) as progress:
        progress("proof", 0.0)
        proof = prove_web(job, device)
        progress("report", 0.0)
        page = proof.report(report)
        events.verdict(*proof.verdict)
    show_web(screen, proof)
    screen.print(f"report  [bold]{shown_path(page.resolve())}[/]")
