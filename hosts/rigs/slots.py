"""Slots of jobs on triggered mirrors: the arrays that frames are for, and the schedule that shows them."""

from __future__ import annotations

from typing import Any

from vamgpu.errors import BadInput
from vamgpu.hosts.frames.sources import MirrorArray
from vamgpu.hosts.rigs.config import RigConfig
from vamgpu.hosts.rigs.jobs import PrintJob
from vamgpu.hosts.schedules.limits import LensTiming, MirrorTiming
from vamgpu.hosts.schedules.mirrors import closest, rising, sla, turned, web
from vamgpu.hosts.schedules.schedule import Schedule
from vamgpu.hosts.schedules.timing import DAY, SECOND

GUARD = 0.02  # share of a pose that stays dark at its end, so that no light falls into the next
BLOCK = 64  # columns that a device packs together: emulated mirrors are as wide as whole blocks


def mirror_arrays(loaded: tuple[PrintJob, ...], rig: RigConfig, rehearsed: bool) -> tuple[MirrorArray, ...]:
    """The arrays that frames are for; emulated ones are as large as the largest of them."""
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


def frame_times(rig: RigConfig, engines: int) -> list[dict[int, float]]:
    """Shortest time of a frame [s] by its bits, of each of so many mirrors."""
    sections = rig.setup.display * engines if rig.setup.emulated else rig.setup.display
    return [{8: section.frame_time, 1: 1e-4} for section in sections[:engines]]


def triggered_schedule(
    first: PrintJob, rig: RigConfig, speed: float, turns: int, mirrors: tuple[MirrorArray, ...],
    focus: tuple[float, ...],
) -> Schedule:  # fmt: skip
    setup, planes = rig.setup, max(len(first.depths), 1)
    pose = (_nearest(first) if first.advance is None else first.advance) / speed
    if pose * SECOND > DAY:
        raise BadInput(f"at that speed a frame lasts {pose:.3g} s; expected a day at most: move faster")
    engines = tuple(
        MirrorTiming(
            frame=times, pixels=(each.columns, each.rows), row_bytes=each.row_bytes,
            dark=round(GUARD * pose / planes, 6),
        )
        for each, times in zip(mirrors, frame_times(rig, len(mirrors)), strict=True)
    )  # fmt: skip
    common: dict[str, Any] = {"speed": speed, "engines": engines, "bits": first.bits, "power": setup.light.power}
    if first.advance is None:
        return turned(first.turn, turns=turns, **common)
    if turns != 1:
        raise BadInput(f"turns is {turns}; expected 1, as only vials come round again")
    if first.kind == "slices":
        return sla(first.poses, pitch=first.advance, **common)
    lens = setup.lens
    if lens is not None and lens.controlled_by == "host":
        focus = ()  # it is there before the print
    timing = None if lens is None or not focus else LensTiming(lens.settle, baud=lens.baud, latency=lens.latency)
    return web(first.poses, advance=first.advance, lens=timing, focus=focus, **common)


def _nearest(first: PrintJob) -> float:
    """Degrees between the nearest two poses of a vial."""
    motion = first.motion
    return 360.0 / first.poses if motion is None or motion.is_even else float(closest(rising(motion)))


def whole_poses(schedule: Schedule, microsteps: float) -> None:
    """Raise `BadInput` for poses that are no even number of microsteps: a stage's output changes at halves of one."""
    pose = float(schedule.advance) * microsteps
    if abs(pose / 2 - round(pose / 2)) <= 1e-6 * pose:
        return
    turn, remedy = 180.0 * microsteps, "take another way from pose to pose"
    if schedule.unit == "deg" and abs(turn - round(turn)) <= 1e-6 * turn:
        fits = [count for count in range(1, 10_000) if round(turn) % count == 0]
        remedy = f"take {min(fits, key=lambda count: abs(count - schedule.frames))} images a turn"
    raise BadInput(
        f"an angle is {pose:.6g} microsteps of the stage, whose trigger output needs an even number: {remedy}, or "
        "correct microsteps in [motion]"
    )
