"""Plans on machines: rehearsed on emulated ones, checked in the dark, and printed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vamgpu.errors import BadInput, WrongDevice
from vamgpu.geometry import positive
from vamgpu.hosts.attended import attended
from vamgpu.hosts.board import Board
from vamgpu.hosts.exposure import Watch
from vamgpu.hosts.players.cable import CablePictures, VideoMachines
from vamgpu.hosts.players.mirrors import Machines
from vamgpu.hosts.players.player import Player
from vamgpu.hosts.players.spinning import SpinningPlayer
from vamgpu.hosts.players.triggered import TriggeredPlayer
from vamgpu.hosts.record import Run, RunFolder, read_run
from vamgpu.hosts.rigs.config import RigConfig, parse_rig, read_rig
from vamgpu.hosts.rigs.motor import emulated_microsteps
from vamgpu.hosts.rigs.opening import close, opened
from vamgpu.hosts.rigs.planning import Plan, plan
from vamgpu.hosts.rigs.preflight import LINE, Judged, answered, fits, judged
from vamgpu.hosts.rigs.stopping import stopping
from vamgpu.hosts.run import Limits, Print
from vamgpu.hosts.schedules.limits import HdmiTiming
from vamgpu.hosts.state import State
from vamgpu.printing.frames import Frames
from vamgpu.storage.atomic import explained

if TYPE_CHECKING:
    from vamgpu.hosts.resume import Interrupted

__all__ = [
    "Plan", "Rehearsal", "carry_out", "check", "close", "limits", "opened", "plan", "player", "read_rig", "rehearsal",
    "stopping",
]  # fmt: skip


AGAIN = {"rig": True, "safety": True, "camera": True, "camera_stage": True, "photodiode": True} | dict.fromkeys(
    ("controller", "lens", "stage"), {"port"}
)
"""What of a rig's file may change before a print goes on."""


def limits(rig: RigConfig) -> Limits:
    """What the rig's file says of safety."""
    said = rig.wanted.safety
    return Limits(round(said.lease * 1e9), said.tolerance, said.budget, round(said.resume * 1e9))


