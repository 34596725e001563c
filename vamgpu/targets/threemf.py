"""Read 3MF packages as slicers do: which objects are printed, where they are placed, and what is subtracted.

The core and production extensions, and the volumes that PrusaSlicer and Bambu Studio (Orca) describe in addition.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from io import BytesIO
from posixpath import normpath
from typing import TYPE_CHECKING, Any
from zipfile import ZipInfo

import numpy as np
import numpy.typing as npt

from vamgpu.errors import EmptyMesh, MeshError
from vamgpu.storage.memory import afford, size
from vamgpu.storage.zips import open_zip, unpacked
from vamgpu.targets.shapes import csg

WORK = 12
"""Bytes of memory that reading takes, by byte of a model's text."""
DENSEST, SMALL = 200, 1 << 24
"""Meshes as text pack ten times smaller; beyond `SMALL` bytes a model that packs so much smaller is none."""
DOCTYPES = (b"<!DOCTYPE", "<!DOCTYPE".encode("utf-16-le")[:-1])
"""What a 3MF file must not have (3MF core, 2.3): entities that multiply, and names of other files."""


def members_of(data: bytes, name: str, beside: Collection[str] = ()) -> dict[str, bytes]:
    """Texts of the models of a 3MF file, and of members ``beside`` them, by path. Raises `MeshError`."""
    found: dict[str, bytes] = {}
    try:
        with open_zip(BytesIO(data)) as package:
            members = [each for each in package.infolist() if _path(each).lower().endswith(".model")]
            members += [each for each in package.infolist() if _path(each) in beside]
            afford(WORK * sum(member.file_size for member in members), f"the mesh {name!r}", MeshError)
            for member in members:
                if member.file_size > max(SMALL, DENSEST * member.compress_size):
                    raise MeshError(
                        f"{name!r} holds {member.filename!r}, which unpacks from {size(member.compress_size)} to "
                        f"{size(member.file_size)}; no mesh compresses so far: export the part again"
                    )
                text = unpacked(package, member)
                if any(mark in text for mark in DOCTYPES):
                    raise MeshError(f"{name!r} declares a DOCTYPE, which 3MF forbids: export the part again")
                found[_path(member)] = text
    except MeshError:
        raise
    except Exception as error:  # noqa: BLE001 - zipfile and its codecs raise whatever they stumble over
        raise MeshError(
            f"cannot read {name!r} as 3MF ({type(error).__name__}: {error}); "
            "the file is damaged or of another format: export the part again"
        ) from error
    return found


def _path(member: ZipInfo) -> str:
    return member.filename.lstrip("/")


if TYPE_CHECKING:
    import trimesh

_Element = Any  # of lxml, which has no types
Array = npt.NDArray[np.float64]

UNITS = {"micron": 1e-3, "millimeter": 1.0, "centimeter": 10.0, "inch": 25.4, "foot": 304.8, "meter": 1e3}
PRINTED = ("model", "solidsupport")
"""Types of objects that are printed; "support", "surface" and "other" are not."""
KNOWN = ("production/2015/06", "material/2015/02", "slice/2015/07", "core/2015/02", "trianglesets/2021/07")
"""Ends of the namespaces of extensions that may be required, because they do not change the solids."""
MOST_INSTANCES, MOST_LEVELS = 10_000, 16
"""Largest number of meshes that a package may place, and of levels of components."""
TRIANGLE = 300
"""Bytes of memory that a triangle takes until it is repaired."""
PRUSA, BAMBU = "Metadata/Slic3r_PE_model.config", "Metadata/model_settings.config"
CUT, LEFT_OUT = "cut", "left out"
ROLES = {
    "NegativeVolume": CUT, "negative_part": CUT, "ParameterModifier": LEFT_OUT, "modifier_part": LEFT_OUT,
    "SupportBlocker": LEFT_OUT, "SupportEnforcer": LEFT_OUT, "support_blocker": LEFT_OUT, "support_enforcer": LEFT_OUT,
}  # fmt: skip
"""Roles of volumes in the words of both programs; all other volumes are solid."""


@dataclass
class _Object:
    kind: str
    vertices: Array
    faces: npt.NDArray[np.int64]
    components: list[tuple[str, str, Array]] = field(default_factory=list)  # file, number, transform


