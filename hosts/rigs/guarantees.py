"""Guarantees of a rig, derived from its roles: guaranteed, watched or only believed; or why the rig is rejected."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from math import ceil, floor, log10
from typing import TYPE_CHECKING, Any, Literal

from vamgpu.errors import BadInput
from vamgpu.schema.registry import name_of
from vamgpu.schema.section import Misplaced

if TYPE_CHECKING:
    from vamgpu.hosts.rigs.config import RigFile

MINUTE = 60.0
SLACK = 1e-9  # relative tolerance of compared drifts, for rounding

Kind = Literal["guaranteed", "watched", "believed", "not there"]
"""By the machine itself; by a sensor that is asked during the print; by the rig's file alone; or absent."""


@dataclass(frozen=True)
class Guarantee:
    """One condition of a print, and what ensures it."""

    about: str  # step, display, position, scale, light, lease, interlock, lamp, lens or part
    kind: Kind
    why: str  # the reason, in words
    remedy: str = ""  # how to guarantee it
    sensor: str = ""  # the machine whose answers show it; empty if none does

    @property
    def holds(self) -> bool:
        """Whether a machine guarantees or watches it."""
        return self.kind in ("guaranteed", "watched")

    def __str__(self) -> str:
        return f"{self.kind}: {self.why}{f'; {self.remedy}' if self.remedy else ''}"

    def record(self) -> dict[str, Any]:
        """For the record of a run."""
        return asdict(self) | {"holds": self.holds}


@dataclass(frozen=True)
class Guarantees:
    """A rig's guarantees at a speed, with those that do not hold."""

    each: tuple[Guarantee, ...]
    drift: float  # drift of frames against motion [deg/min] or [mm/min]

    def __iter__(self) -> Any:
        return iter(self.each)

    @property
    def lacking(self) -> tuple[Guarantee, ...]:
        """The guarantees that do not hold."""
        return tuple(one for one in self.each if not one.holds)


def driver_of(part: Any) -> str:
    """Name of a part in files."""
    found = name_of(type(part))
    return type(part).__name__ if found is None else found[1]


Rule = tuple[object, str, str]
"""A condition that makes a rig impossible, the reason, and the table, or table.key, to change."""


def refusal(setup: RigFile) -> Misplaced | None:
    """Why parts cannot work together, with the table to change; None if they can."""
    motion, clock, light = (driver_of(part) for part in (setup.motion, setup.clock, setup.light))
    display, lens = driver_of(setup.display[0]), setup.lens
    by_rows = lens is not None and lens.controlled_by == "controller"
    bare = setup.controller is None
    beside = setup.controller, setup.motion, setup.light, lens, setup.camera_stage, *setup.display, *setup.feedback
    others = {each.port for each in beside if getattr(each, "port", None)}
    need = 'driver "controller": expected a table [controller] with its port'
    rules: list[Rule] = [
        (bare and motion == "controller", need, "motion"),
        (bare and clock == "controller", need, "clock"),
        (bare and light == "controller", need, "light"),
        (bare and by_rows, 'controlled_by = "controller": expected a table [controller]; add it, or set "host" for one '
         "focus", "lens"),
        *_measuring(setup, motion),
        (setup.lift is not None and (driver_of(setup.lift) == "controller" or not setup.lift.reports),
         "expected a stage that reports its position, such as zaber, standa, thorlabs, tic or grbl", "lift"),
        (setup.lift is not None and not setup.lift.emulated and "microsteps" not in setup.lift.model_fields_set,
         "expected its microsteps per mm: microsteps = …", "lift"),
        (setup.lift is not None and getattr(setup.lift, "port", None) in others,
         "is that of another machine; expected a port of its own", "lift.port"),
        (len({each.triggered for each in setup.display}) > 1,
         "expected displays that all have a trigger, or one on a video cable", "display"),
        *(_on_a_cable if setup.video else _triggered)(setup, motion, clock, display, by_rows),
    ]  # fmt: skip
    return next((Misplaced(why, *place.split(".")) for wrong, why, place in rules if wrong), None)


