"""Versions of a plan's frames: where they may be replaced, by which frames, and those of an earlier host."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vamgpu.errors import BadInput, StorageError
from vamgpu.hosts.frames.sources import FrameSource, MirrorArray, VialFrames, WebFrames
from vamgpu.hosts.frames.versions import FrameVersion, FrameVersions
from vamgpu.hosts.records.plans import kept_frames, last_kept, swaps
from vamgpu.hosts.records.record import RunRecord
from vamgpu.hosts.rigs.jobs import PrintJob
from vamgpu.hosts.rigs.planning import PrintPlan
from vamgpu.printing.frames import Frames


def boundary(planned: PrintPlan) -> int:
    """Slots after which frames may be replaced: of a turn of a vial, or of a segment of a web. Raises `BadInput`."""
    if planned.kind == "slices":
        raise BadInput("frames are replaced at turns of a vial or segments of a web; this is a print of slices")
    first = planned.jobs[0]
    return planned.schedule.frames if planned.kind == "vial" else first.segment * max(len(first.depths), 1)


def planned_versions(planned: PrintPlan, allowance: float = 0.0) -> FrameVersions:
    """The versions of a plan's frames. Raises `BadInput` for slices, or webs with different segments."""
    count, slots = boundary(planned), len(planned.schedule)
    if planned.kind == "vial":
        return FrameVersions(planned.sources(), count, slots // count, allowance=allowance)
    if len({each.segment for each in planned.jobs}) > 1:
        raise BadInput(f"the webs have segments of {[each.segment for each in planned.jobs]} angles; expected the same")
    turns = -(-slots // count)
    return FrameVersions(planned.sources(), count, turns, allowance=allowance, unit="segment", slots=slots)


def sources_of(
    frames: Sequence[Frames], mirrors: Sequence[MirrorArray], jobs: Sequence[PrintJob] = (), turn: int = 0
) -> tuple[FrameSource, ...]:
    """Frames of each projector for its mirrors. jobs, turn: of a web, and its first segment."""
    if jobs and jobs[0].kind == "web":
        return tuple(_stretch(*each, turn) for each in zip(frames, mirrors, jobs, strict=True))
    return tuple(VialFrames(each, array) for each, array in zip(frames, mirrors, strict=True))


def _stretch(frames: Frames, mirrors: MirrorArray, job: PrintJob, turn: int) -> WebFrames:
    """Frames of a web from a segment on; black elsewhere, where they are not used."""
    levels, first = frames.levels(), turn * job.segment

    def read(low: int, high: int) -> np.ndarray:
        out = np.zeros((high - low, *levels.shape[1:]), np.uint8)
        begin, end = max(low, first), min(high, first + len(levels))
        if begin < end:
            out[begin - low : end - low] = levels[begin - first : end - first]
        return out

    return WebFrames(read, job.poses, mirrors, job.masks, frames.device)


def replaced(planned: PrintPlan, turn: int, poses: int) -> tuple[list[Frames], int | None]:
    """The job's frames that ``poses`` from a turn on replace, of each projector, and the segment that ends them."""
    if planned.kind == "vial":
        return [each.frames for each in planned.jobs if each.frames is not None], None
    total, segment = planned.jobs[0].poses, planned.jobs[0].segment
    stop = turn * segment + poses
    if poses < 1 or turn < 1 or not (stop == total or (stop < total and stop % segment == 0)):
        raise BadInput(
            f"got frames of {poses} angles from segment {turn} on; expected whole segments of {segment} angles, up to "
            f"angle {total}"
        )
    frames = [each.stretch(turn * segment, stop) for each in planned.jobs if each.stretch is not None]
    return frames, None if stop == total else stop // segment


def restored(
    versions: FrameVersions, planned: PrintPlan, run: RunRecord, first: int, lost: Sequence[Sequence[int]]
) -> None:
    """Restore the versions that an earlier host committed, with frames still to be shown. lost: slots to repeat."""
    begins: dict[int, int] = {}
    for swap in swaps(run):
        number, turn, light = int(swap["version"]), int(swap["turn"]), float(swap["light"])
        versions.restore(FrameVersion(number, (), turn, swap["stop"], light, swap.get("until")))
        begins[number] = turn
    wanted = {versions.at(slot) for each in lost for slot in each}
    wanted |= {versions.at(slot) for slot in range(max(first - versions.count, 0), versions.end)}
    for number in sorted(wanted - {0}):
        device = None if planned.jobs[0].frames is None else planned.jobs[0].frames.device
        try:
            frames = [kept_frames(run.path, number, engine, device) for engine in range(len(planned.jobs))]
        except StorageError as error:
            raise StorageError(f"version {number} of the frames cannot be read: {error}; start again") from error
        versions.supply(number, sources_of(frames, planned.mirrors, planned.jobs, begins[number]))
    versions.last = max(versions.last, last_kept(run.path))
