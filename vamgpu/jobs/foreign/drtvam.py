"""Dr.TVAM (EPFL): a configuration in JSON, meshes beside it, patterns as an NPZ file or EXR images.

Frames have our orientation; pattern k of n is lit at 2πk/n, backwards if clockwise. Lengths count as millimeters.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.util import find_spec
from math import ceil, inf, radians, tan
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, StorageError
from vamgpu.geometry import Turntable
from vamgpu.jobs.build import pitch_of
from vamgpu.jobs.foreign.containers import Container, check_keys, container, file_of, index, mm, number
from vamgpu.jobs.foreign.patterns import STEPPED, ForeignPatterns
from vamgpu.jobs.foreign.pictures import images_of
from vamgpu.jobs.foreign.vamtoolbox import is_preset, read_preset
from vamgpu.jobs.model import JobFile
from vamgpu.methods.plan_folder import target_of as known_target
from vamgpu.operators.defocus import direct
from vamgpu.operators.projection import Projection
from vamgpu.optics.scattering import SHARPEST
from vamgpu.optics.vat import Vat
from vamgpu.optics.vial import Vial
from vamgpu.printing.frames import Frames
from vamgpu.scene.body import Body
from vamgpu.scene.scene import Scene
from vamgpu.storage.atomic import check_folder, replacing
from vamgpu.storage.images import write_exr
from vamgpu.storage.numpy_files import map_npy, read_npz
from vamgpu.storage.reading import parse_json, read_text
from vamgpu.targets.mesh import load_mesh
from vamgpu.targets.solid import Solid
from vamgpu.targets.target import Target

PATTERNS = ("patterns.npz", "patterns", "patterns_normalized_uint8.npz")
"""Files of its patterns, beside the configuration or in its output folder, the best first."""
KEYS = {
    "": "vial projector sensor final_sensor target output loss optimizer n_steps spp spp_ref spp_grad spp_filter_radon "
        "max_depth max_depth_ref rr_depth rr_depth_ref time progressive surface_aware filter_radon filter_corner "
        "transmission_only regular_sampling diffusion physical_model psf_analysis print_time "
        "export_wasserstein_distance spp_final",
    "vial": "type height ior ior_surrounding medium occlusions r r_int r_ext w_int w_ext filename_vial_outer "
            "filename_vial_inner r_int_outer r_ext_outer r_int_inner r_ext_inner ior_outer ior_inner ior_inside_inner",
    "vial.medium": "ior extinction albedo phase",
    "projector": "type n_patterns resx resy cropx cropy crop_offset_x crop_offset_y pixel_size motion distance tilt "
                 "clockwise patterns filter_nonzero sampler aperture_radius focus_distance fov",
    "sensor": "type scalex scaley scalez film", "final_sensor": "type scalex scaley scalez film",
    "sensor.film": "type resx resy resz surface_aware", "final_sensor.film": "type resx resy resz surface_aware",
    "target": "filename size box_center_x box_center_y box_center_z scale_and_center",
    "loss": "type reduction K M tl tu tp top tinhibitor t_limit weight_object weight_void weight_limit weight_sparsity",
    "diffusion": "type D printing_time number_rotations", "filter_corner": "dist radius",
    "physical_model": "type inhibitor_init diffusion_coefficient number_time_steps",
}  # fmt: skip
"""Keys of versions up to 0.9, by table; those of the optimizer and of phases are Mitsuba's."""
LEFT_OUT = {
    "final_sensor": "all resin inside the sensor is judged", "time": "it follows from irradiance and dose",
    "psf_analysis": "light single pixels in Python",
}  # fmt: skip
"""Keys that change a print and are not imported, and what to do."""
OPAQUE = ("diffuse", "conductor", "roughconductor", "plastic", "roughplastic")  # surfaces that no light passes
LOSSES = ("threshold", "l2")
METHOD = ("loss", "optimizer", "n_steps", "progressive", "filter_radon", "filter_corner")
"""Keys of its method, which only a job that is to be solved would have."""
ORIGIN = (0.0, 0.0, 0.0)  # point of the part's frame that lies on the axis


