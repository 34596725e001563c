"""The file of a rig: which parts fill its roles, where they are, and what they may do."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import BeforeValidator, Field, model_validator

from vamgpu.errors import BadInput, JobError
from vamgpu.hosts.rigs.feedback import CameraFeedback, PowerMeterFeedback
from vamgpu.hosts.rigs.guarantees import refusal
from vamgpu.hosts.rigs.roles import DisplayPart, FeedbackPart, LensPart, LightPart, MotionPart, Part
from vamgpu.hosts.rigs.sections import (
    CalibrationSection,
    CameraStageSection,
    ControllerSection,
    RigSection,
    SafetySection,
)
from vamgpu.jobs.read import checked
from vamgpu.schema.read import noun
from vamgpu.schema.registry import find
from vamgpu.schema.section import Misplaced, Section
from vamgpu.storage.reading import MOST_TOML, read_text

EMULATED = """\
# A rehearsal: every machine is emulated and time is a program's, so that nothing shines and an hour takes seconds.

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
    """``[display]`` is one, ``[[display]]`` may be several."""
    return tuple(value) if isinstance(value, list) else (value,) if isinstance(value, dict) else value


class RigFile(Section):
    """A whole file of a rig: a table for each role, whose ``driver`` names the part that fills it."""

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
                            ("feedback", self.feedback)):  # fmt: skip
            parts += [(name, part.emulated) for part in found if part is not None]
        real, emulated = ([name for name, one in parts if one is which] for which in (False, True))
        if real and emulated:
            raise Misplaced(
                f"is emulated and {real[0]} is real; expected all machines of one kind, as time is of one", emulated[0]
            )
        if (wrong := refusal(self)) is not None:  # type: ignore[arg-type]
            raise wrong
        return self

    @property
    def emulated(self) -> bool:
        """Whether this is a rehearsal."""
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
        """The power meter."""
        return next((each for each in self.feedback if isinstance(each, PowerMeterFeedback)), None)


@dataclass(frozen=True)
class RigConfig:
    """A checked rig file."""

    setup: RigFile
    text: str
    source: str  # where it came from
    settings: tuple[str, ...] = ()  # that replace its values


def read_rig(path: str | Path, settings: Iterable[str] = ()) -> RigConfig:
    """Read a rig file.

    Args:
        path: The TOML file, or the word ``emulated`` for a rig whose machines are all emulated.
        settings: Values that replace those of the file, as ``table.key=value``.

    Returns:
        The checked rig, with the text of its file.

    Raises:
        JobError: The file cannot be read, or has wrong values; the message names the line of each.
    """
    if str(path) == "emulated":
        return parse_rig(EMULATED, settings, source="emulated")
    try:
        text = read_text(path, MOST_TOML)
    except (OSError, ValueError, TypeError) as error:  # no UTF-8, or no path
        why = getattr(error, "strerror", None) or error
        raise JobError(
            f"cannot read the rig {str(path)!r}: {why}; expected a TOML file, or the word emulated"
        ) from error
    return parse_rig(text, settings, source=str(path))


def parse_rig(text: str, settings: Iterable[str] = (), *, source: str = "rig") -> RigConfig:
    """A rig from TOML text. Raises `JobError` naming every wrong value at once."""
    if not isinstance(text, str):
        raise JobError(f"the rig's text is {text!r}; expected the text of a TOML file")
    try:
        given = (settings,) if isinstance(settings, str) else tuple(settings)
        return RigConfig(checked(RigFile, text, given, source=source, complete=_completed)[0], text, source, given)
    except JobError as error:
        alone = "[[display]]" not in text
        raise JobError(str(error).replace("display.0", "display") if alone else str(error)) from error


OLD = {"projector": "display", "stage": "motion", "camera": "feedback", "photodiode": "feedback"}
"""Tables of version 0.2 → those of today."""


def _completed(data: dict[str, Any]) -> None:
    """Add motion, light and clock that the other parts suggest. Raises `JobError` for tables of version 0.2."""
    if old := [name for name in OLD if name in data]:
        raise JobError(f"[{old[0]}] is a table of version 0.2; expected [{OLD[old[0]]}], see hosts/README.md")
    controller, light = data.get("controller"), data.setdefault("light", {})
    if isinstance(controller, dict):
        data.setdefault("motion", {"driver": "emulated" if controller.get("driver") == "emulated" else "controller"})
    if isinstance(light, dict):
        light.setdefault("driver", "display" if controller is None else "controller")
    if "clock" in data or not isinstance(motion := data.get("motion"), dict):
        return
    moves = controller is not None and motion.get("driver") in ("controller", "emulated")
    driver = "vblank" if any(map(_cabled, _each(data.get("display", ())))) else "controller" if moves else "stage"
    data["clock"] = {"driver": driver}


def _cabled(display: Any) -> bool:
    """Whether a display is on a video cable; False for one that there is not."""
    try:
        return not find("rig_display", display["driver"]).triggered
    except (BadInput, KeyError, TypeError, AttributeError):
        return False
