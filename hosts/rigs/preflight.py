"""Before the light: does the job fit these mirrors, their memory, and the wire to them? Refuses with numbers."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from vamgpu.errors import BadInput, TimingInfeasible, WrongDevice
from vamgpu.geometry import positive
from vamgpu.hosts.clock import Clock
from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.drivers.dmd import Dmd
from vamgpu.hosts.drivers.stream import PIECE
from vamgpu.hosts.pictures.supply import BUFFERS, guard, length
from vamgpu.hosts.players.triggered import triggers
from vamgpu.hosts.schedules.limits import HdmiTiming, MirrorTiming
from vamgpu.hosts.schedules.schedule import Schedule
from vamgpu.hosts.schedules.timing import SECOND, numeric, whole

log = logging.getLogger(__name__)

MARGIN = 1.5
"""How much faster than it is used a wire must be measured."""
LINE = 0.3
"""How long a controller's answers are counted [s]."""
LOADING = 30.0
"""Longest time [s] that all pictures of a print may take to the mirrors before its light opens."""


class Residence(Enum):
    """Where the pictures are when the light opens."""

    RESIDENT = "all at the mirrors"
    STREAMED = "two sequences in turn, filled while the other is shown"


@dataclass(frozen=True)
class Preflight:
    """What was found.

    planes, memory: that the job needs and the mirrors have.  demand, measured: bytes a second that the job uses on
    average and the wire carries.  stall, freeze: how long [s] what makes the pictures, or the whole host, may stand
    still at the worst moment before a picture is lost.
    """

    residence: Residence
    planes: int
    memory: int
    demand: float
    measured: float
    stall: float
    freeze: float

    def __str__(self) -> str:
        wire = f"of {1e-6 * self.measured:.3g} MB/s" if np.isfinite(self.measured) else "on a wire that takes no time"
        held = f"; pictures made ahead last {self.stall:.3g} s, those at the mirrors {self.freeze:.3g} s"
        return (
            f"{self.planes} planes, room for {self.memory}: {self.residence.value}; "
            f"{1e-6 * self.demand:.3g} MB/s {wire}{held if np.isfinite(self.stall) else ''}"
        )


@dataclass(frozen=True)
class Judged:
    """What a look at opened mirrors found. found: of each.  depth: pictures in each of their ``sequences``: what a
    player is to be given."""

    found: tuple[Preflight, ...]
    depth: int
    sequences: int

    def __str__(self) -> str:
        lines = "; ".join(dict.fromkeys(map(str, self.found)))
        return f"{lines}; {self.sequences} sequences of {self.depth} pictures"


