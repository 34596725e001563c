"""Read a part from a mesh file and place it in the vial's coordinates."""

from __future__ import annotations

import warnings
from dataclasses import replace
from io import BytesIO
from os import fstat
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from vamgpu.errors import BadInput, EmptyMesh, MeshError, MeshWarning
from vamgpu.storage.memory import afford, size
from vamgpu.storage.reading import is_file, open_file
from vamgpu.targets.ply import read_ply
from vamgpu.targets.repair import repaired
from vamgpu.targets.solid import Solid
from vamgpu.targets.stl import read_stl
from vamgpu.targets.threemf import TRIANGLE, read_3mf

if TYPE_CHECKING:
    import trimesh

__all__ = ["FORMATS", "Solid", "from_trimesh", "load_mesh", "solid_of"]

FORMATS = (".stl", ".ply", ".obj", ".3mf")
"""File formats that load_mesh reads."""
WORK = {"stl": 10, "ply": 20, "obj": 20, "3mf": 2}
"""Bytes of memory that reading and repairing take at most, per byte of the file; for 3MF, see package.py."""


def load_mesh(
    path: str | Path,
    *,
    rotation: npt.ArrayLike | None = None,
    height: float | None = None,
    factor: float | None = None,
    center: bool = True,
    repair: bool = True,
    name: str | None = None,
) -> Solid:
    """Read STL, PLY, OBJ or 3MF, repair it, and return it placed in the vial as a Solid [mm].

    rotation: 3 x 3 rotation matrix, applied first. height [mm] along z, or factor, then scales the part. center finally
    puts the smallest enclosing circle of the footprint on the axis and mid-height at z = 0. Files without a unit are
    read as mm; a 3MF file states its unit. The parts of a file with several are joined into one Solid.

    What is left out of a damaged STL or PLY file is warned of, and stands in ``mended``.

    Raises BadInput (no such file, unknown format, bad rotation, height or factor), EmptyMesh (no triangles),
    NotWatertight (open edges that repair could not close, or any with repair=False), MeshError (unreadable file).
    """
    file = Path(path)
    if file.suffix.lower() not in FORMATS:
        raise BadInput(f"cannot read {str(path)!r}: expected a mesh file ending in {', '.join(FORMATS)}")
    if not is_file(file):
        raise BadInput(f"there is no mesh file {str(path)!r}; check the path")
    mesh, notes = read_mesh(file)
    solid = from_trimesh(mesh, name=name or file.stem, repair=repair)
    if notes:
        solid = replace(solid, mended=(*notes, *solid.mended))
        warnings.warn(f"{file.name} is damaged: {'; '.join(notes)}. Check the part before it is printed, or export it "
                      "again", MeshWarning, stacklevel=2)  # fmt: skip
    placed = solid.placed(rotation=rotation, height=height, factor=factor, center=center)
    return placed if center else replace(placed, drawn=True)


def solid_of(source: Any, name: str = "solid") -> Solid | None:
    """The repaired Solid [mm] of a path, a Solid or a trimesh.Trimesh, where it was drawn; None for anything else."""
    if isinstance(source, Solid):
        return repaired(source)
    if isinstance(source, str | Path):
        return load_mesh(source, center=False)
    if hasattr(source, "faces") and hasattr(source, "vertices"):
        return from_trimesh(source, name=name)
    return None


def from_trimesh(mesh: trimesh.Trimesh, *, name: str = "solid", repair: bool = True) -> Solid:
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
    return repaired(Solid(vertices, faces, name), fix=repair)


def read_mesh(file: Path) -> tuple[trimesh.Trimesh, tuple[str, ...]]:
    """A mesh, and what was left out of its file."""
    import trimesh

    kind = file.suffix[1:].lower()
    data = _bytes(file, kind)
    try:
        if kind == "3mf":
            mesh, notes = read_3mf(data, file.name), ()
        elif kind == "stl":
            corners, notes = read_stl(data, file.name)
            mesh = trimesh.Trimesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
        elif kind == "ply":
            vertices, faces, notes = read_ply(data, file.name)
            mesh = trimesh.Trimesh(vertices, faces)
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


def _scene(data: bytes, kind: str, name: str) -> trimesh.Trimesh:
    import trimesh

    # bytes in place of a path: the readers then open no other file that this one names
    scene = trimesh.load_scene(BytesIO(_encoded(data)), file_type=kind)
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
