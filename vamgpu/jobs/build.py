"""From what a job file says to the operator that it is solved with, and from a manifest back to it."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.backend.device import Device
from vamgpu.chemistry.diffusion import Spread
from vamgpu.errors import BadInput, JobError, OpticsWarning, OutOfMemory, StorageError
from vamgpu.geometry import Beam, Turntable
from vamgpu.jobs.angles import motion_of
from vamgpu.jobs.material import diffusion_of
from vamgpu.jobs.model import BeamSection, FramesSection, JobFile, WobbleSection
from vamgpu.jobs.read import Job
from vamgpu.operators.compose import Composed
from vamgpu.operators.defocus import Defocused
from vamgpu.operators.light import OpenAir
from vamgpu.operators.linear import LinearOperator
from vamgpu.operators.moves import Wobbled
from vamgpu.operators.oblique import Oblique, Rising
from vamgpu.operators.projection import Projection
from vamgpu.operators.wobble import Wobble
from vamgpu.schema import write
from vamgpu.schema.read import read
from vamgpu.storage.turntable import described, turntable_from
from vamgpu.targets.target import Target

SPARE = 2
"""Pixels a beam reaches beyond the part on every side where the job does not say how many it has."""
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


def projection_of(wanted: JobFile, target: Target, device: Device, folder: Path = Path()) -> Any:
    """The projector of a job whose paths are relative to ``folder``, with all that stands in its light.

    Raises `TargetTooLarge` where light does not reach the whole part, `JobError` for a file of angles that is none,
    `StorageError`, `BadInput` for a calibration that cannot be read and for parts that do not go together.
    """
    vessel = next((one for one in (wanted.vial, wanted.vat, wanted.vessel) if one is not None), None)
    check = getattr(vessel, "check_fits", None)
    if check is not None:
        check(target.radius)
    motion = motion_of(wanted.turntable, folder)
    wobble = None if wanted.wobble is None else wobble_of(wanted.wobble, motion)
    section, light = wanted.beam, wanted.light if wanted.light is not None else vessel
    pixels = section.pixels or _covering(target, light, section.pitch, wobble)
    beam = beam_of(section, pixels, folder)
    try:
        if wanted.light is not None:
            A: Any = Oblique(target.grid, beam, motion, light, wobble, device)
            wobble = None
        else:
            A = Projection(target.grid, beam, motion, vessel, device, footprint=section.footprint)
        if wanted.defocus is not None:
            A = Defocused(A, wanted.defocus(), **wanted.defocus.beside)
        A = A if wobble is None else Wobbled(A, wobble)
        return A if wanted.tiles is None else wanted.tiles(operator=A)
    except MemoryError as error:
        raise OutOfMemory(
            f"a beam of {pixels[0]} × {pixels[1]} pixels of {beam.pitch:g} mm needs more memory than this machine has "
            f"({error}); use a larger beam.pitch"
        ) from error


def with_diffusion(wanted: JobFile, A: Any, folder: Path = Path()) -> Any:
    """A job's projector whose dose has diffused as [resin] says; the projector itself where it says nothing."""
    diffusion = diffusion_of(wanted.resin, folder)
    return A if diffusion is None else Composed(A, Spread(A.grid, diffusion, A.device))


def beam_of(section: BeamSection, pixels: tuple[int, int], folder: Path) -> Beam:
    """The light of a job. Raises `StorageError`, `BadInput` for a calibration that cannot be read."""
    spread: Any = section.spread
    if isinstance(spread, str):
        from vamgpu.calibration.pointspread import PointSpread

        spread = PointSpread.load(folder / spread, section.pitch, section.fill)
    return Beam(pixels, section.pitch, section.fill, spread)


def wobble_of(section: WobbleSection, motion: Turntable) -> Wobble:
    """Where the axis stands at every pose."""
    if section.radius is not None:
        return Wobble.circle(section.radius, section.phase, motion)
    return Wobble(section.across, section.along)


def _covering(target: Target, light: Any, pitch: float, wobble: Wobble | None) -> tuple[int, int]:
    """Pixels that light the whole part, wherever the axis stands."""
    turn = np.linspace(0.0, 2.0 * np.pi, 3601)
    away = 0.0 if wobble is None else float(np.hypot(wobble.across, wobble.along).max())
    across, along = ((target.radius + away) * side for side in (np.cos(turn), np.sin(turn)))
    plane = light.plane if isinstance(light, Rising) else light or OpenAir()
    reach = np.abs(plane.illuminate(across, along)[0]).max()
    high = 0.5 * target.height
    if isinstance(light, Rising):
        lift, stretch, _ = light.rows(across, along)
        high = float(np.max(np.abs(lift) + stretch * high))
    return 2 * (ceil(reach / pitch * (1.0 - 1e-9)) + SPARE), 2 * (ceil(high / pitch) + SPARE)


def packing_of(section: FramesSection, folder: Path) -> dict[str, Any]:
    """Arguments of `pack`. Raises `StorageError`, `BadInput` for a gray curve that cannot be read."""
    from vamgpu.printing.gray import GrayCurve

    options = section.model_dump()
    options["gray"] = GrayCurve.load(folder / section.gray) if section.gray is not None else None
    return options


def describe(A: LinearOperator) -> dict[str, Any]:
    """An operator in plain values, for a manifest. Raises `BadInput` for what only Python can describe."""
    if not isinstance(A, Projection):
        return write(A)
    return {
        "grid": write(A.grid),
        "beam": {**write(A.beam), "footprint": A.footprint},
        "turntable": described(A.motion),
        "vessel": None if A.vessel is None else write(A.vessel),
    }


def projection_from(description: dict[str, Any], device: Device) -> Any:
    """The operator that `describe` described. Raises `StorageError` for a description that is not one.

    Warns:
        OpticsWarning: the description is older than the beam's optics, and means light without any.
    """
    try:
        table = dict(description)
        if "kind" in table:
            return read("operator", table, units=False, device=device)
        beam, vessel = _with_optics(table["beam"]), table["vessel"]
        footprint, motion = beam.pop("footprint"), turntable_from(table["turntable"])
        grid, light = (read(name, part, units=False) for name, part in (("grid", table["grid"]), ("beam", beam)))
        around = None if vessel is None else read("vessel", vessel, units=False)
    except StorageError:
        raise
    except (KeyError, TypeError, ValueError, BadInput) as error:
        raise StorageError(f"the manifest garbles its geometry: {error}; write the job again") from error
    return Projection(grid, light, motion, around, device, footprint=footprint)


def _with_optics(beam: Mapping[str, Any]) -> dict[str, Any]:
    """A described beam with all its fields. Folders without optics were solved for a perfect lens and single rays."""
    if set(OPTICS) <= set(beam):
        return dict(beam)
    warnings.warn(
        "the folder says nothing of the beam's fill and point spread: it was solved for pixels lit all over and a "
        "perfect lens, and is read so (fill 1, spread 0); solve it again for the light that a lens makes",
        OpticsWarning, stacklevel=3,
    )  # fmt: skip
    return OPTICS | dict(beam)
