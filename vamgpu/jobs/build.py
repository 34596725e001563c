"""Build target, operator and frames' arguments from a job file."""

from __future__ import annotations

from dataclasses import replace
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.backend.device import Device
from vamgpu.calibration.pointspread import PointSpread
from vamgpu.chemistry.diffusion import Spread
from vamgpu.chemistry.oxygen import OxygenModel
from vamgpu.errors import BadInput, JobError, OutOfMemory, StorageError
from vamgpu.geometry import FULL_TURN, Beam, Grid, Turntable
from vamgpu.jobs.material import diffusion_of
from vamgpu.jobs.model import (
    MOST_ANGLES,
    BeamSection,
    BodySection,
    FramesSection,
    JobFile,
    MediumSection,
    TargetSection,
    TravelSection,
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
from vamgpu.scene.named import named_bodies
from vamgpu.scene.sampled_medium import SampledMedium
from vamgpu.storage.numpy_files import map_npy, read_npz
from vamgpu.storage.tables import read_columns, read_table
from vamgpu.targets import shapes
from vamgpu.targets.mesh import load_mesh
from vamgpu.targets.target import Target
from vamgpu.travel import Travel
from vamgpu.units import deg, rad

SPARE = 2  # pixels by which a beam extends beyond the part on every side if the job does not give its pixels
ANGLES = {"angle_deg": deg, "angle_rad": rad}  # columns that hold angles, and their units


def target_of(job: Job, device: Device) -> Target:
    """The voxels of the part, or of all bodies; with the resin above and below from which oxygen comes."""
    section, scene, pitch = job.file.target, scene_of(job.file, job.folder), pitch_of(job.file)
    (below, above), given = room_of(job.file), {"pitch": pitch, "margin": section.margin, "device": device}
    if scene is not None:
        nx, ny, nz = scene.grid(pitch, margin=section.margin, shape=section.shape_of_grid).shape
        return scene.target(shape=(nx, ny, nz + 2 * min(below, above)), name=job.name, **given)
    source, size = source_of("target.shape", section, job.folder), {"height": section.height, "factor": section.factor}
    part = Target.from_mesh(source, orientation=section.orientation, **size, **given)
    if not below + above:
        return part
    (nx, ny, nz), solid, up = part.grid.shape, part.solid, raised(job.file)
    grid = Grid((nx, ny, nz + below + above), pitch)
    return replace(part, grid=grid, fraction=part.resampled(grid, (0.0, 0.0, -up), device),
                   solid=solid and solid.translated((0.0, 0.0, up)), height=part.height + 2.0 * abs(up))  # fmt: skip


def room_of(file: JobFile) -> tuple[int, int]:
    """Voxels of resin below and above the part from which oxygen comes; none towards a face in air."""
    oxygen = None if file.resin.oxygen is None or file.target.shape_of_grid else file.resin.oxygen(used=0.0)
    if oxygen is None:
        return 0, 0
    room = ceil(oxygen.reach / pitch_of(file))
    return 0 if "z low" in oxygen.air else room, 0 if "z high" in oxygen.air else room


def raised(file: JobFile) -> float:
    """Height of the part above the middle of its grid [mm], which has more room on one side."""
    below, above = room_of(file)
    return 0.5 * (below - above) * pitch_of(file)


def pitch_of(file: JobFile) -> float:
    """Edge of a voxel of a job [mm]: that of the job; by default a pixel in the resin, or along z if smaller."""
    return file.target.pitch or min(resin_pixel(Beam((1, 1), file.beam.pitch), light_of(file)))


def scene_of(file: JobFile, folder: Path) -> Scene | None:
    """The bodies of a job with paths relative to ``folder``, or None. Raises `JobError`, `BadInput`."""
    if not file.body:
        return None
    given = {key: getattr(file.target, key) for key in ("orientation", "origin", "void")}
    bodies: list[Body] = []
    for number, section in enumerate(file.body):
        if section.roles is not None:
            bodies += named_bodies(folder / str(section.mesh), section.roles, dose=section.dose, weight=section.weight)
            continue
        fields = section.model_dump(exclude={"mesh", "shape", "part", "roles"})
        bodies.append(Body(source_of(f"[[body]] {number + 1}, shape", section, folder), **fields))
    scene = Scene(bodies, factor=file.target.factor or 1.0, **given)
    if up := raised(file):
        place = scene.place
        moved = np.array(place.move) + [0.0, 0.0, up]
        origin = -(moved if place.rotation is None else moved @ place.rotation) / place.factor
        scene = replace(scene, origin=tuple(origin.tolist()))
    if scene.inserts and (beside := file.without_inserts):
        raise JobError(f"got an insert with {beside}; remove one")
    return scene


def source_of(key: str, section: TargetSection | BodySection, folder: Path) -> Any:
    """The file of a mesh, or a bundled shape. Raises `JobError`."""
    if section.mesh is not None:
        part = getattr(section, "part", None)
        return folder / section.mesh if part is None else load_mesh(folder / section.mesh, center=False, part=part)
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
        motion = motion_of(file.turntable, folder, enough_angles(Beam((1, 1), file.beam.pitch), light, target.radius))
    wobble = None if file.wobble is None else wobble_of(file.wobble, motion)
    section = file.beam
    needed = covering(target, light, section.pitch, wobble)
    pixels = section.pixels or needed
    if (up := raised(file)) and pixels[1] + 2 * SPARE < needed[1]:
        raise JobError(f"beam.pixels has {pixels[1]} rows; expected at least {needed[1] - 2 * SPARE}: the part is "
                       f"{abs(up):.3g} mm from the middle, beside resin with oxygen; add rows")  # fmt: skip
    beam = beam_of(section, pixels, folder)
    if file.travel is not None and motion.travel is None:
        motion = motion.along(travel_of(file.travel, motion.angles, beam, folder))
    scene = scene_of(file, folder)
    try:
        if scene is not None and scene.inserts:
            return scene.operator(target, beam, motion, vessel, device=device)
        if file.medium is not None:
            return medium_of(file.medium, folder, up).operator(target.grid, beam, motion, vessel, device=device)
        if file.light is not None:
            A: Any = Oblique(target.grid, beam, motion, light, wobble, device)
            wobble = None
        else:
            A = Projection(target.grid, beam, motion, vessel, device)
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
    """A job's projector with the diffusion or the oxygen of [resin]; the projector itself without them."""
    if file.resin.oxygen is not None:
        used = file.resin.oxygen.beside["used"]
        return OxygenModel(A, file.resin.oxygen(used=map_npy(folder / used) if isinstance(used, str) else used))
    diffusion = diffusion_of(file.resin, folder)
    return A if diffusion is None else Composed(A, Spread(A.grid, diffusion, A.device))


def medium_of(section: MediumSection, folder: Path = Path(), up: float = 0.0) -> SampledMedium:
    """The arrays of a job's medium, raised with its part. Raises `StorageError`, `BadInput`."""
    given: dict[str, Any] = {name: getattr(section, name) for name in ("index", "absorption")}
    for name, path in given.items():
        if path is not None and path.lower().endswith(".npz"):
            found = read_npz(folder / path)
            if name not in found and (len(found) != 1 or given.keys() & found):
                raise StorageError(f"{path!r} holds the arrays {', '.join(found)}; expected one named {name!r}")
            given[name] = found.get(name, next(iter(found.values())))
        elif path is not None:
            given[name] = map_npy(folder / path)
    x, y, z = section.center
    return SampledMedium(section.pitch, **given, center=(x, y, z + up))


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


def travel_of(section: TravelSection, angles: int, beam: Beam, folder: Path = Path()) -> Travel:
    """The path of a job's part. Raises `JobError`, `StorageError` for a table that cannot be read."""
    turns, period = section.turns or 1, section.period or 1.0
    try:
        if section.rise is not None:
            height = beam.pixels[1] * beam.pitch
            path = Travel.helix(angles, section.rise, height=height, rows=section.rows or 0, pitch=beam.pitch)
        elif section.heights is not None:
            table = read_table(folder / section.heights)
            times, heights = (table.find(kind) for kind in ("time", "height"))
            if times is None or heights is None:
                raise table.lacks("time_s and height_um")
            for row in np.flatnonzero(np.diff(times) <= 0.0)[:1]:
                raise BadInput(f"line {table.lines[row + 1]} has {times[row + 1]:g} s after {times[row]:g} s; expected "
                               "rising times")  # fmt: skip
            path = Travel.through(times, heights, turns, angles, period)
        elif section.density_difference is not None:
            law = section.model_dump(include={"density_difference", "viscosity", "diameter", "start"})
            path = Travel.sinking(turns, angles, period, **law)
        else:
            path = Travel.through((0.0, turns * period), (0.0, 0.0), turns, 1, period)
    except BadInput as error:
        named = f"heights = {section.heights!r}: " if section.heights else ""
        raise JobError(f"[travel] {named}{error}") from error
    return replace(path, x=section.x, y=section.y, follow=section.follow, period=section.period)


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
