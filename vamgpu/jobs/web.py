"""Jobs of endless webs: a TOML file is solved into a folder, which can be resumed and proved."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterable, Iterator
from inspect import signature
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import model_validator

from vamgpu.errors import JobError, StorageError, VamError
from vamgpu.jobs.cluster import workers
from vamgpu.jobs.limits import Lens, Roll, WebResinSection
from vamgpu.jobs.read import CheckedJob, read_text
from vamgpu.jobs.run import StageProgress, quiet
from vamgpu.methods.bclp import BCLP
from vamgpu.metrics.contrast import contrast
from vamgpu.metrics.limited_angle_dose import limited_dose, random_plane, responded
from vamgpu.optics.film import Film
from vamgpu.printing.gray import GrayCurve
from vamgpu.schema.quantities import Count, Length, NonNegative, PixelPitch, Positive, Speed
from vamgpu.schema.read import noun
from vamgpu.schema.section import Misplaced, Named, Section
from vamgpu.storage.atomic import check_folder
from vamgpu.storage.numpy_files import map_npy
from vamgpu.storage.reading import is_file, parse_toml
from vamgpu.targets import lattices
from vamgpu.targets.mesh import load_mesh
from vamgpu.targets.stream import Repeated
from vamgpu.webs.display import Display
from vamgpu.webs.segment import Segment
from vamgpu.webs.store import RECORD, WebFolder
from vamgpu.webs.stream import Stream

RATIOS = (1.00, 0.92, 0.84, 0.75, 0.67)  # index ratios of the paper's Fig. S9


class WebTarget(Section):
    """The part on the web: a lattice, a mesh repeated along it, or an array of fractions [l, rho, z].

    A mesh keeps its coordinates: x along the web, y outwards from the roller's side, z across; 0 is in the middle.

    lattice: name of a lattice of `vamgpu.targets.lattices`.  cell: edge of its cell.  strut: thickness of its struts.
    level: level of its surface.  mesh: file of a part.  period: distance from one part to the next.  tiles: NumPy file.
    """

    lattice: str | None = None
    cell: Length | None = None
    strut: Length | None = None
    level: float | None = None
    mesh: Annotated[str | None, Named] = None
    period: Length | None = None
    tiles: Annotated[str | None, Named] = None

    @model_validator(mode="after")
    def _one(self) -> WebTarget:
        if sum(part is not None for part in (self.lattice, self.mesh, self.tiles)) != 1:
            raise ValueError(
                'expected exactly one of lattice = "SheetGyroid", mesh = "part.stl" and tiles = "part.npy"'
            )
        if (self.mesh is None) != (self.period is None):
            raise ValueError('expected mesh = "part.stl" and period = "5 mm" together')
        return self


class WebLength(Section):
    """The web.

    length: length to print.  speed: speed of the web, if known.
    """

    length: Length
    speed: Speed | None = None


class WebBeam(Section):
    """The light, as wide as the film on the roller.

    pitch: edge of a pixel in the bath.  height: height of the light.
    """

    pitch: PixelPitch
    height: Length


class WebSolve(Section):
    """Settings of the optimization.

    method: name of the method, with its default parameters, or "best" for the widest window; by default that of
    [method].  iterations: number of iterations for each segment.  core: length of a segment, in windows of light.
    overlap: length also solved on either side of a segment, in windows of light.  device: device that computes; by
    default the best one.
    """

    method: str | None = None
    iterations: Count = 100
    core: Positive = 2.0
    overlap: NonNegative = 1.25
    device: str | None = None


class WebFrames(Section):
    """The packing of patterns into frames.

    gray: file of the projector's gray curve.  scale: irradiance of a full-on pixel relative to the patterns' unit.
    """

    gray: Annotated[str | None, Named] = None
    scale: Positive | None = None


class WebFile(Section):
    """A whole job file of a web. `vam limits` reads the tables that describe its machine."""

    film: Annotated[Film, noun("film")]
    roller: Roll
    web: WebLength
    target: WebTarget
    beam: WebBeam
    lens: Lens | None = None
    display: Annotated[Display, noun("display")] | None = None
    resin: WebResinSection | None = None
    method: Annotated[BCLP, noun("method", kind="bclp")] | None = None
    solve: WebSolve = WebSolve()
    frames: WebFrames = WebFrames()

    @model_validator(mode="after")
    def _fits(self) -> WebFile:
        if self.method is not None and self.solve.method is not None:
            raise Misplaced("got a method here and [method]; remove one", "solve", "method")
        return self


class WebJob(CheckedJob[WebFile]):
    """A checked job of a web."""

    model: ClassVar[type[WebFile]] = WebFile


read_web: Callable[..., WebJob] = WebJob.read


def is_web(path: str | Path) -> bool:
    """Whether a job file is for a web: it has a roller."""
    try:
        return "roller" in parse_toml(read_text(path))
    except tomllib.TOMLDecodeError:
        return False


def is_web_folder(path: str | Path) -> bool:
    """Whether a folder holds the frames of a web."""
    return is_file(Path(path) / RECORD)


def stream_of(job: WebJob) -> Stream:
    """The stream of a job. Raises `JobError`, `BadInput`, `MeshError`, `StorageError`, `DeviceError`."""
    file = job.file
    roller = file.roller(film=file.film)
    pitch = file.beam.pitch
    beam = roller.beam(pitch, max(1, round(file.beam.height / pitch)))
    return Stream(
        target_of(job),
        roller,
        beam,
        lens=None if file.lens is None else file.lens(index=file.film.bath_index),
        method=file.solve.method or file.method or BCLP.paper_002(),
        length=file.web.length,
        iterations=file.solve.iterations,
        core=file.solve.core,
        overlap=file.solve.overlap,
        gray=None if file.frames.gray is None else GrayCurve.load(job.folder / file.frames.gray),
        scale=file.frames.scale,
        speed=file.web.speed,
        device=file.solve.device,
    )


def target_of(job: WebJob) -> Any:
    section = job.file.target
    if section.lattice is not None:
        return _lattice(section)
    if section.mesh is not None:
        assert section.period is not None
        return Repeated(load_mesh(job.folder / section.mesh, center=False), section.period)
    try:
        return map_npy(job.folder / str(section.tiles))
    except StorageError as error:
        raise JobError(
            f"target.tiles: cannot read {section.tiles!r}: {error}; expected a NumPy file [l, rho, z]"
        ) from error


def _lattice(section: WebTarget) -> Any:
    known = {name.lower(): name for name in lattices.__all__}
    name = known.get(str(section.lattice).replace(" ", "").replace("-", "").lower())
    if name is None:
        raise JobError(
            f"target.lattice: got {section.lattice!r}; expected one of {', '.join(lattices.__all__)}: correct the name"
        )
    lattice = getattr(lattices, name)
    options = {key: getattr(section, key) for key in ("cell", "strut", "level") if getattr(section, key) is not None}
    if odd := [key for key in options if key not in signature(lattice).parameters]:
        takes = ", ".join(signature(lattice).parameters)
        raise JobError(f"target: {name} has other parameters, {takes}: remove {' and '.join(odd)}")
    return lattice(**options)


def solve_web(
    job: WebJob, path: str | Path, *, overwrite: bool = False, cluster: str | None = None,
    progress: StageProgress = quiet,
) -> WebFolder:  # fmt: skip
    """Write the frames of a web to a folder, or resume an interrupted run."""
    check_folder(Path(path))
    progress("voxels", 0.0)
    stream = stream_of(job)

    def advance(done: int, of: int | None) -> None:
        progress("light", done / of if of else 0.0)

    progress("light", 0.0)
    if cluster is None:
        return stream.write(path, overwrite=overwrite, progress=advance)
    with workers(cluster, job.file.solve.device) as each:

        def spread(numbers: range, scale: float | None) -> Iterator[Segment]:
            left = list(numbers)
            if scale is None and left:  # the first segment sets the brightness of a full-on pixel
                for segment in each(_segment, [(job, left.pop(0), None)]):
                    scale = _found(segment).scale
                    yield segment
            for segment in each(_segment, [(job, number, scale) for number in left], ordered=True):
                yield _found(segment)

        return stream.write(path, overwrite=overwrite, progress=advance, spread=spread)


def _found(segment: Segment | VamError) -> Segment:
    if isinstance(segment, VamError):
        raise segment
    return segment


def _segment(task: tuple[WebJob, int, float | None]) -> Segment | VamError:
    """Solve a segment; its error is returned, because every worker would fail."""
    global _latest  # noqa: PLW0603 - a worker solves segments of one job, one after the other
    job, number, scale = task
    try:
        if _latest is None or _latest[0] != job:
            _latest = job, stream_of(job)
        return _latest[1].alone(number, scale)
    except VamError as error:
        return error


_latest: tuple[WebJob, Stream] | None = None
"""The last job of this process and its stream; making the stream takes longer than solving some segments."""


def contrasts(
    ratios: Iterable[float] = RATIOS, *, voxels: int = 64, device: str | None = None
) -> tuple[tuple[float, float], ...]:
    """Index ratio m and contrast ξ of the best dose within arcsin m of the normal, for one random target of 3 mm."""
    target = random_plane(voxels)
    doses = ((m, limited_dose(target, 3.0 / voxels, m, device=device)) for m in ratios)
    return tuple((m, contrast(responded(dose), target)) for m, dose in doses)
