"""Emulated machines as large as a plan: the drivers of a print, on a simulated or a real-time clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.hosts.player.machines import Machines, MirrorMachines, StageMachines, VideoMachines
from vamgpu.hosts.player.rows import FINE, emulated_microsteps
from vamgpu.hosts.rigs.guarantees import driver_of
from vamgpu.hosts.rigs.planning import PrintPlan
from vamgpu.hosts.schedules.limits import HdmiTiming
from vamgpu.printing.frames import Frames
from vamgpu.storage.folder import Folder

EMULATED = 2**30  # bytes of host memory for the frames of emulated mirrors; real ones have 8 times as much


@dataclass(frozen=True, eq=False)
class Rehearsal:
    """Emulated machines of a plan.

    Attributes:
        machines: Their drivers, like those from `opened`.
        emulated: The emulated rig behind the drivers: its clock, its faults, and the recorder of the dose.
        monitor: Compares the dose in the resin with the frames.
    """

    machines: Machines
    emulated: Any
    monitor: Any

    def seen(self, planned: PrintPlan, engine: int = 0, turns: int | None = None) -> Frames:
        """Frames of a vial as the resin received them.

        Args:
            planned: The plan.
            engine: Number of the projector, from 0.
            turns: Turns that began, over which the light is averaged; None takes those of the plan.

        Returns:
            Frames [image, row, column] whose levels are the light in the resin, for `vamgpu.prove`.

        Raises:
            BadInput: The job is not for a vial.
        """
        return as_frames(planned, self.levels(planned, engine, turns), engine)

    def levels(self, planned: PrintPlan, engine: int = 0, turns: int | None = None) -> np.ndarray:
        """The levels uint8 [image, row, column] of `seen`; BadInput for other jobs."""
        shares = self.shares(planned, engine)
        turns = turns or len(planned.schedule) // len(shares)
        return np.rint(shares / turns * (255 if planned.bits == 8 else 1)).astype(np.uint8)

    def shares(self, planned: PrintPlan, engine: int = 0) -> np.ndarray:
        """Light in the resin of a vial so far, in full-on slots, [image, row, column]. Raises `BadInput`."""
        from vamgpu.hosts.emulators.dose import full_light  # as below: no real print loads an emulator

        frames = planned.jobs[engine].frames
        if frames is None:
            raise BadInput(f"{planned.jobs[engine].path!r} is not for a vial; get its light from the dose monitor")
        images, rows, columns = frames.shape
        light = self.emulated.recorder.seconds(engine, images, turn=images)[0]
        down, across = planned.mirrors[engine].place(rows, columns)
        return light[:, down, across] / full_light(planned.schedule, engine)


def as_frames(planned: PrintPlan, levels: np.ndarray, engine: int = 0) -> Frames:
    """Levels of a vial, from `Rehearsal.levels`, as frames."""
    frames = planned.jobs[engine].frames
    assert frames is not None
    bytes_ = levels if frames.bits == 8 else np.packbits(levels, axis=-1)
    return Frames.from_bytes(
        bytes_, "numpy", bits=frames.bits, gray=frames.gray, scale=frames.scale, columns=levels.shape[2],
        settings=frames.settings, flat_field=frames.flat_field, motion=frames.motion,
    )  # fmt: skip


def rehearsal(planned: PrintPlan, paced: bool = False) -> Rehearsal:
    """Emulate machines as large as a plan.

    Args:
        planned: The plan.
        paced: Keep pace with real time, for viewers; else time passes as fast as it is computed.

    Returns:
        The machines, the emulated rig and the dose monitor.
    """
    from vamgpu.hosts.emulators.camera import resin_camera
    from vamgpu.hosts.emulators.clock import PacedClock, VirtualClock
    from vamgpu.hosts.emulators.dose import DoseMonitor

    clock = PacedClock() if paced else VirtualClock()
    if planned.display is not None:
        emulated, machines = _video_rig(planned, planned.display, clock)
    elif driver_of(planned.rig.setup.clock) == "stage":
        emulated, machines = _stage_rig(planned, clock)
    else:
        emulated, machines = _mirror_rig(planned, clock)
    if (path := planned.jobs[0].travel) is not None and path.rows:
        machines.lift = emulated.plug_lift()
    sources: Any = planned.sources()
    planes = max(1, len(planned.jobs[0].depths))
    monitor = DoseMonitor(emulated.recorder, planned.schedule, sources, planned.mirrors[0], planes)
    emulated.clock.attach(monitor)
    if planned.kind == "vial":
        moves = range(0 if planned.schedule.repeats else len(planned.schedule))
        dark = next((k for k in moves if sources[0].levels(np.array([k])).any()), 0)
        emulated.recorder.scan(planned.schedule, dark)
    if planned.stop is not None:
        machines.camera = resin_camera(emulated.recorder, emulated.clock, planned.stop.exposure, planned.stop.bits)
    return Rehearsal(machines, emulated, monitor)


def resin_of(
    planned: PrintPlan, settings: Mapping[str, Any], truth: Mapping[str, Any], rehearsed: Rehearsal | None = None
) -> Any:
    """Curing resin of one vial, and its camera; settings, truth: those of the order of a watched print."""
    # it loads SciPy, which other prints do not need
    from vamgpu.hosts.emulators.resin import CuringCamera, printer_of, sensor_of
    from vamgpu.live import LiveSetup

    setup = LiveSetup.of(dict(settings["setup"]))
    sensor = sensor_of(settings, setup)
    printer, turns = printer_of(setup, truth, sharp=sensor is not None), setup.planned / setup.dose
    part = np.array(Folder.open(planned.jobs[0].path).array("target"), np.float32)

    def light(shares: np.ndarray) -> np.ndarray:
        frames = planned.jobs[0].frames
        assert frames is not None
        levels = np.rint(np.clip(shares, 0.0, 1.0) * (255 if frames.bits == 8 else 1)).astype(np.uint8)
        if not levels.any():
            return np.zeros(printer.plan.range.shape, np.float32)
        return np.asarray(as_frames(planned, levels).irradiance().numpy(), np.float32) / turns

    emulated = None if rehearsed is None else rehearsed.emulated
    shares = None if rehearsed is None else lambda: rehearsed.shares(planned)
    return CuringCamera(emulated, printer, part, shares, light, sensor)


def curing(planned: PrintPlan, rehearsed: Rehearsal, settings: Mapping[str, Any], truth: Mapping[str, Any]) -> Any:
    """Put the resin of `resin_of` into an emulated print of one vial, and its camera in front."""
    rehearsed.machines.camera = camera = resin_of(planned, settings, truth, rehearsed)
    return camera


def _mirror_rig(planned: PrintPlan, clock: Any) -> tuple[Any, MirrorMachines]:
    from vamgpu.hosts.emulators.rigs import ArrayModel, EmulatedMirrorRig

    size, lens = planned.mirrors[0], planned.rig.setup.lens
    model = ArrayModel(height=size.rows, width=size.columns)
    model = replace(model, planes=min(model.planes, EMULATED // (model.height * model.row_bytes)))
    steps = emulated_microsteps(planned.schedule)
    emulated = EmulatedMirrorRig(steps, model, len(planned.jobs), planned.focus, clock)
    if emulated.lens is not None and lens is not None:
        emulated.lens.model = replace(emulated.lens.model, least=lens.lowest, greatest=lens.highest)
    machines = emulated.machines(steps / float(planned.schedule.advance))
    measuring = {driver_of(each): each.sensor() for each in planned.rig.setup.feedback if each.sees == "motion"}
    per_unit = machines.controller.microsteps_per_mm
    if (encoder := measuring.get("encoder")) is not None:
        emulated.controller.senses.edges = (round(encoder.counts * 1000), round(per_unit * 1000))
    if (index := measuring.get("index")) is not None:
        emulated.controller.senses.mark = (500, round(index.distance * per_unit))
    machines.controller.feedback(**measuring)
    return emulated, machines


def _stage_rig(planned: PrintPlan, clock: Any) -> tuple[Any, StageMachines]:
    from vamgpu.hosts.emulators.rigs import ArrayModel, EmulatedStageRig

    size, setup, table = planned.mirrors[0], planned.rig.setup, planned.schedule
    model = ArrayModel(height=size.rows, width=size.columns)
    emulated = EmulatedStageRig(
        FINE, model, len(planned.jobs), table.unit, setup.light.gate == "line", setup.light.gate == "controller", clock,
        power=float(table.power[0, 0]),
        outputs=(getattr(setup.motion, "output", 1), getattr(setup.motion, "gate", None)),
    )  # fmt: skip
    return emulated, emulated.machines(FINE / float(table.advance))


def _video_rig(planned: PrintPlan, display: HdmiTiming, clock: Any) -> tuple[Any, VideoMachines]:
    from vamgpu.hosts.emulators.rigs import EmulatedVideoRig

    columns, rows = display.pixels
    setup = planned.rig.setup
    cable: Any = setup.display[0]
    free = not setup.motion.reports  # its clock and the cable's differ by the greatest errors in the file
    emulated = EmulatedVideoRig(
        planned.schedule.frames, (rows, columns), bits=display.bits, latency=display.latency,
        rate_hz=round(float(display.refresh)), clock=clock, layout=cable.layout,
        share=1.0 - float(display.dark * display.slot_rate),
        pose=float(planned.schedule.advance), unit=planned.schedule.unit,
        stepper=setup.motion.tolerance + cable.tolerance if free else None,
        indexed=any(driver_of(each) == "index" for each in setup.feedback), gated=setup.light.gate == "controller",
        power=float(planned.schedule.power[0, 0]),
    )  # fmt: skip
    return emulated, emulated.machines(display.latency)
