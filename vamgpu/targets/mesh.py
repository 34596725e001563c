"""Read a part from a mesh file and place it in the vial's coordinates."""

from __future__ import annotations

from dataclasses import replace
from io import BytesIO
from os import fstat
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from vamgpu.errors import BadInput, EmptyMesh, MeshError
from vamgpu.storage.memory import afford, size
from vamgpu.storage.reading import is_file, open_file
from vamgpu.targets.repair import repaired
from vamgpu.targets.solid import Solid
from vamgpu.targets.threemf import TRIANGLE, read_3mf

if TYPE_CHECKING:
    import trimesh

__all__ = ["FORMATS", "Solid", "from_trimesh", "load_mesh", "solid_of"]

FORMATS = (".stl", ".ply", ".obj", ".3mf")
"""File formats that load_mesh reads."""
WORK = {"stl": 10, "ply": 20, "obj": 20, "3mf": 2}
"""Bytes of memory that reading and repairing take at most, per byte of the file; for 3MF, see package.py."""
PLY_HEAD = 1 << 16
"""Largest number of bytes of a PLY file's header."""


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

    Raises BadInput (no such file, unknown format, bad rotation, height or factor), EmptyMesh (no triangles),
    NotWatertight (open edges that repair could not close, or any with repair=False), MeshError (unreadable file).
    """
    file = Path(path)
    if file.suffix.lower() not in FORMATS:
        raise BadInput(f"cannot read {str(path)!r}: expected a mesh file ending in {', '.join(FORMATS)}")
    if not is_file(file):
        raise BadInput(f"there is no mesh file {str(path)!r}; check the path")
    solid = from_trimesh(_read(file), name=name or file.stem, repair=repair)
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
    """Turn a trimesh.Trimesh into a watertight Solid [mm]; its unit, mm by default, is converted.

    Raises EmptyMesh, NotWatertight, MeshError as load_mesh does.
    """
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


def _read(file: Path) -> trimesh.Trimesh:
    import trimesh

    kind = file.suffix[1:].lower()
    data = _bytes(file, kind)
    count = _announced(data, kind, file.name)
    if kind == "ply":
        _check_ply(data, file.name)
    try:
        if kind == "3mf":
            return read_3mf(data, file.name)
        content = BytesIO(_encoded(data, kind))
        # bytes in place of a path: the readers then cannot open other files that this one names
        scene = trimesh.load_scene(content, file_type=kind)
        instances = [scene.graph[node][1] for node in scene.graph.nodes_geometry]
        triangles = sum(len(getattr(scene.geometry.get(name), "faces", ())) for name in instances)
        afford(triangles * TRIANGLE, f"{file.name!r} with {triangles:,} triangles", MeshError)
        mesh = scene.to_mesh()
        if scene.units is not None:
            mesh.units = scene.units
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
    if count > len(mesh.faces):  # the reader drops them in silence, which leaves holes
        raise MeshError(
            f"{file.name}: {count - len(mesh.faces)} of {count} triangles have corners that are NaN or infinite; "
            "expected finite numbers: export the part again"
        )
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


def _announced(data: bytes, kind: str, name: str) -> int:
    """Number of triangles by the header of a binary STL file, else 0. Raises MeshError if the file ends too soon."""
    if kind != "stl" or b"\0" not in data[:512]:
        return 0
    count, room = int.from_bytes(data[80:84], "little"), max(0, len(data) - 84) // 50
    if count > room:
        raise MeshError(
            f"{name} states that it has {count} triangles but ends after {room}; it is cut off or not an STL file: "
            "copy or export it again"
        )
    return count


def _check_ply(data: bytes, name: str) -> None:
    """Raise MeshError if the header counts more numbers than the file has bytes."""
    count = claim = 0
    head, mark, _ = data[:PLY_HEAD].partition(b"end_header")
    for line in head.splitlines():
        words = line.split()
        if words[:1] == [b"element"] and len(words) == 3 and words[2].isdigit():
            count = int(words[2][:20])
            claim += count
        elif words[:1] == [b"property"]:
            claim += count
    if not mark or claim > 2 * len(data):
        fault = f"counts {claim:,} elements and numbers" if mark else "has no end of its header"
        raise MeshError(f"{name!r} {fault} in {len(data):,} bytes; it is cut off or no PLY file: export it again")


def _encoded(data: bytes, kind: str) -> bytes:
    """Bytes. Text in another encoding than UTF-8 is converted to UTF-8; only names and remarks can need this."""
    if kind not in ("obj", "stl") or b"\0" in data[:512]:
        return data
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("latin-1").encode()
    return data
