"""What a job file may say. Lengths and the like carry their units and are read into mm, s and mJ."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from vamgpu.geometry import FULL_TURN
from vamgpu.jobs.quantity import Absorption, Angle, DoseValue, Irradiance, Length, Spread, Thickness


def _tupled(value: Any) -> Any:
    return tuple(_tupled(entry) for entry in value) if isinstance(value, list) else value


Listed = BeforeValidator(_tupled)
Index = Annotated[float, Field(ge=1.0, le=5.0)]
Count = Annotated[int, Field(ge=1)]
Row = tuple[float, float, float]
Polarization = Literal["none", "s", "p"]


class Misplaced(ValueError):
    """What is wrong between the tables of a file. key: where one would begin to mend it."""

    def __init__(self, message: str, *key: str) -> None:
        super().__init__(message)
        self.key = key


class Section(BaseModel):
    """A table of a job file: nothing unknown, nothing converted in silence."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class TargetSection(Section):
    """The part: a mesh file or a bundled shape, its size and its voxels."""

    mesh: str | None = None
    shape: str | None = None
    height: Length | None = None
    factor: Annotated[float, Field(gt=0)] | None = None
    pitch: Length
    orientation: Annotated[tuple[Row, Row, Row] | None, Listed] = None
    margin: Annotated[int, Field(ge=0)] = 2

    @model_validator(mode="after")
    def _one_of_each(self) -> TargetSection:
        if (self.mesh is None) == (self.shape is None):
            raise ValueError('wanted exactly one of mesh = "part.stl" and shape = "boat"')
        if (self.height is None) == (self.factor is None):
            raise ValueError('wanted exactly one of height = "11.5 mm" and factor = 1.0')
        return self


class BeamSection(Section):
    """The projector's light: pixel edge in air, and how many; by default as many as the part needs.

    fill: share of a pixel's area that is lit.  spread: standard deviation of the point spread in the resin, "0 um" for
    a perfect lens, or the result of `vam calibrate mtf`; half a pixel where nothing is said.  footprint: how a pixel
    meets a voxel: "exact", by its area, or "joseph", by one ray.
    """

    pitch: Length
    pixels: Annotated[tuple[Count, Count] | None, Listed] = None
    fill: Annotated[float, Field(gt=0, le=1)] = 1.0
    spread: Spread | None = None
    footprint: Literal["exact", "joseph"] = "exact"


def _count_or_file(value: Any) -> Any:
    named = isinstance(value, str) and value.lower().endswith(".csv")
    if not named and (isinstance(value, bool) or not isinstance(value, int) or value < 1):
        raise ValueError('wanted a whole number of angles ≥ 1, or a file of measured ones: angles = "measured.csv"')
    return value


class TurntableSection(Section):
    """The motion: even angles over a full turn or a range of it, or measured ones from a file."""

    angles: Annotated[int | str, BeforeValidator(_count_or_file)] = 360
    range: Angle | None = None

    @model_validator(mode="after")
    def _one_of_both(self) -> TurntableSection:
        if self.range is not None and isinstance(self.angles, str):
            raise ValueError(f"got a range and the file {self.angles!r}, which has its own; remove one of both")
        if self.range is not None and self.range > FULL_TURN * (1.0 + 1e-9):
            raise Misplaced(f"got {self.range:.6g} rad; wanted 360 deg at most: correct the value", "range")
        return self


class VialSection(Section):
    """A round vial in air or in a bath."""

    radius: Length
    wall: Thickness
    resin_index: Index
    wall_index: Index
    bath_index: Index = 1.0
    absorption: Absorption = 0.0
    polarization: Polarization = "none"


class VatSection(Section):
    """A vat with flat windows whose liquid matches the resin."""

    width: Length
    depth: Length | None = None
    radius: Length | None = None
    absorption: Absorption = 0.0
    resin_index: Index = 1.0
    wall_index: Index = 1.0
    bath_index: Index = 1.0
    polarization: Polarization = "none"


class SolveSection(Section):
    """How light is found."""

    method: str = "default"
    iterations: Count | None = None
    device: str | None = None


class FramesSection(Section):
    """How light becomes pictures."""

    bits: Literal[1, 8] = 8
    gray: str | None = None
    flip_r: bool = False
    flip_z: bool = False
    shift: Annotated[tuple[float, float], Listed] = (0.0, 0.0)
    quantile: Annotated[float, Field(gt=0, le=1)] = 0.99999
    dither: Literal["round", "error-diffusion"] = "round"


class PrintSection(Section):
    """What it takes to predict times."""

    irradiance: Irradiance
    critical_dose: DoseValue


class JobFile(Section):
    """A whole job file."""

    target: TargetSection
    beam: BeamSection
    turntable: TurntableSection = TurntableSection()
    vial: VialSection | None = None
    vat: VatSection | None = None
    solve: SolveSection = SolveSection()
    frames: FramesSection = FramesSection()
    print: PrintSection | None = None

    @model_validator(mode="after")
    def _one_vessel(self) -> JobFile:
        if self.vial is not None and self.vat is not None:
            raise Misplaced("got both [vial] and [vat]; remove one", "vat")
        return self
