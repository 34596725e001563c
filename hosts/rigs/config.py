"""The file of a rig: which machines it has, where they are, and what they may do."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, model_validator

from vamgpu.errors import JobError
from vamgpu.hosts.calibrating.sections import CameraSection, CameraStageSection, PhotodiodeSection
from vamgpu.hosts.rigs.sections import (
    ControllerSection,
    LensRigSection,
    LightSection,
    ProjectorSection,
    RigSection,
    SafetySection,
    StageSection,
)
from vamgpu.jobs.read import checked
from vamgpu.schema.read import Misplaced, Section

EMULATED = """\
# A rehearsal: every machine is emulated and time is a program's, so that nothing shines and an hour takes seconds.

[rig]
name = "emulated"
machine = "any"

[controller]
driver = "emulated"

[projector]
driver = "emulated"

[lens]
driver = "emulated"

[stage]
driver = "emulated"

[camera]
driver = "emulated"
exposure = "5 ms"
pixel = "7.8 um"
discard = 0

[camera_stage]
driver = "emulated"
microsteps = 5000.0
middle = "20 mm"

[photodiode]
driver = "emulated"
"""


def _each(value: Any) -> Any:
    """``[projector]`` is one, ``[[projector]]`` may be several."""
    return tuple(value) if isinstance(value, list) else (value,) if isinstance(value, dict) else value


class RigFile(Section):
    """A whole file of a rig."""

    rig: RigSection
    controller: ControllerSection
    projector: Annotated[tuple[ProjectorSection, ...], BeforeValidator(_each), Field(min_length=1)]
    lens: LensRigSection | None = None
    stage: StageSection | None = None
    camera: CameraSection | None = None
    camera_stage: CameraStageSection | None = None
    photodiode: PhotodiodeSection | None = None
    light: LightSection = LightSection()
    safety: SafetySection = SafetySection()

    @model_validator(mode="after")
    def _whole(self) -> RigFile:
        ports = {"controller": self.controller, "lens": self.lens, "stage": self.stage}
        ports |= {"camera_stage": self.camera_stage, "photodiode": self.photodiode}
        for name, section in ports.items():
            if section is not None and section.driver != "emulated" and not section.port:
                raise Misplaced(f'driver "{section.driver}" wanted port = "/dev/…" or "socket://host:port"', name)
        every = [("projector", section) for section in self.projector] + [("camera", self.camera), *ports.items()]
        real, emulated = ([name for name, section in every if section and (section.driver == "emulated") is rehearsed]
                          for rehearsed in (False, True))  # fmt: skip
        if real and emulated:
            raise Misplaced(
                f"is emulated and {real[0]} is real; wanted all machines of one kind, as time is of one", emulated[0]
            )
        if self.video:
            self._on_a_cable()
        elif self.stage is not None and not self.emulated:
            raise Misplaced(
                "mirrors behind a trigger follow the motor that the controller itself moves; remove [stage], or take a "
                'projector with driver "hdmi"', "stage",
            )  # fmt: skip
        return self

    def _on_a_cable(self) -> None:
        if len(self.projector) > 1:
            raise Misplaced(
                f"wanted one projector on a video cable, got {len(self.projector)}: cables keep no step", "projector"
            )
        if self.rig.machine != "vial":
            raise Misplaced(
                f'driver "hdmi" prints vials; wanted machine = "vial", got "{self.rig.machine}"', "rig", "machine"
            )
        if self.stage is None:
            raise Misplaced('driver "hdmi" wanted a table [stage]: its angle chooses the pictures', "projector")
        if self.lens is not None:
            raise Misplaced('driver "hdmi" prints vials, which want no lens; remove [lens]', "lens")

    @property
    def emulated(self) -> bool:
        """Whether this is a rehearsal."""
        return self.controller.driver == "emulated"

    @property
    def video(self) -> bool:
        """Whether the projector is on a video cable."""
        return any(section.driver == "hdmi" for section in self.projector)


@dataclass(frozen=True)
class RigConfig:
    """A checked rig. text: of its file.  source: where it came from.  settings: that replace its values."""

    wanted: RigFile
    text: str
    source: str
    settings: tuple[str, ...] = ()


def read_rig(path: str | Path, settings: Iterable[str] = ()) -> RigConfig:
    """Read the file of a rig; the word ``emulated`` is a rig that is rehearsed on. Raises `JobError`."""
    if str(path) == "emulated":
        return parse_rig(EMULATED, settings, source="emulated")
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except (OSError, ValueError, TypeError) as error:  # no UTF-8, or no path
        why = getattr(error, "strerror", None) or error
        raise JobError(f"cannot read the rig {str(path)!r}: {why}; wanted a TOML file, or the word emulated") from error
    return parse_rig(text, settings, source=str(path))


def parse_rig(text: str, settings: Iterable[str] = (), *, source: str = "rig") -> RigConfig:
    """A rig from TOML text. Raises `JobError` naming every wrong value at once."""
    if not isinstance(text, str):
        raise JobError(f"the rig's text is {text!r}; wanted the text of a TOML file")
    try:
        given = (settings,) if isinstance(settings, str) else tuple(settings)
        return RigConfig(checked(RigFile, text, given, source=source)[0], text, source, given)
    except JobError as error:
        alone = "[[projector]]" not in text
        raise JobError(str(error).replace("projector.0", "projector") if alone else str(error)) from error
