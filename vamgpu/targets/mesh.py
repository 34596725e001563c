"""Read a part from a mesh file and place it in the vial's coordinates."""

from __future__ import annotations

import subprocess
import sys
import warnings
from dataclasses import replace
from importlib.util import find_spec
from io import BytesIO
from os import fstat
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from vamgpu.errors import BadInput, EmptyMesh, MeshError, MeshWarning
from vamgpu.storage.memory import afford, size
from vamgpu.storage.reading import is_file, open_file
from vamgpu.targets.ply import read_ply
from vamgpu.targets.repair import repaired
from vamgpu.targets.role_names import role_in
from vamgpu.targets.solid import Solid
from vamgpu.targets.stl import read_stl
from vamgpu.targets.threemf import TRIANGLE, read_3mf

if TYPE_CHECKING:
    import trimesh

TESSELLATE = """
import os, sys, cascadio
out = os.dup(1)
os.dup2(2, 1)
made = cascadio.load(sys.stdin.buffer.read(), file_type="step", tol_linear=0.002, tol_angular=0.1)
with os.fdopen(out, "wb") as file:
    file.write(made)
"""
"""A process of its own, because damaged CAD models can end it. Triangles are within 2 µm of the surface."""
PATIENCE = 300.0  # seconds for a CAD model

__all__ = ["FORMATS", "Solid", "from_trimesh", "load_mesh", "solid_of"]

FORMATS = (".stl", ".ply", ".obj", ".3mf", ".step", ".stp")  # file formats that load_mesh reads
EQUAL = 1e-8  # distance [mm] below which corners of triangles are one vertex
WORK = {"stl": 10, "ply": 20, "obj": 20, "3mf": 2, "step": 60, "stp": 60}
"""Bytes of memory that reading and repairing take at most, per byte of the file; for 3MF, see threemf.py."""


class Mesh(NamedTuple):
    """Triangles of a file, in place of a trimesh.Trimesh: importing trimesh takes longer than reading them."""

    vertices: npt.NDArray[np.float64]
    faces: npt.NDArray[np.int64]
    units: str | None = None

    @classmethod
    def of(cls, corners: npt.NDArray[np.float64]) -> Mesh:
        """Triangles (m, 3, 3) [mm] with equal corners merged; vertices are in the order of their first corner."""
        points = corners.reshape(-1, 3)
        places = np.round(points / EQUAL)
        order = np.lexsort(places.T)
        begins = np.ones(len(order), bool)
        begins[1:] = (places[order[1:]] != places[order[:-1]]).any(axis=1)
        first = order[begins]
        number, vertex = np.empty(len(first), np.int64), np.empty(len(order), np.int64)
        number[first.argsort()] = np.arange(len(first))
        vertex[order] = number[begins.cumsum() - 1]
        return cls(points[np.sort(first)], vertex.reshape(-1, 3))


def load_mesh(
    path: str | Path,
    *,
    rotation: npt.ArrayLike | None = None,
    height: float | None = None,
    factor: float | None = None,
    center: bool = True,
    name: str | None = None,
    part: int | None = None,
) -> Solid:
    """Read STL, PLY, OBJ, 3MF or STEP, repair it, and return it placed in the vial as a Solid [mm].

    rotation: 3 x 3 rotation matrix, applied first. height [mm] along z, or factor, then scales the part. center finally
    puts the smallest enclosing circle of the footprint on the axis and mid-height at z = 0. Files without a unit are
    read as mm; a 3MF file states its unit. The parts of a file with several are joined into one Solid; ``part`` takes
    one of a 3MF file, counted from 1 in the order of the file.

    A warning and ``mended`` name what is left out of a damaged STL or PLY file.

    Raises BadInput (no such file, unknown format, bad rotation, height or factor), EmptyMesh (no triangles),
    NotWatertight (open edges that repair could not close), MeshError (unreadable file).
    """
    file = _existing(path, FORMATS)
    mesh, notes = read_mesh(file, part)
    solid = from_trimesh(mesh, name=name or file.stem)
    if notes:
        solid = replace(solid, mended=(*notes, *solid.mended))
        warnings.warn(f"{file.name} is damaged: {'; '.join(notes)}. Check the part before it is printed, or export it "
                      "again", MeshWarning, stacklevel=2)  # fmt: skip
    names = dict.fromkeys(name for _, names in parts_in(mesh) for name in names)
    if part is None and (named := [name for name in names if role_in([name]) not in (None, "print")]):
        warnings.warn(f"{file.name} has objects named {', '.join(map(repr, named))}, which are printed as all others. "
                      'If these names are roles, ask for them: roles = "names" in a [[body]] of a job, or '
                      'Scene.from_3mf(path, roles="names"); else rename them', MeshWarning, stacklevel=2)  # fmt: skip
    placed = solid.placed(rotation=rotation, height=height, factor=factor, center=center)
    return placed if center else replace(placed, drawn=True)


def parts_in(mesh: trimesh.Trimesh | Mesh) -> list[tuple[int, tuple[str, ...]]]:
    """Number of triangles, and names, of each part of a file; triangles are in the order of parts."""
    return [(len(mesh.faces), ())] if isinstance(mesh, Mesh) else mesh.metadata.get("parts", [(len(mesh.faces), ())])


def load_parts(path: str | Path) -> list[tuple[Solid, tuple[str, ...]]]:
    """The parts of a 3MF file [mm], repaired and where they were drawn, with their names; raises as `load_mesh`."""
    file = _existing(path, (".3mf",))
    mesh, _ = read_mesh(file)
    found, begin = [], 0
    for number, (count, names) in enumerate(parts_in(mesh), 1):
        used, faces = np.unique(np.asarray(mesh.faces)[begin : begin + count], return_inverse=True)
        begin += count
        if count:  # else negative volumes left nothing
            some = Mesh(np.asarray(mesh.vertices)[used], faces.reshape(-1, 3))
            found.append((from_trimesh(some, name=next(iter(names), f"{file.stem} {number}")), names))
    return found