def read_drtvam(path: Path, patterns: Path | None = None) -> ForeignPatterns:
    """Patterns of a configuration. Raises `StorageError`, `BadInput`."""
    with _explaining(path):
        said = parse_json(read_text(path), finite=False)
        if is_preset(said):
            raise BadInput(f"{str(path)!r} is a preset of VAMToolbox, which has no patterns; make a job of it with "
                           "--out job.toml, or import its sinogram")  # fmt: skip
        setup = _set_up(path, said)
        place = patterns if patterns is not None else _beside(path, said)
        light = _patterns(place) if place.is_file() else images_of(place)[0]
    if setup.occlusions or setup.container.bodies:
        has = "occlusions" if setup.occlusions else f"a container that is {said['vial']['type']!r}"
        raise BadInput(f"{str(path)!r} has {has}, without which its patterns cannot be judged; make a job of "
                       "it with --out job.toml, then import its folder of EXR images with --job job.toml")  # fmt: skip
    if light.ndim != 3:
        raise BadInput(f"its patterns have shape {light.shape}; expected [pattern, row, column]")
    angles, rows, columns = light.shape
    for name, found in (("n_patterns", angles), ("resx", columns), ("resy", rows)):
        if said["projector"].get(name, found) != found:
            raise BadInput(f"{str(path)!r} has {name} {said['projector'][name]!r}, and {place.name!r} {found}; "
                           "expected patterns of this configuration: name them with --patterns")  # fmt: skip
    tables = setup.tables(angles, (columns, rows))
    tables["target"] = {"mesh": str(setup.part.mesh.resolve()), "factor": 1.0, **tables["target"]}
    found = np.ascontiguousarray(light[:, ::-1].transpose(0, 2, 1))
    if setup.clockwise:  # the same patterns in the order of our turntable
        found = np.roll(found[::-1], 1, axis=0)
    return ForeignPatterns("Dr.TVAM", found, Turntable(angles, lit_share=0), tables, setup.part, notes=setup.notes)


def read_task(path: Path) -> tuple[dict[str, Any], list[tuple[dict[str, Any], Solid]], tuple[str, ...]]:
    """Job of a configuration, and its bodies, the part first. Raises `StorageError`, `BadInput`, `MeshError`."""
    with _explaining(path):
        said = parse_json(read_text(path), finite=False)
        if is_preset(said):
            return read_preset(path.parent, said)
        setup, projector = _set_up(path, said), said["projector"]
        pixels = _count(projector, "resx"), _count(projector, "resy")
        tables = setup.tables(_count(projector, "n_patterns"), pixels)
        own = [name for name in METHOD if name in said]
        inside, void = (number(said.get("loss", {}), f"weight_{each}", 1.0) for each in ("object", "void"))
        weight = {} if inside == void else {"weight": inside / void}
    part, across = setup.part.placed(), setup.container.across
    tables["target"]["origin"] = list(ORIGIN)
    if across is not None:
        tall = 2 * ceil(float(np.abs(part.bounds[:, 2]).max()) / setup.voxel - 1e-6)
        tables["target"]["shape_of_grid"] = [across, across, max(tall, 4)]
    notes = (f"its {', '.join(own)} left out: `vam solve` has methods of its own",) if own else ()
    notes += ('its weights count in methods that minimize a loss, such as solve.method = "lbfgs"',) if weight else ()
    inserts = [({"role": "insert", **keys}, load_mesh(mesh, center=False)) for mesh, keys, _ in setup.occlusions]
    return tables, [(weight, part), *setup.container.bodies, *inserts], (*setup.notes, *notes)


@contextmanager
def _explaining(path: Path) -> Iterator[None]:
    """Report what was expected in place of a configuration that cannot be read."""
    try:
        yield
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        if isinstance(error, StorageError):
            raise
        reason = getattr(error, "strerror", None) or error
        raise StorageError(f"cannot read {str(path)!r}: {reason}; expected a configuration of Dr.TVAM") from error
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        if isinstance(error, BadInput):
            raise
        expected = "" if "expected" in str(error) else "; expected a configuration of Dr.TVAM in JSON"
        problem = f"lacks {error}" if isinstance(error, KeyError) else f"has a malformed value: {error}"
        raise BadInput(f"{str(path)!r} {problem}{expected}: correct it") from error


