"""Plans on machines: checked in the dark, and printed."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.errors import BadInput, JobError, StorageError, WrongDevice
from vamgpu.geometry import positive
from vamgpu.hosts.frames.versions import FrameVersions
from vamgpu.hosts.player.controller_mirrors import TriggeredPlayer
from vamgpu.hosts.player.exposure import ScatterWatch, StopRule
from vamgpu.hosts.player.height import MovingPlayer
from vamgpu.hosts.player.machines import (
    Machines,
    SourceFrames,
    StageMachines,
    VideoMachines,
    inspect,
    senses,
    within_travel,
)  # fmt: skip
from vamgpu.hosts.player.motor import Origin
from vamgpu.hosts.player.operator import attended, print_with_operator
from vamgpu.hosts.player.player import Player
from vamgpu.hosts.player.run import Print
from vamgpu.hosts.player.stage_mirrors import StageClockedPlayer
from vamgpu.hosts.player.video import SpinningPlayer
from vamgpu.hosts.process.live_camera import LiveCamera
from vamgpu.hosts.process.live_link import LiveLink, LiveOrder, task_of
from vamgpu.hosts.process.resume import Interrupted, left_by_a_host, limits, run_folder
from vamgpu.hosts.process.versions import boundary, planned_versions, restored
from vamgpu.hosts.records.plans import swaps
from vamgpu.hosts.records.record import RunFolder, read_run
from vamgpu.hosts.records.state import Board, PrintState
from vamgpu.hosts.rigs.planning import PrintPlan
from vamgpu.hosts.rigs.preflight import LINE, Judged, answered, fits, judged
from vamgpu.hosts.safety.interlock import InterlockOpen
from vamgpu.printing.scatter import STOP
from vamgpu.storage.folder import Folder

log: logging.Logger = logging.getLogger(__name__)


def check(planned: PrintPlan, machines: Machines, seconds: float = 2.0, *, live: bool = False) -> Judged | None:
    """Check a plan on opened machines, in the dark.

    Args:
        planned: The plan, from `plan`.
        machines: Its machines, from `opened` or `rehearsal`.
        seconds: Time for measuring the transfer rates of real machines [s].
        live: Whether frames may be replaced while they are printed, so that the wire must carry new ones in time.

    Returns:
        The findings, with the depth and number of sequences for the player; None for a rig on a video cable, whose
        frames need no upload.

    Raises:
        BadInput: The schedule cannot be shown by these machines.
        WrongDevice: The machines are not those that the plan is for.
        TimingInfeasible: A machine is too slow; the message names it, and its greatest speed.
    """
    seconds = positive("seconds", seconds)
    within_travel(planned.schedule, machines)
    if isinstance(machines, VideoMachines) or planned.display is not None:
        if not isinstance(machines, VideoMachines) or planned.display is None:
            raise WrongDevice(
                "the plan and the machines differ: only one of them is for a video cable; expected the same rig"
            )
        machines.check(planned.schedule, planned.display)
        return None
    if len(machines.mirrors) != len(planned.mirrors):
        raise WrongDevice(
            f"the plan is for {len(planned.mirrors)} mirrors, {len(machines.mirrors)} were opened; open the rig of "
            "the plan, or plan for this one"
        )
    for dmd, mirrors in zip(machines.mirrors, planned.mirrors, strict=True):
        fits((dmd.height, dmd.width), mirrors.rows, mirrors.columns)
    if len(planned.focus) > 1 and machines.lens is None:
        raise WrongDevice("the plan changes its focus, but no lens was opened; open the rig of the plan")
    if not isinstance(machines, StageMachines):
        answered(planned.schedule, machines.controller, machines.clock, min(seconds, LINE))
    return judged(planned.schedule, machines.mirrors, machines.clock, bits=planned.bits, seconds=seconds,
                  live=boundary(planned) if live else None)  # fmt: skip


def player(
    planned: PrintPlan, machines: Machines, found: Judged | None = None, origin: Origin | None = None,
    versions: FrameVersions | None = None,
) -> Player:  # fmt: skip
    """The player of a plan on its machines.

    Args:
        planned: The plan.
        machines: Its opened machines.
        found: Result of `check`; None runs it.
        origin: Position of pose 0 on the motor, for a resumed print; None sets it.
        versions: Versions of the frames, from `vamgpu.hosts.process.versions.planned_versions`; None if frames stay.

    Returns:
        A `TriggeredPlayer` for mirrors that a controller triggers, a `StageClockedPlayer` if a stage does, a
        `SpinningPlayer` for a video cable.

    Raises:
        BadInput, WrongDevice, TimingInfeasible: See `check`.
    """
    found = found or check(planned, machines, live=versions is not None)
    if planned.display is not None and isinstance(machines, VideoMachines):
        sources = planned.sources() if versions is None else versions.sources
        shown = SourceFrames(sources[0], (planned.mirrors[0].rows, planned.mirrors[0].columns))
        return SpinningPlayer(planned.schedule, planned.display, machines, shown, versions=versions)
    assert found is not None and not isinstance(machines, VideoMachines)
    sizes: dict[str, Any] = {"depth": found.depth, "sequences": found.sequences, "versions": versions}
    if isinstance(machines, StageMachines):
        return StageClockedPlayer(planned.schedule, machines, planned.sources(), **sizes)
    return TriggeredPlayer(planned.schedule, machines, planned.sources(), turn=found.turn, origin=origin, **sizes)


def carry_out(
    planned: PrintPlan, machines: Machines, folder: str | Path, board: Board | None = None,
    found: Judged | None = None, resume: bool = False, *, unattended: int = 0,
    go_on: Callable[[Print], bool] | None = None, process: Mapping[str, str] | None = None,
    live: LiveOrder | None = None, mend: bool = False,
) -> tuple[PrintState, Print]:  # fmt: skip
    """Print a plan and record it in a run folder.

    Args:
        planned: The plan. If it has a stop, a camera watches the resin and ends the print.
        machines: Its opened machines.
        folder: The run folder. It must not exist, unless ``resume`` is set.
        board: Shows the print to an operator and offers buttons to pause, resume and cancel; None offers none.
        found: Result of `check`; None runs it.
        resume: Resume the print that a host left in the folder.
        unattended: How often a held print continues without asking.
        go_on: Returns whether a held print continues; None asks at the board, and never continues without one.
        process: Priority of this process from the system, for the record.
        live: Planner of the frames of coming turns or segments, in a separate process, and the light that it may add.
        mend: Show frames of a vial whose light is in doubt again, where the proved dose and the budget of light allow.

    Returns:
        The state at the end, and the print with its record.

    Raises:
        InterlockOpen: The enclosure is open, or the light had to go off.
        BadInput: The print cannot be resumed, or it is live and prints slices.
        WrongDevice: The plan has a stop, and no camera was opened.
        StorageError: The folder exists, or cannot be written.
        VamError: Another error ended or holds the print: it is dark and recorded; the folder's state shows if it can
            continue.
    """
    _may_begin(planned, machines, resume)
    left = left_by_a_host(planned, machines, folder) if resume else None
    versions = _versions(planned, live, left)
    playing = player(planned, machines, found, None if left is None else left.origin, versions)
    if left is not None and isinstance(playing, TriggeredPlayer):
        playing.restore(left.lost)  # frames that the earlier host missed
    path, row = planned.jobs[0].travel, planned.jobs[0].row
    shows: Any = playing if path is None else MovingPlayer(playing, machines, path, row)
    if lacking := planned.guarantees.lacking:
        log.warning("not guaranteed: %s", ", ".join(f"{one.about} ({one.kind})" for one in lacking))
    with ExitStack() as held:
        now, at = machines.clock.now(), None if versions is None else versions.at
        record = held.enter_context(run_folder(planned, folder, left, now, at))
        if process is not None:
            record.event("process", now, **process)
        shown = board or Board()
        shown.show(rehearsed=planned.rehearsed, guarantees=tuple(one.record() for one in planned.guarantees))
        watch = _scatter_watch(planned, machines, record, shown)
        ends: Any = {} if watch is None else {name: getattr(watch, name) for name in ("enough", "short", "recover")}
        if live is not None and versions is not None:
            ends["live"] = _linked(held, live, planned, machines, record, versions, shown, images=watch is None)
        ends |= {"senses": partial(senses, machines), "watch": partial(inspect, machines)}
        job = Print(shows, record, limits=limits(planned.rig), board=shown, mend=mend, dose=planned.dose, **ends)
        if left is not None:
            job.restore((run := read_run(folder)).shown, left.pause)
            shown.show(doubt=run.doubt)
        first, asked = None if left is None else left.first, None if go_on is None else partial(go_on, job)
        with nullcontext() if watch is None else _before_the_light(watch, job):
            if board is not None:
                return print_with_operator(job, board, first, unattended, asked), job
            return attended(job, first, asked, unattended), job


def _versions(planned: PrintPlan, live: LiveOrder | None, left: Interrupted | None) -> FrameVersions | None:
    """Versions of the frames, with those of an earlier host; None if frames stay."""
    if live is None and (left is None or not swaps(left.run)):
        return None
    versions = planned_versions(planned, 0.0 if live is None else live.allowance)
    if live is not None:
        versions.stop = live.stop
    if left is not None:
        restored(versions, planned, left.run, left.first, left.lost)
    return versions


def _scatter_watch(planned: PrintPlan, machines: Machines, record: RunFolder, board: Board) -> ScatterWatch | None:
    """The camera's watch of a plan with a stop."""
    if planned.stop is None or machines.camera is None:
        return None
    speed = float(planned.schedule.speed)
    lit = lambda: board.now.position / speed  # noqa: E731
    return ScatterWatch(machines.camera, machines.clock, planned.stop, record, lit, board=board)


