"""A web machine from a TOML file, for the report of its limits.

The file may be that of a web job: tables that say nothing of the machine are left alone.
"""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from math import inf
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, model_validator

from vamgpu.jobs.model import Count, Index, Listed, Polarization, Section
from vamgpu.jobs.quantity import Absorption, Angle, DataRate, Density, Length, LensPower, Rate, Speed, Thickness, Time
from vamgpu.jobs.quantity import Viscosity as ViscosityValue
from vamgpu.jobs.read import checked, read_text
from vamgpu.optics.film import Film
from vamgpu.optics.lens import TunableLens
from vamgpu.optics.roller import Roller
from vamgpu.units import dpt
from vamgpu.webs.display import Display
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


class FilmSection(Section):
    """The film and the bath it moves in."""

    thickness: Length
    resin_index: Index
    bath_index: Index = 1.0
    absorption: Absorption = 0.0


class RollerSection(Section):
    """The roller, how far it turns from pose to pose, and how long its straight legs are in the light."""

    radius: Length
    step: Angle
    legs: Thickness | None = None
    polarization: Polarization = "none"


class LensSection(Section):
    """The tunable lens and the relays it stands in."""

    bins: Count = 3
    settle: Time = 5e-3
    depth_of_focus: Length = 3.8
    focal: Annotated[tuple[Length, Length, Length, Length], Listed] = TunableLens.focal
    powers: Annotated[tuple[LensPower, LensPower], Listed] | None = None
    quantum: LensPower = 0.0


class DisplaySection(Section):
    """The mirrors and their wires."""

    rate: Rate = 266.0
    pixels: Annotated[tuple[Count, Count], Listed] = (1920, 1080)
    pitch: Length = 0.0144
    bits: Literal[1, 8] = 8
    wire: Time = Display.wire
    link: DataRate | None = None
    turning: bool = False


class WebSection(Section):
    """What is wanted of the web."""

    speed: Speed
    length: Length = 600.0


class ResinSection(Section):
    """How the uncured resin flows; a gel has no viscosity."""

    density: Density = Limits.density
    viscosity: ViscosityValue | None = None


class MachineFile(Section):
    """The tables of a machine."""

    model_config = ConfigDict(extra="ignore")

    film: FilmSection
    roller: RollerSection
    web: WebSection
    lens: LensSection = LensSection()
    display: DisplaySection = DisplaySection()
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
    film = Film(**file.film.model_dump())
    roller = Roller(film=film, **file.roller.model_dump())
    display = Display(**{**file.display.model_dump(), "link": file.display.link or inf})
    return Limits(
        roller, lens_of(file.lens, file.film), display, file.web.speed, file.web.length, file.lens.depth_of_focus,
        file.resin.density, file.resin.viscosity,
    )  # fmt: skip


def lens_of(wanted: LensSection, film: FilmSection) -> TunableLens:
    """The lens of a machine, which focuses in its bath."""
    low, high = TunableLens.powers if wanted.powers is None else (power / dpt for power in wanted.powers)
    return TunableLens(
        focal=wanted.focal, powers=(low, high), index=film.bath_index, bins=wanted.bins,
        quantum=wanted.quantum / dpt, settle=wanted.settle,
    )  # fmt: skip