@dataclass(frozen=True, eq=False)
class _SetUp:
    """All of a configuration except its patterns."""

    pitch: float
    voxel: float
    container: Container
    resin: dict[str, Any]
    clockwise: bool
    part: _Part
    occlusions: tuple[tuple[Path, dict[str, Any], tuple[str, ...]], ...]
    notes: tuple[str, ...]

    def tables(self, angles: int, pixels: tuple[int, int]) -> dict[str, Any]:
        """Tables of a job file for patterns of that size."""
        return {
            "target": {"pitch": mm(self.voxel)},
            "beam": {"pitch": mm(self.pitch), "pixels": list(pixels), "spread": "0 mm"},
            "turntable": {"angles": angles, "lit_share": 0.0},
            **self.container.tables,
            **self.resin,
        }


def _set_up(path: Path, said: Any) -> _SetUp:
    _check_keys(said, "")
    projector, sensor, target, vial = (_table(said, name) for name in ("projector", "sensor", "target", "vial"))
    film = _table(sensor, "film")
    if (loss := (said.get("loss") or {}).get("type", LOSSES[0])) not in LOSSES:
        raise BadInput(f"its loss is {loss!r}; expected {' or '.join(LOSSES)}: correct it")
    voxel = min(number(sensor, f"scale{axis}", 1.0) / _count(film, f"res{axis}", 256) for axis in "xyz")
    occlusions = tuple(_insert(path.parent, each) for each in vial.get("occlusions", ()))
    medium = _medium(_table(vial, "medium"))
    found = container(vial, path.parent, voxel, medium.absorption)
    alone = not found.bodies and not occlusions
    found, pitch, notes = _projector(projector, found, alone)
    straight = projector.get("type") != "lens" and "vial" in found.tables
    scattering = medium.scattering(not (alone and straight))
    resin = {name: table for name, table in (("scattering", scattering), ("resin", _physics(said))) if table}
    notes = [STEPPED, *notes, *found.notes, *medium.notes(scattering)]
    if "inhibitor_init" in (said.get("physical_model") or {}):
        notes.append("its physical_model.inhibitor_init is left out: the inhibitor is the same everywhere")
    notes += [note for *_, each in occlusions for note in each]
    notes += [f"its {name} is left out: {why}" for name, why in LEFT_OUT.items() if name in said]
    number(target, "size", 1.0)
    width = 2.0 * (number(vial, "r") if "r" in vial else number(vial, "r_int") if "r_int" in vial else inf)
    box = tuple(min(number(sensor, f"scale{axis}", 1.0), width if axis != "z" else inf) for axis in "xyz")
    part = _Part(file_of(path.parent, target["filename"]), target, box)
    clockwise = bool(projector.get("clockwise", False))
    return _SetUp(pitch, found.voxel or voxel, found, resin, clockwise, part, occlusions, tuple(notes))


@dataclass(frozen=True)
class _Medium:
    """Absorption and scattering of a resin [1/mm], and its phase function."""

    extinction: float
    albedo: float
    phase: Mapping[str, Any]

    @property
    def absorption(self) -> float:
        return self.extinction * (1.0 - self.albedo)

    def scattering(self, beside: bool) -> dict[str, Any]:
        """Its table in a job; none if it cannot be computed, as ``beside`` inserts, in a vat or in diverging light."""
        coefficient, kind = self.extinction * self.albedo, self.phase.get("type")
        shapes = {"rayleigh": "rayleigh", "isotropic": 0.0, "hg": self.phase.get("g", 0.8)}
        if beside or not coefficient or kind not in shapes:
            return {}
        return {"coefficient": f"{coefficient:.12g} 1/mm", "anisotropy": shapes[kind]}

    def notes(self, computed: Mapping[str, Any]) -> list[str]:
        """What is left out."""
        if not self.extinction * self.albedo or computed:
            return []
        return [f"its resin scatters (albedo {self.albedo:g}, phase {self.phase.get('type')!r}), which is left out: "
                f"{1.0 - self.albedo:.3g} of its extinction counts as absorption"]  # fmt: skip


