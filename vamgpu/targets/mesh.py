"""Read a part from a mesh file and bring it into the vial's frame."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from vamgpu.errors import BadInput, EmptyMesh, MeshError
from vamgpu.targets.repair import repaired
from vamgpu.targets.solid import Solid

if TYPE_CHECKING:
    import trimesh

__all__ = ["FORMATS", "Solid", "from_trimesh", "load_mesh"]

FORMATS = (".stl", ".ply", ".obj", ".3mf")
"""File formats that load_mesh reads."""


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

    rotation: 3 x 3 rotation matrix, applied first; then height [mm] along z, or factor, scales; then center puts the
    smallest enclosing circle of the footprint on the axis and mid-height at z = 0. Files without a unit are read as
    mm; a 3MF file says its unit. The parts of a file with several are joined into one Solid.

    Raises BadInput (no such file, unknown format, bad rotation, height or factor), EmptyMesh (no triangles),
    NotWatertight (open edges that repair could not close, or any with repair=False), MeshError (unreadable file).
    """
    file = Path(path)
    if file.suffix.lower() not in FORMATS:
        raise BadInput(f"cannot read {file.name!r}: wanted a mesh file ending in {', '.join(FORMATS)}")
    if not file.is_file():
        raise BadInput(f"there is no mesh file {str(path)!r}; check the path")
    solid = from_trimesh(_read(file), name=name or file.stem, repair=repair)
    return solid.placed(rotation=rotation, height=height, factor=factor, center=center)


def from_trimesh(mesh: trimesh.Trimesh, *, name: str = "solid", repair: bool = True) -> Solid:
    """Turn a trimesh.Trimesh into a watertight Solid [mm]; a mesh with a unit is converted, one without is in mm.

    Raises EmptyMesh, NotWatertight, MeshError as load_mesh does.
    """
    faces = np.asarray(mesh.faces)
    if len(faces) == 0:
        raise EmptyMesh(f"{name}: the mesh has no triangles; export the part again as a triangle mesh")
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    if not np.isfinite(vertices).all():
        raise MeshError(f"{name}: vertices are NaN or infinite; wanted finite numbers: export the part again")
    if mesh.units not in (None, "mm", "millimeter", "millimeters"):
        from trimesh.units import unit_conversion

        vertices = vertices * unit_conversion(mesh.units, "millimeter")
    return repaired(Solid(vertices, faces, name), fix=repair)


def _read(file: Path) -> trimesh.Trimesh:
    import trimesh

    if file.stat().st_size == 0:
        raise EmptyMesh(f"{file.name} is an empty file; export the part again")
    count = _announced(file)
    try:
        scene = trimesh.load_scene(_readable(file), file_type=file.suffix[1:].lower())
        mesh = scene.to_mesh()
        if scene.units is not None:
            mesh.units = scene.units
    except Exception as error:  # the readers raise whatever they stumble over
        raise MeshError(
            f"cannot read {file.name} as {file.suffix[1:].upper()} ({type(error).__name__}: {error}); "
            "the file is damaged or of another format: export the part again"
        ) from error
    if count > len(mesh.faces):  # the reader drops them in silence, which leaves holes
        raise MeshError(
            f"{file.name}: {count - len(mesh.faces)} of {count} triangles have corners that are NaN or infinite; "
            "wanted finite numbers: export the part again"
        )
    return mesh


def _announced(file: Path) -> int:
    """Triangles that a binary STL file says it has, 0 for all others. Raises MeshError where the file ends too soon."""
    with open(file, "rb") as stream:
        head = stream.read(512)
    if file.suffix.lower() != ".stl" or b"\0" not in head:
        return 0
    count, room = int.from_bytes(head[80:84], "little"), max(0, file.stat().st_size - 84) // 50
    if count > room:
        raise MeshError(
            f"{file.name} says that it has {count} triangles but ends after {room}; it is cut off or no STL: "
            "copy or export it again"
        )
    return count


def _readable(file: Path) -> str | BytesIO:
    """The path; for text in another encoding than UTF-8, which only names and remarks can hold, its text in UTF-8."""
    data = file.read_bytes() if file.suffix.lower() in (".obj", ".stl") else b""
    if b"\0" in data[:512]:
        return str(file)
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        return BytesIO(data.decode("latin-1").encode())
    return str(file)
