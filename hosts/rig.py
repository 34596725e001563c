"""Jobs on rigs: which pictures when, on which machines; rehearsed first, printed then."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.hosts.board import Board
from vamgpu.hosts.clock import RealClock
from vamgpu.hosts.config import RigConfig
from vamgpu.hosts.limits import MirrorTiming
from vamgpu.hosts.moving import turned
from vamgpu.hosts.preflight import Preflight, fits, measure, preflight
from vamgpu.hosts.record import RunFolder
from vamgpu.hosts.run import Limits, Machines, Print
from vamgpu.hosts.schedule import Schedule
from vamgpu.hosts.state import State
from vamgpu.hosts.stream import FramePictures, Mirrors
from vamgpu.hosts.supply import BUFFERS
from vamgpu.printing.frames import Frames

GUARD = 0.02
"""Share of a pose that stays dark at its end, so that no light falls into the next."""
EMULATED_STEPS = 1000
"""Microsteps of an emulated motion in a pose."""
MEASURED = 8
"""Pictures at once while the wire to the mirrors is measured."""
UPLOAD = 0.25
"""Share of a lease that the upload of one sequence may last: the thread that uploads also renews."""


@dataclass(frozen=True)
class Plan:
    """A vial's job on a rig, before any machine is touched. speed: [deg/s]."""

    frames: Frames
    schedule: Schedule
    mirrors: Mirrors
    rig: RigConfig
    job: str

    def lines(self) -> tuple[tuple[str, str], ...]:
        """What a preflight tells."""
        table = self.schedule
        return (
            ("pictures", f"{len(table)} of {self.frames.bits} bits, {table.frames} different"),
            ("duration", f"{table.duration * 1e-9:.2f} s at {float(table.speed):.4g} {table.unit}/s"),
            ("rate", f"{table.rate:.4g} pictures/s, lit {100 * table.duty:.1f} % of the time"),
            ("light a picture", f"{int(table.on[0]) * 1e-6:.3f} ms"),
            ("memory", f"{self.frames.bits * table.frames} bit planes"),
            ("lease", f"{1e3 * self.rig.wanted.safety.lease:.0f} ms"),
        )


