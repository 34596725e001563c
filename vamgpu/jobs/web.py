"""Jobs of endless webs: what their TOML file asks for, carried out into a folder that is resumed and proven."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import model_validator

from vamgpu.errors import JobError
from vamgpu.jobs.limits import Lens, ResinSection, Roll
from vamgpu.jobs.read import checked, read_text
from vamgpu.jobs.run import Told, _quietly
from vamgpu.optics.roller import Roller
from vamgpu.schema.quantities import Count, Length, NonNegative, Positive, Speed
from vamgpu.schema.read import Section, noun
from vamgpu.webs.store import RECORD, WebFolder
from vamgpu.webs.stream import Stream

RATIOS = (1.00, 0.92, 0.84, 0.75, 0.67)
"""Index ratios of the paper's Fig. S9."""


class WebTarget(Section):
    """What is printed on the web: a lattice, a mesh repeated along it, or an array of fractions [l, rho, z].

    A mesh stays where it is: its x along the web, its y from the roller's side outwards, its z across about the middle.

    lattice: one of `vamgpu.targets.lattices`.  cell: its edge.  strut: thickness of its struts.  level: of its surface.
    mesh: file of a part.  period: from one part to the next.  tiles: NumPy file.
    """

    lattice: str | None = None
    cell: Length | None = None
    strut: Length | None = None
    level: float | None = None
    mesh: str | None = None
    period: Length | None = None
    tiles: str | None = None

    @model_validator(mode="after")
    def _one(self) -> WebTarget:
        if sum(part is not None for part in (self.lattice, self.mesh, self.tiles)) != 1:
            raise ValueError('wanted exactly one of lattice = "SheetGyroid", mesh = "part.stl" and tiles = "part.npy"')
        if (self.mesh is None) != (self.period is None):
            raise ValueError('wanted mesh = "part.stl" and period = "5 mm" together')
        return self


class WebLength(Section):
    """The web.

    length: to be printed.  speed: where it is known.
    """

    length: Length
    speed: Speed | None = None


class WebBeam(Section):
    """The light, which is as wide as the film about the roller.

    pitch: edge of a pixel in the bath.  height: of the light.
    """

    pitch: Length
    height: Length


class WebSolve(Section):
    """How light is found.

    iterations: of each segment.  core, overlap: of a segment, in windows of light.  device: where to compute; the best
    one here by default.
    """

    iterations: Count = 100
    core: Positive = 2.0
    overlap: NonNegative = 1.0
    device: str | None = None


class WebFrames(Section):
    """How light becomes pictures.

    gray: file of the projector's gray curve.  scale: light of a full-on pixel.
    """

    gray: str | None = None
    scale: Positive | None = None


class WebFile(Section):
    """A whole job file of a web. The tables of the machine are those that its limits are told from."""

    film: noun("film")  # type: ignore[valid-type]
    roller: Roll  # type: ignore[valid-type]
    web: WebLength
    target: WebTarget
    beam: WebBeam
    lens: Lens | None = None  # type: ignore[valid-type]
    display: noun("display") | None = None  # type: ignore[valid-type]
    resin: ResinSection | None = None
    method: noun("method", kind="bclp") | None = None  # type: ignore[valid-type]
    solve: WebSolve = WebSolve()
    frames: WebFrames = WebFrames()


@dataclass(frozen=True)
class WebJob:
    """A checked job of a web. folder: what its paths are relative to."""

    wanted: WebFile
    given: dict[str, Any]
    folder: Path
    name: str


def is_web(path: str | Path) -> bool:
    """Whether a job file is that of a web: it has a roller. A file that is no TOML is none."""
    try:
        return "roller" in tomllib.loads(read_text(path))
    except tomllib.TOMLDecodeError:
        return False


def is_web_folder(path: str | Path) -> bool:
    """Whether a folder holds the frames of a web."""
    return (Path(path) / RECORD).is_file()


def read_web(path: str | Path, settings: Iterable[str] = ()) -> WebJob:
    """Read the job file of a web. Raises `JobError`."""
    file = Path(path)
    return parse_web(read_text(path), settings, source=str(path), folder=file.parent, name=file.stem)