def _existing(path: str | Path, formats: tuple[str, ...]) -> Path:
    file = Path(path)
    if file.suffix.lower() not in formats:
        raise BadInput(f"cannot read {str(path)!r}: expected a mesh file ending in {', '.join(formats)}")
    if not is_file(file):
        raise BadInput(f"there is no mesh file {str(path)!r}; check the path")
    return file


def solid_of(source: Any, name: str = "solid") -> Solid | None:
    """The repaired Solid [mm] of a path, a Solid or a trimesh.Trimesh, where it was drawn; None for anything else."""
    if isinstance(source, Solid):
        return repaired(source)
    if isinstance(source, str | Path):
        return load_mesh(source, center=False)
    if hasattr(source, "faces") and hasattr(source, "vertices"):
        return from_trimesh(source, name=name)
    return None


def from_trimesh(mesh: trimesh.Trimesh | Mesh, *, name: str = "solid") -> Solid:
    """A trimesh.Trimesh as a watertight Solid [mm], its unit converted; raises as `load_mesh`."""
    faces = np.asarray(mesh.faces)
    if len(faces) == 0:
        raise EmptyMesh(f"{name}: the mesh has no triangles; export the part again as a triangle mesh")
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    if not np.isfinite(vertices).all():
        raise MeshError(f"{name}: vertices are NaN or infinite; expected finite numbers: export the part again")
    if mesh.units not in (None, "mm", "millimeter", "millimeters"):
        from trimesh.units import unit_conversion

        vertices = vertices * unit_conversion(mesh.units, "millimeter")
    return repaired(Solid(vertices, faces, name))


def read_mesh(file: Path, part: int | None = None) -> tuple[trimesh.Trimesh | Mesh, tuple[str, ...]]:
    """A mesh, or one part of a 3MF file, and what was left out of its file."""
    kind = file.suffix[1:].lower()
    if part is not None and kind != "3mf":
        raise BadInput(f"got part {part} of {file.name!r}; expected it only for a 3MF file of several parts: remove it")
    data = _bytes(file, kind)
    try:
        if kind == "3mf":
            mesh, notes = read_3mf(data, file.name, part), ()
        elif kind == "stl":
            corners, notes = read_stl(data, file.name)
            mesh = Mesh.of(corners)
        elif kind == "ply":
            vertices, faces, notes = read_ply(data, file.name)
            mesh = Mesh.of(vertices[faces])
        elif kind in ("step", "stp"):
            mesh, notes = _scene(_tessellated(data, file.name), "glb", file.name), ()
        else:
            mesh, notes = _scene(data, kind, file.name), ()
    except MeshError:
        raise
    except Exception as error:  # the readers raise many types of errors
        raise MeshError(
            f"cannot read {file.name!r} as {kind.upper()} ({type(error).__name__}: {error}); "
            "the file is damaged or of another format: export the part again"
        ) from error
    if not len(mesh.faces):
        raise EmptyMesh(f"{file.name!r} has no triangles: it is empty, or no {kind.upper()} file; expected a triangle "
                        "mesh: export the part again")  # fmt: skip
    return mesh, notes


def _tessellated(data: bytes, name: str) -> bytes:
    """A CAD model as triangles in GLB."""
    if find_spec("cascadio") is None:
        raise MeshError(f"{name!r} is a CAD model, which the package cascadio turns into triangles: pip install "
                        '"vamgpu[step]", or export the part as 3MF or STL')  # fmt: skip
    try:
        made = subprocess.run([sys.executable, "-c", TESSELLATE], input=data, capture_output=True, timeout=PATIENCE)
    except subprocess.TimeoutExpired as error:
        raise MeshError(f"{name!r} takes more than {PATIENCE:g} s to become triangles; expected less: simplify it, or "
                        "export it as 3MF or STL") from error  # fmt: skip
    if made.returncode or not made.stdout:
        raise MeshError(f"{name!r} is damaged, or no STEP file with a solid: export the part again")
    return made.stdout


def _scene(data: bytes, kind: str, name: str) -> trimesh.Trimesh:
    import trimesh

    # bytes in place of a path: the readers then open no other file that this one names
    scene = trimesh.load_scene(BytesIO(data if kind == "glb" else _encoded(data)), file_type=kind)
    instances = [scene.graph[node][1] for node in scene.graph.nodes_geometry]
    triangles = sum(len(getattr(scene.geometry.get(each), "faces", ())) for each in instances)
    afford(triangles * TRIANGLE, f"{name!r} with {triangles:,} triangles", MeshError)
    mesh = scene.to_mesh()
    if scene.units is not None:
        mesh.units = scene.units
    return mesh


def _bytes(file: Path, kind: str) -> bytes:
    try:
        with open_file(file) as opened:
            length = fstat(opened.fileno()).st_size
            afford(length * WORK[kind], f"the mesh {file.name!r} of {size(length)}", MeshError)
            data = opened.read(length)
    except OSError as error:
        raise MeshError(f"cannot read the mesh {str(file)!r}: {error.strerror or error}; check the path") from error
    if not data:
        raise EmptyMesh(f"{file.name} is an empty file; export the part again")
    return data


def _encoded(data: bytes) -> bytes:
    """Text; if it is in another encoding than UTF-8, which only names and remarks can hold, in UTF-8."""
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("latin-1").encode()
    return data
