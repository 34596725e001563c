"""Plans on machines: rehearsed on emulated ones, checked in the dark, and printed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

from vamgpu.errors import BadInput, WrongDevice
from vamgpu.geometry import positive
from vamgpu.hosts.attended import attended
from vamgpu.hosts.board import Board
from vamgpu.hosts.exposure import Watch
from vamgpu.hosts.players.approach import Origin
from vamgpu.hosts.players.cable import CablePictures, VideoMachines
from vamgpu.hosts.players.mirrors import Machines
from vamgpu.hosts.players.player import Player
from vamgpu.hosts.players.spinning import SpinningPlayer
from vamgpu.hosts.players.triggered import TriggeredPlayer
from vamgpu.hosts.record import read_run
from vamgpu.hosts.rigs.config import read_rig
from vamgpu.hosts.rigs.opening import close, opened
from vamgpu.hosts.rigs.planning import Plan, plan
from vamgpu.hosts.rigs.preflight import LINE, Judged, answered, fits, judged
from vamgpu.hosts.rigs.rehearsing import Rehearsal, rehearsal
from vamgpu.hosts.rigs.runs import left_by_a_host, limits, may_go_on, run_folder
from vamgpu.hosts.rigs.stopping import stopping
from vamgpu.hosts.run import Print
from vamgpu.hosts.safety.interlock import InterlockOpen
from vamgpu.hosts.state import State

__all__ = [
    "Plan", "Rehearsal", "carry_out", "check", "close", "limits", "may_go_on", "opened", "plan", "player", "read_rig",
    "rehearsal", "stopping",
]  # fmt: skip


def check(planned: Plan, machines: Machines | VideoMachines, seconds: float = 2.0) -> Judged | None:
    """Judge a plan on opened machines, in the dark; None on a video cable, which has a time of its own.

    seconds: how long the wires are measured, on real machines alone. Raises `BadInput`, `WrongDevice` for other
    machines than planned, and `TimingInfeasible` with what binds.
    """
    seconds = positive("seconds", seconds)
    if isinstance(machines, VideoMachines) or planned.display is not None:
        if not isinstance(machines, VideoMachines) or planned.display is None:
            raise WrongDevice("mirrors behind a trigger and those on a video cable want plans of their own")
        machines.check(planned.schedule, planned.display)
        return None
    if len(machines.mirrors) != len(planned.mirrors):
        raise WrongDevice(
            f"the plan is for {len(planned.mirrors)} mirrors, {len(machines.mirrors)} were opened; open the rig that "
            "it was planned for, or plan for this one"
        )
    for dmd, timing in zip(machines.mirrors, planned.timings, strict=True):
        fits((dmd.height, dmd.width), timing)
    if len(planned.focus) > 1 and machines.lens is None:
        raise WrongDevice("the plan changes its focus, and no lens was opened; open the rig that it was planned for")
    answered(planned.schedule, machines.controller, machines.clock, min(seconds, LINE))
    return judged(planned.schedule, machines.mirrors, machines.clock, bits=planned.bits, seconds=seconds)


def player(
    planned: Plan, machines: Machines | VideoMachines, found: Judged | None = None, origin: Origin | None = None
) -> Player:
    """What plays a plan on its machines. found: by `check`.  origin: see `TriggeredPlayer`."""
    found = found or check(planned, machines)
    if planned.display is not None and isinstance(machines, VideoMachines):
        frames = planned.works[0].frames
        assert frames is not None
        pictures = CablePictures(frames, (planned.mirrors[0].rows, planned.mirrors[0].columns))
        return SpinningPlayer(planned.schedule, planned.display, machines, pictures)
    assert found is not None and isinstance(machines, Machines)
    return TriggeredPlayer(
        planned.schedule, machines, planned.pictures(), depth=found.depth, sequences=found.sequences, origin=origin
    )


def carry_out(
    planned: Plan, machines: Machines | VideoMachines, folder: str | Path, board: Board | None = None,
    found: Judged | None = None, resume: bool = False,
) -> tuple[State, Print]:  # fmt: skip
    """Print a plan into the folder of a run. Raises what went wrong, after it is dark and written down.

    board: of a person who attends, with buttons to pause and go on.  found: by `check`, which is run where it is
    missing.  resume: go on with the print that a host left in the folder.  A plan with a stop is watched.
    """
    _may_watch(planned, machines, resume)
    _shut(machines)
    left = left_by_a_host(planned, machines, folder) if resume else None
    playing = player(planned, machines, found, None if left is None else left.origin)
    if left is not None and isinstance(playing, TriggeredPlayer):
        playing.recall(left.lost)
    with run_folder(planned, folder, left, machines.clock.now()) as record:
        shown, watch = board or Board(), None
        if planned.stop is not None and machines.camera is not None:
            speed = float(planned.schedule.speed)
            watch = Watch(machines.camera, machines.clock, planned.stop, record, lambda: shown.now.position / speed)
        ends: Any = {} if watch is None else {"enough": watch.enough, "short": watch.short}
        job = Print(playing, record, limits=limits(planned.rig), board=shown, **ends)
        if left is not None:
            job.recall(read_run(folder).shown, left.rest)
        with nullcontext() if watch is None else _before_the_light(watch, job):
            first = None if left is None else left.first
            return (job.run(first) if board is None else attended(job, board, first)), job


@contextmanager
def _before_the_light(watch: Watch, job: Print) -> Iterator[None]:
    """A watch whose background was taken in the dark; a print that has none has failed."""
    with watch:
        try:
            job.player.lamp.off()  # whatever a crashed host left
            watch.begin()
        except BaseException as error:
            job.ended(error)
            raise
        yield


def _shut(machines: Machines | VideoMachines) -> None:
    """Raise `InterlockOpen` while the enclosure is; a print that began would have failed, and could not go on."""
    if not machines.controller.status().interlock_closed:
        raise InterlockOpen("the interlock is open: close the enclosure, then print again")


def _may_watch(planned: Plan, machines: Machines | VideoMachines, resume: bool) -> None:
    """Raise `WrongDevice` where the camera of a plan with a stop was not opened, `BadInput` where it comes too late."""
    if planned.stop is None:
        return
    if machines.camera is None:
        raise WrongDevice("the plan stops by what a camera sees, and none was opened; use opened(rig, camera=True)")
    if resume:
        raise BadInput(
            "resin that was lit scatters already, so a print that stops by its scatter cannot be gone on with: begin "
            "it anew with fresh resin"
        )
