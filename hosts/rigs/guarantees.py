"""What a combination of parts guarantees, what drifts, and what cannot be: reasoned out from the roles alone."""

from __future__ import annotations

from dataclasses import dataclass
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
    """One thing that a print relies on. about: step, position, light or lease.  holds: whether it is guaranteed.

    why: the reason, in words.  remedy: what would guarantee it.
    """

    about: str
    holds: bool
    why: str
    remedy: str = ""

    def __str__(self) -> str:
        said = "" if self.holds else "not guaranteed: "
        return f"{said}{self.why}{f'; {self.remedy}' if self.remedy else ''}"

    def told(self) -> dict[str, Any]:
        """For the record of a run."""
        return {"about": self.about, "holds": self.holds, "why": self.why, "remedy": self.remedy}


@dataclass(frozen=True)
class Guarantees:
    """What a rig guarantees at a speed.

    Attributes:
        each: Its guarantees, those that hold and those that do not.
        drift: Of the frames against the motion [deg/min] or [mm/min]; 0 where something keeps them in step.
    """

    each: tuple[Guarantee, ...]
    drift: float

    def __iter__(self) -> Any:
        return iter(self.each)

    @property
    def lacking(self) -> tuple[Guarantee, ...]:
        """Those that do not hold."""
        return tuple(one for one in self.each if not one.holds)


def driver_of(part: Any) -> str:
    """What files call a part."""
    found = name_of(type(part))
    return type(part).__name__ if found is None else found[1]


def refusal(setup: RigFile) -> Misplaced | None:
    """Why parts cannot work together, with a remedy; None where they can.

    Args:
        setup: The roles.

    Returns:
        The complaint, at the table where one would begin to mend it.
    """
    motion, clock, display, light = (
        driver_of(part) for part in (setup.motion, setup.clock, setup.display[0], setup.light)
    )
    if setup.controller is None:
        for role, part in (("motion", motion), ("clock", clock), ("light", light)):
            if part == "controller":
                return Misplaced('driver "controller": expected a table [controller] with its port', role)
        if setup.lens is not None and setup.lens.told_by == "controller":
            return Misplaced(
                'told_by = "controller": expected a table [controller]; add it, or set told_by = "host" for one focus',
                "lens",
            )
    if not setup.motion.runs:
        return Misplaced(
            f'driver "{motion}" moves from place to place, and every print runs its motion at a speed; take the driver '
            "of the stage's maker", "motion",
        )  # fmt: skip
    if (found := _measuring(setup, motion)) is not None:
        return found
    if len({each.triggered for each in setup.display}) > 1:
        return Misplaced("expected displays that all have a trigger, or one on a video cable", "display")
    return (_on_a_cable if setup.video else _triggered)(setup, motion, clock, display)


def _measuring(setup: RigFile, motion: str) -> Misplaced | None:
    """What is wrong with encoders and indices."""
    names = [driver_of(each) for each in setup.feedback if each.sees == "motion"]
    if len(set(names)) < len(names):
        return Misplaced("expected one encoder and one index at most", "feedback")
    for each in setup.feedback:
        if each.sees != "motion":
            continue
        name, pin = driver_of(each), getattr(each, "pin", None)
        if motion == "stepper" and name == "index":
            if pin is None:
                return Misplaced(
                    'driver "index": expected pin, of the computer that gives the stepper its pulses', "feedback"
                )
        elif motion not in ("controller", "emulated"):
            return Misplaced(
                f'driver "{name}": its input is the controller\'s, that measures the motor it moves, and [motion] '
                f'is "{motion}"; remove it, or set encoder = true of a stage that has its own', "feedback",
            )  # fmt: skip
        elif pin is not None:
            return Misplaced(
                'driver "index": a pin is of a "stepper"; remove it: it is the controller\'s input', "feedback"
            )
        elif name == "index" and getattr(each, "distance", None) is None and setup.rig.machine != "vial":
            return Misplaced(
                'driver "index": expected distance, the way of the web or platform from mark to mark [mm]', "feedback"
            )
    return None


