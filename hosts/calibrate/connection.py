"""Machines of calibrations: those of a rig's file, or emulated ones with emulated optics."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any

from vamgpu.errors import BadInput
from vamgpu.hosts.calibrate.machines import CalibrationMachines, SteppedTurntable, need
from vamgpu.hosts.calibrate.patterns import PatternScreen, VideoScreen
from vamgpu.hosts.calibrate.truth import USUAL
from vamgpu.hosts.drivers.camera import CameraDriver
from vamgpu.hosts.drivers.cleanup import closed_on_error
from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.drivers.dmd import Dmd
from vamgpu.hosts.drivers.projector import HdmiProjector
from vamgpu.hosts.drivers.scpi import PowerMeter
from vamgpu.hosts.drivers.stages import Stage, StandaStage, ZaberStage
from vamgpu.hosts.emulators.calibration import EmulatedCalibrationRig, Optics, marked_vial
from vamgpu.hosts.rigs.config import RigConfig, RigFile
from vamgpu.hosts.rigs.guarantees import driver_of
from vamgpu.hosts.schedules.clock import Clock, RealClock

STANDA_FRACTION = 256  # microsteps per full step
ATTRIBUTES = {"lens": "lens", "camera": "camera", "camera_stage": "stage", "photodiode": "meter"}
"""Table of a rig's file → attribute of `CalibrationMachines`."""


def checked(rig: RigFile, tables: Collection[str]) -> None:
    """Raises `JobError`, which names the first missing table, before any machine is opened."""
    for table in tables:
        need(getattr(rig, table), table)


def opened(config: RigConfig, tables: Collection[str]) -> CalibrationMachines:
    """Open the rig's light, projectors, and the machines of the tables; JobError for a table that is missing."""
    rig, controller = config.setup, None
    checked(rig, tables)
    if rig.controller is not None:
        microsteps = rig.motion.microsteps if driver_of(rig.motion) == "controller" else 1.0
        controller = Controller.open(str(rig.controller.port), microsteps, rig.controller.baud)
    return _assembled(rig, tables, RealClock(), controller, (section.open() for section in rig.display), {
        "lamp": rig.light.open, "lens": lambda: need(rig.lens, "lens").open(),
        "camera": lambda: need(rig.camera, "camera").open(free=True),
        "camera_stage": lambda: _stage(rig), "photodiode": lambda: _meter(rig),
    })  # fmt: skip


def rehearsal(
    config: RigConfig, tables: Collection[str], truth: Any = None, *, kind: str = "axis"
) -> tuple[CalibrationMachines, Any]:
    """Emulate a rig's machines and their optics, which are the usual ones for a kind unless a truth is given."""
    rig = config.setup
    checked(rig, tables)
    optics = truth or Optics(**USUAL.get(kind, {}), **_view(rig))
    emulated = EmulatedCalibrationRig(optics, rig)
    machines = _assembled(rig, tables, emulated.clock, emulated.controller(), emulated.displays(), {
        "lamp": emulated.lamp, "lens": emulated.lens, "camera": emulated.camera,
        "camera_stage": emulated.stage, "photodiode": emulated.meter,
    })  # fmt: skip
    return machines, optics


def _view(rig: RigFile) -> dict[str, Any]:
    """Size and orientation of the emulated camera's images, as its section says."""
    if rig.camera is None:
        return {}
    turned = {"flip": rig.camera.flip, "rotation": rig.camera.rotation}
    return turned if rig.camera.crop is None else turned | {"view": rig.camera.view}


RATIO = 1.009  # degrees of an emulated vial per degree that its stage reports


def opened_turn(config: RigConfig, ratio: float = RATIO) -> tuple[CalibrationMachines, float | None]:
    """Open a rig's motion and camera, without light and mirrors; and the truth if they are emulated."""
    rig, camera = config.setup, need(config.setup.camera, "camera")
    if rig.emulated:
        return turning(rig, *marked_vial(ratio)), ratio
    if driver_of(rig.motion) == "controller":
        raise BadInput("the controller's motor uses index or encoder instead; expected another driver in [motion]")
    stage = rig.motion.open("deg")
    with closed_on_error(stage):
        return turning(rig, RealClock(), stage, camera.open()), None


def turning(rig: RigFile, clock: Clock, stage: Stage, camera: CameraDriver) -> CalibrationMachines:
    """The motion of a rig, and its camera, which are closed together."""
    closers = [camera.close, stage.close]
    return CalibrationMachines(rig, clock, None, (), camera=camera, stage=stage, closers=closers)


def _assembled(
    rig: RigFile, tables: Collection[str], clock: Clock, controller: Controller | None,
    displays: Iterable[Dmd | HdmiProjector], openers: Mapping[str, Callable[[], Any]],
) -> CalibrationMachines:  # fmt: skip
    """Open projectors and the machines of the tables, which are closed together."""
    machines, sections = CalibrationMachines(rig, clock, controller, ()), list[Any](rig.display)
    machines.closers += [] if controller is None else [controller.close]
    with closed_on_error(machines):
        machines.lamp = lamp = openers["lamp"]()
        machines.closers += [] if lamp is None else [lamp.close]
        for section, shown in zip(sections, displays, strict=True):
            machines.closers.append(shown.close)
            if isinstance(shown, Dmd):
                machines.screens += (PatternScreen(shown, section.frame_time),)
            else:
                machines.screens += (VideoScreen(shown),)
                machines.lamp = getattr(shown, "lamp", lamp)
        for table in tables:
            if table != "motion":
                machine = openers[table]()
                setattr(machines, ATTRIBUTES[table], machine)
            elif controller is not None and (rig.emulated or driver_of(rig.motion) == "controller"):
                machines.turntable = SteppedTurntable(controller, clock)
                continue
            else:
                machines.turntable = machine = rig.motion.open("deg")
            machines.closers.append(machine.close)
        if machines.camera is not None:
            machines.camera.expose(1e6 * need(rig.camera, "camera").exposure)
    return machines


def _stage(rig: RigFile) -> Stage:
    section = need(rig.camera_stage, "camera_stage")
    if section.driver == "standa":
        return StandaStage.open(str(section.port), section.microsteps / STANDA_FRACTION, "mm", STANDA_FRACTION)
    return ZaberStage.open(str(section.port), section.microsteps, "mm", section.device, section.axis)


def _meter(rig: RigFile) -> PowerMeter:
    section = need(rig.photodiode, "photodiode")
    meter = PowerMeter.open(str(section.port))
    with closed_on_error(meter):
        if section.wavelength is not None:
            meter.wavelength(section.wavelength)
        meter.average(section.average)
    return meter
