"""Resume the print of a dead host: the same jobs on the same rig, from its folder and its controller."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vamgpu.errors import BadInput
from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.player.machines import Machines, MirrorMachines
from vamgpu.hosts.player.motor import Origin
from vamgpu.hosts.player.run import SafetyLimits, may_resume
from vamgpu.hosts.records.account import views_asked
from vamgpu.hosts.records.record import FrameRecord, RunFolder, RunRecord, digest, read_run
from vamgpu.hosts.records.state import PrintState
from vamgpu.hosts.rigs.config import RigConfig, RigFile, parse_rig
from vamgpu.hosts.rigs.guarantees import driver_of
from vamgpu.hosts.rigs.planning import PrintPlan
from vamgpu.hosts.schedules.schedule import Schedule
from vamgpu.hosts.schedules.timing import SECOND
from vamgpu.storage.atomic import explaining
from vamgpu.storage.reading import MOST_TOML, read_text


@dataclass(frozen=True, eq=False)
class Interrupted:
    run: RunRecord
    first: int  # the next slot
    unseen: int  # the slot from which records may be incomplete
    origin: Origin
    lost: tuple[tuple[int, ...], ...]  # black poses of each projector
    since: float  # last light, in clock time [s]

    @property
    def pause(self) -> int:
        """Time in the dark [ns]."""
        return _since(self.since)

    def take_up(
        self, folder: RunFolder, schedule: Schedule, now: int, version: Callable[[int], int] = lambda slot: 0
    ) -> None:
        """Record, at a time of the rig's clock [ns], the frames triggered after the host's last poll."""
        # the present frame may have been cut; mirrors that go dark with their program showed none after it
        if self.first > self.unseen:
            folder.event("unseen", now, first=self.unseen, stop=self.first)
        have = set(zip(self.run.shown["slot"].tolist(), self.run.shown["engine"].tolist(), strict=True))
        for slot in range(self.unseen, self.first):
            for engine in range(schedule.engines):
                if (slot, engine) not in have:
                    folder.shown(FrameRecord.of(schedule, slot, engine, version(slot)))


def left_in(run: RunRecord, limits: SafetyLimits = SafetyLimits()) -> tuple[dict[str, Any], float, bool]:
    """A dead host's last run segment, last sign of light [s], and whether it went off. Raises `BadInput`."""
    path = run.path
    if run.state is not PrintState.PRINTING and not run.state.waits:
        raise BadInput(f"{str(path)!r} is {run.state.value}; only interrupted prints can be resumed")
    segment = next((event for event in reversed(run.events) if event["event"] == "segment"), None)
    if segment is None:
        raise BadInput(f"{str(path)!r} has shown nothing; start again in another folder")
    if "preroll" not in segment:
        raise BadInput(
            f"{str(path)!r} was printed on a screen, whose last frames before the dark are not known; start "
            "again with fresh resin"
        )
    _check_pause(path, float(run.events[-1]["wall"]), limits)
    signs = [event for event in run.events if event["event"] in ("segment", "light", "poll")]
    dark = next(event.get("to") == "off" for event in reversed(signs) if event["event"] != "poll")
    return segment, float(signs[-1]["wall"]), dark


def _check_pause(path: str | Path, since: float, limits: SafetyLimits) -> None:
    """Raise `BadInput` if the pause since a clock time [s] was too long, or is not known."""
    if (pause := _since(since)) < 0:
        raise BadInput(
            f"the last record in {str(path)!r} is {-pause / SECOND:.1f} s ahead of this host's clock; the pause is "
            "therefore not known; start again with fresh resin"
        )
    may_resume(pause, limits)


def interrupted(
    path: str | Path, controller: Controller, schedule: Schedule, limits: SafetyLimits = SafetyLimits()
) -> Interrupted:
    """State of a print from its folder and its controller, which kept its power. Raises `BadInput`."""
    run, now = read_run(path), controller.status()
    segment, sign, off = left_in(run, limits)
    if now.zero != segment.get("zero"):
        raise BadInput(
            f"the controller has lost the print of {str(path)!r}: it lost its power, was reset when its port opened or "
            "another print began, so the position of the motor is not known; start again with fresh resin"
        )
    slots = run.shown["slot"]
    recorded = int(slots.max()) + 1 if len(slots) else 0
    # frames of a run segment shown by the controller; none if the host died before it let the controller play
    counted = max(now.shown - segment["preroll"], 0) if now.play == segment["play"] else 0
    shown = segment["first"] + counted
    if now.play not in (segment["play"], segment["before"]) or shown < recorded:
        raise BadInput(
            f"another program used the controller after {str(path)!r}; the dose of the resin is therefore not known; "
            "start again with fresh resin"
        )
    dark = run.shown[run.shown["dark"] > 0]
    if shown >= len(schedule):
        missed = f", {len(dark)} of them black: only the host that planned them can repeat them" if len(dark) else ""
        raise BadInput(f"{str(path)!r} has shown all its {len(schedule)} slots{missed}; nothing is left to print")
    lost = (dark["position"][dark["engine"] == engine].tolist() for engine in range(schedule.engines))
    origin = Origin(segment["origin"], segment["zero"])
    lit = recorded > segment["first"]  # frames shown after that count as dark, so that a pause is never too short
    since = sign if lit else segment["wall"] - segment["dark"] / SECOND
    _check_pause(path, since, limits)
    return Interrupted(run, shown, recorded - int(lit and not off), origin, tuple(map(tuple, lost)), since)


