"""Slots of jobs on triggered mirrors: the arrays for the frames, and their schedule."""

from __future__ import annotations

from typing import Any

from vamgpu.errors import BadInput
from vamgpu.hosts.frames.sources import MirrorArray
from vamgpu.hosts.rigs.config import RigConfig
from vamgpu.hosts.rigs.jobs import PrintJob
from vamgpu.hosts.schedules.limits import LensTiming, MirrorTiming
from vamgpu.hosts.schedules.mirrors import closest, rising, turned, web
from vamgpu.hosts.schedules.schedule import Schedule
from vamgpu.hosts.schedules.timing import DAY, SECOND

GUARD = 0.02  # dark share of a pose at its end, so that no light reaches the next pose
BLOCK = 64  # columns that a device packs together: emulated mirrors are whole blocks wide


def mirror_arrays(loaded: tuple[PrintJob, ...], rig: RigConfig, rehearsed: bool) -> tuple[MirrorArray, ...]:
    """The arrays for the frames; emulated ones are as large as the largest."""
    if rehearsed:
        rows = max(each.shape[0] for each in loaded)
        columns = BLOCK * max(-(-each.shape[1] // BLOCK) for each in loaded)
        found = [MirrorArray(rows, columns, _row_bytes(columns))] * len(loaded)
    else:
        sizes = (section.array for section in rig.setup.display)
        found = [MirrorArray(rows, columns, _row_bytes(columns)) for rows, columns in sizes]
    for each, mirrors in zip(loaded, found, strict=True):
        mirrors.place(*each.shape)
    return tuple(found)


def _row_bytes(columns: int) -> int:
    """Bytes of a packed row in the mirrors' memory."""
    return 256 if columns == 1920 else -(-columns // 8)


def frame_times(rig: RigConfig, engines: int) -> list[tuple[dict[int, float], float]]:
    """Shortest time of a frame [s] by bits, and greatest lit share of a time slot, for each array."""
    sections: Any = rig.setup.display * engines if rig.setup.emulated else rig.setup.display
    return [({8: section.frame_time, 1: 1e-4}, section.duty) for section in sections[:engines]]


def triggered_schedule(
    first: PrintJob, rig: RigConfig, speed: float, turns: int, mirrors: tuple[MirrorArray, ...],
    focus: tuple[float, ...],
) -> Schedule:  # fmt: skip
    setup, planes = rig.setup, max(len(first.depths), 1)
    pose = (_nearest(first) if first.advance is None else first.advance) / speed
    if pose * SECOND > DAY:
        raise BadInput(f"at that speed a frame lasts {pose:.3g} s; expected at most a day: move faster")
    engines = tuple(
        MirrorTiming(
            frame=times, pixels=(each.columns, each.rows), row_bytes=each.row_bytes,
            dark=round(max(GUARD, 1.0 - duty) * pose / planes, 6),
        )
        for each, (times, duty) in zip(mirrors, frame_times(rig, len(mirrors)), strict=True)
    )  # fmt: skip
    common: dict[str, Any] = {"speed": speed, "engines": engines, "bits": first.bits, "power": setup.light.power}
    if first.advance is None:
        return turned(first.turn, turns=turns, **common)
    if turns != 1:
        raise BadInput(f"turns is {turns}; expected 1, because only vials have several turns")
    if first.kind == "slices":
        return web(first.poses, advance=first.advance, **common)
    lens = setup.lens
    if lens is not None and lens.controlled_by == "host":
        focus = ()  # the host sets the focus before the print
    timing = None if lens is None or not focus else LensTiming(lens.settle, baud=lens.baud, latency=lens.latency)
    return web(first.poses, advance=first.advance, lens=timing, focus=focus, **common)


def _nearest(first: PrintJob) -> float:
    """Degrees between the two nearest angles of a vial."""
    motion = first.motion
    return 360.0 / first.poses if motion is None or motion.is_even else float(closest(rising(motion)))


def whole_poses(schedule: Schedule, microsteps: float) -> None:
    """Raise `BadInput` if a pose is not an even number of microsteps: a stage's output switches at half a pose."""
    pose = float(schedule.advance) * microsteps
    if abs(pose / 2 - round(pose / 2)) <= 1e-6 * pose:
        return
    turn, remedy = 180.0 * microsteps, "use another travel from pose to pose"
    if schedule.unit == "deg":
        remedy = f"correct microsteps in [motion], of which a turn has {2 * turn:.9g}"
        if abs(turn - round(turn)) <= 1e-6 * turn:
            fits = [count for count in range(1, 10_000) if round(turn) % count == 0]
            nearest = min(fits, key=lambda count: abs(count - schedule.frames))
            remedy = f"solve the job with angles = {nearest} in [turntable]"
    raise BadInput(
        f"an angle is {pose:.6g} microsteps of the stage, whose trigger output needs an even number: {remedy}"
    )
