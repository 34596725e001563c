"""Jobs of stereolithography: slices, printer and resin from a TOML file; modeling or correcting the slices."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, model_validator

from vamgpu.backend import open_device
from vamgpu.curethrough.correction import Correction
from vamgpu.curethrough.job import Outcome, correct_stack, model
from vamgpu.curethrough.layers import LayerPrinter
from vamgpu.curethrough.leastsquares import StageProgress
from vamgpu.curethrough.mesh_stack import MeshStack
from vamgpu.curethrough.output import check_place, made_with
from vamgpu.curethrough.printer import Printer, levels_of
from vamgpu.curethrough.profile import Flat, Parallel, Profile
from vamgpu.curethrough.stack import ARCHIVES, PACKED, layer_height, open_stack
from vamgpu.errors import JobError, SliceWarning
from vamgpu.jobs.read import CheckedJob
from vamgpu.printing.gray import GrayCurve
from vamgpu.schema.quantities import Background, Count, Dose, ExposureTime, Irradiance, Length, Speed, Thickness
from vamgpu.schema.section import Listed, Section
from vamgpu.targets.mesh import load_mesh

EXAMPLE = """\
# The continuous printer of the cure-through paper.

[printer]
absorption_height = "2 mm"
critical_dose = "576 mJ/cm3"
slice_height = "50 um"
speed = "1000 mm/h"
light = "100 mW/cm2"
dark = "1 mW/cm2"

[slices]
path = "slices"

[correct]
dither = false
"""
"""An example of such a file."""
DIFFERENT = 1e-3  # share by which a file's layer height may differ from the job's


class PrinterSection(Section):
    """Printer and resin: ``speed`` for a continuous printer, ``exposure`` of a slice for a layer-by-layer printer.

    absorption_height: depth in which light falls to a tenth.  critical_dose: dose at which the resin solidifies.
    slice_height: height of a slice.  speed: speed of the platform.  exposure: time of each slice.  dead_zone: depth
    that never cures.  light: irradiance of level 255.  dark: irradiance of level 0.  gray: file with a table [gray] of
    the irradiance of all levels, down to level 0.
    """

    absorption_height: Length
    critical_dose: Dose
    slice_height: Length
    speed: Speed | None = None
    exposure: ExposureTime | None = None
    light: Irradiance
    dark: Background | None = None
    gray: str | None = None
    dead_zone: Thickness = 0.0

    @model_validator(mode="after")
    def _one_of_each(self) -> PrinterSection:
        if (self.speed is None) == (self.exposure is None):
            raise ValueError('expected exactly one of speed = "1000 mm/h" and exposure = "2 s"')
        if self.dark is not None and self.gray is not None:
            raise ValueError("expected dark or gray, not both: the gray curve includes level 0")
        if self.exposure is not None and self.dead_zone:
            raise ValueError("expected a dead_zone only with a speed: a printer with exposure has none")
        return self


class SlicesSection(Section):
    """Slices from a folder or zip, or sliced from a mesh.

    path: folder or zip of the slices.  mesh: file of a part.  pitch: edge of a pixel.  height: height of the part.
    factor: scale of the part, in place of a height.  pixels: number of pixels along x and y.  threshold: lowest gray
    level that counts as part.
    """

    path: str | None = None
    mesh: str | None = None
    pitch: Length | None = None
    height: Length | None = None
    factor: Annotated[float, Field(gt=0)] | None = None
    pixels: Annotated[tuple[Count, Count] | None, Listed] = None
    threshold: Annotated[int, Field(ge=1, le=255)] = 128

    @model_validator(mode="after")
    def _one_of_each(self) -> SlicesSection:
        if self.path is not None and self.mesh is not None:
            raise ValueError('expected path = "slices" or mesh = "part.stl", not both')
        if (self.mesh is None) != (self.pitch is None):
            raise ValueError('expected mesh = "part.stl" and pitch = "50 um" together')
        return self


class CorrectSection(Section):
    """The correction. Inside features the dose is ``flat`` at ``most`` critical doses, or ``parallel`` to its bounds.

    profile: profile of the dose. most: greatest dose of a flat profile, in critical doses. share: position of a
    parallel profile between its bounds. tail: number of slices added after the last. platform: whether the platform is
    below the first slice. dither: round neighboring pixels at different thresholds, up to half a gray level higher or
    lower. device: device that computes; by default the best one. whole_columns: solve columns whose features or voids
    cannot be printed by least squares.
    """

    profile: Literal["flat", "parallel"] = "flat"
    most: Annotated[float, Field(ge=1)] | None = None
    share: Annotated[float, Field(ge=0, le=1)] = 0.5
    tail: Annotated[int, Field(ge=0)] | None = None
    platform: bool = True
    dither: bool = False
    whole_columns: bool = False
    device: str | None = None


class CurethroughFile(Section):
    """A job of stereolithography."""

    printer: PrinterSection
    slices: SlicesSection = SlicesSection()
    correct: CorrectSection = CorrectSection()


class CurethroughJob(CheckedJob[CurethroughFile]):
    """A checked job of stereolithography."""

    model: ClassVar[type[CurethroughFile]] = CurethroughFile

    @property
    def machine(self) -> Printer | LayerPrinter:
        """Printer and resin. Raises `StorageError`, `BadInput` for a gray curve that cannot be read."""
        section = self.file.printer
        curve = None
        if section.gray is not None:
            curve = GrayCurve.load(self.folder / section.gray)
        light = levels_of(section.light, section.dark or 0.0, curve)
        common = (section.absorption_height, section.critical_dose, section.slice_height)
        if section.exposure is not None:
            return LayerPrinter(*common, section.exposure, light)
        assert section.speed is not None
        return Printer(*common, section.speed, light, section.dead_zone)

    @property
    def correction(self) -> Correction:
        """The correction. Raises `BadInput` if the light or dark irradiance does not suffice."""
        section, machine = self.file.correct, self.machine
        profile: Profile = Flat() if section.most is None else Flat(section.most)
        if section.profile == "parallel":
            if not isinstance(machine, Printer):
                raise JobError('correct.profile = "parallel": expected a printer with a speed; use "flat"')
            profile = Parallel(section.share, machine.absorption_height, machine.phi_min, machine.phi_max)
        threshold = self.file.slices.threshold
        return Correction(machine, profile, section.tail, threshold, section.platform, section.dither)

    def stack(self, slices: Path | None = None) -> AbstractContextManager[Any]:
        """The slices, or those at a path that replaces them. Raises `SliceError`, `MeshError`, `JobError`."""
        section = self.file.slices
        if slices is None and section.mesh is not None:
            assert section.pitch is not None
            solid = load_mesh(self.folder / section.mesh, height=section.height, factor=section.factor)
            return MeshStack(solid, section.pitch, self.file.printer.slice_height, section.pixels,
                             self.file.correct.device)  # fmt: skip
        place = slices if slices is not None else None if section.path is None else self.folder / section.path
        if place is None:
            raise JobError('the job names no slices; expected path = "slices" or mesh = "part.stl" in [slices]')
        stack = open_stack(place)
        said, height = layer_height(stack), self.file.printer.slice_height
        if said is not None and abs(said - height) > DIFFERENT * height:
            warnings.warn(
                f"{str(place)!r} has layers of {1e3 * said:g} µm, but the job has {1e3 * height:g} µm, which is used: "
                "correct printer.slice_height if that is wrong",
                SliceWarning,
                stacklevel=2,
            )
        return stack

    def beside(self, slices: Path | None = None) -> Path:
        """Default place of corrected slices: beside the originals."""
        section = self.file.slices
        if slices is None and section.path is None:
            return self.folder / f"{self.name}-corrected"
        place = slices if slices is not None else self.folder / str(section.path)
        archive = place.suffix.lower() in (*ARCHIVES, *PACKED)
        name = place.stem if archive else place.name
        return place.with_name(f"{name}-corrected{place.suffix if archive else ''}")


read_curethrough: Callable[..., CurethroughJob] = CurethroughJob.read


def check_output(
    job: CurethroughJob, out: Path, *, slices: Path | None = None, overwrite: bool = False, report: Path | None = None
) -> None:
    """Check before a run whether it may write slices or doses to ``out``. Raises `StorageError`, `SliceError`."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the run warns
        opened = job.stack(slices)
    with opened as stack:
        check_place(out, stack, overwrite=overwrite or _unreported(out, report, _record(job, stack)))