def _since(wall: float) -> int:
    """Time since a clock time [ns]."""
    return round((time.time() - wall) * SECOND)


def limits(rig: RigConfig) -> SafetyLimits:
    """The limits of the light in a rig file.

    Args:
        rig: The rig.

    Returns:
        Lease [ns], tolerance of motion [poses], budget of light relative to the plan, and longest pause [ns].
    """
    said = rig.setup.safety
    return SafetyLimits(round(said.lease * 1e9), said.tolerance, said.budget, round(said.resume * 1e9))


def asked_for(planned: PrintPlan) -> dict[str, Any]:
    """The plan as stored in a run's folder."""
    table, jobs = planned.schedule, [each.path for each in planned.jobs]
    return {
        "jobs": jobs, "digests": [digest(Path(job)) for job in jobs], "kind": planned.kind, "rig": planned.rig.source,
        "slots": len(table), "seconds": table.duration / SECOND, "unit": table.unit, "speed": float(table.speed),
        "stop": None if planned.stop is None else planned.stop.threshold, "settings": planned.rig.settings,
        "guarantees": [one.record() for one in planned.guarantees],
        "calibrations": dict(planned.calibration.used),
        "views": views_asked(table),
        "dose": None if planned.dose is None else planned.dose.plain(),
    }  # fmt: skip


def may_go_on(planned: PrintPlan, folder: str | Path) -> None:
    """Check, only from the folders, that a print can be resumed. Call before any machine is opened.

    Args:
        planned: The plan of the same jobs at the same speed.
        folder: The run folder of the interrupted print.

    Raises:
        BadInput: The folder holds another print, one that ended, one that paused for too long, or one on a video cable.
        StorageError: The folder cannot be read.
    """
    if driver_of(planned.rig.setup.clock) == "stage":
        raise BadInput(
            "the stage triggered the mirrors to the end of their frames, and it is not known which of them were lit: "
            "the print cannot be resumed; start again with fresh resin"
        )
    if planned.jobs[0].travel is not None:
        raise BadInput("the height of a part that moves is not known after its host died: the print cannot be resumed; "
                       "start again with fresh resin")  # fmt: skip
    if planned.display is not None:
        raise BadInput(
            "a video projector repeated its last frame while the vial turned, until the lease ended: the print "
            "cannot be resumed; start again with fresh resin"
        )
    before = read_run(folder)
    asked, wanted = before.asked, asked_for(planned)
    names = ("digests", "kind", "slots", "speed", "stop", "calibrations", "views")
    if different := [name for name in names if name in asked and asked[name] != wanted[name]]:
        told = ", ".join(f"{name} {asked.get(name)!r} in place of {wanted[name]!r}" for name in different)
        raise BadInput(f"{str(folder)!r} is another print, with {told}; give its jobs and speed")
    _same_rig(planned, before)
    left_in(before, limits(planned.rig))


def left_by_a_host(planned: PrintPlan, machines: Machines, folder: str | Path) -> Interrupted:
    """The interrupted print in a folder, if it matches the plan. Raises `BadInput`, `StorageError`."""
    may_go_on(planned, folder)
    assert isinstance(machines, MirrorMachines)
    return interrupted(folder, machines.controller, planned.schedule, limits(planned.rig))


def _same_rig(planned: PrintPlan, run: RunRecord) -> None:
    """Raise `BadInput` for a rig with another light or motion than the print, after the same calibration."""
    file, given = run.path / "rig.toml", run.asked.get("settings", ())
    with explaining("read", file):
        first = planned.calibration.motion(parse_rig(read_text(file, MOST_TOML), given, source=str(file)))
    began, now = (_light(read.setup) for read in (first, planned.rig))
    if different := [name for name in now if now[name] != began[name]]:
        settings = "".join(f" --set {setting!r}" for setting in given)
        settings = f" and print with{settings}" if given else ""
        raise BadInput(
            f"the rig has other values in [{'], ['.join(different)}] than that of {str(run.path)!r}: the "
            f"rest of the print would get other light; copy them from {str(file)!r}{settings}"
        )


def _light(rig: RigFile) -> dict[str, Any]:
    """The part of a rig's file that must not change before a print continues."""
    told = rig.model_dump(exclude={"rig", "safety", "feedback", "camera_stage"})
    for section in (told["controller"], told["motion"], *told["display"], told["lens"], told["lift"], told["light"]):
        for name in ("port", "library"):
            (section or {}).pop(name, None)
    return told


def run_folder(
    planned: PrintPlan, folder: str | Path, left: Interrupted | None, now: int,
    version: Callable[[int], int] | None = None,
) -> RunFolder:  # fmt: skip
    """A new run folder, or a resumed one with its shown frames. now: time [ns].  version: gives a slot's version."""
    if left is None:
        return RunFolder.begin(folder, asked_for(planned), planned.rig.text)
    record = RunFolder.again(folder)
    left.take_up(record, planned.schedule, now, version or (lambda slot: 0))
    return record
