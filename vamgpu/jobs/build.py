"""From what a job file says to the nouns of the library."""

from __future__ import annotations

import warnings
from dataclasses import asdict
from math import ceil
from pathlib import Path
from typing import Any

from vamgpu.backend.device import Device
from vamgpu.errors import JobError, OpticsWarning, OutOfMemory, StorageError
from vamgpu.geometry import Beam, Grid
from vamgpu.jobs.angles import motion_of
from vamgpu.jobs.model import BeamSection, FramesSection, JobFile
from vamgpu.jobs.read import Job
from vamgpu.operators.projection import Projection
from vamgpu.optics.vat import Vat
from vamgpu.optics.vial import Vial
from vamgpu.storage.turntable import described, turntable_from
from vamgpu.targets.target import Target

SPARE = 2
"""Pixels a beam reaches beyond the part on every side where the job does not say how many it has."""

VESSELS = {"vial": Vial, "vat": Vat}
OPTICS: dict[str, Any] = {"fill": 1.0, "spread": 0.0, "footprint": "exact"}
"""What beams were taken for by folders that do not say it."""


def target_of(job: Job, device: Device) -> Target:
    """The voxels of the part. Raises what `Target.from_mesh` raises, and `JobError` for a shape that does not exist."""
    section = job.wanted.target
    source: Any
    if section.mesh is not None:
        source = job.folder / section.mesh
    else:
        from vamgpu.targets import shapes

        if section.shape not in shapes.names():
            known = ", ".join(shapes.names())
            raise JobError(f"target.shape: got {section.shape!r}; wanted one of {known}: correct the name")
        source = shapes.build(str(section.shape))
    return Target.from_mesh(
        source,
        height=section.height,
        factor=section.factor,
        pitch=section.pitch,
        orientation=section.orientation,
        margin=section.margin,
        device=device,
    )


def vessel_of(wanted: JobFile) -> Vial | Vat | None:
    """The container, or None for straight light that nothing absorbs."""
    if wanted.vial is not None:
        return Vial(**wanted.vial.model_dump())
    return Vat(**wanted.vat.model_dump()) if wanted.vat is not None else None


def projection_of(wanted: JobFile, target: Target, device: Device, folder: Path = Path()) -> Projection:
    """The projector of a job whose paths are relative to ``folder``.

    Raises `TargetTooLarge` where light does not reach the whole part, `JobError` for a file of angles that is none,
    `StorageError`, `BadInput` for a calibration that cannot be read.
    """
    vessel = vessel_of(wanted)
    if vessel is not None:
        vessel.check_fits(target.radius)
    pixels = wanted.beam.pixels or _covering(target, vessel, wanted.beam.pitch)
    beam, motion = beam_of(wanted.beam, pixels, folder), motion_of(wanted.turntable, folder)
    try:
        A = Projection(target.grid, beam, motion, vessel, device, footprint=wanted.beam.footprint)
    except MemoryError as error:
        raise OutOfMemory(
            f"a beam of {pixels[0]} × {pixels[1]} pixels of {beam.pitch:g} mm needs more memory than this machine has "
            f"({error}); use a larger beam.pitch"
        ) from error
    return A


def beam_of(section: BeamSection, pixels: tuple[int, int], folder: Path) -> Beam:
    """The light of a job. Raises `StorageError`, `BadInput` for a calibration that cannot be read."""
    spread: Any = section.spread
    if isinstance(spread, str):
        from vamgpu.calibration.pointspread import PointSpread

        spread = PointSpread.load(folder / spread, section.pitch, section.fill)
    return Beam(pixels, section.pitch, section.fill, spread)


def _covering(target: Target, vessel: Vial | Vat | None, pitch: float) -> tuple[int, int]:
    """Pixels that light the whole part; a column's chord passes a vial's axis at offset · n_bath / n_resin."""
    spread = vessel.resin_index / vessel.bath_index if isinstance(vessel, Vial) else 1.0
    columns = 2 * (ceil(target.radius * spread / pitch) + SPARE)
    return columns, 2 * (ceil(0.5 * target.height / pitch) + SPARE)


def packing_of(section: FramesSection, folder: Path) -> dict[str, Any]:
    """Arguments of `pack`. Raises `StorageError`, `BadInput` for a gray curve that cannot be read."""
    from vamgpu.printing.gray import GrayCurve

    options = section.model_dump()
    options["gray"] = GrayCurve.load(folder / section.gray) if section.gray is not None else None
    return options


def describe(A: Projection) -> dict[str, Any]:
    """A projector's geometry in plain values, for a manifest."""
    kind = next((name for name, cls in VESSELS.items() if isinstance(A.vessel, cls)), None)
    return {
        "grid": {"shape": list(A.grid.shape), "pitch": A.grid.pitch},
        "beam": {**asdict(A.beam), "pixels": list(A.beam.pixels), "footprint": A.footprint},
        "turntable": described(A.motion),
        "vessel": None if kind is None else {"kind": kind, **asdict(A.vessel)},  # type: ignore[call-overload]
    }


def projection_from(description: dict[str, Any], device: Device) -> Projection:
    """The projector that `describe` described. Raises `StorageError` for a description that is not one.

    Warns:
        OpticsWarning: the description is older than the beam's optics, and means light without any.
    """
    try:
        grid, beam = description["grid"], _with_optics(description["beam"])
        footprint, pixels = beam.pop("footprint"), tuple(beam.pop("pixels"))
        fields = dict(description["vessel"] or {})
        vessel = VESSELS[fields.pop("kind")](**fields) if fields else None
        motion = turntable_from(description["turntable"])
        nouns = (Grid(tuple(grid["shape"]), grid["pitch"]), Beam(pixels, **beam), motion)
    except (KeyError, TypeError, ValueError) as error:
        raise StorageError(f"the manifest garbles its geometry: {error}; write the job again") from error
    return Projection(*nouns, vessel, device, footprint=footprint)


def _with_optics(beam: dict[str, Any]) -> dict[str, Any]:
    """A described beam with all its fields. Folders without optics were solved for a perfect lens and single rays."""
    if set(OPTICS) <= set(beam):
        return dict(beam)
    warnings.warn(
        "the folder says nothing of the beam's fill and point spread: it was solved for pixels lit all over and a "
        "perfect lens, and is read so (fill 1, spread 0); solve it again for the light that a lens makes",
        OpticsWarning, stacklevel=3,
    )  # fmt: skip
    return OPTICS | beam