def judged(
    schedule: Schedule, mirrors: Sequence[Dmd], clock: Clock, *, bits: int = 8, seconds: float = 2.0
) -> Judged:
    """Judge a schedule on opened mirrors, in the dark; every print wants this before its light.

    seconds: how long the wires are measured, all at once; emulated mirrors, on a clock that a program sets, have none.
    What can be loaded within `LOADING` is loaded before the light. Raises `BadInput`, and `TimingInfeasible` with what
    binds.
    """
    if not mirrors or not len(schedule):
        raise BadInput(f"got {len(mirrors)} mirrors and {len(schedule)} slots; wanted one or more of both")
    timings = [MirrorTiming(pixels=(dmd.width, dmd.height), row_bytes=dmd.row_bytes) for dmd in mirrors]
    for dmd in mirrors:
        _in_time(schedule, dmd, bits)
    real, free = clock.real, min(dmd.free_planes() for dmd in mirrors) - guard(schedule.rate) * bits
    with ThreadPoolExecutor(len(mirrors)) as pool:
        wires = list(pool.map(lambda dmd: _wire(dmd, bits, clock, seconds), mirrors)) if real else [np.inf]
    pictures, slowest = triggers(schedule), min(wires)
    picture = max(timing.nbytes(bits) for timing in timings)
    load = pictures * picture / slowest
    depth = max(2, min(length(schedule.rate, picture), free // (2 * bits)))
    whole = -(-pictures // depth)
    resident = real and load <= LOADING and whole * depth * bits <= free
    sequences = max(2, whole) if resident else 2
    memory = free if resident else min(free, sequences * depth * bits)
    each = (
        preflight(schedule, timing, slowest, bits=bits, batch=depth, depth=BUFFERS, memory=memory) for timing in timings
    )
    return Judged(tuple(replace(found, memory=free) for found in each), depth, sequences)


def answered(schedule: Schedule, controller: Controller, clock: Clock, seconds: float = LINE) -> float:
    """Judge the controller's own line, in the dark; exchanges a second, infinite on a clock that a program sets.

    seconds: how long answers are counted; a row and its answer are as long as what is asked here.  Rows that do not
    all fit into the controller follow at the rate of the slots, and must be carried `MARGIN` times as fast. Raises
    `BadInput`, and `TimingInfeasible` where the controller would run out of rows.
    """
    length = positive("seconds", seconds)
    if not clock.real:
        return float("inf")
    measured = _rate(controller.status, clock, length)
    rows, unit = triggers(schedule), f"{schedule.unit}/s"
    log.info("preflight: %.4g rows/s of %.4g on the controller's line", schedule.rate, measured)
    if rows > controller.capacity and measured < MARGIN * schedule.rate:
        most = float(schedule.speed) * measured / (MARGIN * schedule.rate)
        raise TimingInfeasible(
            f"the controller answers {measured:.4g} times a second where {MARGIN:g} × {schedule.rate:.4g} rows/s are "
            f"wanted, and holds {controller.capacity} of {rows} rows: move at {most:.4g} {unit} at most, or raise baud "
            "in [controller] and in its firmware",
            "serial line", most, unit,
        )  # fmt: skip
    return measured


def _in_time(schedule: Schedule, dmd: Dmd, bits: int) -> None:
    """Raise `TimingInfeasible` for pictures that follow each other faster than the device itself allows."""
    sequence = dmd.sequence(1, bits)
    try:
        allowed = sequence.limits()
    finally:
        sequence.free()
    least, most_us = 1000 * allowed.least_picture_us, allowed.greatest_picture_us
    if schedule.on.max() >= 1000 * most_us:
        slowest = float(schedule.speed) * float(schedule.on.max()) / (1000 * most_us)
        raise TimingInfeasible(
            f"pictures are lit for {1e-9 * float(schedule.on.max()):.4g} s; these mirrors show one for "
            f"{1e-6 * most_us:.4g} s at most: move at {slowest:.4g} {schedule.unit}/s at least",
            "mirrors", slowest, f"{schedule.unit}/s",
        )  # fmt: skip
    gap, on = schedule.gap, int(schedule.on.max())
    if min(gap, on + 1000) < least:
        most = float(schedule.speed) * min(gap, on + 1000) / least
        raise TimingInfeasible(
            f"pictures of {bits} bits are lit for {1e-6 * on:.4g} ms every {1e-6 * gap:.4g} ms; these mirrors need "
            f"{1e-6 * least:.4g} ms: move at {most:.4g} {schedule.unit}/s at most, or tell the rig's file their time",
            "mirrors", most, f"{schedule.unit}/s",
        )  # fmt: skip


def _wire(dmd: Dmd, bits: int, clock: Clock, seconds: float) -> float:
    """Bytes a second to mirrors, in pieces as large as those of a print."""
    count = max(1, min(PIECE // (bits * dmd.height * dmd.row_bytes), dmd.free_planes() // bits))
    sequence = dmd.sequence(count, bits)
    try:
        return measure(sequence.put, np.zeros((count, bits, *dmd.plane_shape), np.uint8), clock, seconds)
    finally:
        sequence.free()


def fits(frames: tuple[int, int], mirrors: MirrorTiming | HdmiTiming) -> None:
    """Raise `WrongDevice` for pictures (rows, columns) that were made for other mirrors."""
    columns, rows = mirrors.pixels
    if tuple(frames) != (rows, columns):
        raise WrongDevice(
            f"the job's pictures have {frames[0]} × {frames[1]} pixels, the mirrors {rows} × {columns}: it was made "
            "for another device; pack it again for this one, or check the rig's file"
        )


def measure(put: Callable[[np.ndarray], None], pictures: np.ndarray, clock: Clock, seconds: float = 5.0) -> float:
    """Bytes a second that ``put`` takes of pictures again and again; black ones do no harm and are as large."""
    length = positive("seconds", seconds)
    if pictures.nbytes == 0:
        raise BadInput("measuring with pictures of 0 bytes; wanted more")
    return pictures.nbytes * _rate(lambda: put(pictures), clock, length)


def _rate(act: Callable[[], object], clock: Clock, seconds: float) -> float:
    """How often a second an act is done, when it is done again and again for so long."""
    start, count = clock.now(), 0
    while True:
        act()
        count += 1
        passed = clock.now() - start
        if passed >= int(seconds * SECOND):
            return count * SECOND / max(passed, 1)


def preflight(
    schedule: Schedule, mirrors: MirrorTiming, measured: float, *, bits: int = 8, batch: int = 8, depth: int = 8,
    memory: int | None = None,
) -> Preflight:  # fmt: skip
    """Judge a job. measured: bytes a second, of `measure`.  batch, depth: of the feed.  memory: free planes, inquired;
    None for those of the mirrors' limits.

    What fits is loaded before; the rest must be carried `MARGIN` times as fast as it is shown. Raises `BadInput`,
    `TimingInfeasible`.
    """
    if not numeric(measured) or not measured > 0:
        raise BadInput(f"measured is {measured!r} bytes a second; wanted more than 0: run the measurement again")
    measured = float(measured)
    bits, batch, depth = whole("bits", bits), whole("batch", batch), whole("depth", depth)
    free, planes = mirrors.memory if memory is None else memory, triggers(schedule) * bits
    demand = schedule.rate * mirrors.nbytes(bits)
    if planes <= free:
        found = Preflight(Residence.RESIDENT, planes, free, demand, measured, float("inf"), float("inf"))
        log.info("preflight: %s", found)
        return found
    if 2 * batch * bits > free:
        raise TimingInfeasible(
            f"two sequences of {batch} pictures are {2 * batch * bits} planes; {free} are free: take smaller batches",
            "memory", 0.0, f"{schedule.unit}/s",
        )  # fmt: skip
    if measured < MARGIN * demand:
        most = float(schedule.speed) * measured / (MARGIN * demand)
        raise TimingInfeasible(
            f"{planes} planes do not fit into {free}, and the wire carries {1e-6 * measured:.4g} MB/s where "
            f"{MARGIN:g} × {1e-6 * demand:.4g} MB/s are wanted: move at {most:.4g} {schedule.unit}/s at most, or show "
            "pictures of 1 bit", "data link", most, f"{schedule.unit}/s",
        )  # fmt: skip
    freeze = batch / schedule.rate  # one of the two sequences may just have ended
    found = Preflight(Residence.STREAMED, planes, free, demand, measured, freeze * (1 + depth), freeze)
    log.info("preflight: %s", found)
    return found
