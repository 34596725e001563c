"""The file of a rig: the parts that fill its roles, their addresses and limits."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, field_validator, model_validator

from vamgpu.errors import BadInput, JobError
from vamgpu.hosts.drivers.controller_protocol import LONGEST_LEASE_MS
from vamgpu.hosts.rigs.feedback import CameraFeedback, PowerMeterFeedback
from vamgpu.hosts.rigs.guarantees import refusal
from vamgpu.hosts.rigs.roles import Baud, DisplayPart, FeedbackPart, LensPart, LightPart, Microsteps, MotionPart, Part
from vamgpu.jobs.read import checked
from vamgpu.schema.quantities import Age, Count, NonNegative, PauseTime, Quantity, Speed, Thickness
from vamgpu.schema.read import noun
from vamgpu.schema.registry import find
from vamgpu.schema.section import Misplaced, Section
from vamgpu.storage.reading import MOST_TOML, read_text

SHORTEST_LEASE_MS = 20  # A host renews it four times in this time


class RigSection(Section):
    """The rig itself. machine: kind of jobs that it prints."""

    name: str
    machine: Literal["vial", "web", "slices", "any"]


class ControllerSection(Section):
    """The line to the controller, for the roles that it fills: motion, clock, light, lens line and lease."""

    driver: Literal["vam-controller", "emulated"] = "vam-controller"
    port: str | None = None
    baud: Baud = 115200


class SafetySection(Section):
    """Limits of the light. tolerance: largest error of the motion, in poses.  budget: allowed light, relative to that
    of the plan.  lease: time for which the controller keeps the light on without the host, 20 ms to 1 s.  resume:
    longest pause after which a print continues; resin loses its dose during a pause.  drift: accepted drift of the
    frames against the motion if no clock keeps them in step [deg/min] or [mm/min].
    """

    lease: Annotated[float, Quantity("a time", least=0.0, example="250 ms")] = 0.25
    tolerance: Annotated[float, Field(gt=0, le=5)] = 0.5
    budget: Annotated[float, Field(ge=1, le=2)] = 1.01
    resume: PauseTime = 30.0
    drift: NonNegative = 0.0

    @field_validator("lease")
    @classmethod
    def _kept(cls, lease: float) -> float:
        if not SHORTEST_LEASE_MS <= 1000 * lease <= LONGEST_LEASE_MS:
            raise ValueError(f"expected {SHORTEST_LEASE_MS} ms to {LONGEST_LEASE_MS} ms, which the controller supports")
        return lease


DATE = re.compile(r"none|\d{4}(-\d\d(-\d\d(T\d*)?)?)?")


def _chosen(value: str) -> str:
    if not DATE.fullmatch(value):
        raise ValueError('expected the date of one, such as "2026-11-20", or "none"')
    return value


Chosen = Annotated[str, AfterValidator(_chosen)] | None


class CalibrationSection(Section):
    """Applied calibrations of the rig: for each kind the newest, or that of a date, or ``"none"``.

    warn_after: age from which a calibration is reported as old.
    """

    gray: Chosen = None
    flat: Chosen = None
    axis: Chosen = None
    focus: Chosen = None
    mtf: Chosen = None
    runout: Chosen = None
    live: Chosen = None
    turn: Chosen = None
    warn_after: Age = 90 * 86400.0


class CameraStageSection(Section):
    """The stage that moves the camera along the light. microsteps: number per millimeter; Standa's have 256 per step.

    middle: its position [mm] on the axis of rotation, from which positions are counted.
    """

    driver: Literal["zaber", "standa", "emulated"]
    port: str | None = None
    device: Count = 1
    axis: Count = 1
    microsteps: Microsteps
    speed: Speed = 5.0
    middle: Thickness = 0.0


EMULATED = """\
# A dry run: every machine is emulated on a simulated clock, so there is no light, and an hour takes seconds.

[rig]
name = "emulated"
machine = "any"

[controller]
driver = "emulated"

[motion]
driver = "emulated"

[display]
driver = "emulated"

[lens]
driver = "emulated"

[lift]
driver = "emulated"

[[feedback]]
driver = "emulated camera"
exposure = "5 ms"
pixel = "7.8 um"
discard = 0

[[feedback]]
driver = "emulated photodiode"