def _measuring(setup: RigFile, motion: str) -> Iterator[Rule]:
    """Rules of encoders and indices."""
    found: list[Any] = [each for each in setup.feedback if each.sees == "motion"]
    names = [driver_of(each) for each in found]
    yield len(set(names)) < len(names), "expected at most one encoder and one index", "feedback"
    for each, name in zip(found, names, strict=True):
        pin = getattr(each, "pin", None)
        if motion == "stepper" and name == "index":
            yield pin is None, 'driver "index": expected pin, an input of the stepper\'s computer', "feedback"
            continue
        yield motion not in ("controller", "emulated"), (
            f'driver "{name}": it is at the controller\'s input, for a motor that it steps, and [motion] is '
            f'"{motion}"; remove it, or set encoder = true if the stage has its own'
        ), "feedback"  # fmt: skip
        yield pin is not None, (
            'driver "index": pin is only for a "stepper"; remove it: the controller has its own input'
        ), "feedback"  # fmt: skip
        yield name == "index" and each.distance is None and setup.rig.machine != "vial", (
            'driver "index": expected distance, the travel of the web or platform from mark to mark [mm]'
        ), "feedback"  # fmt: skip


def _on_a_cable(setup: RigFile, motion: str, clock: str, display: str, by_rows: bool) -> list[Rule]:
    """Rules of video projectors."""
    machine, known = setup.rig.machine, setup.motion.reports or _indexed(setup)
    return [
        (len(setup.display) > 1,
         f"expected one projector on a video cable, got {len(setup.display)}: cables do not stay in step", "display"),
        (machine not in ("vial", "web"), f'driver "{display}" prints vials and webs; expected machine = "vial" or '
         f'"web", got "{machine}"', "rig.machine"),
        (motion == "controller", f'driver "{display}": expected [motion] with a stage, whose angle chooses the frames, '
         'or a stepper; got "controller"', "motion"),
        (by_rows, f'driver "{display}" prints with one focus, which the host sets; expected controlled_by = "host"',
         "lens"),
        (clock not in ("vblank", "free"), f'driver "{clock}": a video cable has no trigger input; expected "vblank", '
         'or "free" with an accepted drift', "clock"),
        (clock == "vblank" and not known, f'driver "vblank": the angle of the motion chooses the frames, and a '
         f'"{motion}" does not report it; add [[feedback]] with driver = "index", use a stage, or set driver = "free" '
         "and accept drift in [safety]", "clock"),
    ]  # fmt: skip


def _triggered(setup: RigFile, motion: str, clock: str, display: str, by_rows: bool) -> list[Rule]:
    """Rules of mirrors behind a trigger."""
    staged, gate = clock == "stage", setup.light.gate
    return [
        (clock in ("vblank", "free"), f'driver "{clock}": mirrors of the display "{display}" wait for triggers; '
         'expected "controller" or "stage"', "clock"),
        (clock == "controller" and motion not in ("controller", "emulated"), 'driver "controller" triggers by the '
         f'steps of the controller\'s own motor, and [motion] is "{motion}"; expected [clock] "stage", '
         'or [motion] "controller"', "clock"),
        (staged and (motion == "controller" or not setup.motion.triggers), f'driver "stage": a "{motion}" has no '
         'trigger output; use a stage that has one, such as "zaber", or let the controller move and trigger', "clock"),
        (staged and by_rows, 'controlled_by = "controller": the stage triggers, so the controller has no rows; set '
         '"host" for one focus, or let the controller move and trigger', "lens"),
        (staged and len(setup.display) > 1 and gate == "line",
         "expected one display: a laser's line switches one light", "display"),
        (clock == "controller" and gate != "controller",
         'expected driver = "controller": its rows time the light, and the controller gates it', "light"),
    ]  # fmt: skip


def _indexed(setup: RigFile) -> bool:
    return any(each.sees == "motion" for each in setup.feedback)