def parse_web(
    text: str, settings: Iterable[str] = (), *, source: str = "job", folder: Path = Path(), name: str = "web"
) -> WebJob:
    """A job of a web from TOML text. Raises `JobError` naming every wrong value at once."""
    return WebJob(*checked(WebFile, text, settings, source=source), folder, name)


def stream_of(job: WebJob) -> Stream:
    """The stream of a job. Raises `JobError`, `BadInput`, `MeshError`, `StorageError`, `DeviceError`."""
    from vamgpu.methods import BCLP
    from vamgpu.printing.gray import GrayCurve

    wanted = job.wanted
    roller = roller_of(wanted)
    pitch = wanted.beam.pitch
    beam = roller.beam(pitch, max(1, round(wanted.beam.height / pitch)))
    return Stream(
        target_of(job),
        roller,
        beam,
        lens=None if wanted.lens is None else wanted.lens(index=wanted.film.bath_index),
        method=BCLP.paper_002() if wanted.method is None else wanted.method,
        length=wanted.web.length,
        iterations=wanted.solve.iterations,
        core=wanted.solve.core,
        overlap=wanted.solve.overlap,
        gray=None if wanted.frames.gray is None else GrayCurve.load(job.folder / wanted.frames.gray),
        scale=wanted.frames.scale,
        device=wanted.solve.device,
    )


def roller_of(wanted: WebFile) -> Roller:
    """The machine of a job."""
    return wanted.roller(film=wanted.film)


def target_of(job: WebJob) -> Any:
    """What is printed, as a stream takes it."""
    section = job.wanted.target
    if section.lattice is not None:
        return _lattice(section)
    if section.mesh is not None:
        from vamgpu.targets.mesh import load_mesh
        from vamgpu.targets.stream import Repeated

        assert section.period is not None
        return Repeated(load_mesh(job.folder / section.mesh, center=False), section.period)
    try:
        return np.load(job.folder / str(section.tiles), mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError) as error:
        raise JobError(
            f"target.tiles: cannot read {section.tiles!r}: {error}; wanted a NumPy file [l, rho, z]"
        ) from error


def _lattice(section: WebTarget) -> Any:
    from vamgpu.targets import lattices

    known = {name.lower(): name for name in lattices.__all__}
    name = known.get(str(section.lattice).replace(" ", "").replace("-", "").lower())
    if name is None:
        raise JobError(
            f"target.lattice: got {section.lattice!r}; wanted one of {', '.join(lattices.__all__)}: correct the name"
        )
    lattice = getattr(lattices, name)
    options = {key: getattr(section, key) for key in ("cell", "strut", "level") if getattr(section, key) is not None}
    if odd := [key for key in options if key not in signature(lattice).parameters]:
        takes = ", ".join(signature(lattice).parameters)
        raise JobError(f"target: {name} takes other parameters, {takes}: remove {' and '.join(odd)}")
    return lattice(**options)


def solve_web(job: WebJob, path: str | Path, *, overwrite: bool = False, told: Told = _quietly) -> WebFolder:
    """Write the frames of a web to a folder, or go on with one that was interrupted.

    Raises what the parts raise: `BadInput`, `TileError`, `MeshError`, `DeviceError`, `StorageError`.
    """
    told("voxels", 0.0)
    stream = stream_of(job)
    told("light", 0.0)
    return stream.write(path, overwrite=overwrite, told=lambda done, of: told("light", done / of if of else 0.0))


def contrasts(
    ratios: Iterable[float] = RATIOS, *, voxels: int = 64, device: str | None = None
) -> tuple[tuple[float, float], ...]:
    """Index ratio m and contrast ξ of the best dose within arcsin m of the normal, for one random target of 3 mm.

    Source: Toombs et al., section S10 and Fig. S9, whose target is not published.
    """
    from vamgpu.metrics.contrast import contrast
    from vamgpu.metrics.limited_dose import limited_dose, random_plane, responded

    target = random_plane(voxels)
    doses = ((m, limited_dose(target, 3.0 / voxels, m, device=device)) for m in ratios)
    return tuple((m, contrast(responded(dose), target)) for m, dose in doses)
