"""What a job file may say. Lengths and the like carry their units and are read into mm, s and mJ.

Tables that are nouns of the library have the fields of their constructors, which `vamgpu.schema` reads; the tables of
this file say what is to be made of them.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, ValidationInfo, model_validator

from vamgpu.geometry import FULL_TURN
from vamgpu.jobs.material import with_material
from vamgpu.schema.quantities import (
    Absorption,
    Angle,
    Count,
    Dose,
    Exposure,
    Fill,
    Irradiance,
    Length,
    NonNegative,
    Place,
    Positive,
    Quantity,
    Thickness,
    Turn,
    Wavelength,
)
from vamgpu.schema.read import Listed, Misplaced, OneOrMany, Section, noun

Row = tuple[float, float, float]
Places = Annotated[Any, OneOrMany(Place, Annotated[tuple[Place, ...], Listed])]
Missed = Annotated[Positive, Field(description="largest share by which the width may miss its formula")]
TOLERANCE = {"tolerance": (Missed, 0.02)}
LENGTH = Quantity("a length", least=0.0)


class TargetSection(Section):
    """The part: a mesh file or a bundled shape, its size and its voxels.

    mesh: file of the part (STL, PLY, OBJ, 3MF).  shape: a bundled one in place of a mesh, such as "boat".  height: of
    the part along z.  factor: by which it is scaled, in place of a height.  pitch: edge of a voxel.  orientation: 3 × 3
    matrix that turns the part first.  margin: voxels between the part and the rim.
    """

    mesh: str | None = None
    shape: str | None = None
    height: Length | None = None
    factor: Positive | None = None
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


def _length_or_file(text: Any) -> float | str:
    """A length, or the path of a calibration: what begins like a number and is no file is a length."""
    if isinstance(text, str) and (text.endswith(".toml") or "/" in text or "\\" in text or text[:1].isalpha()):
        return text
    try:
        return LENGTH.read(text)
    except ValueError as error:
        raise ValueError(f"{error}; or the path of a calibration: spread = \"mtf/result.toml\"") from error


class BeamSection(Section):
    """The projector's light.

    pitch: edge of a pixel in air.  pixels: columns and rows; by default as many as the part needs.  fill: share of a
    pixel's area that is lit.  spread: standard deviation of the point spread, measured where the pitch is, "0 um" for a
    perfect lens, or the result of `vam calibrate mtf`; half a pixel where nothing is said.  footprint: how a pixel
    meets a voxel: "exact", by its area, or "joseph", by one ray.
    """

    pitch: Length
    pixels: Annotated[tuple[Count, Count] | None, Listed] = None
    fill: Fill = 1.0
    spread: Annotated[float | str, BeforeValidator(_length_or_file)] | None = None
    footprint: Literal["exact", "joseph"] = "exact"


def _count_or_file(value: Any) -> Any:
    named = isinstance(value, str) and value.lower().endswith(".csv")
    if not named and (isinstance(value, bool) or not isinstance(value, int) or value < 1):
        raise ValueError('wanted a whole number of angles ≥ 1, or a file of measured ones: angles = "measured.csv"')
    return value


class TurntableSection(Section):
    """The motion: even angles over a full turn or a range of it, or measured ones from a file.

    angles: how many, or a CSV file of measured ones.  range: part of a turn that they are even over.
    """

    angles: Annotated[int | str, BeforeValidator(_count_or_file)] = 360
    range: Angle | None = None

    @model_validator(mode="after")
    def _one_of_both(self) -> TurntableSection:
        if self.range is not None and isinstance(self.angles, str):
            raise ValueError(f"got a range and the file {self.angles!r}, which has its own; remove one of both")
        if self.range is not None and self.range > FULL_TURN * (1.0 + 1e-9):
            raise Misplaced(f"got {self.range:.6g} rad; wanted 360 deg at most: correct the value", "range")
        return self


class WobbleSection(Section):
    """Where the axis stands.

    across, along: off its place across the light and along it, always or at every pose.  radius: of a circle that it
    runs once a turn instead.  phase: angle from x of the point of the table that carries it.
    """

    across: Places = 0.0
    along: Places = 0.0
    radius: Thickness | None = None
    phase: Turn = 0.0

    @model_validator(mode="after")
    def _one_of_both(self) -> WobbleSection:
        if self.radius is not None and self.model_fields_set & {"across", "along"}:
            raise ValueError('wanted radius = "50 um", or across and along, not both')
        return self


class ResinSection(Section):
    """What the resin is, and what its inhibitor does while the light is on.

    material: a bundled resin, or a file. It gives index and absorption at the wavelength to the vessel, and the
    critical dose to [print].  wavelength: of the light.  inhibitor: that diffuses as fast as the resin's viscosity
    says.  temperature: of the resin, where it is not its material's.  exposure: time the inhibitor has.
    diffusion: the same in numbers of one's own; any method then seeks light for the dose after diffusion.
    precompensate: the recipe starts from a target that is sharpened for it.
    """

    material: str | None = None
    wavelength: Wavelength | None = None
    inhibitor: str | None = None
    temperature: Annotated[float, Quantity("a temperature", above=0.0)] | None = None
    exposure: Exposure | None = None
    diffusion: noun("diffusion") | None = None  # type: ignore[valid-type]
    precompensate: bool = False

    @model_validator(mode="after")
    def _whole(self) -> ResinSection:
        if self.inhibitor is not None and (self.material is None or self.exposure is None or self.diffusion):
            raise ValueError('wanted inhibitor = "oxygen" with material and exposure = "20 s", and no diffusion')
        if self.precompensate and self.inhibitor is None and self.diffusion is None:
            raise Misplaced("wanted diffusion or an inhibitor: there is nothing to compensate for", "precompensate")
        return self


class ColorsSection(Section):
    """A second color that undoes the dose of the first.

    absorption: of the resin for the second color.  strength: dose of the first that one unit of the second undoes.
    rule: by which the two are found.
    """

    absorption: Absorption
    strength: Positive = 1.0
    rule: noun("rule") = Field(default={}, validate_default=True)  # type: ignore[valid-type]


class SolveSection(Section):
    """How light is found.

    method: by its name, with its own parameters; the table [method] sets them.  iterations: in all; the method's own by
    default.  tolerance: share of the first loss at which to stop.  pairs: projector pairs that may be spent.  device:
    where to compute; the best one here by default.
    """

    method: str = "default"
    iterations: Count | None = None
    tolerance: NonNegative = 0.0
    pairs: Positive | None = None
    device: str | None = None


class FramesSection(Section):
    """How light becomes pictures.

    bits: of a pixel.  gray: file of the projector's gray curve.  flip_r, flip_z: mirror columns, rows.  shift: columns
    and rows by which pictures are moved.  quantile: of the lit pixels that a full-on pixel shows.  dither: round to the
    nearest level, or carry the error on to the next angle.
    """

    bits: Literal[1, 8] = 8
    gray: str | None = None
    flip_r: bool = False
    flip_z: bool = False
    shift: Annotated[tuple[float, float], Listed] = (0.0, 0.0)
    quantile: Annotated[float, Field(gt=0, le=1)] = 0.99999
    dither: Literal["round", "error-diffusion"] = "round"


class PrintSection(Section):
    """What it takes to predict times.

    irradiance: of a full-on pixel in air.  critical_dose: from which the resin is solid.
    absorption: of the resin, where the vessel says none.
    """

    irradiance: Irradiance
    critical_dose: Dose
    absorption: Absorption | None = None


class JobFile(Section):
    """A whole job file.

    [vessel] is any container, [vial] and [vat] the usual two. [light] is light that rises, a cone or inclined, or a
    vessel whose light is one ray a pixel, past which an axis may wobble along the light too.
    """

    target: TargetSection
    beam: BeamSection
    turntable: TurntableSection = TurntableSection()
    vial: noun("vessel", kind="vial") | None = None  # type: ignore[valid-type]
    vat: noun("vessel", kind="vat") | None = None  # type: ignore[valid-type]
    vessel: noun("vessel") | None = None  # type: ignore[valid-type]
    light: noun("light", "vessel") | None = None  # type: ignore[valid-type]
    wobble: WobbleSection | None = None
    defocus: noun("defocus", beside=TOLERANCE) | None = None  # type: ignore[valid-type]
    tiles: noun("operator", kind="tiles", without=("operator",)) | None = None  # type: ignore[valid-type]
    resin: ResinSection = ResinSection()
    colors: ColorsSection | None = None
    method: noun("method") | None = None  # type: ignore[valid-type]
    solve: SolveSection = SolveSection()
    frames: FramesSection = FramesSection()
    print: PrintSection | None = None

    @model_validator(mode="before")
    @classmethod
    def _of_a_material(cls, data: Any, info: ValidationInfo) -> Any:
        return with_material(data, (info.context or {}).get("folder"))

    @model_validator(mode="after")
    def _fits(self) -> JobFile:
        said = [name for name in ("vial", "vat", "vessel") if getattr(self, name) is not None]
        if len(said) > 1:
            raise Misplaced(f"got both [{said[0]}] and [{said[1]}]; remove one", said[1])
        if said and self.light is not None:
            raise Misplaced(f"got [{said[0]}] and [light]; wanted the vessel in [light.vessel]", said[0])
        if self.light is not None and self.beam.footprint != "exact":
            raise Misplaced('got "joseph" and [light], whose pixels are one ray anyway; remove it', "beam", "footprint")
        if self.method is not None and self.solve.method != "default":
            raise Misplaced("got a method here and [method]; remove one", "solve", "method")
        if self.method is not None and self.colors is not None:
            raise Misplaced("got [method] and [colors]; wanted the rule of two colors in [colors.rule]", "method")
        if self.resin.precompensate and not hasattr(self.method, "diffusion"):
            raise Misplaced('wanted [method] kind = "recipe", which starts from the target', "resin", "precompensate")
        return self
