"""Build target, operator and frames' arguments from a job file."""

from __future__ import annotations

from math import ceil
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.backend.device import Device
from vamgpu.calibration.pointspread import PointSpread
from vamgpu.chemistry.diffusion import Spread
from vamgpu.errors import BadInput, JobError, OutOfMemory, StorageError
from vamgpu.geometry import FULL_TURN, Beam, Turntable
from vamgpu.jobs.material import diffusion_of
from vamgpu.jobs.model import (
    MOST_ANGLES,
    BeamSection,
    BodySection,
    FramesSection,
    JobFile,
    TargetSection,
    TurntableSection,
    WobbleSection,
)
from vamgpu.jobs.read import Job
from vamgpu.operators.compose import Composed
from vamgpu.operators.defocus import Defocused
from vamgpu.operators.oblique import Oblique, Rising
from vamgpu.operators.projection import Projection
from vamgpu.operators.ray_table import OpenAir
from vamgpu.operators.scattering_rings import ScatteringRings
from vamgpu.operators.shifts import Wobbled
from vamgpu.operators.wobble import Wobble
from vamgpu.optics.sampling import enough_angles, resin_pixel
from vamgpu.printing.fit import check_fit
from vamgpu.printing.gray import GrayCurve
from vamgpu.printing.placement import FIT
from vamgpu.scene import Body, Scene
from vamgpu.storage.tables import read_columns
from vamgpu.targets import shapes
from vamgpu.targets.target import Target
from vamgpu.units import deg, rad

SPARE = 2
"""Pixels by which a beam extends beyond the part on every side if the job does not give its pixels."""
ANGLES = {"angle_deg": deg, "angle_rad": rad}
"""Columns that hold angles, and their units."""


def target_of(job: Job, device: Device) -> Target:
    """The voxels of the part, or of all bodies."""
    section, scene, pitch = job.file.target, scene_of(job.file, job.folder), pitch_of(job.file)
    if scene is not None:
        return scene.target(
            pitch=pitch, margin=section.margin, shape=section.shape_of_grid, device=device, name=job.name
        )
    return Target.from_mesh(
        source_of("target.shape", section, job.folder),
        height=section.height,
        factor=section.factor,
        pitch=pitch,
        orientation=section.orientation,
        margin=section.margin,
        device=device,
    )


def pitch_of(file: JobFile) -> float:
    """Edge of a voxel of a job [mm]: that of the job; by default a pixel in the resin, or along z if smaller."""
    return file.target.pitch or min(resin_pixel(_pixel(file), light_of(file)))


def scene_of(file: JobFile, folder: Path) -> Scene | None:
    """The bodies of a job with paths relative to ``folder``, or None. Raises `JobError`, `BadInput`."""
    if not file.body:
        return None
    given = {key: getattr(file.target, key) for key in ("orientation", "origin", "void")}
    bodies = []
    for number, section in enumerate(file.body):
        fields = section.model_dump(exclude={"mesh", "shape"})
        bodies.append(Body(source_of(f"[[body]] {number + 1}, shape", section, folder), **fields))
    return Scene(bodies, factor=file.target.factor or 1.0, **given)


def source_of(key: str, section: TargetSection | BodySection, folder: Path) -> Any:
    """The file of a mesh, or a bundled shape. Raises `JobError`."""
    if section.mesh is not None:
        return folder / section.mesh
    if section.shape not in shapes.names():
        known = ", ".join(shapes.names())
        raise JobError(f"{key}: got {section.shape!r}; expected one of {known}: correct the name")
    return shapes.build(str(section.shape))


def motion_of(section: TurntableSection, folder: Path, enough: int = MOST_ANGLES) -> Turntable:
    """The turntable of a job whose paths are relative to ``folder``. Raises `JobError`."""
    if isinstance(section.angles, str):
        return read_angles(folder / section.angles, section.lit_share)
    span, share = FULL_TURN if section.range is None else min(section.range, FULL_TURN), section.lit_share
    most = min(ceil(enough * span / FULL_TURN), section.most or MOST_ANGLES)
    return Turntable.arc(section.angles or most, span, lit_share=1.0 if share is None else share)


