"""Guarantees of a rig, reasoned out from its roles: step, position, light and lease, or why it is refused."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from math import ceil, floor, log10
from typing import TYPE_CHECKING, Any

from vamgpu.errors import BadInput
from vamgpu.schema.registry import name_of
from vamgpu.schema.section import Misplaced

if TYPE_CHECKING:
    from vamgpu.hosts.rigs.config import RigFile

MINUTE = 60.0
SLACK = 1e-9  # of drifts that are compared, for the rounding of their product


@dataclass(frozen=True)
class Guarantee:
    """One thing that a print relies on."""

    about: str  # step, position, light or lease
    holds: bool
    why: str  # the reason, in words
    remedy: str = ""  # what would guarantee it

    def __str__(self) -> str:
        said = "" if self.holds else "not guaranteed: "
        return f"{said}{self.why}{f'; {self.remedy}' if self.remedy else ''}"

    def record(self) -> dict[str, Any]:
        """For the record of a run."""
        return asdict(self)


@dataclass(frozen=True)
class Guarantees:
    """A rig's guarantees at a speed, those that hold and those that do not."""

    each: tuple[Guarantee, ...]
    drift: float  # of frames against motion [deg/min] or [mm/min]

    def __iter__(self) -> Any:
        return iter(self.each)

    @property
    def lacking(self) -> tuple[Guarantee, ...]:
        """Those that do not hold."""
        return tuple(one for one in self.each if not one.holds)


def driver_of(part: Any) -> str:
    """Name a part as files do."""
    found = name_of(type(part))
    return type(part).__name__ if found is None else found[1]


Rule = tuple[object, str, str]
"""What makes a rig impossible where it is true, why, and the table, or table.key, where one would begin to mend it."""


def refusal(setup: RigFile) -> Misplaced | None:
    """Say why parts cannot work together, at the table where one would begin to mend it; None where they can."""
    motion, clock, light = (driver_of(part) for part in (setup.motion, setup.clock, setup.light))
    display, lens = driver_of(setup.display[0]), setup.lens
    by_rows = lens is not None and lens.controlled_by == "controller"
    bare = setup.controller is None
    need = 'driver "controller": expected a table [controller] with its port'
    rules: list[Rule] = [
        (bare and motion == "controller", need, "motion"),
        (bare and clock == "controller", need, "clock"),
        (bare and light == "controller", need, "light"),
        (bare and by_rows, 'controlled_by = "controller": expected a table [controller]; add it, or set "host" for one '
         "focus", "lens"),
        (not setup.motion.runs, f'driver "{motion}" moves from place to place, and every print runs its motion at a '
         "speed; take the driver of the stage's maker", "motion"),
        *_measuring(setup, motion),
        (len({each.triggered for each in setup.display}) > 1,
         "expected displays that all have a trigger, or one on a video cable", "display"),
        *(_on_a_cable if setup.video else _triggered)(setup, motion, clock, display, by_rows),
    ]  # fmt: skip
    return next((Misplaced(why, *place.split(".")) for wrong, why, place in rules if wrong), None)


def _measuring(setup: RigFile, motion: str) -> Iterator[Rule]:
    """Rules of encoders and indices."""
    found: list[Any] = [each for each in setup.feedback if each.sees == "motion"]
    names = [driver_of(each) for each in found]
    yield len(set(names)) < len(names), "expected one encoder and one index at most", "feedback"
    for each, name in zip(found, names, strict=True):
        pin = getattr(each, "pin", None)
        if motion == "stepper" and name == "index":
            yield pin is None, 'driver "index": expected pin, of the computer that steps the stepper', "feedback"
            continue
        yield motion not in ("controller", "emulated"), (
            f'driver "{name}": its input is the controller\'s, that measures the motor it moves, and [motion] is '
            f'"{motion}"; remove it, or set encoder = true of a stage that has its own'
        ), "feedback"  # fmt: skip
        yield pin is not None, (
            'driver "index": a pin is of a "stepper"; remove it: it is the controller\'s input'
        ), "feedback"  # fmt: skip
        yield name == "index" and each.distance is None and setup.rig.machine != "vial", (
            'driver "index": expected distance, the way of the web or platform from mark to mark [mm]'
        ), "feedback"  # fmt: skip


def _on_a_cable(setup: RigFile, motion: str, clock: str, display: str, by_rows: bool) -> list[Rule]:
    """Rules of video projectors."""
    machine, known = setup.rig.machine, setup.motion.reports or _indexed(setup)
    return [
        (len(setup.display) > 1,
         f"expected one projector on a video cable, got {len(setup.display)}: cables keep no step", "display"),
        (machine not in ("vial", "web"), f'driver "{display}" prints vials and webs; expected machine = "vial" or '
         f'"web", got "{machine}"', "rig.machine"),
        (motion == "controller", f'driver "{display}": expected [motion] with a stage, whose angle chooses the frames, '
         'or a stepper; got "controller"', "motion"),
        (setup.lens is not None, f'driver "{display}" prints through one focus, which takes no lens; remove [lens]',
         "lens"),
        (clock not in ("vblank", "free"), f'driver "{clock}": a video cable has no trigger input; expected "vblank", '
         'or "free" with the drift that is accepted', "clock"),
        (clock == "vblank" and not known, f'driver "vblank": the angle of the motion chooses the frames, and a '
         f'"{motion}" does not say it; add [[feedback]] with driver = "index", take a stage, or set driver = "free" '
         "and accept drift in [safety]", "clock"),
    ]  # fmt: skip