def _medium(said: Mapping[str, Any]) -> _Medium:
    albedo, phase = number(said, "albedo", 0.0, zero=True), said.get("phase") or {}
    if albedo > 1.0:
        raise ValueError(f"albedo, which is {albedo:g}; expected a share from 0 to 1")
    if not isinstance(phase, dict):
        raise TypeError("phase, which is not a table")
    if albedo and "phase" not in said:
        raise ValueError(f"albedo, which is {albedo:g} without a phase; expected a phase function, as in Dr.TVAM")
    if phase.get("type") == "hg" and not abs(g := number(phase, "g", 0.8, least=-inf)) <= SHARPEST:
        raise ValueError(f"g, which is {g:g}; expected −{SHARPEST} to {SHARPEST}")
    return _Medium(number(said, "extinction", zero=True), albedo, phase)


def _physics(said: Mapping[str, Any]) -> dict[str, Any]:
    """[resin] for an inhibitor that diffuses. Without diffusion, it only raises the dose that prints."""
    model, older = (_table(said, name) if said.get(name) else {} for name in ("physical_model", "diffusion"))
    kind = model.get("type")
    if kind not in (None, "inhibitor", "inhibitor_diffusion"):
        raise BadInput(f"its physical_model is {kind!r}; expected inhibitor or inhibitor_diffusion: correct it")
    if kind == "inhibitor_diffusion":
        rate, seconds = number(model, "diffusion_coefficient"), number(said, "print_time")
    elif older:
        rate, seconds = number(older, "D", zero=True), number(older, "printing_time")
    else:
        return {}
    return {} if not rate else {"diffusion": {"diffusivity": f"{rate!r} mm2/s", "seconds": f"{seconds!r} s"}}


def _check_keys(said: Any, place: str) -> None:
    """Raises `BadInput` for a key that no version has."""
    for key in set(said) - set(KEYS[place].split()) if isinstance(said, dict) else ():
        if homes := [name for name, keys in KEYS.items() if name and key in keys.split()]:
            raise BadInput(f"its key {f'{place}.{key}'.lstrip('.')} is unknown; expected it in {' or '.join(homes)}: "
                           "move it")  # fmt: skip
    check_keys(said, KEYS[place].split(), place)
    for key, value in said.items() if isinstance(said, dict) else ():
        if (name := f"{place}.{key}".lstrip(".")) in KEYS:
            _check_keys(value, name)


def _insert(folder: Path, said: Any) -> tuple[Path, dict[str, Any], tuple[str, ...]]:
    """File, keys and note of an occlusion: black by default, or clear. Raises `BadInput`."""
    surface, name = said.get("bsdf", {"type": "diffuse"}), said["filename"]
    kind, reflectance = surface.get("type"), surface.get("reflectance", 0.0)
    shine = reflectance.get("value", 0.0) if isinstance(reflectance, dict) else reflectance
    if kind == "dielectric":
        return file_of(folder, name), {"index": index(surface, "int_ior")}, ()
    if kind not in OPAQUE:
        raise BadInput(f"its occlusion {name!r} has the surface {surface!r}; expected a dielectric or one of "
                       f"{', '.join(OPAQUE)}: correct it")  # fmt: skip
    shines = kind != "diffuse" or shine
    return file_of(folder, name), {}, (f"reflections at {name} are left out: it counts as black",) if shines else ()


