"""The real machines of a rig, opened and checked before any light; nothing stands in for one that is missing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from vamgpu.errors import DeviceRefused, WrongDevice
from vamgpu.hosts.calibrating.sections import CameraSection
from vamgpu.hosts.clock import RealClock
from vamgpu.hosts.drivers.camera import Camera
from vamgpu.hosts.drivers.lens import TunableLens
from vamgpu.hosts.drivers.stage import Stage
from vamgpu.hosts.players.cable import VideoMachines
from vamgpu.hosts.players.mirrors import Machines
from vamgpu.hosts.rigs.closing import let_go
from vamgpu.hosts.rigs.config import RigConfig
from vamgpu.hosts.rigs.sections import ORDERS, LensRigSection, ProjectorSection, StageSection

if TYPE_CHECKING:
    from vamgpu.hosts.drivers.projector import HdmiProjector


def opened(rig: RigConfig, camera: bool = False) -> Machines | VideoMachines:
    """The real machines of a rig; ``camera``: also the one that watches the resin.

    Raises `DeviceNotFound`, `DeviceBusy`, `WrongDevice`; nothing stands in for them.
    """
    from vamgpu.hosts.drivers.controller import Controller
    from vamgpu.hosts.drivers.dmd import Dmd

    wanted, held = rig.wanted, []
    try:
        controller = Controller.open(str(wanted.controller.port), wanted.controller.microsteps, wanted.controller.baud)
        held.append(controller)
        if wanted.controller.ramp is not None:
            controller.ramp(wanted.controller.ramp)
        if wanted.stage is not None and wanted.video:
            held.append(_stage(wanted.stage))
            held.append(_screen(wanted.projector[0]))
            watching = _camera(wanted.camera) if camera and wanted.camera is not None else None
            return VideoMachines(RealClock(), controller, held[1], held[2], watching)
        lens = None if wanted.lens is None else _lens(wanted.lens)
        held += [] if lens is None else [lens]
        mirrors = []
        for each in wanted.projector:
            mirrors.append(Dmd.open(str(each.library), each.serial, each.array))
            held.append(mirrors[-1])
        watching = _camera(wanted.camera) if camera and wanted.camera is not None else None
    except BaseException:
        let_go([each.close for each in held])
        raise
    return Machines(RealClock(), controller, mirrors, wanted.controller.microsteps, lens, watching)


def _stage(wanted: StageSection) -> Stage:
    if wanted.driver == "standa":
        from vamgpu.hosts.drivers.standa import StandaStage

        return StandaStage.open(str(wanted.port), wanted.steps)
    from vamgpu.hosts.drivers.zaber import ZaberStage

    return ZaberStage.open(str(wanted.port), wanted.steps, "deg", wanted.device, wanted.axis)


def _screen(wanted: ProjectorSection) -> HdmiProjector:
    from vamgpu.hosts.drivers.projector import HdmiProjector, PygletWindow
    from vamgpu.hosts.protocols.slots import SlotLayout

    colors = {"red": 0, "green": 1, "blue": 2}
    layout = SlotLayout(tuple(colors[name] for name in wanted.order or ORDERS[wanted.bits]), wanted.bits)
    return HdmiProjector(PygletWindow(wanted.screen, wanted.array, wanted.refresh), layout, wanted.latency)


def _camera(wanted: CameraSection) -> Camera:
    from vamgpu.hosts.drivers.camera import GenicamCamera

    return GenicamCamera.open(str(wanted.producer), wanted.serial)


def _lens(wanted: LensRigSection) -> TunableLens:
    """A lens that is what the rig's file says, in its mode, and reaches the powers that it may be told."""
    lens = TunableLens.open(str(wanted.port), wanted.firmware)
    try:
        found = lens.focal_power_mode()
        if not found.least <= wanted.lowest < wanted.highest <= found.greatest:
            raise WrongDevice(
                f"the lens guarantees {found.least:.4g} to {found.greatest:.4g} dpt, the rig's file wants "
                f"{wanted.lowest:g} to {wanted.highest:g} dpt; correct lowest and highest in [lens], or warm it up"
            )
        if said := lens.status():
            raise DeviceRefused(f"the lens is not ready: {', '.join(said)}", "status")
    except BaseException:
        lens.close()
        raise
    return lens


def close(machines: Machines | VideoMachines) -> None:
    """Let go of all machines, a camera and the mirrors first."""
    watching = [] if machines.camera is None else [machines.camera]
    if isinstance(machines, VideoMachines):
        held: list[Any] = [machines.controller, machines.stage, machines.projector, *watching]
    else:
        held = [machines.controller, *([] if machines.lens is None else [machines.lens]), *machines.mirrors, *watching]
    let_go([each.close for each in held])