def _triggered(setup: RigFile, motion: str, clock: str, display: str, by_rows: bool) -> list[Rule]:
    """Rules of mirrors behind a trigger."""
    staged, gate = clock == "stage", setup.light.gate
    return [
        (clock in ("vblank", "free"), f'driver "{clock}": mirrors of the display "{display}" wait for triggers; '
         'expected "controller" or "stage"', "clock"),
        (clock == "controller" and motion not in ("controller", "emulated"), 'driver "controller" triggers by the '
         f'steps of the motor that the controller itself moves, and [motion] is "{motion}"; expected [clock] "stage", '
         'or [motion] "controller"', "clock"),
        (staged and (motion == "controller" or not setup.motion.triggers), f'driver "stage": a "{motion}" has no '
         'trigger output; take a stage that has one, such as "zaber", or let the controller move and trigger', "clock"),
        (staged and by_rows, 'controlled_by = "controller": the stage triggers, so the controller knows no rows; set '
         '"host" for one focus, or let the controller move and trigger', "lens"),
        (staged and len(setup.display) > 1 and gate == "line",
         "expected one display: a laser's line switches one light", "display"),
        (clock == "controller" and gate != "controller",
         'expected driver = "controller": rows say when there is light, and the controller gates it', "light"),
    ]  # fmt: skip


def _indexed(setup: RigFile) -> bool:
    return any(each.sees == "motion" for each in setup.feedback)


def guarantees(setup: RigFile, speed: float, unit: str = "deg") -> Guarantees:
    """Reason out what a rig guarantees at a speed [unit/s]: step of frames and motion, position, light and lease."""
    step, drift = _step(setup, speed, unit)
    return Guarantees((step, _position(setup), _light(setup), _lease(setup)), drift)


def _step(setup: RigFile, speed: float, unit: str) -> tuple[Guarantee, float]:
    """Whether frames stay where the motion is, and how fast they drift apart."""
    clock = driver_of(setup.clock)
    if clock == "controller":
        return Guarantee("step", True, "each frame is triggered by the controller's own steps"), 0.0
    if clock == "stage":
        return Guarantee("step", True, "each frame is triggered by the stage at its pose"), 0.0
    if clock == "vblank" and setup.motion.reports:
        return Guarantee("step", True, "the angle that the stage says chooses the frame of every refresh"), 0.0
    display: Any = setup.display[0]  # a video cable's, by now
    cable, motion = display.tolerance, setup.motion.tolerance
    apart = 1e-6 * (cable + motion)
    if _indexed(setup):
        return Guarantee("step", True, f"the index corrects the angle once a turn, within {360 * apart:.2g} deg"), 0.0
    drift = MINUTE * speed * apart
    enough = _rounded_up(drift)
    return Guarantee(
        "step", False,
        f"free-running video with a {driver_of(setup.motion)} drifts {enough:g} {unit} a minute (two clocks, off by "
        f"{cable:g} and {motion:g} ppm at most, at {speed:g} {unit}/s)",
        f"give it a trigger or an index, or accept drift = {enough:g} in [safety]",
    ), drift  # fmt: skip


def _rounded_up(drift: float) -> float:
    """Round a drift up to two digits, so that accepting the number of the message accepts the drift."""
    if drift <= 0:
        return 0.0
    digit = 10.0 ** (floor(log10(drift)) - 1)
    return round(ceil(drift / digit * (1 - SLACK)) * digit, 12)


def refused(found: Guarantees, setup: RigFile) -> bool:
    """Whether frames and motion drift apart faster than ``[safety] drift`` accepts."""
    return found.drift > setup.safety.drift * (1 + SLACK)


def accepted(setup: RigFile, speed: float, unit: str) -> Guarantees:
    """Return a rig's guarantees; BadInput where it drifts faster than ``[safety] drift`` accepts."""
    found = guarantees(setup, speed, unit)
    if refused(found, setup):
        step = found.each[0]
        raise BadInput(f"{step.why}, and [safety] accepts drift = {setup.safety.drift:g}; {step.remedy}")
    return found


def _position(setup: RigFile) -> Guarantee:
    if setup.motion.measured or any(driver_of(each) == "encoder" for each in setup.feedback):
        return Guarantee("position", True, "an encoder measures where the motion is")
    if _indexed(setup):
        return Guarantee("position", True, "an index is seen once a turn; between two, steps are counted")
    return Guarantee(
        "position", False, "nobody measures where the motion is: steps that its motor loses are not seen",
        'add [[feedback]] with driver = "encoder" or "index", or say encoder = true of a stage that has one',
    )  # fmt: skip


def _light(setup: RigFile) -> Guarantee:
    why = {
        "controller": "the controller gates it", "line": "the host's own line and the projector switch it",
        "display": "black frames make the dark, as dark as the projector's black is",
    }  # fmt: skip
    if setup.light.gate == "display" and setup.display[0].lamps:
        return Guarantee("light", True, "the host switches the projector's LEDs")
    return Guarantee("light", True, why[setup.light.gate])


def _lease(setup: RigFile) -> Guarantee:
    if setup.light.gate == "controller":
        return Guarantee("lease", True, f"{1e3 * setup.safety.lease:.0f} ms after the host's last sign it is dark")
    return Guarantee(
        "lease", False, "a host that dies or hangs may leave the light on, as no controller is in the lamp's wire",
        'put the controller there: [light] driver = "controller"',
    )  # fmt: skip