def guarantees(setup: RigFile, speed: float, unit: str = "deg") -> Guarantees:
    """Derive a rig's guarantees at a speed [unit/s]."""
    (step, drift), lens = _step(setup, speed, unit), () if setup.lens is None else (LENS,)
    rest = (_display(setup), _position(setup), _scale(setup, unit), _light(setup))
    return Guarantees((step, *rest, _lease(setup), _interlock(setup), LAMP, *lens), drift)


def _step(setup: RigFile, speed: float, unit: str) -> tuple[Guarantee, float]:
    """Whether frames stay in step with the motion, and how fast they drift apart."""
    clock = driver_of(setup.clock)
    if clock == "controller":
        why = "each frame is triggered by the controller's own steps"
        return Guarantee("step", "guaranteed", why, sensor="controller"), 0.0
    if clock == "stage":
        return Guarantee("step", "guaranteed", "each frame is triggered by the stage at its angle", sensor="stage"), 0.0
    if clock == "vblank" and setup.motion.reports:
        why = "the angle that the stage reports selects the frame of every refresh"
        return Guarantee("step", "watched", why, sensor="stage"), 0.0
    display: Any = setup.display[0]  # only a video cable's is left
    cable, motion = display.tolerance, setup.motion.tolerance
    apart = 1e-6 * (cable + motion)
    if _indexed(setup):
        why = f"the index corrects the angle once per turn, within {360 * apart:.2g} deg"
        return Guarantee("step", "watched", why, sensor="index"), 0.0
    drift = MINUTE * speed * apart
    enough = _rounded_up(drift)
    accepts = drift <= setup.safety.drift * (1 + SLACK)
    return Guarantee(
        "step", "believed",
        f"free-running video with a {driver_of(setup.motion)} drifts {enough:g} {unit} per minute (two clocks with "
        f"errors up to {cable:g} and {motion:g} ppm, at {speed:g} {unit}/s)"
        + (f", and [safety] accepts {setup.safety.drift:g}" if accepts else ""),
        "give it a trigger or an index" + ("" if accepts else f", or set drift = {enough:g} in [safety]"),
    ), drift  # fmt: skip


def _rounded_up(drift: float) -> float:
    """Round a drift up to two digits, which makes the number in the message large enough to accept it."""
    if drift <= 0:
        return 0.0
    digit = 10.0 ** (floor(log10(drift)) - 1)
    return round(ceil(drift / digit * (1 - SLACK)) * digit, 12)


def refused(found: Guarantees, setup: RigFile) -> bool:
    """Whether frames and motion drift apart faster than ``[safety] drift`` accepts."""
    return found.drift > setup.safety.drift * (1 + SLACK)


def accepted(setup: RigFile, speed: float, unit: str) -> Guarantees:
    """Return a rig's guarantees; BadInput if it drifts faster than ``[safety] drift`` accepts."""
    found = guarantees(setup, speed, unit)
    if refused(found, setup):
        step = found.each[0]
        raise BadInput(f"{step.why}, and [safety] accepts {setup.safety.drift:g}; {step.remedy}")
    return found


def _display(setup: RigFile) -> Guarantee:
    if not setup.video:
        return Guarantee("display", "watched", "the mirrors count the frames that they show", sensor="mirrors")
    if setup.display[0].lamps:
        return Guarantee("display", "watched", "the projector is asked whether its patterns run", sensor="lamp")
    return Guarantee(
        "display", "believed", "no machine reports what the projector shows: a dead lamp, a blank screen or a scaled "
        "image go unnoticed", "watch the first turn",
    )  # fmt: skip


def _measured_by(setup: RigFile) -> str:
    """The machine that reads encoder or index."""
    if setup.motion.measured:
        return "stage"
    return "controller" if driver_of(setup.motion) in ("controller", "emulated") else "index"


