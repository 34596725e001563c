"""Jobs on a rig, before any machine is touched: time, mirrors and focus of every frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from math import ceil, floor
from pathlib import Path
from typing import Any, Literal

import numpy as np

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, StorageError
from vamgpu.hosts.frames.sources import FrameSource, MirrorArray
from vamgpu.hosts.player.exposure import StopRule
from vamgpu.hosts.player.rows import steppable
from vamgpu.hosts.rigs.calibrations import MachineCalibration, calibration_of
from vamgpu.hosts.rigs.config import RigConfig
from vamgpu.hosts.rigs.guarantees import Guarantees, accepted, driver_of, guarantees, part, refused
from vamgpu.hosts.rigs.jobs import Kind, PrintJob, print_job
from vamgpu.hosts.rigs.slots import frame_times, mirror_arrays, triggered_schedule, whole_poses
from vamgpu.hosts.rigs.turns import CLOSE, Turning, proved
from vamgpu.hosts.schedules.limits import HdmiTiming
from vamgpu.hosts.schedules.schedule import Schedule
from vamgpu.hosts.schedules.timing import SECOND, every, whole
from vamgpu.hosts.schedules.video import vial, web_on_cable
from vamgpu.jobs.run import Proven, prove
from vamgpu.optics.lens import TunableLens
from vamgpu.printing.exposure import USUAL
from vamgpu.printing.given_dose import GivenDose, ProvedDose
from vamgpu.quantity import counted, parse
from vamgpu.travel import Travel
from vamgpu.units import deg

HOUR = 3600.0
NEAR = 10  # greatest ratio of a speed that is suggested to the wanted one
UNITS: dict[Kind, str] = {"vial": "deg/s", "web": "mm/s", "slices": "mm/h"}  # unit of a speed that is a plain number


@dataclass(frozen=True, eq=False)
class PrintPlan:
    """Jobs on a rig, with the schedule that prints them.

    Attributes:
        jobs: One `PrintJob` for each projector.
        schedule: Time, position and frame of every slot.
        mirrors: Rows and columns of the mirrors of each projector.
        rig: The rig.
        focus: Power of the lens in each focus plane [dpt]; empty without a lens.
        display: Timing of the video cable; None for mirrors behind a trigger.
        rehearsed: Whether the machines are emulated.
        calibration: The rig's calibrations, as applied to frames and lens.
        stop: Scatter at which the print ends, see `vamgpu.hosts.rig.stopping`; None runs all turns.
        dose: Dose of a vial relative to the proved dose; None if it is not known.
        proven: Proof from planning, for a vial on emulated machines, else None.
    """

    jobs: tuple[PrintJob, ...]
    schedule: Schedule
    mirrors: tuple[MirrorArray, ...]
    rig: RigConfig
    focus: tuple[float, ...] = ()
    display: HdmiTiming | None = None
    rehearsed: bool = False
    stop: StopRule | None = None
    calibration: MachineCalibration = MachineCalibration()
    dose: GivenDose | None = None
    proven: Proven | None = None

    @property
    def kind(self) -> Kind:
        """The kind of motion."""
        return self.jobs[0].kind

    @property
    def guarantees(self) -> Guarantees:
        """The rig's guarantees at the plan's speed, with those that do not hold."""
        found = guarantees(self.rig.setup, float(self.schedule.speed), self.schedule.unit)
        if (path := self.jobs[0].travel) is not None:
            found = replace(found, each=(*found.each, part(self.rig.setup, bool(path.rows))))
        if not self.rehearsed:
            return found
        lens = len(self.focus) > 1  # no lens is emulated for one focus, and no LEDs of projectors
        each = (replace(one, kind="believed", sensor="") if one.sensor == "lamp" else one for one in found)
        return replace(found, each=tuple(one for one in each if lens or one.about != "lens"))

    @property
    def bits(self) -> int:
        """Bits of the frames."""
        return self.jobs[0].bits

    def sources(self) -> tuple[FrameSource, ...]:
        """The frames of each projector."""
        return tuple(each.source(mirrors) for each, mirrors in zip(self.jobs, self.mirrors, strict=True))

    def faults(self) -> str:
        """Faults of a vial's print according to its proof; empty if it prints, or there is no proof."""
        if self.dose is not None:
            return "" if self.dose.proved.right else self.dose.proved.faults
        if self.kind == "vial" and len(self.jobs) == 1:
            with suppress(StorageError):  # frames without a part
                return "; ".join(fault.said for fault in prove(self.jobs[0].path).proof.verdict.faults)
        return ""

    def lines(self) -> tuple[tuple[str, str], ...]:
        """Name and value of each line shown before a print."""
        table, shape = self.schedule, self.jobs[0].shape
        planes = len(self.jobs[0].depths)
        focus = ", ".join(f"{power:.3f}" for power in self.focus) + " dpt"
        unit, speed = UNITS[self.kind], float(table.speed) * (HOUR if self.kind == "slices" else 1.0)
        rows = (
            ("frames", f"{len(table)} of {shape[0]} × {shape[1]}, {self.bits} bits, {table.frames} different"),
            ("machines", "emulated: no real machine moves or shines" if self.rehearsed else ""),
            ("projectors", f"{len(self.jobs)} in step" if len(self.jobs) > 1 else ""),
            ("focus planes", f"{planes} at {focus}" if self.focus else ""),
            ("duration", f"{table.duration * 1e-9:.2f} s at {speed:.4g} {unit}"),
            ("rate", f"{table.rate:.4g} frames/s, lit {100 * table.duty:.1f} % of the time"),
            ("light per frame", f"{int(table.on[0]) * 1e-6:.3f} ms"),
            ("memory", f"{self.bits * len(table)} bit planes in total" if self.display is None else ""),
            ("calibrations", ", ".join(self.calibration.used.values())),
            ("stop", "" if self.stop is None else f"at scatter density {self.stop.threshold:g}, or after its turns"),
            *self._exposure(),
        )
        claims = ((one.about, f"{one.kind}: {one.why}") for one in self.guarantees)
        notes = (("note", note) for note in self.calibration.notes)
        return (*(row for row in rows if row[1]), *claims, *notes)

    def _exposure(self) -> tuple[tuple[str, str], ...]:
        """Turns of a vial, and their dose."""
        if self.kind != "vial":
            return ()
        turns, dose = counted(self.schedule.turns, "turn"), self.dose
        shown = f"{turns} in {self.schedule.duration / SECOND:.2f} s"
        if self.stop is not None:
            return (("exposure", f"at most {shown}"),)
        if dose is None:
            return (("exposure", shown), ("dose", "not known: this job has no proof with its exposure"))
        light = dose.share * dose.proved.seconds
        return (
            ("exposure", f"{shown}, with {light:.3g} s of full light"),
            ("dimmed", dose.dimming if dose.lit < 1.0 else ""),
            ("dose", str(dose)),
            ("proof", "" if dose.proved.right else f"does not print: {dose.proved.faults}"),
        )