def read_3mf(data: bytes, name: str) -> trimesh.Trimesh:
    """The printed parts of a package [mm], joined, minus its negative volumes. Raises `MeshError`, `EmptyMesh`."""
    import trimesh

    solid, cut = _Package(name, members_of(data, name, (PRUSA, BAMBU))).placed()
    if not solid:
        raise EmptyMesh(f"{name} places no triangles that are printed; expected an <item> of a model with a mesh")
    mesh: Any = trimesh.util.concatenate([trimesh.Trimesh(v, f, process=False) for v, f in solid])
    if cut:
        mesh.merge_vertices()
        body = csg.from_triangles(mesh.vertices, mesh.faces) - csg.union(csg.from_triangles(*each) for each in cut)
        if body.is_empty():
            raise MeshError(f"{name!r} has negative volumes that leave nothing, or surfaces that are not closed; "
                            "expected closed parts: repair them in the slicer and export again")  # fmt: skip
        found = body.to_mesh64()
        mesh = trimesh.Trimesh(np.asarray(found.vert_properties)[:, :3], np.asarray(found.tri_verts), process=False)
    mesh.units = "millimeter"
    return mesh


class _Package:
    """The objects of a package by file and number, and the roles of volumes."""

    def __init__(self, name: str, files: dict[str, bytes]) -> None:
        self.name, self.triangles, self.instances = name, 0, 0
        models = {path: _parsed(text) for path, text in files.items() if path.lower().endswith(".model")}
        root = next((path for path in models if path.lower().endswith("3d/3dmodel.model")), next(iter(models), None))
        if root is None:
            raise MeshError(f"{name!r} holds no model; expected 3D/3dmodel.model: export the part again as 3MF")
        self.root, self.build = root, models[root].findall("{*}build/{*}item")
        self.objects = {
            (path, each.get("id", "")): self._object(each, path)
            for path, model in models.items() if self._is_known(model) for each in model.iter("{*}object")
        }  # fmt: skip
        self.scale = {path: self._unit(model) for path, model in models.items()}
        self.ranges, self.parts = _ranges(files.get(PRUSA)), _parts(files.get(BAMBU))

    def placed(self) -> tuple[list[tuple[Array, Any]], list[tuple[Array, Any]]]:
        """Vertices [mm] and faces of the solid volumes, and of the negative ones."""
        solid: list[tuple[Array, Any]] = []
        cut: list[tuple[Array, Any]] = []
        for item in self.build:
            if item.get("printable", "1") not in ("0", "false"):
                path = self._path(item, self.root)
                for vertices, faces, role in self._meshes(path, item.get("objectid", ""), _transform(item), "", 0):
                    (cut if role == CUT else solid).append((vertices, faces))
        return solid, cut

    def _meshes(self, path: str, number: str, move: Array, role: str, level: int) -> Any:
        """Meshes of an object and its components, transformed; without those that are ignored."""
        found = self.objects.get((path, number))
        if found is None:
            raise MeshError(f"{self.name!r} places object {number!r} of {path!r}, which does not exist; the file is "
                            "damaged: export the part again")  # fmt: skip
        self.instances += 1
        if level > MOST_LEVELS or self.instances > MOST_INSTANCES:
            raise MeshError(f"{self.name!r} has parts on more than {MOST_LEVELS} levels of components, or more than "
                            f"{MOST_INSTANCES} of them: join the parts and export them again")  # fmt: skip
        if found.kind not in PRINTED:
            return
        ranges = self.ranges.get(number) if path == self.root else None
        for some, own in ranges or ((slice(None), role),):
            yield from self._mesh(found, some, move, self.scale[path], own or role)
        for where, other, way in found.components:
            own = self.parts.get((number, other), role)
            if own != LEFT_OUT:
                yield from self._meshes(where, other, way @ move, own, level + 1)

    def _mesh(self, found: _Object, some: slice, move: Array, scale: float, role: str) -> Any:
        faces = found.faces[some]
        if role != LEFT_OUT and len(faces):
            self.triangles += len(faces)
            afford(self.triangles * TRIANGLE, f"{self.name!r} with {self.triangles:,} triangles", MeshError)
            vertices = (found.vertices @ move[:3, :3] + move[3, :3]) * scale
            yield vertices, faces if np.linalg.det(move[:3, :3]) > 0.0 else faces[:, ::-1], role

    def _object(self, element: _Element, path: str) -> _Object:
        mesh = element.find("{*}mesh")
        if mesh is not None and (lattice := mesh.find("{*}beamlattice")) is not None and len(lattice):
            raise MeshError(f"{self.name!r} has a beam lattice, which is not supported; expected triangles: turn the "
                            "lattice into a mesh and export again")  # fmt: skip
        none: Any = ()
        corners = none if mesh is None else mesh.iterfind("{*}vertices/{*}vertex")
        vertices = np.array([[v.get(k) for k in "xyz"] for v in corners], float).reshape(-1, 3)
        triangles = none if mesh is None else mesh.iterfind("{*}triangles/{*}triangle")
        faces = np.array([[t.get(k) for k in ("v1", "v2", "v3")] for t in triangles], np.int64).reshape(-1, 3)
        if faces.size and not 0 <= faces.min() <= faces.max() < len(vertices):
            raise MeshError(f"{self.name!r} has triangles of vertices that do not exist; it is damaged: export again")
        parts = element.iterfind("{*}components/{*}component")
        inner = [(self._path(each, path), each.get("objectid", ""), _transform(each)) for each in parts]
        return _Object(element.get("type", "model"), vertices, faces, inner)

    @staticmethod
    def _path(element: _Element, path: str) -> str:
        """The file that contains an item or a component: its own, or the one that the production extension names."""
        given = next((value for key, value in element.attrib.items() if str(key).endswith("}path")), None)
        return path if given is None else normpath(str(given)).lstrip("/")

    def _is_known(self, model: _Element) -> bool:
        """Reject extensions that a model needs and that are not supported."""
        for prefix in (model.get("requiredextensions") or "").split():
            space = str(model.nsmap.get(prefix, prefix))
            if not space.endswith(KNOWN):
                raise MeshError(f"{self.name!r} needs the 3MF extension {space!r}, which is not supported; expected a "
                                "mesh without it: export the part again as plain triangles")  # fmt: skip
        return True

    def _unit(self, model: _Element) -> float:
        unit = model.get("unit", "millimeter")
        if unit not in UNITS:
            raise MeshError(f"{self.name!r} has the unit {unit!r}; expected one of {', '.join(UNITS)}: export it again")
        return UNITS[unit]


