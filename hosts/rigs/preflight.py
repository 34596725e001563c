"""Check before the light that the job fits these mirrors, their memory and their wire; errors state the numbers."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from vamgpu.errors import BadInput, TimingInfeasible, WrongDevice
from vamgpu.geometry import positive
from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.drivers.dmd import Dmd
from vamgpu.hosts.drivers.memory import PIECE
from vamgpu.hosts.frames.upload import BUFFERS, guard, length
from vamgpu.hosts.player.controller_mirrors import triggers
from vamgpu.hosts.schedules.clock import Clock
from vamgpu.hosts.schedules.limits import MirrorTiming
from vamgpu.hosts.schedules.schedule import Schedule
from vamgpu.hosts.schedules.timing import SECOND, numeric, whole

log: logging.Logger = logging.getLogger(__name__)

MARGIN = 1.5  # least ratio of measured to needed speed of a wire
LINE = 0.3  # time for which a controller's answers are counted [s]
LOADING = 30.0  # longest time [s] for uploading all frames of a print before its light opens


class Residence(Enum):
    """Place of the frames when the light opens."""

    RESIDENT = "all at the mirrors"
    STREAMED = "two sequences in alternation, one filled while the other is shown"


@dataclass(frozen=True)
class Preflight:
    """Whether frames fit the memory of mirrors, and their wire."""

    residence: Residence
    planes: int  # planes that the job needs
    memory: int  # planes that the mirrors have
    demand: float  # bytes/s that the job uses on average
    measured: float  # bytes/s that the wire carries
    stall: float  # longest stall of the frames' source before one is lost [s]
    freeze: float  # longest stall of the whole host [s]

    def __str__(self) -> str:
        wire = f"of {1e-6 * self.measured:.3g} MB/s" if np.isfinite(self.measured) else "on an instantaneous wire"
        held = f"; prepared frames last {self.stall:.3g} s, those at the mirrors {self.freeze:.3g} s"
        return (
            f"{self.planes} planes, room for {self.memory}: {self.residence.value}; "
            f"{1e-6 * self.demand:.3g} MB/s {wire}{held if np.isfinite(self.stall) else ''}"
        )


@dataclass(frozen=True)
class Judged:
    """The preflight of each array, and the sequences for a player."""

    found: tuple[Preflight, ...]
    depth: int  # frames in each sequence
    sequences: int
    turn: int | None = None  # slots that are uploaded once and repeated; None if no turn repeats, or fits

    def __str__(self) -> str:
        lines = "; ".join(dict.fromkeys(map(str, self.found)))
        return f"{lines}; {self.sequences} sequences of {self.depth} frames"


def judged(
    schedule: Schedule, mirrors: Sequence[Dmd], clock: Clock, *, bits: int = 8, seconds: float = 2.0,
    live: int | None = None,
) -> Judged:  # fmt: skip
    """Check a schedule on opened mirrors, in the dark. live: slots after which later frames may be replaced."""
    if not mirrors or not len(schedule):
        raise BadInput(f"got {len(mirrors)} mirrors and {len(schedule)} slots; expected at least one of both")
    timings = [MirrorTiming(pixels=(dmd.width, dmd.height), row_bytes=dmd.row_bytes) for dmd in mirrors]
    for dmd in mirrors:
        _in_time(schedule, dmd, bits)
    real, free = clock.real, min(dmd.free_planes() for dmd in mirrors) - guard(schedule.rate) * bits
    with ThreadPoolExecutor(len(mirrors)) as pool:
        wires = list(pool.map(lambda dmd: _wire(dmd, bits, clock, seconds), mirrors)) if real else [np.inf]
    frames, slowest = triggers(schedule), min(wires)
    frame = max(timing.nbytes(bits) for timing in timings)
    depth = max(2, min(length(schedule.rate, frame), free // (2 * bits)))
    turn = round_again(schedule, 2 * depth)
    parts = -(-(turn or frames) // depth)
    if live is not None:
        parts = max(3, -(-live // depth))  # of one turn or segment: packing stops at its end
        turn, depth = live, max(2, -(-live // parts))
        even, spare = depth, parts + 2
    elif turn is not None:
        parts = max(2, parts)
        even = -(-turn // parts)
        spare = 2  # the black frames before the first slot, and the rest after a late frame
    else:
        even, spare = depth, 0
    comes = live is None or schedule.unit == "deg"  # repeated; segments of a web are not
    resident = comes and (parts + spare) * even * bits <= free and (turn or frames) * frame / slowest <= LOADING
    depth = even if resident else depth
    sequences = max(2, parts + spare) if resident else 2
    memory = free if resident and live is None else min(free, 2 * depth * bits)
    each = (
        preflight(
            schedule, timing, slowest, bits=bits, batch=depth, depth=BUFFERS, memory=memory,
            stored=turn if resident and live is None else None,
        )
        for timing in timings
    )  # fmt: skip
    return Judged(tuple(replace(found, memory=free) for found in each), depth, sequences, turn if resident else None)


def round_again(schedule: Schedule, least: int = 1) -> int | None:
    """Slots of whole turns, at least ``least``, after which the frames of a vial repeat; None if none do."""
    turn, frames = schedule.frames, schedule.frame
    if schedule.unit != "deg" or len(schedule) <= turn or (frames[turn:] != frames[:-turn]).any():
        return None
    return turn * max(1, min(-(-least // turn), len(schedule) // turn))


def answered(schedule: Schedule, controller: Controller, clock: Clock, seconds: float = LINE) -> float:
    """Measure the controller's answers per second, in the dark; TimingInfeasible if rows would run out."""
    length = positive("seconds", seconds)
    if not clock.real:
        return float("inf")
    measured = _rate(controller.status, clock, length)
    rows, unit = triggers(schedule), f"{schedule.unit}/s"
    log.info("preflight: %.4g rows/s of %.4g on the controller's line", schedule.rate, measured)
    if rows > controller.capacity and measured < MARGIN * schedule.rate:
        most = float(schedule.speed) * measured / (MARGIN * schedule.rate)
        raise TimingInfeasible(
            f"the controller answers {measured:.4g} times per second and holds {controller.capacity} of {rows} rows; "
            f"expected {MARGIN:g} × {schedule.rate:.4g} answers per second: move at {most:.4g} {unit} or slower, or "
            "raise baud in [controller] and in its firmware",
            "serial line", most, unit,
        )  # fmt: skip
    return measured