def plan(
    jobs: str | Path | Sequence[str | Path], rig: RigConfig, *, speed: float | Fraction | str | None = None,
    turns: int | None = None, rehearsed: bool = False, device: str | Device | None = None,
    exposure: ProvedDose | Literal[False] | None = None,
) -> PrintPlan:  # fmt: skip
    """Plan jobs on a rig, one for each projector, without touching a machine.

    Args:
        jobs: Folder of the job, or one folder for each projector: all for vials, all for webs, or all of slices.
        rig: The rig, from `read_rig`.
        speed: A number in deg/s for vials, mm/s for webs, mm/h for slices, or text with its unit, such as "9 rpm". None
            takes 40 deg/s for vials, on a video cable the fastest lower speed at which images take whole slots and
            whole turns give the proved dose; for others the speed of the job.
        turns: Turns of a vial, at the full light of the rig; 1 for all others. None takes as many as the proved
            exposure needs, dimmed to give the proved dose.
        rehearsed: Plan for emulated machines as large as the job, on any rig.
        device: Device that packs the frames, or its name; None takes the best one, and NumPy for emulated machines.
        exposure: Proved dose of a vial, if known; None proves the job, which takes the time of `vam prove`. False
            leaves the dose unknown.

    Returns:
        The plan. Its `PrintPlan.dose` is the dose of a vial.

    Raises:
        StorageError, SliceError: A folder holds no complete job.
        BadInput: The jobs do not fit the rig or each other, or a number is out of range; or without ``turns``, no whole
            number of turns gives a dose at which the verdict of the proof holds, or the exposure is not known.
        TimingInfeasible: The speed is too high; the message gives the limit and the greatest speed.

    Warns:
        DoseWarning: ``turns`` give a dose at which the verdict of the proof does not hold.
    """
    if not isinstance(rig, RigConfig):
        raise BadInput(f'rig is {rig!r}; expected a rig from read_rig, such as read_rig("lab.toml")')
    rehearsed = rehearsed or rig.setup.emulated
    calibration = calibration_of(rig)
    rig = calibration.motion(rig)
    loaded = _loaded(jobs, rig, calibration, device or ("numpy" if rehearsed else None))
    if turns is not None:
        whole("turns", turns)
    first, speeds = loaded[0], ()
    going, focus = speed_of(speed, first.kind, first.speed), _focus(first, rig, calibration)
    free = speed is None and (first.travel is None or first.travel.period is None)
    if first.travel is not None:
        going, rig = _along(first.travel, rig, speed, going, turns)
    of: Callable[[float, int], Schedule]
    if rig.setup.video:
        mirrors, display = _screen(first, rig, rehearsed)
        of, least = partial(_on_a_cable, first, rig, display), None
        if first.kind == "vial":
            speeds = _cable_speeds(first.poses, going, display, rig)
            usual = (each for each in sorted(speeds, reverse=True) if free and each <= going)
            going = next(usual, going)
    else:
        mirrors, display = mirror_arrays(loaded, rig, rehearsed), None
        of = partial(triggered_schedule, first, rig, mirrors=mirrors, focus=focus)
        least = round(max(times[first.bits] for times, _ in frame_times(rig, len(mirrors))) * SECOND)
        if driver_of(rig.setup.clock) == "stage":
            whole_poses(of(going, 1), rig.setup.motion.microsteps)
        elif not rehearsed:
            steppable(of(going, 1), rig.setup.motion.microsteps)
    accepted(rig.setup, going, "deg" if first.kind == "vial" else "mm")
    dose: GivenDose | None = None
    taken: list[Proven] = []
    if first.frames is None:
        schedule = of(going, 1 if turns is None else turns)
    else:
        known = partial(_known, exposure, partial(proved, loaded, turns, going, device), taken)
        turning = Turning(of, going, rig.setup.light, first.frames.scale, least, speeds, free, first.travel)
        schedule, dose = turning.schedule(turns if first.travel is None else None, known)
        if first.travel is not None:  # each slot has a frame of its own
            schedule = replace(schedule, frame=schedule.pose, frames=len(schedule))
    return PrintPlan(
        loaded, schedule, mirrors, rig, focus if display is None else (), display, rehearsed, calibration=calibration,
        dose=dose, proven=taken[0] if rehearsed and taken else None,
    )  # fmt: skip


