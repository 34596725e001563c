"""A web machine from a TOML file, for the report of its limits.

The file may be that of a web job: tables that say nothing of the machine are left alone.
"""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any

from pydantic import ConfigDict, Field, model_validator

from vamgpu.jobs.read import checked, read_text
from vamgpu.schema.quantities import Density, Length, Speed, Viscosity
from vamgpu.schema.read import Section, noun
from vamgpu.webs.limits import Limits

MACHINE = """\
# The machine of the roll-to-roll paper at its greatest speed.

[film]
thickness = "3 mm"
resin_index = 1.49
bath_index = 1.33
absorption = "2.2 1/cm"

[roller]
radius = "7.5 mm"
step = "0.5 deg"
legs = "14.14 mm"

[lens]
bins = 3
settle = "5 ms"
depth_of_focus = "3.8 mm"

[display]
rate = "266 Hz"
pixels = [1920, 1080]
pitch = "14.4 um"
bits = 8

[web]
speed = "48 mm/min"
length = "600 mm"

[resin]
density = "1100 kg/m3"
"""
"""An example of such a file."""


Roll = noun("wrap", kind="roller", without=("film",))
Depth = Annotated[Length, Field(description="of the projector: where its light is less than √2 wider")]
Lens = noun("lens", without=("index",), beside={"depth_of_focus": (Depth, 3.8)})
"""A lens that focuses in the bath of the film."""
Plain: Any = Field(default={}, validate_default=True)
"""A table that may be left out."""


class WebSection(Section):
    """What is wanted of the web.

    speed: of its neutral line.  length: to be printed.
    """

    speed: Speed
    length: Length = 600.0


class ResinSection(Section):
    """How the uncured resin flows.

    density: of the resin.  viscosity: a gel has none.
    """

    density: Density = Limits.density
    viscosity: Viscosity | None = None


class MachineFile(Section):
    """The tables of a machine."""

    model_config = ConfigDict(extra="ignore")

    film: noun("film")  # type: ignore[valid-type]
    roller: Roll  # type: ignore[valid-type]
    web: WebSection
    lens: Lens = Plain  # type: ignore[valid-type]
    display: noun("display") = Plain  # type: ignore[valid-type]
    resin: ResinSection = ResinSection()

    @model_validator(mode="before")
    @classmethod
    def _spelled(cls, data: Any) -> Any:
        known = list(cls.model_fields)
        for key in data if isinstance(data, dict) else ():
            close = get_close_matches(key, known, n=1, cutoff=0.75)
            if key not in known and close:
                raise ValueError(f"unknown table [{key}]; did you mean [{close[0]}]?")
        return data


def read_limits(path: str | Path, settings: Iterable[str] = ()) -> Limits:
    """The limits of the machine of a TOML file. Raises `JobError`, and `BadInput` where its parts do not fit."""
    return parse_limits(read_text(path), settings, source=str(path))


def parse_limits(text: str, settings: Iterable[str] = (), *, source: str = "machine") -> Limits:
    """The limits of a machine from TOML text. Raises `JobError` naming every wrong value, and `BadInput`."""
    file, _ = checked(MachineFile, text, settings, source=source)
    lens = file.lens(index=file.film.bath_index)
    return Limits(
        file.roller(film=file.film), lens, file.display, file.web.speed, file.web.length,
        file.lens.beside["depth_of_focus"], file.resin.density, file.resin.viscosity,
    )  # fmt: skip
