"""Models of a job file. Lengths and other quantities carry their units and are read into mm, s and mJ.

Tables of components have the fields of their constructors, which `vamgpu.schema` reads; this file has all other tables.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, ValidationInfo, model_validator

from vamgpu.chemistry.diffusion import Diffusion
from vamgpu.errors import BadInput
from vamgpu.geometry import FULL_TURN, Vessel
from vamgpu.jobs.material import with_material
from vamgpu.methods.dual.passes import Rule
from vamgpu.methods.method import Method
from vamgpu.methods.tolerances import Tolerances
from vamgpu.operators.oblique import Rising
from vamgpu.operators.scattering_rings import PHOTONS
from vamgpu.optics.vat import Vat
from vamgpu.optics.vial import Vial
from vamgpu.schema.quantities import (
    Absorption,
    Angle,
    Count,
    DensityDifference,
    Dose,
    ExposureTime,
    Fill,
    Irradiance,
    Length,
    NonNegative,
    Pitch,
    PixelPitch,
    Place,
    Positive,
    Quantity,
    Share,
    Thickness,
    Time,
    Turn,
    Viscosity,
    Wavelength,
)
from vamgpu.schema.read import OneOrMany, Partial, noun
from vamgpu.schema.section import Listed, Misplaced, Named, Section
from vamgpu.travel import Travel

Row = tuple[float, float, float]
Places = Annotated[Any, OneOrMany(Place, Annotated[tuple[Place, ...], Listed])]
Missed = Annotated[Positive, Field(description="largest relative error of the width")]
TOLERANCE = {"tolerance": (Missed, 0.02)}
Noise = Annotated[Positive, Field(description="largest error of scattered light, relative to its greatest dose")]
Followed = Annotated[Count, Field(description="number of photons that are followed")]
SCATTERED: dict[str, tuple[Any, float]] = {"tolerance": (Noise, 0.01), "photons": (Followed, PHOTONS)}
Lacking: Any = Field(
    description="share of the oxygen that is used up before the print, or an NPY file, [z] or [x, y, z]"
)
Used = Annotated[Any, OneOrMany(Share, Annotated[str, Named], str), Lacking]
USED: dict[str, tuple[Any, float]] = {"used": (Used, 0.0)}
LENGTH = Quantity("a length", least=0.0, example="25 um")
MOST_ANGLES = 1_000_000
"""Largest number of angles per turn: more are a typing error, and would fail after minutes for lack of memory."""
Plain: Any = Field(default={}, validate_default=True)  # an optional table


Role = Literal["print", "gray", "keep out", "don't care", "insert"]


class BodySection(Section):
    """One of several bodies, at the place where it was drawn; see docs/tasks.md. [target] sets the voxels for all of
    them.

    mesh: file of the body (STL, PLY, OBJ, 3MF, STEP).  part: number of the body in a 3MF file of several.  roles:
    "names" takes all objects of a 3MF file, with the roles that their names begin with; dose is then the limit of those
    to keep out.  shape: a bundled shape in place of a mesh, such as "boat".  role: requirement on its voxels.  name:
    name in reports.  dose: dose of gray, or dose limit of keep out, relative to the dose that prints.  tolerance:
    allowed relative deviation of a gray dose.  weight: weight of its voxels in methods that minimize a loss.  priority:
    voxels in an overlap belong to the body with the higher priority.  index: refractive index of a transparent
    insert.  absorption: absorption of a transparent insert.
    """

    mesh: Annotated[str | None, Named] = None
    part: Count | None = None
    roles: Literal["names"] | None = None
    shape: str | None = None
    role: Role = "print"
    name: str | None = None
    dose: Positive | None = None
    tolerance: Positive = 0.2
    weight: Positive = 1.0
    priority: float | None = None
    index: Annotated[float | None, Field(ge=1, lt=10)] = None
    absorption: Absorption | None = None

    @model_validator(mode="after")
    def _whole(self) -> BodySection:
        if (self.mesh is None) == (self.shape is None):
            raise ValueError('expected exactly one of mesh = "part.stl" and shape = "boat"')
        if self.part is not None and not str(self.mesh).lower().endswith(".3mf"):
            raise ValueError("got part; expected it only with the mesh of a 3MF file of several parts: remove it")
        if self.roles is not None:
            alone = sorted(self.model_fields_set - {"mesh", "roles", "dose", "weight"})
            if alone or not str(self.mesh).lower().endswith(".3mf"):
                raise ValueError(f"got roles with {', '.join(alone) or self.mesh}; expected the mesh of a 3MF file, at "
                                 "most with dose and weight: remove it")  # fmt: skip
            return self
        if (self.dose is None) == (self.role in ("gray", "keep out")):
            raise ValueError(f'role is "{self.role}"; expected dose = 0.7, say, for gray and keep out, and no dose '
                             "for other roles")  # fmt: skip
        if self.role != "insert" and (self.index is not None or self.absorption is not None):
            raise ValueError(f'role is "{self.role}"; expected index and absorption only for inserts')
        return self


class TargetSection(Section):
    """The part: a mesh file or a bundled shape, its size and its voxels. With [[body]], the voxels are those of all
    bodies.

    mesh: file of the part (STL, PLY, OBJ, 3MF, STEP).  shape: a bundled shape instead, such as "boat".  height:
    height of the part along z.  factor: scale of the part, in place of a height.  pitch: edge of a voxel; by default
    the width of a pixel in the resin.  orientation: 3 × 3 matrix that rotates the part first.  margin: number of voxels
    between the part and the rim.  shape_of_grid: number of voxels along x, y and z, with [[body]]; by default as many
    as the bodies need.  origin: point in the bodies' coordinates that is placed at the center of the axis.  void: dose
    limit outside all bodies, relative to the dose that prints.
    """

    mesh: Annotated[str | None, Named] = None
    shape: str | None = None
    height: Length | None = None
    factor: Positive | None = None
    pitch: Pitch | None = None
    orientation: Annotated[tuple[Row, Row, Row] | None, Listed] = None
    margin: Annotated[int, Field(ge=0)] = 2
    shape_of_grid: Annotated[tuple[Count, Count, Count] | None, Listed] = None
    origin: Annotated[Row | None, Listed] = None
    void: Positive | None = None

    @model_validator(mode="after")
    def _one_of_each(self, info: ValidationInfo) -> TargetSection:
        alone = [name for name in ("mesh", "shape", "height") if getattr(self, name) is not None]
        beside = [name for name in ("shape_of_grid", "origin", "void") if getattr(self, name) is not None]
        if (info.context or {}).get("bodies"):
            if alone:
                raise ValueError(f"got {', '.join(alone)} with [[body]]; expected it in a separate [[body]]: move it")
            return self
        if beside:
            raise ValueError(f"got {', '.join(beside)} without a [[body]]; remove it")
        if (self.mesh is None) == (self.shape is None):
            raise ValueError('expected exactly one of mesh = "part.stl" and shape = "boat"')
        if (self.height is None) == (self.factor is None):
            raise ValueError('expected exactly one of height = "11.5 mm" and factor = 1.0')
        return self


def _length_or_file(text: Any) -> float | str:
    """A length, or the path of a calibration: text that begins like a number and does not name a file is a length."""
    if isinstance(text, str) and (text.endswith(".toml") or "/" in text or "\\" in text or text[:1].isalpha()):
        return text
    try:
        return LENGTH.read(text)
    except ValueError as error:
        raise ValueError(f'{error}; or the path of a calibration: spread = "mtf/result.toml"') from error


class BeamSection(Section):
    """The projector's light.

    pitch: edge of a pixel in air.  pixels: columns and rows; by default as many as the part needs.  fill: share of a
    pixel's area that is lit.  spread: standard deviation of the point spread, a length in air, "0 um" for a perfect
    lens, or the result of `vam calibrate mtf`; by default half a pixel.
    """

    pitch: PixelPitch
    pixels: Annotated[tuple[Count, Count] | None, Listed] = None
    fill: Fill = 1.0
    spread: Annotated[float | str, BeforeValidator(_length_or_file), Named] | None = None


def _count_or_file(value: Any) -> Any:
    named = isinstance(value, str) and value.lower().endswith(".csv")
    if not named and (isinstance(value, bool) or not isinstance(value, int) or value < 1):
        raise ValueError('expected a whole number of angles ≥ 1, or a file of measured ones: angles = "measured.csv"')
    if isinstance(value, int) and value > MOST_ANGLES:
        raise ValueError(f"expected at most {MOST_ANGLES:,} angles: even a turn of 10 minutes with 1,000 frames per "
                         "second has only 600,000")  # fmt: skip
    return value


class TurntableSection(Section):
    """The motion: equally spaced angles over a full turn or a range of it, or measured angles from a file.

    angles: number of angles, or a CSV file of measured ones; by default the number from `vamgpu.enough_angles`.  most:
    greatest number of angles that the projector shows per turn, if the job leaves out angles.  range: part of a turn
    over which the angles are spaced.  lit_share: share of each step during which the frame is lit while the container
    turns, 0 (at rest) to 1; by default 1, and 0 for measured angles.
    """

    angles: Annotated[int | str, BeforeValidator(_count_or_file), Named] | None = None
    most: Count | None = None
    range: Angle | None = None
    lit_share: Share | None = None

    @model_validator(mode="after")
    def _one_of_both(self) -> TurntableSection:
        if self.most is not None and self.angles is not None:
            raise Misplaced(f"got {self.most} with angles = {self.angles!r}; remove one of the two", "most")
        if self.range is not None and isinstance(self.angles, str):
            raise ValueError(f"got a range and the file {self.angles!r}, which has its own; remove one of the two")
        if self.range is not None and self.range > FULL_TURN * (1.0 + 1e-9):
            raise Misplaced(f"got {self.range:.6g} rad; expected at most 360 deg: correct the value", "range")
        return self


class WobbleSection(Section):
    """Offset of the rotation axis, across and along the light, or on a circle.

    across: offset across the light, one for all angles or one for each. along: offset along the light, one for all
    angles or one for each. radius: radius of the circle that the axis describes once per turn, in place of offsets.
    phase: direction, measured from x, of the point of the turntable through which the axis passes.
    """

    across: Places = 0.0
    along: Places = 0.0
    radius: Thickness | None = None
    phase: Turn = 0.0

    @model_validator(mode="after")
    def _one_of_both(self) -> WobbleSection:
        if self.radius is not None and self.model_fields_set & {"across", "along"}:
            raise ValueError('expected radius = "50 um", or across and along, not both')
        return self


class TravelSection(Section):
    """The path of the part through all turns of the print, which frames follow.

    turns: number of turns of the print; that of a helix follows. period: time of a turn. heights: CSV file of measured
    heights above the place for which the part is solved, with columns such as time_s and height_um. density_difference:
    density of the gelled part less that of the resin, if it sinks by Stokes's law. viscosity: viscosity of the resin.
    diameter: diameter of a sphere that sinks as fast as the part. start: time at which it begins to sink. rise: height
    by which the part of a helical print rises in each turn, negative if it is lowered. rows: rows of the projector's
    image that such a part passes. x: distance from the axis along x of the vial, in straight light. y: distance along
    y. follow: whether frames move with the part.
    """

    turns: Count | None = None
    period: ExposureTime | None = None
    heights: Annotated[str, Named] | None = None
    density_difference: DensityDifference | None = None
    viscosity: Viscosity | None = None
    diameter: Length | None = None
    start: Time = 0.0
    rise: Place | None = None
    rows: Count | None = None
    x: Place = 0.0
    y: Place = 0.0
    follow: bool = True

    @model_validator(mode="after")
    def _one_law(self) -> TravelSection:
        turned = {"turns", "period"}
        laws = {"heights": turned, "rise": {"rows"}, "density_difference": turned | {"viscosity", "diameter"}}
        given = [law for law in laws if getattr(self, law) is not None]
        if len(given) > 1 or not (given or self.x or self.y):
            raise ValueError(f"got {' and '.join(given) or 'no path'}; expected one of {', '.join(laws)}")
        law = given[0] if given else "x and y"
        needed, beside = laws.get(law, set()), {"density_difference": {"start"}, "x and y": turned}.get(law, set())
        if lacks := sorted(needed - self.model_fields_set):
            raise Misplaced(f"expected {', '.join(lacks)} with it: add it", law)
        if others := sorted(self.model_fields_set - needed - beside - {law, "x", "y", "follow"}):
            raise Misplaced(f"got it with {law}, whose path does not depend on it: remove it", others[0])
        return self


class ResinSection(Section):
    """The resin, and diffusion of its inhibitor during the exposure.

    material: a bundled resin, or a file. It sets index and absorption of the vessel at the wavelength, and the critical
    dose of [print].  wavelength: wavelength of the light.  inhibitor: inhibitor that diffuses; its diffusivity follows
    from the resin's viscosity.  temperature: temperature of the resin, if it is not that of its material.  exposure:
    time during which the inhibitor diffuses.  diffusion: diffusion set by numbers, in place of an inhibitor; every
    method then optimizes the dose after diffusion.  precompensate: the recipe starts from a target sharpened against
    diffusion.  kinetics: "oxygen" for patterns that follow the oxygen of [resin.oxygen] through all turns; by default
    the dose alone counts.  oxygen: oxygen that inhibits curing, and the turns of the print.
    """

    material: str | None = None
    wavelength: Wavelength | None = None
    inhibitor: str | None = None
    temperature: Annotated[float, Quantity("a temperature", above=0.0)] | None = None
    exposure: ExposureTime | None = None
    diffusion: Annotated[Diffusion, noun("diffusion")] | None = None
    precompensate: bool = False
    kinetics: Literal["oxygen"] | None = None
    oxygen: Annotated[Partial, noun("oxygen", without=("used",), beside=USED)] | None = None

    @model_validator(mode="after")
    def _whole(self) -> ResinSection:
        if (self.kinetics == "oxygen") != (self.oxygen is not None):
            lacks = 'kinetics = "oxygen"' if self.kinetics is None else "[resin.oxygen] with diffusivity, turns, period"
            raise Misplaced(f"expected {lacks} with it: add it", "oxygen" if self.oxygen else "kinetics")
        if self.oxygen and (self.inhibitor or self.diffusion or self.precompensate):
            raise Misplaced("got [resin.oxygen] with an inhibitor, diffusion or precompensate; expected oxygen alone, "
                            "which diffuses: remove them", "oxygen")  # fmt: skip
        if self.inhibitor is not None and (self.material is None or self.exposure is None or self.diffusion):
            raise ValueError('expected inhibitor = "oxygen" with material and exposure = "20 s", and no diffusion')
        if self.precompensate and self.inhibitor is None and self.diffusion is None:
            raise Misplaced("expected diffusion or an inhibitor: there is nothing to compensate for", "precompensate")
        return self


class MediumSection(Section):
    """Arrays of index and absorption that turn with the resin, such as those of a CT scan.

    index: NPY or NPZ file of refractive indices, [x, y] or [x, y, z]; by default that of the resin.  absorption: NPY or
    NPZ file of absorption [1/mm], natural logarithm; by default that of the resin.  pitch: distance of the samples.
    center: middle of the arrays, from the axis and the middle of the voxels.
    """

    index: Annotated[str | None, Named] = None
    absorption: Annotated[str | None, Named] = None
    pitch: Length
    center: Annotated[tuple[Place, Place, Place], Listed] = (0.0, 0.0, 0.0)


class ColorsSection(Section):
    """A second color that reduces the dose of the first.

    absorption: absorption of the resin for the second color. strength: dose of the first color that one unit of the
    second removes. rule: rule that finds the patterns of both colors.
    """

    absorption: Absorption
    strength: Positive = 1.0
    rule: Annotated[Rule, noun("rule")] = Plain


class SolveSection(Section):
    """Settings of the optimization.

    method: name of the method, with its default parameters; the table [method] sets others.  iterations: total number
    of iterations; by default that of the method.  tolerance: share of the first loss at which to stop.  evaluations:
    greatest number of projector evaluations.  exposure_limit: longest exposure, computed with lamp and resin of
    [print]; for the default method.  device: device that computes; by default the best one.  operator: "voxels", by
    rays through each voxel; "rings", by Fourier transforms over equally spaced angles (`RingProjection`), which is
    faster on large volumes and within 0.003 of the window of a run of 40 evaluations; "auto", rings if they support the
    job and were measured to be faster.
    """

    method: str = "default"
    iterations: Count | None = None
    tolerance: NonNegative = 0.0
    evaluations: Positive | None = None
    exposure_limit: ExposureTime | None = None
    device: str | None = None
    operator: Literal["voxels", "rings", "auto"] = "voxels"


class FramesSection(Section):
    """The packing of patterns into frames.

    bits: bits per pixel.  gray: file of the projector's gray curve.  flip_r: mirror columns.  flip_z: mirror rows.
    shift: columns and rows by which frames are moved.  quantile: quantile of the lit pixels that a full-on pixel shows;
    by default the brightest pixel that is not an outlier.  dither: "round" rounds to the nearest level,
    "error-diffusion" carries the error to the next angle, "fit" chooses pixels by their dose; by default "fit" if
    possible, and "error-diffusion" for two colors with 1 bit.
    """

    bits: Literal[1, 8] = 8
    gray: Annotated[str | None, Named] = None
    flip_r: bool = False
    flip_z: bool = False
    shift: Annotated[tuple[float, float], Listed] = (0.0, 0.0)
    quantile: Annotated[float | None, Field(gt=0, le=1)] = None
    dither: Literal["round", "error-diffusion", "fit"] | None = None


class PrintSection(Section):
    """Lamp and resin, for predicting print times.

    irradiance: irradiance of a full-on pixel in air.  critical_dose: dose at which the resin solidifies.  absorption:
    absorption of the resin, if the vessel has none.
    """

    irradiance: Irradiance
    critical_dose: Dose
    absorption: Absorption | None = None


class JobFile(Section):
    """A whole job file.

    [vessel] is any container; [vial] and [vat] are the usual ones. [light] is a cone of light, inclined light, or a
    vessel with one ray per pixel. In these, the axis may also wobble along the light. [tolerances] are the errors that
    the print must tolerate; one set of patterns is found for all their corners.
    """

    target: TargetSection
    body: Annotated[tuple[BodySection, ...], Listed] = ()
    beam: BeamSection
    turntable: TurntableSection = TurntableSection()
    vial: Annotated[Vial, noun("vessel", kind="vial")] | None = None
    vat: Annotated[Vat, noun("vessel", kind="vat")] | None = None
    vessel: Annotated[Vessel, noun("vessel")] | None = None
    light: Annotated[Rising | Vessel, noun("light", "vessel")] | None = None
    wobble: WobbleSection | None = None
    travel: TravelSection | None = None
    medium: MediumSection | None = None
    defocus: Annotated[Partial, noun("defocus", beside=TOLERANCE)] | None = None
    scattering: Annotated[Partial, noun("scattering", beside=SCATTERED)] | None = None
    tiles: Annotated[Partial, noun("operator", kind="tiles", without=("operator",))] | None = None
    tolerances: Annotated[Tolerances, noun("tolerances")] | None = None
    resin: ResinSection = ResinSection()
    colors: ColorsSection | None = None
    method: Annotated[Method, noun("method")] | None = None
    solve: SolveSection = SolveSection()
    frames: FramesSection = FramesSection()
    print: PrintSection | None = None

    @model_validator(mode="before")
    @classmethod
    def _of_a_material(cls, data: Any, info: ValidationInfo) -> Any:
        if isinstance(info.context, dict):
            info.context["bodies"] = isinstance(data, dict) and bool(data.get("body"))
        return with_material(data, (info.context or {}).get("folder"))

    @model_validator(mode="after")
    def _fits(self) -> JobFile:
        said = [name for name in ("vial", "vat", "vessel") if getattr(self, name) is not None]
        if len(said) > 1:
            raise Misplaced(f"got both [{said[0]}] and [{said[1]}]; remove one", said[1])
        if said and self.light is not None:
            raise Misplaced(f"got [{said[0]}] and [light]; expected the vessel in [light.vessel]", said[0])
        if self.print and self.print.absorption is None and not (said or self.light or self.body):
            raise Misplaced("is missing, and there is no vessel that states it; add the absorption of the resin",
                            "print", "absorption")  # fmt: skip
        if self.method is not None and self.solve.method != "default":
            raise Misplaced("got a method here and [method]; remove one", "solve", "method")
        if self.solve.exposure_limit is not None and self.print is None:
            raise Misplaced("got a time without [print]; expected [print] with irradiance and critical_dose", "solve",
                            "exposure_limit")  # fmt: skip
        if self.solve.exposure_limit is not None and self.colors is not None:
            raise Misplaced("got a time and [colors]; expected a time only with one color", "solve", "exposure_limit")
        if self.method is not None and self.colors is not None:
            raise Misplaced("got [method] and [colors]; expected the rule of two colors in [colors.rule]", "method")
        if self.tolerances is not None and self.colors is not None:
            raise Misplaced("got [tolerances] and [colors]; expected tolerances only with one color", "tolerances")
        if self.resin.oxygen and (self.tolerances or self.colors or self.solve.exposure_limit):
            raise Misplaced("got [tolerances], [colors] or an exposure limit with oxygen, whose exposure is its turns; "
                            "expected none of them: remove it", "resin", "oxygen")  # fmt: skip
        if self.body and not any(body.role in ("print", "gray") for body in self.body):
            raise Misplaced("got no [[body]] that prints; expected one with role print or gray", "body")
        if self.body and (self.colors is not None or self.resin.precompensate):
            raise Misplaced("got [[body]] with [colors] or precompensate; expected a single part with these", "body")
        inserted = any(body.role == "insert" for body in self.body)
        if self.without_inserts and inserted:
            raise Misplaced(f"got an insert with {self.without_inserts}; remove one", "body")
        if self.medium and (self.without_inserts or inserted or self.colors):
            beside = "an insert" if inserted else self.without_inserts or "[colors]"
            raise Misplaced(f"got [medium] and {beside}; expected only a vessel with it: remove one", "medium")
        beside = [name for name in ("light", "wobble", "defocus", "tiles", "colors") if getattr(self, name) is not None]
        if self.scattering and beside:
            raise Misplaced(f"got [scattering] and [{beside[0]}]; expected scattering in a vial and nothing else: "
                            "remove one", "scattering")  # fmt: skip
        if self.scattering and {"anisotropy", "phase"} <= self.scattering.given.keys():
            raise Misplaced("got a phase function, which replaces anisotropy, and anisotropy; remove one",
                            "scattering", "phase")  # fmt: skip
        if self.resin.precompensate and not hasattr(self.method, "diffusion"):
            raise Misplaced('expected [method] kind = "recipe", which starts from the target', "resin", "precompensate")
        return self

    @model_validator(mode="after")
    def _moves(self) -> JobFile:
        travel, beam = self.travel, self.beam
        if travel is None:
            return self
        still = {"[scattering]": self.scattering, "[tiles]": self.tiles, 'kinetics = "oxygen"': self.resin.kinetics,
                 'operator = "rings"': self.solve.operator == "rings"}  # fmt: skip
        if found := next((name for name, given in still.items() if given), None):
            raise Misplaced(f"got it with {found}, which does not follow a part that moves; remove one", "travel")
        rows = travel.rows or 1
        if beam.pixels and rows > beam.pixels[1]:
            raise Misplaced(f"is {rows}, and the beam has {beam.pixels[1]} rows; expected the rows of the projector's "
                            "image, at most those of the beam", "travel", "rows")  # fmt: skip
        try:
            if travel.rise is not None:
                Travel.helix(1, travel.rise, height=rows * beam.pitch, rows=rows, pitch=beam.pitch)
        except BadInput as error:
            raise Misplaced(str(error), "travel", "rise") from error
        return self

    @property
    def without_inserts(self) -> str:
        """Its tables that do not stand beside inserts, in words."""
        names = ("light", "defocus", "tiles", "wobble", "scattering", "travel")
        return ", ".join(f"[{name}]" for name in names if getattr(self, name) is not None)
