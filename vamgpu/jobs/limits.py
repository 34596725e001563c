"""A web machine from a TOML file, for the report of its limits.

The file may be that of a web job: tables that do not concern the machine are ignored.
"""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import ConfigDict, Field, model_validator

from vamgpu.jobs.model import Plain
from vamgpu.jobs.read import checked, read_text
from vamgpu.optics.film import Film
from vamgpu.schema.quantities import Density, Length, Speed, Viscosity
from vamgpu.schema.read import Partial, noun
from vamgpu.schema.section import Section
from vamgpu.webs.display import Display
from vamgpu.webs.limits import WebLimits

Roll = Annotated[Partial, noun("wrap", kind="roller", without=("film",))]
Depth = Annotated[Length, Field(description="depth of focus of the projector: its light is at most √2 wider")]
Lens = Annotated[Partial, noun("lens", without=("index",), beside={"depth_of_focus": (Depth, 3.8)})]
"""A lens that focuses in the bath of the film."""


class WebSection(Section):
    """Speed and length of the web.

    speed: speed of its neutral line.  length: length to print.
    """

    speed: Speed
    length: Length = 600.0


class WebResinSection(Section):
    """Flow of the uncured resin.

    density: density of the resin. viscosity: viscosity of the resin; a gel has none.
    """

    density: Density = WebLimits.density
    viscosity: Viscosity | None = None


class MachineFile(Section):
    """The tables of a machine."""

    model_config: ClassVar[ConfigDict] = ConfigDict(extra="ignore")

    film: Annotated[Film, noun("film")]
    roller: Roll
    web: WebSection
    lens: Lens = Plain
    display: Annotated[Display, noun("display")] = Plain
    resin: WebResinSection = WebResinSection()

    @model_validator(mode="before")
    @classmethod
    def _spelled(cls, data: Any) -> Any:
        known = list(cls.model_fields)
        for key in data if isinstance(data, dict) else ():
            close = get_close_matches(key, known, n=1, cutoff=0.75)
            if key not in known and close:
                raise ValueError(f"unknown table [{key}]; did you mean [{close[0]}]?")
        return data


def read_limits(path: str | Path, settings: Iterable[str] = ()) -> WebLimits:
    """Read the limits of a web's machine from a TOML file. Raises `JobError`, `BadInput`."""
    return parse_limits(read_text(path), settings, source=str(path))


def parse_limits(text: str, settings: Iterable[str] = (), *, source: str = "machine") -> WebLimits:
    """The limits of a machine from TOML text. Raises `JobError`, which names every invalid value, and `BadInput`."""
    file, _ = checked(MachineFile, text, settings, source=source)
    lens = file.lens(index=file.film.bath_index)
    return WebLimits(
        file.roller(film=file.film), lens, file.display, file.web.speed, file.web.length,
        file.lens.beside["depth_of_focus"], file.resin.density, file.resin.viscosity,
    )  # fmt: skip
