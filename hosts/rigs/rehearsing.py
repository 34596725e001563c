"""Emulated machines as large as a plan: the drivers of a print, on a clock that a program sets or that keeps pace."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.hosts.players.cable import VideoMachines
from vamgpu.hosts.players.mirrors import Machines
from vamgpu.hosts.rigs.motor import emulated_microsteps
from vamgpu.hosts.rigs.planning import Plan
from vamgpu.hosts.schedules.limits import HdmiTiming
from vamgpu.printing.frames import Frames


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
            settings=frames.settings, flat_field=frames.flat_field, motion=frames.motion,
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
        bench.chamber.scan(planned.schedule)
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