def plan(job: str | Path, rig: RigConfig, *, speed: float, turns: int = 1) -> Plan:
    """A vial's job folder on a rig. Raises `StorageError`, `BadInput`, and `TimingInfeasible` with what binds."""
    from vamgpu.jobs.web import is_web_folder
    from vamgpu.printing.folder import load_frames

    wanted = rig.wanted
    if is_web_folder(job):
        raise BadInput(
            f"{str(job)!r} is a web; wanted the folder of a vial's job: print webs from Python, with "
            "vamgpu.hosts.run.Print"
        )
    if wanted.rig.machine == "web":
        raise BadInput(f"the rig {wanted.rig.name!r} carries webs, {str(job)!r} is a vial's job; choose another rig")
    frames = load_frames(job, "numpy")
    images, rows, columns = frames.shape
    if wanted.emulated:
        size = (rows, 8 * -(-columns // 8))
        mirrors = Mirrors(*size, size[1] // 8)
    else:
        size = wanted.projector.size
        mirrors = Mirrors(*size, 256 if size[1] == 1920 else -(-size[1] // 8))
    mirrors.place(rows, columns)
    dark = round(GUARD * 360.0 / images / speed, 6)
    timing = MirrorTiming(
        picture={8: wanted.projector.picture, 1: 1e-4}, pixels=(size[1], size[0]), row_bytes=mirrors.row_bytes,
        dark=dark,
    )  # fmt: skip
    schedule = turned(images, speed=speed, engines=timing, turns=turns, bits=frames.bits, power=wanted.light.power)
    return Plan(frames, schedule, mirrors, rig, str(job))


def limits(rig: RigConfig) -> Limits:
    """What the rig's file says of safety."""
    said = rig.wanted.safety
    return Limits(round(said.lease * 1e9), said.tolerance, said.budget, round(said.resume * 1e9))


def opened(rig: RigConfig) -> Machines:
    """The real machines of a rig. Raises `DeviceNotFound`, `DeviceBusy`, `WrongDevice`; nothing stands in for them."""
    from vamgpu.hosts.drivers.controller import Controller
    from vamgpu.hosts.drivers.dmd import Dmd

    wanted = rig.wanted
    controller = Controller.open(str(wanted.controller.port), wanted.controller.microsteps, wanted.controller.baud)
    try:
        mirrors = Dmd.open(str(wanted.projector.library), wanted.projector.serial, wanted.projector.size)
    except BaseException:
        controller.close()
        raise
    return Machines(RealClock(), controller, [mirrors], wanted.controller.microsteps)


def rehearsal(planned: Plan) -> tuple[Machines, Any]:
    """Emulated machines of a plan, and their bench."""
    from vamgpu.hosts.emulators.array import ArrayModel
    from vamgpu.hosts.emulators.bench import Bench

    bench = Bench(EMULATED_STEPS, ArrayModel(height=planned.mirrors.rows, width=planned.mirrors.columns))
    return bench.machines(EMULATED_STEPS / float(planned.schedule.advance)), bench


@dataclass(frozen=True)
class Checked:
    """What a look at the machines found. depth: pictures in each of the two sequences of the mirrors."""

    found: Preflight
    depth: int

    def __str__(self) -> str:
        found = self.found
        if np.isfinite(found.measured):
            return f"{found}; {self.depth} pictures a sequence"
        return (
            f"{found.planes} planes, {found.memory} fit: {found.residence.value}; {1e-6 * found.demand:.3g} MB/s, "
            f"emulated mirrors have no wire to measure; {self.depth} pictures a sequence"
        )


def check(planned: Plan, machines: Machines, seconds: float = 2.0) -> Checked:
    """Judge a plan on opened machines, in the dark. seconds: how long the wire is measured, on real machines alone.

    Raises `WrongDevice` for other mirrors than planned, and `TimingInfeasible` with what binds.
    """
    table, bits, dmd = planned.schedule, planned.frames.bits, machines.mirrors[0]
    wanted = planned.mirrors
    timing = MirrorTiming(pixels=(wanted.columns, wanted.rows), row_bytes=wanted.row_bytes)
    fits((dmd.height, dmd.width), timing)
    measured = float("inf")
    if isinstance(machines.clock, RealClock):
        sequence = dmd.sequence(MEASURED, bits)
        try:
            black = np.zeros((MEASURED, bits, *dmd.plane_shape), np.uint8)
            measured = measure(sequence.put, black, machines.clock, seconds)
        finally:
            sequence.free()
    most = measured * planned.rig.wanted.safety.lease * UPLOAD / timing.nbytes(bits)
    depth = max(2, int(min(round(table.rate), most)))
    memory = min(dmd.free_planes(), 2 * depth * bits)
    found = preflight(table, timing, measured, bits=bits, batch=depth, depth=BUFFERS, memory=memory)
    return Checked(found, depth)


def carry_out(
    planned: Plan, machines: Machines, folder: str | Path, board: Board | None = None, depth: int | None = None
) -> tuple[State, Print]:
    """Print a plan into the folder of a run. Raises what went wrong, after it is dark and written down.

    depth: see `Print`; that of `check` lets no upload outlast the lease.
    """
    table = planned.schedule
    asked = {"job": planned.job, "rig": planned.rig.source, "slots": len(table), "unit": table.unit}
    with RunFolder.begin(folder, asked, planned.rig.text) as record:
        pictures = FramePictures(planned.frames, planned.mirrors)
        job = Print(
            planned.schedule, machines, [pictures], record, limits=limits(planned.rig), board=board,
            depth=depth, power=planned.rig.wanted.light.power,
        )  # fmt: skip
        return job.run(), job


def seen(planned: Plan, bench: Any) -> Frames:
    """What emulated resin saw, as frames: levels that give the same light, which a proof can judge."""
    frames, table = planned.frames, planned.schedule
    images, rows, columns = frames.shape
    light = bench.chamber.seconds(0, images, turn=images)[0]
    turns = len(table) // images
    down, across = planned.mirrors.place(rows, columns)
    share = light[:, down, across] / (turns * (int(table.on[0]) // 1000) * 1e-6)
    full = 255 if frames.bits == 8 else 1
    levels = np.rint(share * full).astype(np.uint8)
    bytes_ = levels if frames.bits == 8 else np.packbits(levels, axis=-1)
    return Frames.from_bytes(
        bytes_, "numpy", bits=frames.bits, gray=frames.gray, scale=frames.scale, columns=columns,
        settings=frames.settings, flat_field=frames.flat_field,
    )  # fmt: skip
