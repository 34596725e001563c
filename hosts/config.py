"""The file of a rig: which machines it has, where they are, and what they may do."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from vamgpu.errors import JobError
from vamgpu.jobs.model import Count, Listed, Section
from vamgpu.jobs.quantity import Exposure, Irradiance, Time
from vamgpu.jobs.read import checked

Share = Annotated[float, Field(gt=0, le=1)]
Baud = Annotated[int, Field(ge=300, le=4_000_000)]

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
"""


class RigSection(Section):
    """The rig itself. machine: what jobs it prints; ``any`` is for rehearsals."""

    name: str
    machine: Literal["vial", "web", "any"]


class ControllerSection(Section):
    """What keeps trigger, lease, motion and light. microsteps: of the motion, a millimeter or degree."""

    driver: Literal["vam-controller", "emulated"]
    port: str | None = None
    baud: Baud = 115200
    microsteps: Annotated[float, Field(gt=0)] = 3200.0
    channel: Annotated[int, Field(ge=0, le=7)] = 0


class ProjectorSection(Section):
    """The mirrors. size: rows, columns.  picture, settle: how long a picture and the lens take at least."""

    driver: Literal["alp", "emulated"]
    library: str | None = None
    serial: int = 0
    size: Annotated[tuple[Count, Count], Listed] = (1080, 1920)
    picture: Exposure = 1.0 / 266.0


class LensRigSection(Section):
    """The tunable lens."""

    driver: Literal["optotune", "emulated"]
    port: str | None = None
    firmware: str | None = None
    settle: Time = 0.005
    lowest: float = -5.0
    highest: float = 10.0


class StageSection(Section):
    """The stage that turns a vial."""

    driver: Literal["zaber", "standa", "emulated"]
    port: str | None = None
    axis: Count = 1


class LightSection(Section):
    """The light. power: share of full drive.  irradiance: of a full-on pixel at full drive."""

    power: Share = 1.0
    irradiance: Irradiance | None = None


class SafetySection(Section):
    """What holds the light. tolerance: of motion, in poses.  budget: light over what the plan needs.

    lease: how long the controller keeps the light by itself.  resume: the longest pause after which a print goes on;
    resin forgets a dose meanwhile.
    """

    lease: Time = 0.25
    tolerance: Annotated[float, Field(gt=0, le=5)] = 0.5
    budget: Annotated[float, Field(ge=1, le=2)] = 1.01
    resume: Time = 30.0


class RigFile(Section):
    """A whole file of a rig."""

    rig: RigSection
    controller: ControllerSection
    projector: ProjectorSection
    lens: LensRigSection | None = None
    stage: StageSection | None = None
    light: LightSection = LightSection()
    safety: SafetySection = SafetySection()

    @model_validator(mode="after")
    def _whole(self) -> RigFile:
        machines = {"controller": self.controller, "lens": self.lens, "stage": self.stage}
        for name, section in machines.items():
            if section is not None and section.driver != "emulated" and not section.port:
                raise ValueError(f'{name} = driver "{section.driver}" wanted port = "/dev/…" or "socket://host:port"')
        if self.projector.driver == "alp" and not self.projector.library:
            raise ValueError('projector: driver "alp" wanted library = "path of the maker\'s library"')
        drivers = {section.driver == "emulated" for section in (self.projector, *machines.values()) if section}
        if len(drivers) > 1:
            raise ValueError("some machines are emulated and some are real; wanted all of one kind, as time is of one")
        if self.rig.machine == "vial" and self.stage is None:
            raise ValueError("a rig for vials wanted a table [stage]")
        return self

    @property
    def emulated(self) -> bool:
        """Whether this is a rehearsal."""
        return self.controller.driver == "emulated"


@dataclass(frozen=True)
class RigConfig:
    """A checked rig. text: of its file.  source: where it came from."""

    wanted: RigFile
    text: str
    source: str


def read_rig(path: str | Path, settings: Iterable[str] = ()) -> RigConfig:
    """Read the file of a rig; the word ``emulated`` is a rig that is rehearsed on. Raises `JobError`."""
    if str(path) == "emulated":
        return parse_rig(EMULATED, settings, source="emulated")
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        why = getattr(error, "strerror", None) or error
        raise JobError(f"cannot read the rig {str(path)!r}: {why}; wanted a TOML file, or the word emulated") from error
    return parse_rig(text, settings, source=str(path))


def parse_rig(text: str, settings: Iterable[str] = (), *, source: str = "rig") -> RigConfig:
    """A rig from TOML text. Raises `JobError` naming every wrong value at once."""
    return RigConfig(checked(RigFile, text, settings, source=source)[0], text, source)


def given(text: str) -> dict[str, Any]:
    """The tables of a rig's file as written."""
    return tomllib.loads(text)