def part(setup: RigFile, lifted: bool) -> Guarantee:
    """Whether a part that moves, perhaps with its vial, is where its frames follow it."""
    if not lifted or setup.lift is None:
        why = "no sensor shows that the part is where [travel] says"
        return Guarantee("part", "believed", why, "watch it with a camera")
    scale = f"{setup.lift.microsteps:.6g} microsteps per mm"
    if setup.lift.measured:
        why = f"the encoder of the lift measures its height; {scale} are the file's"
        return Guarantee("part", "watched", why, sensor="lift")
    return Guarantee("part", "believed", f"the lift counts its steps, {scale}", "use one with an encoder")


def _position(setup: RigFile) -> Guarantee:
    if setup.motion.measured or any(driver_of(each) == "encoder" for each in setup.feedback):
        return Guarantee("position", "watched", "an encoder measures the position", sensor=_measured_by(setup))
    if _indexed(setup):
        why = "an index marks each turn; between two, steps are counted"
        return Guarantee("position", "watched", why, sensor=_measured_by(setup))
    why = "the position is not measured: lost steps of the motor go unnoticed"
    remedy = "set encoder = true if the stage has one, or use one that has"
    if (motion := driver_of(setup.motion)) in ("controller", "emulated", "stepper"):
        sensor = '"index" and its pin' if motion == "stepper" else '"encoder" or "index"'
        remedy = f"add [[feedback]] with driver = {sensor}"
    elif not hasattr(setup.motion, "encoder"):
        remedy = "use a stage with an encoder"
    return Guarantee("position", "believed", why, remedy)


def _scale(setup: RigFile, unit: str) -> Guarantee:
    """Whether a microstep is as large as the rig's file says."""
    count = f"{setup.motion.microsteps:.6g} microsteps per {unit}"
    if setup.motion.scaled and unit == "deg":
        why = f"the stage reports its own, which is compared with the file's {count}"
        return Guarantee("scale", "watched", why, sensor="stage")
    if _indexed(setup):
        why = f"[[feedback]] shows whether {count} are right"
        return Guarantee("scale", "watched", why, sensor=_measured_by(setup))
    why = f"{count} are the file's: an error in them is an error of every angle or position"
    measure = "a turn with vam calibrate turn" if unit == "deg" else "a travel by hand"
    return Guarantee("scale", "believed", why, f"measure {measure}")


def _light(setup: RigFile) -> Guarantee:
    if setup.light.gate == "controller":
        return Guarantee("light", "guaranteed", "the controller gates it", sensor="controller")
    if setup.light.gate == "line":
        return Guarantee("light", "believed", "a line of the host and the projector switch it; no sensor sees it")
    if setup.display[0].lamps:
        why = "the host switches the projector's LEDs and asks whether they stay enabled; no sensor sees their light"
        return Guarantee("light", "believed", why)
    return Guarantee("light", "believed", "black frames switch it off, as dark as the projector's black")


def _lease(setup: RigFile) -> Guarantee:
    if setup.light.gate == "controller":
        why = f"{1e3 * setup.safety.lease:.0f} ms after the host's last signal it is dark"
        return Guarantee("lease", "guaranteed", why, sensor="controller")
    return Guarantee(
        "lease", "not there", "if the host dies or hangs, the light may stay on: no controller gates the lamp",
        'let the controller gate it: [light] driver = "controller"',
    )  # fmt: skip


def _interlock(setup: RigFile) -> Guarantee:
    if setup.light.gate == "controller":
        why = "the controller switches the light off when the enclosure opens"
        return Guarantee("interlock", "guaranteed", why, sensor="controller")
    if setup.controller is not None:
        why = "the controller reports whether the enclosure is closed"
        return Guarantee("interlock", "watched", why, sensor="controller")
    return Guarantee("interlock", "not there", "no machine reports whether the enclosure is closed")


LAMP = Guarantee(
    "lamp", "believed", "nobody measures its brightness during the print", "measure it with vam calibrate gray or flat"
)
LENS = Guarantee("lens", "watched", "its driver reports its faults and the power that is set", sensor="lens")
