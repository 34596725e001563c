"""Before the light: does the job fit these mirrors, their memory, and the wire to them? Refuses with numbers."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np

from vamgpu.errors import BadInput, TimingInfeasible, WrongDevice
from vamgpu.hosts.clock import Clock
from vamgpu.hosts.limits import HdmiTiming, MirrorTiming
from vamgpu.hosts.schedule import Schedule
from vamgpu.hosts.timing import SECOND

log = logging.getLogger(__name__)

MARGIN = 1.5
"""How much faster than it is used a wire must be measured."""


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
        return (
            f"{self.planes} planes, {self.memory} fit: {self.residence.value}; {1e-6 * self.demand:.3g} MB/s of "
            f"{1e-6 * self.measured:.3g} MB/s; the source may stand still for {self.stall:.3g} s, the host for "
            f"{self.freeze:.3g} s"
        )


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
    if pictures.nbytes == 0 or not seconds > 0:
        raise BadInput(f"measuring {pictures.nbytes} bytes for {seconds!r} s; wanted more than 0 of both")
    start, end, sent = clock.now(), clock.now() + int(seconds * SECOND), 0
    while True:
        put(pictures)
        sent += pictures.nbytes
        now = clock.now()
        if now >= end:
            return sent * SECOND / max(now - start, 1)


def preflight(
    schedule: Schedule, mirrors: MirrorTiming, measured: float, *, bits: int = 8, batch: int = 8, depth: int = 8,
    memory: int | None = None,
) -> Preflight:  # fmt: skip
    """Judge a job. measured: bytes a second, of `measure`.  batch, depth: of the feed.  memory: free planes, inquired;
    None for those of the mirrors' limits.

    What fits is loaded before; the rest must be carried `MARGIN` times as fast as it is shown. Raises `BadInput`,
    `TimingInfeasible`.
    """
    if not measured > 0:
        raise BadInput(f"measured is {measured!r} bytes a second; wanted more than 0: run the measurement again")
    free, planes = mirrors.memory if memory is None else memory, len(schedule) * bits
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
