"""Machines of calibrations: those of a rig's file, or emulated ones before emulated optics."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from vamgpu.errors import BadInput
from vamgpu.hosts.calibrating.screen import Screen
from vamgpu.hosts.calibrating.sections import CameraStageSection
from vamgpu.hosts.calibrating.stand import Stand, need
from vamgpu.hosts.clock import RealClock
from vamgpu.hosts.drivers.camera import GenicamCamera
from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.drivers.dmd import Dmd
from vamgpu.hosts.drivers.lens import TunableLens
from vamgpu.hosts.drivers.scpi import PowerMeter
from vamgpu.hosts.drivers.stage import Stage
from vamgpu.hosts.rigs.config import RigConfig, RigFile

STANDA_FRACTION = 256
"""Microsteps of a full step."""


def checked(rig: RigFile, tables: Collection[str]) -> None:
    """Raises `JobError` naming the first of the tables that the rig has not, before any machine is opened."""
    for table in tables:
        need(getattr(rig, table), table)


def channels(rig: RigFile) -> tuple[int, ...]:
    """The controller's channel of light of each projector."""
    return tuple(range(len(rig.projector)))


def opened(config: RigConfig, tables: Collection[str]) -> Stand:
    """The real machines of a rig: controller, mirrors, and those of the tables; nothing stands in for them.

    Raises `JobError` for a table that is missing, `DeviceNotFound`, `DeviceBusy`, `WrongDevice`.
    """
    rig = config.wanted
    checked(rig, tables)
    if any(section.driver != "alp" for section in rig.projector):
        raise BadInput('calibrations show patterns on mirrors with a trigger; wanted projectors with driver "alp"')
    controller = Controller.open(str(rig.controller.port), 1.0, rig.controller.baud)
    stand = Stand(rig, RealClock(), controller, (), channels(rig), closers=[controller.close])
    try:
        for section in rig.projector:
            dmd = Dmd.open(str(section.library), section.serial, section.array)
            stand.closers.append(dmd.close)
            stand.screens += (Screen(dmd, section.picture),)
        for table in tables:
            _open(stand, table)
    except BaseException:
        stand.close()
        raise
    return stand


def _open(stand: Stand, table: str) -> None:
    rig = stand.rig
    if table == "lens":
        section = need(rig.lens, table)
        stand.lens = TunableLens.open(str(section.port), section.firmware)
        stand.closers.append(stand.lens.close)
        stand.lens.focal_power_mode()
    elif table == "camera":
        section = need(rig.camera, table)
        stand.camera = GenicamCamera.open(str(section.producer), section.serial)
        stand.closers.append(stand.camera.close)
        stand.camera.expose(1e6 * section.exposure)
    elif table == "camera_stage":
        stand.stage = _stage(need(rig.camera_stage, table))
        stand.closers.append(stand.stage.close)
    elif table == "photodiode":
        section = need(rig.photodiode, table)
        stand.meter = PowerMeter.open(str(section.port))
        stand.closers.append(stand.meter.close)
        if section.wavelength is not None:
            stand.meter.wavelength(section.wavelength)
        stand.meter.average(section.average)


def _stage(section: CameraStageSection) -> Stage:
    if section.driver == "standa":
        from vamgpu.hosts.drivers.standa import StandaStage

        return StandaStage.open(str(section.port), section.microsteps / STANDA_FRACTION, "mm", STANDA_FRACTION)
    from vamgpu.hosts.drivers.zaber import ZaberStage

    return ZaberStage.open(str(section.port), section.microsteps, "mm", section.device, section.axis)


def rehearsal(config: RigConfig, tables: Collection[str], truth: Any = None) -> tuple[Stand, Any]:
    """Emulated machines of a rig, and the optics they stand in; ``truth`` is of `vamgpu.hosts.emulators.optics`.

    Raises `JobError` for a table that is missing.
    """
    from vamgpu.hosts.emulators.laboratory import Laboratory
    from vamgpu.hosts.emulators.optics import Optics

    rig = config.wanted
    checked(rig, tables)
    laboratory = Laboratory(truth or Optics(), rig, channels(rig))
    stand = Stand(rig, laboratory.clock, laboratory.controller(), (), channels(rig))
    stand.closers.append(stand.controller.close)
    for section, dmd in zip(rig.projector, laboratory.mirrors(), strict=True):
        stand.closers.append(dmd.close)
        stand.screens += (Screen(dmd, section.picture),)
    stand.lens = laboratory.lens() if "lens" in tables else None
    stand.camera = laboratory.camera() if "camera" in tables else None
    stand.stage = laboratory.stage() if "camera_stage" in tables else None
    stand.meter = laboratory.meter() if "photodiode" in tables else None
    return stand, laboratory.optics