def _linked(
    held: ExitStack, live: LiveOrder, planned: PrintPlan, machines: Machines, record: RunFolder,
    versions: FrameVersions, board: Board, *, images: bool,
) -> LiveLink:  # fmt: skip
    """The planning process and its camera, held until the print ends."""
    camera = None
    if machines.camera is not None and images:
        speed, section = float(planned.schedule.speed), planned.rig.setup.camera
        exposure = 0.01 if section is None else section.exposure
        lit = lambda: board.now.light  # noqa: E731
        camera = held.enter_context(LiveCamera(machines.camera, machines.clock, lit, speed, exposure=exposure))
    task = task_of(planned, record.path)
    return held.enter_context(LiveLink(live, task, planned, versions, machines.clock, board, camera))


def stopping(planned: PrintPlan, threshold: float = STOP) -> PrintPlan:
    """Add a stop to the plan of a vial: the print ends when the resin scatters enough, at the latest after its turns.

    Args:
        planned: The plan; its turns are the maximum.
        threshold: Scatter density at which to stop [gray levels/voxel], in levels of the rig's camera and voxels of
            the first job's part.

    Returns:
        The plan with its stop.

    Raises:
        BadInput: The plan is not for a vial, or the threshold is not above 0.
        JobError: The rig has no camera.
        StorageError: The job's folder does not contain its part.
    """
    positive("threshold of scatter [gray levels/voxel]", threshold)
    if planned.kind != "vial":
        raise BadInput("only vials stop by scatter, because their whole part gels at once; print without a stop")
    rig = planned.rig.setup
    if rig.camera is None:
        raise JobError(
            f'the rig {rig.rig.name!r} has no [[feedback]] with driver = "camera", which measures the scatter of the '
            "resin; add it to the rig's file, or print without a stop"
        )
    camera = rig.camera
    stop = StopRule(float(threshold), _voxels(planned.jobs[0].path), camera.bits, camera.exposure, camera.discard)
    return replace(planned, stop=stop)