def _pixel(file: JobFile) -> Beam:
    """Light of one pixel, if the number of pixels does not matter."""
    return Beam((1, 1), file.beam.pitch)


def light_of(file: JobFile) -> Any:
    """Vessel or light of a job; None in air."""
    vessel = next((one for one in (file.vial, file.vat, file.vessel) if one is not None), None)
    return vessel if file.light is None else file.light


def read_angles(path: Path, lit_share: float | None = None) -> Turntable:
    """Measured angles of a CSV file, one row each in the order in which they are shown, with their times if given."""
    try:
        table = read_columns(path)
        unit = next((name for name in ANGLES if name in table), None)
        if unit is None or set(table) - {unit, "dwell"}:
            raise BadInput(
                f"{path.name} has columns {', '.join(table)}; expected angle_deg or angle_rad, and dwell if angles "
                "are lit for unequal times"
            )
        return Turntable(table[unit] * ANGLES[unit], table.get("dwell"), lit_share)
    except (BadInput, StorageError) as error:
        raise JobError(f"turntable.angles: {error}") from error


def projection_of(
    file: JobFile, target: Target, device: Device, folder: Path = Path(), motion: Turntable | None = None
) -> Any:
    """The projector of a job whose paths are relative to ``folder``, with everything in its light path."""
    light = light_of(file)
    vessel = light if file.light is None else None
    check = getattr(vessel, "check_fits", None)
    if check is not None:
        check(target.radius)
    if motion is None:
        motion = motion_of(file.turntable, folder, enough_angles(_pixel(file), light, target.radius))
    wobble = None if file.wobble is None else wobble_of(file.wobble, motion)
    section = file.beam
    pixels = section.pixels or covering(target, light, section.pitch, wobble)
    beam = beam_of(section, pixels, folder)
    scene = scene_of(file, folder)
    try:
        if scene is not None and scene.inserts:
            return scene.operator(target, beam, motion, vessel, device=device)
        if file.light is not None:
            A: Any = Oblique(target.grid, beam, motion, light, wobble, device)
            wobble = None
        else:
            A = Projection(target.grid, beam, motion, vessel, device, footprint=section.footprint)
        if file.scattering is not None:
            return ScatteringRings(A, file.scattering(), **file.scattering.beside)
        if file.defocus is not None:
            A = Defocused(A, file.defocus(), **file.defocus.beside)
        A = A if wobble is None else Wobbled(A, wobble)
        return A if file.tiles is None else file.tiles(operator=A)
    except MemoryError as error:
        raise OutOfMemory(
            f"a beam of {pixels[0]} × {pixels[1]} pixels of {beam.pitch:g} mm needs more memory than this machine has "
            f"({error}); use a larger beam.pitch"
        ) from error


def with_diffusion(file: JobFile, A: Any, folder: Path = Path()) -> Any:
    """A job's projector with the diffusion of [resin] applied to the dose; the projector itself without diffusion."""
    diffusion = diffusion_of(file.resin, folder)
    return A if diffusion is None else Composed(A, Spread(A.grid, diffusion, A.device))


def beam_of(section: BeamSection, pixels: tuple[int, int], folder: Path) -> Beam:
    """The light of a job. Raises `StorageError`, `BadInput` for a calibration that cannot be read."""
    spread: Any = section.spread
    if isinstance(spread, str):
        spread = PointSpread.load(folder / spread, section.pitch, section.fill)
    return Beam(pixels, section.pitch, section.fill, spread)


def wobble_of(section: WobbleSection, motion: Turntable) -> Wobble:
    """Position of the axis at every angle."""
    if section.radius is not None:
        return Wobble.circle(section.radius, section.phase, motion)
    return Wobble(section.across, section.along)


def covering(target: Target, light: Any, pitch: float, wobble: Wobble | None) -> tuple[int, int]:
    """Pixels that light the whole part, for all positions of the axis."""
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
    """Arguments of `pack`. Raises `StorageError`, `BadInput` for a gray curve that cannot be read, or a wrong "fit"."""
    options = section.model_dump()
    if section.dither == FIT:
        check_fit(section.bits, section.shift)
    options["gray"] = GrayCurve.load(folder / section.gray) if section.gray is not None else None
    return options