def _transform(element: _Element) -> Array:
    """A transform for row vectors, (4, 4)."""
    given, found = element.get("transform"), np.eye(4)
    if given is not None:
        found[:, :3] = np.array(given.split(), float).reshape(4, 3)
    if not np.isfinite(found).all():
        raise MeshError(f"a transform of the 3MF file is {given!r}; expected twelve numbers: export the part again")
    return found


def _parsed(text: bytes) -> _Element:
    from lxml import etree  # pyright: ignore[reportAttributeAccessIssue]

    return etree.fromstring(text, etree.XMLParser(resolve_entities=False, no_network=True, huge_tree=True))


def _ranges(text: bytes | None) -> dict[str, list[tuple[slice, str]]]:
    """PrusaSlicer's volumes: triangles of each object and their role."""
    found: dict[str, list[tuple[slice, str]]] = {}
    for each in _parsed(text).iter("object") if text else ():
        for volume in each.iter("volume"):
            some = slice(int(volume.get("firstid", 0)), int(volume.get("lastid", -1)) + 1)
            words = {data.get("value") for data in volume.iter("metadata") if data.get("key") == "volume_type"}
            role = next((ROLES[word] for word in words if word in ROLES), "")
            found.setdefault(each.get("id", ""), []).append((some, role))
    return found


def _parts(text: bytes | None) -> dict[tuple[str, str], str]:
    """Parts of Bambu Studio and Orca: the role of a component, by the number of its object and its own."""
    return {
        (each.get("id", ""), part.get("id", "")): ROLES[part.get("subtype", "")]
        for each in (_parsed(text).iter("object") if text else ())
        for part in each.iter("part") if part.get("subtype") in ROLES
    }  # fmt: skip