def _loaded(
    jobs: str | Path | Sequence[str | Path], rig: RigConfig, calibration: MachineCalibration,
    device: str | Device | None,
) -> tuple[PrintJob, ...]:  # fmt: skip
    """The jobs, corrected for the rig's projectors. Raises `BadInput` for those that it cannot print together."""
    paths = (jobs,) if isinstance(jobs, (str, Path)) else every("jobs", jobs)
    if wrong := [path for path in paths if not isinstance(path, (str, Path))]:
        raise BadInput(f"a job is {wrong[0]!r}; expected the path of its folder")
    loaded = tuple(print_job(path, device, calibration, number) for number, path in enumerate(paths))
    _alike(loaded, rig)
    return loaded


def _known(
    exposure: ProvedDose | Literal[False] | None, proving: Callable[[], Proven | str], taken: list[Proven]
) -> ProvedDose | str:  # fmt: skip
    """The proved dose of a vial, or why it is not known; a new proof is appended to ``taken``."""
    if exposure is False:
        return "the dose was left out (exposure=False)"
    if exposure is not None:
        return exposure
    if isinstance(found := proving(), str):
        return found
    taken.append(found)
    return ProvedDose.of(found.proof)


def _alike(loaded: tuple[PrintJob, ...], rig: RigConfig) -> None:
    """Raise `BadInput` for jobs that the rig cannot print, or cannot print together."""
    setup, names = rig.setup, {"vial": "vials", "web": "webs"}
    if not loaded:
        raise BadInput("there is no job; expected a folder for each projector")
    if len(loaded) != len(setup.display) and not setup.emulated:
        raise BadInput(
            f"got {counted(len(loaded), 'job')} for the {counted(len(setup.display), 'projector')} of the rig "
            f"{setup.rig.name!r}; expected one for each, in their order"
        )
    for each in loaded:
        if setup.rig.machine not in ("any", each.kind):
            machine, kind = (names.get(name, name) for name in (setup.rig.machine, each.kind))
            raise BadInput(
                f"the rig {setup.rig.name!r} prints {machine}, {each.path!r} is for {kind}; choose another rig, or "
                "check the path"
            )
    first = loaded[0]
    for other in loaded[1:]:
        for what, one, two in (
            ("kind", first.kind, other.kind), ("number of poses", first.poses, other.poses),
            ("angles", first.motion, other.motion), ("path of the part", first.travel, other.travel),
            ("bits", first.bits, other.bits), ("travel from pose to pose [mm]", first.advance, other.advance),
            ("focus planes [mm]", first.depths, other.depths), ("speed [mm/s]", first.speed, other.speed),
        ):  # fmt: skip
            if one != two:
                raise BadInput(
                    f"jobs that are printed together must have the same {what}; {first.path!r} has {one}, "
                    f"{other.path!r} has {two}: solve them with the same"
                )


