"""Machines of calibrations: those of a rig's file, or emulated ones before emulated optics, whose truth is known."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import Any

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.hosts.calibrating.machines import CalibrationMachines, SteppedTurntable, need
from vamgpu.hosts.calibrating.patterns import PatternScreen
from vamgpu.hosts.calibrating.report import CalibrationResult
from vamgpu.hosts.clock import RealClock
from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.drivers.scpi import PowerMeter
from vamgpu.hosts.drivers.stages import Stage
from vamgpu.hosts.rigs.config import RigConfig, RigFile
from vamgpu.hosts.rigs.guarantees import driver_of
from vamgpu.hosts.rigs.sections import CameraStageSection

STANDA_FRACTION = 256  # microsteps of a full step


def checked(rig: RigFile, tables: Collection[str]) -> None:
    """Raises `JobError` naming the first of the tables that the rig has not, before any machine is opened."""
    for table in tables:
        need(getattr(rig, table), table)


def channels(rig: RigFile) -> tuple[int, ...]:
    """The controller's channel of light of each projector."""
    return tuple(range(len(rig.display)))


def opened(config: RigConfig, tables: Collection[str]) -> CalibrationMachines:
    """The real machines of a rig: controller, mirrors, and those of the tables; nothing stands in for them.

    Raises `JobError` for a table that is missing, `DeviceNotFound`, `DeviceBusy`, `WrongDevice`.
    """
    rig = config.setup
    checked(rig, tables)
    if rig.video or rig.controller is None:
        raise BadInput(
            "calibrations show patterns on mirrors with a trigger, behind a controller; expected displays with driver "
            '"alp", and a table [controller]'
        )
    stepping = driver_of(rig.motion) == "controller"
    microsteps = rig.motion.microsteps if stepping else 1.0
    controller = Controller.open(str(rig.controller.port), microsteps, rig.controller.baud)
    machines = CalibrationMachines(rig, RealClock(), controller, (), channels(rig), closers=[controller.close])
    try:
        for section in rig.display:
            dmd = section.open()
            machines.closers.append(dmd.close)
            machines.screens += (PatternScreen(dmd, section.frame_time),)
        for table in tables:
            _open(machines, table)
    except BaseException:
        machines.close()
        raise
    return machines


def _open(machines: CalibrationMachines, table: str) -> None:
    rig = machines.rig
    if table == "lens":
        machines.lens = need(rig.lens, table).open()
        machines.closers.append(machines.lens.close)
    elif table == "camera":
        section = need(rig.camera, table)
        machines.camera = section.open()
        machines.closers.append(machines.camera.close)
        machines.camera.expose(1e6 * section.exposure)
    elif table == "camera_stage":
        machines.stage = _stage(need(rig.camera_stage, table))
        machines.closers.append(machines.stage.close)
    elif table == "motion":
        if driver_of(rig.motion) == "controller":
            machines.turntable = SteppedTurntable(machines.controller, machines.clock)
        else:
            stage = rig.motion.open("deg")
            machines.closers.append(stage.close)
            machines.turntable = stage
    elif table == "photodiode":
        section = need(rig.photodiode, table)
        machines.meter = PowerMeter.open(str(section.port))
        machines.closers.append(machines.meter.close)
        if section.wavelength is not None:
            machines.meter.wavelength(section.wavelength)
        machines.meter.average(section.average)


def _stage(section: CameraStageSection) -> Stage:
    if section.driver == "standa":
        from vamgpu.hosts.drivers.stages import StandaStage

        return StandaStage.open(str(section.port), section.microsteps / STANDA_FRACTION, "mm", STANDA_FRACTION)
    from vamgpu.hosts.drivers.stages import ZaberStage

    return ZaberStage.open(str(section.port), section.microsteps, "mm", section.device, section.axis)