@dataclass(frozen=True, eq=False)
class Rehearsal:
    """Emulated machines, and the bench they stand on. witness: compares what resin sees with the pictures."""

    machines: Machines | VideoMachines
    bench: Any
    witness: Any

    def seen(self, planned: Plan, engine: int = 0, turns: int | None = None) -> Frames:
        """What resin saw of a vial's frames, as frames: levels that give the same light, which a proof can judge.

        turns: that were begun, which levels are told by; by default all that were planned.
        """
        frames, table = planned.works[engine].frames, planned.schedule
        if frames is None:
            raise BadInput(f"{planned.works[engine].path!r} is no vial's job; ask the witness what resin saw of it")
        images, rows, columns = frames.shape
        light = self.bench.chamber.seconds(engine, images, turn=images)[0]
        down, across = planned.mirrors[engine].place(rows, columns)
        turns = turns or len(table) // images
        share = light[:, down, across] / (turns * (int(table.on[0]) // 1000) * 1e-6)
        levels = np.rint(share * (255 if frames.bits == 8 else 1)).astype(np.uint8)
        bytes_ = levels if frames.bits == 8 else np.packbits(levels, axis=-1)
        return Frames.from_bytes(
            bytes_, "numpy", bits=frames.bits, gray=frames.gray, scale=frames.scale, columns=columns,
            settings=frames.settings, flat_field=frames.flat_field,
        )  # fmt: skip


def rehearsal(planned: Plan, paced: bool = False) -> Rehearsal:
    """Emulated machines as large as a plan. paced: in step with real time, for those who watch."""
    from vamgpu.hosts.emulators.clock import PacedClock, VirtualClock
    from vamgpu.hosts.emulators.resin import resin_camera
    from vamgpu.hosts.emulators.witness import Witness

    clock = PacedClock() if paced else VirtualClock()
    bench, machines = _bench(planned, clock) if planned.display is None else _booth(planned, planned.display, clock)
    pictures: Any = [each.pictures(mirrors) for each, mirrors in zip(planned.works, planned.mirrors, strict=True)]
    planes = max(1, len(planned.works[0].depths))
    witness = Witness(bench.chamber, planned.schedule, pictures, planned.mirrors[0], planes)
    bench.clock.attach(witness)
    if planned.kind == "vial":
        bench.chamber.turn = planned.schedule.frames
    if planned.stop is not None:
        machines.camera = resin_camera(bench.chamber, bench.clock, planned.stop.exposure, planned.stop.bits)
    return Rehearsal(machines, bench, witness)


def _bench(planned: Plan, clock: Any) -> tuple[Any, Machines]:
    from vamgpu.hosts.emulators.array import ArrayModel
    from vamgpu.hosts.emulators.bench import Bench

    size, lens = planned.mirrors[0], planned.rig.wanted.lens
    model = ArrayModel(height=size.rows, width=size.columns)
    steps = emulated_microsteps(planned.schedule)
    bench = Bench(steps, model, len(planned.works), planned.focus, clock)
    if bench.lens is not None and lens is not None:
        bench.lens.model = replace(bench.lens.model, least=lens.lowest, greatest=lens.highest)
    return bench, bench.machines(steps / float(planned.schedule.advance))


def _booth(planned: Plan, display: HdmiTiming, clock: Any) -> tuple[Any, VideoMachines]:
    from vamgpu.hosts.emulators.booth import Booth

    columns, rows = display.pixels
    booth = Booth(
        planned.schedule.frames, (rows, columns), bits=display.bits, latency=display.latency,
        rate_hz=round(float(display.refresh)), clock=clock,
    )  # fmt: skip
    return booth, booth.machines(display.latency)


# ---- prints --------------------------------------------------------------------------------------------------
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
    planned: Plan, machines: Machines | VideoMachines, found: Judged | None = None, origin: float | None = None
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
    left = _left(planned, machines, folder) if resume else None
    playing = player(planned, machines, found, None if left is None else left.origin)
    if left is not None and isinstance(playing, TriggeredPlayer):
        playing.recall(left.lost)
    with _folder(planned, folder, left) as record:
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


def _asked(planned: Plan) -> dict[str, Any]:
    table, jobs = planned.schedule, [each.path for each in planned.works]
    return {
        "jobs": jobs, "digests": [_digest(Path(job)) for job in jobs], "kind": planned.kind, "rig": planned.rig.source,
        "slots": len(table), "unit": table.unit, "speed": float(table.speed),
        "stop": None if planned.stop is None else planned.stop.threshold, "settings": planned.rig.settings,
    }  # fmt: skip


def _digest(job: Path) -> str:
    """Of what a job's folder says of its frames; of the names and sizes of slices."""
    manifest = job / "manifest.json"
    if manifest.is_file():
        return sha256(manifest.read_bytes()).hexdigest()
    files = sorted((file.name, file.stat().st_size) for file in job.iterdir()) if job.is_dir() else []
    return sha256(repr(files or job.name).encode()).hexdigest()


def _left(planned: Plan, machines: Machines | VideoMachines, folder: str | Path) -> Interrupted:
    """What a host left in a folder, of the same print. Raises `BadInput`, `StorageError`."""
    from vamgpu.hosts.resume import interrupted

    if isinstance(machines, VideoMachines):
        raise BadInput(
            "a video projector went on with its last picture while the vial turned, until the lease was over: this "
            "print cannot be gone on with; begin it anew with fresh resin"
        )
    before = read_run(folder)
    _same_rig(planned.rig, before)
    asked, wanted = before.asked, _asked(planned)
    names = ("digests", "kind", "slots", "speed", "stop")
    if different := [name for name in names if name in asked and asked[name] != wanted[name]]:
        told = ", ".join(f"{name} {asked.get(name)!r} in place of {wanted[name]!r}" for name in different)
        raise BadInput(f"{str(folder)!r} is another print, with {told}; give its own jobs and speed")
    return interrupted(folder, machines.controller, planned.schedule, limits(planned.rig))


def _same_rig(rig: RigConfig, run: Run) -> None:
    """Raise `BadInput` for a rig whose light or motion is another than the one that began a print."""
    file = run.path / "rig.toml"
    try:
        first = parse_rig(file.read_text(encoding="utf-8"), run.asked.get("settings", ()), source=str(file))
    except OSError as error:
        raise explained("read", file, error) from error
    began, now = (read.wanted.model_dump(exclude=AGAIN) for read in (first, rig))
    if different := [name for name in now if now[name] != began[name]]:
        raise BadInput(
            f"the rig has other values in [{'], ['.join(different)}] than the one that began {str(run.path)!r}: the "
            "rest would get another light; print with those of its own rig.toml"
        )


def _folder(planned: Plan, folder: str | Path, left: Interrupted | None) -> RunFolder:
    if left is None:
        return RunFolder.begin(folder, _asked(planned), planned.rig.text)
    record = RunFolder.again(folder)
    left.take_up(record, planned.schedule)
    return record