def _on_a_cable(setup: RigFile, motion: str, clock: str, display: str) -> Misplaced | None:
    if len(setup.display) > 1:
        return Misplaced(
            f"expected one projector on a video cable, got {len(setup.display)}: cables keep no step", "display"
        )
    if setup.rig.machine not in ("vial", "web"):
        return Misplaced(
            f'driver "{display}" prints vials and webs; expected machine = "vial" or "web", got "{setup.rig.machine}"',
            "rig", "machine",
        )  # fmt: skip
    if motion == "controller":
        return Misplaced(
            f'driver "{display}": expected [motion] with a stage, whose angle chooses the frames, or a stepper; got '
            '"controller"', "motion",
        )  # fmt: skip
    if setup.lens is not None:
        return Misplaced(f'driver "{display}" prints through one focus, which takes no lens; remove [lens]', "lens")
    if clock not in ("vblank", "free"):
        return Misplaced(
            f'driver "{clock}": a video cable has no trigger input; expected "vblank", or "free" with the drift that '
            "is accepted", "clock",
        )  # fmt: skip
    if clock == "vblank" and not (setup.motion.reports or _indexed(setup)):
        return Misplaced(
            f'driver "vblank": the angle of the motion chooses the frames, and a "{motion}" does not say it; '
            'add [[feedback]] with driver = "index", take a stage, or set driver = "free" and accept drift in [safety]',
            "clock",
        )  # fmt: skip
    return None


def _triggered(setup: RigFile, motion: str, clock: str, display: str) -> Misplaced | None:
    if clock in ("vblank", "free"):
        return Misplaced(
            f'driver "{clock}": mirrors of the display "{display}" wait for triggers; expected "controller" or "stage"',
            "clock",
        )
    if clock == "controller" and motion not in ("controller", "emulated"):
        return Misplaced(
            f'driver "controller" triggers by the steps of the motor that the controller itself moves, and [motion] is '
            f'"{motion}"; expected [clock] "stage", or [motion] "controller"', "clock",
        )  # fmt: skip
    if clock == "stage":
        if motion == "controller" or not setup.motion.triggers:
            return Misplaced(
                f'driver "stage": a "{motion}" has no trigger output; take a stage that has one, such as "zaber", or '
                'let the controller move and trigger', "clock",
            )  # fmt: skip
        if setup.lens is not None and setup.lens.told_by == "controller":
            return Misplaced(
                'told_by = "controller": the stage triggers, so the controller knows no rows; set told_by = "host" for '
                "one focus, or let the controller move and trigger", "lens",
            )  # fmt: skip
        if len(setup.display) > 1 and setup.light.gate == "line":
            return Misplaced("expected one display: a laser's line switches one light", "display")
    if clock == "controller" and setup.light.gate != "controller":
        return Misplaced(
            'expected driver = "controller": rows say when there is light, and the controller gates it', "light"
        )
    return None


def _indexed(setup: RigFile) -> bool:
    return any(each.sees == "motion" for each in setup.feedback)


def guarantees(setup: RigFile, speed: float, unit: str = "deg") -> Guarantees:
    """Reason out what a rig guarantees.

    Args:
        setup: The roles.
        speed: Of the motion [unit/s].
        unit: Of the motion, "deg" or "mm".

    Returns:
        Step of frames and motion, position, light and lease, each with its reason.
    """
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
    """To two digits, so that who accepts what was told has accepted the drift."""
    if drift <= 0:
        return 0.0
    digit = 10.0 ** (floor(log10(drift)) - 1)
    return round(ceil(drift / digit * (1 - SLACK)) * digit, 12)


def refused(found: Guarantees, setup: RigFile) -> bool:
    """Whether frames and motion drift apart faster than ``[safety] drift`` accepts."""
    return found.drift > setup.safety.drift * (1 + SLACK)


def accepted(setup: RigFile, speed: float, unit: str) -> Guarantees:
    """What a rig guarantees, where the drift is accepted.

    Args:
        setup, speed, unit: See `guarantees`.

    Raises:
        BadInput: Frames and motion drift apart faster than ``[safety] drift`` accepts.
    """
    found = guarantees(setup, speed, unit)
    if refused(found, setup):
        step = next(one for one in found if one.about == "step")
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