def _in_time(schedule: Schedule, dmd: Dmd, bits: int) -> None:
    """Raise `TimingInfeasible` for frames that follow faster than the device allows."""
    sequence = dmd.sequence(1, bits)
    try:
        allowed = sequence.limits()
    finally:
        sequence.free()
    least, most_us = 1000 * allowed.least_picture_us, allowed.greatest_picture_us
    if schedule.on.max() >= 1000 * most_us:
        slowest = float(schedule.speed) * float(schedule.on.max()) / (1000 * most_us)
        raise TimingInfeasible(
            f"frames are lit for {1e-9 * float(schedule.on.max()):.4g} s; these mirrors show one for "
            f"at most {1e-6 * most_us:.4g} s: move at {slowest:.4g} {schedule.unit}/s or faster",
            "mirrors", slowest, f"{schedule.unit}/s",
        )  # fmt: skip
    gap, on = schedule.gap, int(schedule.on.max())
    if min(gap, on + 1000) < least:
        most = float(schedule.speed) * min(gap, on + 1000) / least
        raise TimingInfeasible(
            f"frames of {bits} bits are lit for {1e-6 * on:.4g} ms every {1e-6 * gap:.4g} ms; these mirrors need "
            f"{1e-6 * least:.4g} ms: move at {most:.4g} {schedule.unit}/s or slower, or set their time in the rig "
            "file",
            "mirrors", most, f"{schedule.unit}/s",
        )  # fmt: skip


def _wire(dmd: Dmd, bits: int, clock: Clock, seconds: float) -> float:
    """Bytes per second to the mirrors, in pieces as large as those of a print."""
    count = max(1, min(PIECE // (bits * dmd.height * dmd.row_bytes), dmd.free_planes() // bits))
    sequence = dmd.sequence(count, bits)
    try:
        return measure(sequence.put, np.zeros((count, bits, *dmd.plane_shape), np.uint8), clock, seconds)
    finally:
        sequence.free()


def fits(frames: tuple[int, int], rows: int, columns: int) -> None:
    """Raise `WrongDevice` for frames (rows, columns) that were made for other mirrors."""
    if tuple(frames) != (rows, columns):
        raise WrongDevice(
            f"the job's frames have {frames[0]} × {frames[1]} pixels, the mirrors {rows} × {columns}: it was made "
            "for another device; pack it again for these mirrors, or check the rig's file"
        )


def measure(put: Callable[[np.ndarray], None], frames: np.ndarray, clock: Clock, seconds: float = 5.0) -> float:
    """Bytes per second of repeated ``put`` of frames, which are black, and as large as those of a print."""
    length = positive("seconds", seconds)
    if frames.nbytes == 0:
        raise BadInput("the frames to measure with have 0 bytes; expected more")
    return frames.nbytes * _rate(lambda: put(frames), clock, length)


def _rate(act: Callable[[], object], clock: Clock, seconds: float) -> float:
    """Count repetitions of an act per second, over a time."""
    start, count = clock.now(), 0
    while True:
        act()
        count += 1
        passed = clock.now() - start
        if passed >= int(seconds * SECOND):
            return count * SECOND / max(passed, 1)


def preflight(
    schedule: Schedule, mirrors: MirrorTiming, measured: float, *, bits: int = 8, batch: int = 8, depth: int = 8,
    memory: int | None = None, stored: int | None = None,
) -> Preflight:  # fmt: skip
    """Check a job against the measured bytes per second, for the batches of an upload queue."""
    if not numeric(measured) or not measured > 0:
        raise BadInput(f"measured is {measured!r} bytes per second; expected more than 0: run the measurement again")
    measured = float(measured)
    bits, batch, depth = whole("bits", bits), whole("batch", batch), whole("depth", depth)
    free, planes = mirrors.memory if memory is None else memory, (stored or triggers(schedule)) * bits
    demand = schedule.rate * mirrors.nbytes(bits)
    if planes <= free:
        found = Preflight(Residence.RESIDENT, planes, free, demand, measured, float("inf"), float("inf"))
        log.info("preflight: %s", found)
        return found
    if 2 * batch * bits > free:
        raise TimingInfeasible(
            f"two sequences of {batch} frames are {2 * batch * bits} planes; {free} are free: use smaller batches",
            "memory", 0.0, f"{schedule.unit}/s",
        )  # fmt: skip
    if measured < MARGIN * demand:
        most = float(schedule.speed) * measured / (MARGIN * demand)
        raise TimingInfeasible(
            f"{planes} planes do not fit into {free}, and the wire carries {1e-6 * measured:.4g} MB/s; expected "
            f"{MARGIN:g} × {1e-6 * demand:.4g} MB/s: move at {most:.4g} {schedule.unit}/s or slower, or show "
            "frames of 1 bit", "data link", most, f"{schedule.unit}/s",
        )  # fmt: skip
    freeze = batch / schedule.rate  # one of the two sequences may just have ended
    found = Preflight(Residence.STREAMED, planes, free, demand, measured, freeze * (1 + depth), freeze)
    log.info("preflight: %s", found)
    return found