[camera_stage]
driver = "emulated"
microsteps = 5000.0
middle = "20 mm"
"""


def _each(value: Any) -> Any:
    """``[display]`` is one display, ``[[display]]`` may be several."""
    return tuple(value) if isinstance(value, list) else (value,) if isinstance(value, dict) else value


class RigFile(Section):
    """A whole rig file: a table for each role, whose ``driver`` names the part that fills it."""

    rig: RigSection
    controller: ControllerSection | None = None
    motion: Annotated[MotionPart, noun("rig_motion")]
    clock: Annotated[Part, noun("rig_clock")]
    display: Annotated[
        tuple[Annotated[DisplayPart, noun("rig_display")], ...], BeforeValidator(_each), Field(min_length=1)
    ]
    light: Annotated[LightPart, noun("rig_light")]
    lens: Annotated[LensPart, noun("rig_lens")] | None = None
    feedback: Annotated[tuple[Annotated[FeedbackPart, noun("rig_feedback")], ...], BeforeValidator(_each)] = ()
    lift: Annotated[MotionPart, noun("rig_motion")] | None = None
    camera_stage: CameraStageSection | None = None
    safety: SafetySection = SafetySection()
    calibration: CalibrationSection = CalibrationSection()

    @model_validator(mode="after")
    def _whole(self) -> Self:
        parts: list[tuple[str, bool]] = []
        for name, section in (("controller", self.controller), ("camera_stage", self.camera_stage)):
            if section is not None:
                parts.append((name, section.driver == "emulated"))
                if not parts[-1][1] and not section.port:
                    raise Misplaced(
                        f'driver "{section.driver}": expected port = "/dev/…" or "socket://host:port"', name
                    )
        for name, found in (("motion", (self.motion,)), ("display", self.display), ("lens", (self.lens,)),
                            ("lift", (self.lift,)), ("feedback", self.feedback)):  # fmt: skip
            parts += [(name, part.emulated) for part in found if part is not None]
        real, emulated = ([name for name, one in parts if one is which] for which in (False, True))
        if real and emulated:
            raise Misplaced(
                f"is emulated and {real[0]} is real; expected all machines of one kind, with one clock", emulated[0]
            )
        if (wrong := refusal(self)) is not None:  # type: ignore[arg-type]
            raise wrong
        return self

    @property
    def emulated(self) -> bool:
        return self.motion.emulated

    @property
    def video(self) -> bool:
        """Whether the projector is on a video cable."""
        return not self.display[0].triggered

    @property
    def camera(self) -> CameraFeedback | None:
        """The camera that looks along the light."""
        return next((each for each in self.feedback if isinstance(each, CameraFeedback)), None)

    @property
    def photodiode(self) -> PowerMeterFeedback | None:
        return next((each for each in self.feedback if isinstance(each, PowerMeterFeedback)), None)


@dataclass(frozen=True)
class RigConfig:
    """A checked rig file."""

    setup: RigFile
    text: str
    source: str  # path of the file
    settings: tuple[str, ...] = ()  # values that replace those of the file


def read_rig(path: str | Path, settings: Iterable[str] = ()) -> RigConfig:
    """Read a rig file.

    Args:
        path: The TOML file, or the word ``emulated`` for a rig whose machines are all emulated.
        settings: Values that replace those of the file, as ``table.key=value``.

    Returns:
        The checked rig with the text of its file.

    Raises:
        JobError: The file cannot be read, or has invalid values; the message names their lines.
    """
    if str(path) == "emulated":
        return parse_rig(EMULATED, settings, source="emulated")
    try:
        text = read_text(path, MOST_TOML)
    except (OSError, ValueError, TypeError) as error:  # not UTF-8, or not a path
        why = "it is not text" if isinstance(error, UnicodeDecodeError) else getattr(error, "strerror", None) or error
        raise JobError(
            f"cannot read the rig {str(path)!r}: {why}; expected a TOML file, or the word emulated"
        ) from error
    return parse_rig(text, settings, source=str(path))


def parse_rig(text: str, settings: Iterable[str] = (), *, source: str = "rig") -> RigConfig:
    """A rig from TOML text. Raises `JobError`, which names every invalid value."""
    if not isinstance(text, str):
        raise JobError(f"the rig's text is {text!r}; expected the text of a TOML file")
    given = (settings,) if isinstance(settings, str) else tuple(settings)
    return RigConfig(checked(RigFile, text, given, source=source, complete=_completed)[0], text, source, given)


OLD = {"projector": "display", "stage": "motion", "camera": "feedback", "photodiode": "feedback"}
"""Tables of version 0.2 → current tables."""


def _completed(data: dict[str, Any]) -> None:
    """Add the motion, light and clock that follow from the other parts. Raises `JobError` for tables of version 0.2."""
    if old := [name for name in OLD if name in data]:
        raise JobError(f"[{old[0]}] is a table of version 0.2; expected [{OLD[old[0]]}], see hosts/README.md")
    controller, light = data.get("controller"), data.setdefault("light", {})
    if isinstance(controller, dict):
        moves = data.setdefault("motion", {})
        if isinstance(moves, dict):
            moves.setdefault("driver", "emulated" if controller.get("driver") == "emulated" else "controller")
    if isinstance(light, dict):
        light.setdefault("driver", "display" if controller is None else "controller")
    if "clock" in data or not isinstance(motion := data.get("motion"), dict):
        return
    moves = controller is not None and motion.get("driver") in ("controller", "emulated")
    displays = _each(data.get("display", ()))
    cabled = isinstance(displays, tuple) and any(map(_cabled, displays))
    driver = "vblank" if cabled else "controller" if moves else "stage"
    data["clock"] = {"driver": driver}


def _cabled(display: Any) -> bool:
    """Whether a display is on a video cable; False without a display."""
    try:
        return not find("rig_display", display["driver"]).triggered
    except (BadInput, KeyError, TypeError, AttributeError):
        return False