def rehearsal(
    config: RigConfig, tables: Collection[str], truth: Any = None, *, kind: str = "axis"
) -> tuple[CalibrationMachines, Any]:
    """Emulated machines of a rig, and their optics; truth: `Optics`, by default the usual ones of a kind.

    Raises `JobError` for a table that is missing.
    """
    from vamgpu.hosts.emulators.calibration import EmulatedCalibrationRig, Optics

    rig = config.setup
    checked(rig, tables)
    usual = {
        "flat": Optics(radius=0.0, tilt=0.03, falloff=0.1), "runout": Optics(radius=0.0, pin=9.0),
    }.get(kind, Optics())  # fmt: skip
    emulated = EmulatedCalibrationRig(truth or usual, rig, channels(rig))
    machines = CalibrationMachines(rig, emulated.clock, emulated.controller(), (), channels(rig))
    machines.closers.append(machines.controller.close)
    for section, dmd in zip(rig.display, emulated.mirrors(), strict=True):
        machines.closers.append(dmd.close)
        machines.screens += (PatternScreen(dmd, section.frame_time),)
    machines.lens = emulated.lens() if "lens" in tables else None
    machines.camera = emulated.camera() if "camera" in tables else None
    machines.stage = emulated.stage() if "camera_stage" in tables else None
    machines.turntable = SteppedTurntable(machines.controller, emulated.clock) if "motion" in tables else None
    machines.meter = emulated.meter() if "photodiode" in tables else None
    return machines, emulated.optics


HIGHEST = 100.0  # frequency up to which the truth is looked at [1/mm]
Truth = tuple[dict[str, Any], list[tuple[str, str]]]
"""Of emulated optics: numbers of a result's table, and lines for people."""


def compared(found: CalibrationResult, optics: Any, machines: CalibrationMachines) -> CalibrationResult:
    """The same with the emulated truth: a table ``emulated``, and lines. optics: `Optics`."""
    known = {"focus": _focus, "axis": _axis, "gray": _gray, "mtf": _mtf, "flat": _flat, "runout": _runout}
    truth, lines = known[found.kind](found, optics, machines)
    return replace(found, lines=(*found.lines, *lines), tables={**found.tables, "emulated": truth})


def _focus(found: CalibrationResult, optics: Any, machines: CalibrationMachines) -> Truth:
    power = -optics.middle / optics.slope
    truth = {"slope_mm_dpt": optics.slope, "axis_dpt": power}
    return truth, [("emulated", f"{optics.slope:.3f} mm/dpt, {power:.4f} dpt at the middle")]


def _axis(found: CalibrationResult, optics: Any, machines: CalibrationMachines) -> Truth:
    truth = {"column": optics.axis, "radius_columns": optics.radius}
    return truth, [("emulated", f"column {optics.axis:.3f}, radius {optics.radius:.3f} columns")]


def _gray(found: CalibrationResult, optics: Any, machines: CalibrationMachines) -> Truth:
    lit = round(1e6 * machines.screens[0].period)
    curve = found.tables["gray"]
    light = np.array([optics.gray(level, lit) for level in curve["levels"]])
    off = float(np.abs(light / light[-1] - np.array(curve["intensity"])).max())
    truth = {"black": float(light[0] / light[-1]), "largest_error": off}
    return truth, [("emulated", f"black {100 * truth['black']:.3f} %, largest error of a level {100 * off:.2g} %")]


def _flat(found: CalibrationResult, optics: Any, machines: CalibrationMachines) -> Truth:
    true = optics.flat() / optics.flat().max()
    off = float(np.abs(found.readings["flat_0"] - true).max())
    truth = {"dimmest": float(true.min()), "largest_error": off}
    return truth, [("emulated", f"dimmest {100 * true.min():.2f} %, largest error of a mirror {100 * off:.2g} %")]


def _runout(found: CalibrationResult, optics: Any, machines: CalibrationMachines) -> Truth:
    truth = {"column": optics.axis, "lean": optics.lean, "across": optics.across, "tilt": optics.wobble}
    out, wobble = (float(np.hypot(*each)) for each in (optics.across, optics.wobble))
    edge = 0.5 * optics.mirrors[0]
    return truth, [("emulated", f"column {optics.axis:.3f}, pin {out:.3f}, wobble {edge * wobble:.3f} columns")]


def _mtf(found: CalibrationResult, optics: Any, machines: CalibrationMachines) -> Truth:
    frequency = np.linspace(0.0, HIGHEST, 20001)
    places = found.numbers["positions_mm"]
    powers = found.numbers["powers_dpt"] or [0.0] * len(places)
    pixel = found.numbers["pixel_mm"]
    half = [
        float(frequency[np.argmax(optics.modulation(frequency, place, power, pixel) < 0.5)])
        for place, power in zip(places, powers, strict=True)
    ]
    return {"mtf50_per_mm": half}, [("emulated", ", ".join(f"{each:.3g}" for each in half) + " cycles/mm")]