def _along(
    path: Travel, rig: RigConfig, speed: float | Fraction | str | None, going: float, turns: int | None
) -> tuple[float, RigConfig]:  # fmt: skip
    """Speed [deg/s] and rig for a part that moves, which has a lift or does not wait. Raises `BadInput`."""
    usual, setup = going if path.period is None else 360.0 / path.period, rig.setup
    if turns not in (None, path.turns) or (speed is not None and abs(going / usual - 1.0) > CLOSE):
        shown, own = (counted(count, "turn") for count in (turns or path.turns, path.turns))
        raise BadInput(f"got {shown} at {going:.6g} deg/s for a part that moves; expected its {own} at {usual:.6g} "
                       "deg/s: leave out --turns and --speed, or change [travel] and solve again")  # fmt: skip
    if path.rows and setup.lift is None:
        raise BadInput(f"the job is for a vial that rises through the image, and the rig {setup.rig.name!r} has no "
                       "[lift]; add the linear stage that raises it, or print a lower part")  # fmt: skip
    if not path.rows:
        setup = setup.model_copy(update={"safety": setup.safety.model_copy(update={"resume": 0.0})})
    return usual, replace(rig, setup=setup)


def speed_of(speed: float | Fraction | str | None, kind: Kind, usual: float | None = None) -> float:
    """Speed in deg/s or mm/s; None takes the usual one. Raises `BadInput`."""
    unit = UNITS[kind]
    if speed is None:
        going = USUAL if kind == "vial" else usual
        if going is None:
            raise BadInput(f"the job has no speed; give one in {unit} with --speed (speed= in Python)")
        return going
    text = str(float(speed) if isinstance(speed, Fraction) else speed)
    with suppress(ValueError):  # text with a unit
        if 0 < float(text) < np.inf:
            return float(text) / (HOUR if kind == "slices" else 1.0)
    try:
        if kind == "vial":
            return float(f"{parse(text, 'an angular speed') / deg:.12g}")
        return parse(text, "a speed")
    except ValueError as error:
        raise BadInput(f"speed is {speed!r}: {error}, or a plain number of {unit}") from error