def _voxels(path: str) -> float:
    """Voxels of a job's part: the sum of its fractions."""
    folder = Folder.open(path)
    if "target" not in folder.manifest.arrays:
        raise StorageError(
            f"{path!r} lacks its part, whose voxels scale the scatter; write it with `vam solve`, or print "
            "without a stop"
        )
    return float(folder.array("target").sum(dtype=np.float64))


@contextmanager
def _before_the_light(watch: ScatterWatch, job: Print) -> Iterator[None]:
    """A watch with its background taken in the dark; without one the print fails."""
    with watch:
        try:
            job.player.lamp.off()  # for any state that a crashed host left
            watch.begin()
        except BaseException as error:
            job.ended(error)
            raise
        yield


def _may_begin(planned: PrintPlan, machines: Machines, resume: bool) -> None:
    """Raise `WrongDevice` for a stop without a camera, `BadInput` for a stop that is too late, `InterlockOpen`."""
    if planned.stop is not None and machines.camera is None:
        raise WrongDevice("the plan stops by a camera, but none was opened; use opened(rig, camera=True)")
    if planned.stop is not None and resume:
        raise BadInput(
            "lit resin already scatters; a print with a stop therefore cannot be resumed: start again with fresh resin"
        )
    if machines.controller is not None and not machines.controller.status().interlock_closed:
        raise InterlockOpen("the interlock is open: close the enclosure, then print again")