class _Part:
    """The part where Dr.TVAM places it: its bounding box, not its circle, is centered; its longest edge scales it."""

    def __init__(self, mesh: Path, said: Mapping[str, Any], box: tuple[float, ...]) -> None:
        self.mesh, self.said, self.box = mesh, said, box

    def placed(self) -> Solid:
        """The part, centered only if the configuration says so. Raises `MeshError`."""
        solid = load_mesh(self.mesh, center=False)
        if not self.said.get("scale_and_center", True):
            return solid
        low, high = solid.bounds
        middle = [float(self.said.get(f"box_center_{axis}", 0.0)) for axis in "xyz"]
        size = float(self.said.get("size", 1.0)) / float((high - low).max())
        return solid.translated(-0.5 * (low + high)).scaled(size).translated(middle)

    def __call__(self, file: JobFile, device: Device) -> Target:
        """The voxels of a job for the part, and the sensor, which covers the judged resin."""
        pitch, margin, solid = pitch_of(file), file.target.margin, self.placed()
        scene = Scene([Body(solid)], factor=file.target.factor or 1.0, origin=ORIGIN)
        needed = scene.grid(pitch, margin=margin).shape
        nx, ny, nz = (max(n, ceil(length / pitch - 1e-6)) for n, length in zip(needed, self.box, strict=True))
        target = scene.target(pitch=pitch, margin=margin, shape=(nx, ny, nz), device=device, name=solid.name)
        return replace(target, height=scene.factor * solid.height)


def write_drtvam(light: np.ndarray, path: Path) -> None:
    """Write patterns [angle, r, z] as Dr.TVAM's ``patterns.npz``: float32 [pattern, row, column]."""
    patterns = np.ascontiguousarray(light.transpose(0, 2, 1)[:, ::-1], np.float32)
    with open(path, "wb") as file:
        np.savez_compressed(file, patterns=patterns)


def export_drtvam(frames: Frames, path: str | Path) -> Path:
    """Write a folder that Dr.TVAM reads: ``config.json``, ``patterns.npz`` and ``target.ply``."""
    plan, place = frames.plan, Path(path)
    A, target = direct(getattr(plan, "operator", None)), None if plan is None else known_target(plan)
    if plan is None or not isinstance(A, Projection):
        raise BadInput(f"got frames {'without a plan' if plan is None else f'of a {type(A).__name__}'}; expected those "
                       "of a Projection: export the frames of a job that `vam solve` wrote")  # fmt: skip
    said = _configuration(A, target)
    if place.is_dir():
        raise StorageError(f"{str(path)!r} is a folder, which is never replaced; remove it or choose another path")
    check_folder(place)
    with replacing(place) as draft:
        draft.mkdir()
        light = plan.sinogram.numpy()
        write_drtvam(light, draft / "patterns.npz")
        if find_spec("OpenEXR"):
            (draft / "patterns").mkdir()
            for index, pattern in enumerate(light.transpose(0, 2, 1)[:, ::-1]):
                write_exr(draft / "patterns" / f"{index:04d}.exr", pattern)
        if target is not None and target.solid is not None:
            target.solid.save(draft / "target.ply")
        (draft / "config.json").write_text(json.dumps(said, indent=2) + "\n", encoding="utf-8")
    return place


def _configuration(A: Projection, target: Target | None) -> dict[str, Any]:
    """A set-up as a configuration of Dr.TVAM. Raises `BadInput` if Dr.TVAM does not support it."""
    if not A.motion.is_even:
        raise BadInput(f"got angles of {A.motion}; expected equal steps and times over a full turn, as in Dr.TVAM")
    vessel = A.vessel
    medium: dict[str, Any] = {"albedo": 0.0, "extinction": float(getattr(vessel, "absorption", 0.0))}
    if isinstance(vessel, Vial):
        medium["ior"] = vessel.resin_index
        vial = {"type": "cylindrical", "r_ext": vessel.radius, "r_int": vessel.inner_radius, "ior": vessel.wall_index,
                "ior_surrounding": vessel.bath_index}  # fmt: skip
    elif vessel is None or isinstance(vessel, Vat) and vessel.radius is not None:
        medium["ior"] = getattr(vessel, "resin_index", 1.0)
        vial = {"type": "index_matched", "r": getattr(vessel, "radius", None) or 2.0 * A.grid.inscribed_radius}
    else:
        raise BadInput(f"got a {type(vessel).__name__}; expected a Vial, a Vat with a radius or no vessel, because "
                       "Dr.TVAM has no other round vessel")  # fmt: skip
    (columns, rows), pitch = A.beam.pixels, A.beam.pitch
    film = {"type": "vfilm"} | {f"res{axis}": n for axis, n in zip("xyz", A.grid.shape, strict=True)}
    scales = {f"scale{axis}": n * A.grid.pitch for axis, n in zip("xyz", A.grid.shape, strict=True)}
    said: dict[str, Any] = {
        "vial": {**vial, "medium": medium},
        "projector": {"type": "collimated", "n_patterns": A.motion.angles, "resx": columns, "resy": rows,
                      "pixel_size": float(pitch), "motion": "circular", "distance": 20.0 + 2.0 * columns * pitch},
        "sensor": {"type": "dda", **scales, "film": film},
    }  # fmt: skip
    if target is not None and target.solid is not None:
        said["target"] = {"filename": "target.ply", "scale_and_center": False}
    return said