def _focus(first: PrintJob, rig: RigConfig, calibration: MachineCalibration) -> tuple[float, ...]:
    """Powers of the lens [dpt] that focus on a job's planes."""
    lens = rig.setup.lens
    if not first.depths or (lens is None and len(first.depths) == 1):
        return ()
    if lens is None:
        raise BadInput(
            f"{first.path!r} changes its focus among {len(first.depths)} planes, and the rig {rig.setup.rig.name!r} "
            "has no lens; add a table [lens], or solve the job with lens.bins = 1"
        )
    slope = lens.slope or TunableLens(focal=lens.focal, index=first.bath).slope
    axis, slope = calibration.lens or (lens.axis, slope)
    powers = tuple(round(axis + depth / slope, 6) for depth in first.depths)
    if lens.controlled_by == "host" and len(powers) > 1:
        raise BadInput(
            f"{first.path!r} changes its focus among {len(powers)} planes in time with its frames, and the host sets "
            'only one before the print; set controlled_by = "controller" in [lens], or solve the job with lens.bins = 1'
        )
    if not lens.lowest <= min(powers) <= max(powers) <= lens.highest:
        raise BadInput(
            f"the focus planes of {first.path!r} need powers from {min(powers):.4g} to {max(powers):.4g} dpt; the lens "
            f"has {lens.lowest:g} to {lens.highest:g} dpt: check axis, slope, lowest and highest in [lens]"
        )
    return powers


def _screen(first: PrintJob, rig: RigConfig, rehearsed: bool) -> tuple[tuple[MirrorArray, ...], HdmiTiming]:
    """The mirrors of a video projector and the timing of its cable."""
    section: Any = rig.setup.display[0]  # on a cable, or emulated, which can be of either kind
    rows, columns = first.shape if rehearsed else section.array
    screen = MirrorArray(rows, columns, columns)
    screen.place(*first.shape)
    display = HdmiTiming(
        refresh=section.refresh, bits=section.bits, latency=section.latency, pixels=(columns, rows),
        slots=section.layout.slots, dark=section.dark, exposures=section.shortest,
    )  # fmt: skip
    return (screen,), display


def _cable_speeds(images: int, wanted: float, display: HdmiTiming, rig: RigConfig) -> tuple[float, ...]:
    """Speeds [deg/s] at which images take whole slots and the rig does not drift too far, the nearest first."""
    most = Fraction(360, images) * display.slot_rate  # one slot for each
    counts = range(max(1, ceil(most / (NEAR * Fraction(wanted)))), floor(NEAR * most / Fraction(wanted)) + 1)
    found = sorted((float(f"{float(most / count):.6g}") for count in counts), key=lambda speed: abs(speed - wanted))
    return tuple(speed for speed in found if not refused(guarantees(rig.setup, speed), rig.setup))


def _on_a_cable(first: PrintJob, rig: RigConfig, display: HdmiTiming, speed: float, turns: int) -> Schedule:
    """A vial or web in front of a video projector."""
    common: dict[str, Any] = {"speed": speed, "display": display, "power": rig.setup.light.power}
    if first.advance is None:
        return vial(first.turn, turns=turns, **common)
    if turns != 1:
        raise BadInput(f"turns is {turns}; expected 1, because only vials have several turns")
    return web_on_cable(first.poses, advance=first.advance, **common)
