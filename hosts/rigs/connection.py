"""The real machines of a rig, opened and checked before any light; a missing machine is never emulated."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

from vamgpu.hosts.drivers.cleanup import close_all
from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.player.machines import Machines, MirrorMachines, StageMachines, VideoMachines
from vamgpu.hosts.rigs.config import RigConfig, RigFile
from vamgpu.hosts.rigs.guarantees import driver_of
from vamgpu.hosts.schedules.clock import RealClock

Machine = TypeVar("Machine")


def opened(rig: RigConfig, camera: bool = False, focus: Sequence[float] = ()) -> Machines:
    """Open the real machines of a rig. No emulator replaces a machine that is missing.

    Args:
        rig: The rig, from `read_rig`.
        camera: Also open the camera that watches the resin.
        focus: Lens powers of the plan [dpt]; a lens controlled by the host gets the only one, or that of the axis.

    Returns:
        The machines; release them with `close`.

    Raises:
        DeviceNotFound: A machine is missing.
        DeviceBusy: Another program uses it.
        WrongDevice: The machine that answers is not that of the rig file.
        DeviceRefused: A machine is not ready.
    """
    held: list[Any] = []

    def hold(machine: Machine) -> Machine:
        held.append(machine)
        return machine

    try:
        machines = _opened(rig.setup, camera, hold)
        lens = rig.setup.lens
        if lens is not None and lens.controlled_by == "host":
            assert machines.lens is not None
            machines.lens.set_power(focus[0] if focus else lens.axis)
        return machines
    except BaseException:
        close_all([each.close for each in held])
        raise


def _opened(setup: RigFile, camera: bool, hold: Any) -> Machines:
    """Each part opens its own machine; ``hold`` closes the earlier ones if a later one fails."""
    measuring = {driver_of(each): each for each in setup.feedback if each.sees == "motion"}
    motion, stepping = setup.motion, driver_of(setup.motion) == "controller"
    controller = None
    if setup.controller is not None:
        port, microsteps = str(setup.controller.port), motion.microsteps if stepping else 1.0
        controller = hold(Controller.open(port, microsteps, setup.controller.baud))
    lamp = setup.light.open()
    hold(lamp) if lamp is not None else None
    if stepping:
        assert controller is not None
        if motion.ramp is not None:
            controller.ramp(motion.ramp)
        controller.feedback(**{name: each.sensor() for name, each in measuring.items()})
        stage = None
    else:
        pin = {"pin": measuring["index"].pin} if "index" in measuring else {}
        stage = hold(motion.open("deg" if setup.rig.machine == "vial" else "mm", **pin))
    lift = None if setup.lift is None else hold(setup.lift.open("mm"))
    lens = None if setup.lens is None else hold(setup.lens.open())
    shown = [hold(each.open()) for each in setup.display]
    if setup.light.gate == "display" and setup.display[0].lamps:
        lamp = shown[0].lamp
    watching = hold(setup.camera.open()) if camera and setup.camera is not None else None
    if setup.video:
        assert stage is not None
        return VideoMachines(RealClock(), controller, stage, shown[0], watching, lamp, lens, lift)
    if stage is not None:
        return StageMachines(RealClock(), stage, shown, motion.microsteps, controller, lamp, lens, watching, lift)
    assert controller is not None
    return MirrorMachines(RealClock(), controller, shown, motion.microsteps, lens, watching, lift)


def close(machines: Machines) -> None:
    """Release all machines, the last opened first, even if one fails.

    Args:
        machines: The machines from `opened` or `rehearsal`.

    Raises:
        DeviceError: The first failure; the other machines are closed anyway.
    """
    names = ("controller", "lamp", "stage", "lift", "lens", "projector", "mirrors", "camera")
    found: list[Any] = [getattr(machines, name, None) for name in names]
    each = [machine for one in found for machine in (one if isinstance(one, (list, tuple)) else [one])]
    close_all([machine.close for machine in each if hasattr(machine, "close")])