def _table(said: Any, name: str) -> dict[str, Any]:
    if not isinstance(said, dict):
        raise TypeError(f"its outermost braces: it is a {type(said).__name__}, not a table")
    table = said[name]
    if not isinstance(table, dict):
        raise TypeError(f"{name}, which is not a table")
    return table


def _count(said: Mapping[str, Any], name: str, default: int | None = None) -> int:
    value = number(said, name, default)
    if value != int(value):
        raise ValueError(f"{name}, which is {value!r}; expected a whole number")
    return int(value)


def _projector(said: Mapping[str, Any], found: Container, alone: bool) -> tuple[Container, float, list[str]]:
    """Its light with the container in it, the pitch of its pixels at the axis, and notes. Raises `BadInput`."""
    kind, motion = said.get("type"), said.get("motion", "circular")
    if motion != "circular" or said.get("tilt") or kind not in ("collimated", "telecentric", "lens"):
        raise BadInput(
            f"its projector is {kind!r} with motion {motion!r}; expected a collimated, telecentric or lens one on a "
            "circle without a tilt: import its patterns as a folder of EXR images with your own job"
        )
    cropped = ["its crop is left out: pixels beyond it may be lit"] if {"cropx", "cropy"} & said.keys() else []
    notes = [*cropped, "its aperture is left out: every pixel counts as in focus; add [defocus] to the job"]
    if kind != "lens":
        return found, number(said, "pixel_size"), notes if kind == "telecentric" else cropped
    throw, focus = number(said, "distance"), number(said, "focus_distance")
    wide = 2.0 * focus * tan(0.5 * radians(number(said, "fov"))) / _count(said, "resx", 256) if "fov" in said else None
    pitch = throw / focus * (number(said, "pixel_size") if wide is None else wide)
    ((name, vessel),) = found.tables.items()
    light = {"throw": mm(throw), "vessel": {"kind": name, **vessel}}
    if name == "vat" and alone:
        return replace(found, tables={"light": {"kind": "cone", **light}}), pitch, notes
    notes += ["its rows count as level, though light of a lens also spreads along the axis"]
    return replace(found, tables={"vessel": {"kind": "fan", **light}}), pitch, notes


def _beside(path: Path, said: Mapping[str, Any]) -> Path:
    """Its patterns. Raises `StorageError`."""
    places = [path.parent, *([path.parent / str(said["output"])] if "output" in said else [])]
    tried = [place / name for place in places for name in PATTERNS]
    found = next((each for each in tried if each.exists()), None)
    if found is None:
        raise StorageError(f"no patterns beside {str(path)!r}: searched for {', '.join(PATTERNS)}; name them with "
                           "--patterns, or let `vam solve` optimize patterns: --out job.toml")  # fmt: skip
    return found


def _patterns(path: Path) -> np.ndarray:
    """Patterns [pattern, row, column] of an NPZ or NPY file. Raises `StorageError`, `BadInput`."""
    if path.suffix.lower() == ".npy":
        return np.array(map_npy(path))
    held = read_npz(path)
    if len(held) != 1 and "patterns" not in held:
        raise BadInput(f"{str(path)!r} holds {', '.join(held) or 'nothing'}; expected one array, patterns")
    return held.get("patterns", next(iter(held.values())))