def model_job(
    job: CurethroughJob, *, slices: Path | None = None, doses: Path | None = None, overwrite: bool = False,
    report: Path | None = None, progress: StageProgress = lambda stage, share: None,
) -> Outcome:  # fmt: skip
    """Model the print of a job's slices; see `vamgpu.curethrough.job.model`."""
    device = open_device(job.file.correct.device)
    with job.stack(slices) as stack:
        record = _record(job, stack)
        overwrite = overwrite or (doses is not None and _unreported(doses, report, record))
        return model(job.machine, stack, threshold=job.file.slices.threshold, doses=doses, device=device,
                     overwrite=overwrite, record=record, progress=progress)  # fmt: skip


def correct_job(
    job: CurethroughJob, out: Path, *, slices: Path | None = None, overwrite: bool = False, report: Path | None = None,
    progress: StageProgress = lambda stage, share: None,
) -> Outcome:  # fmt: skip
    """Correct a job's slices and write them; as `vamgpu.curethrough.job.correct_stack`."""
    correction, device = job.correction, open_device(job.file.correct.device)
    with job.stack(slices) as stack:
        record = _record(job, stack)
        return correct_stack(
            correction, stack, out, device=device, whole_columns=job.file.correct.whole_columns,
            overwrite=overwrite or _unreported(out, report, record), record=record, progress=progress,
        )  # fmt: skip


def _record(job: CurethroughJob, stack: Any) -> dict[str, Any]:
    """Provenance of slices: the keys of the job, and its slices."""
    return {"job": job.given, "slices": {"name": Path(getattr(stack, "place", "")).name, "shape": list(stack.shape)}}


def _unreported(place: Path, report: Path | None, record: Mapping[str, Any]) -> bool:
    return report is not None and not os.path.lexists(report) and made_with(place, record)
