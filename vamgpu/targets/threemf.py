"""Read 3MF packages as slicers do: which objects are printed, where they are placed, and what is subtracted.

The core, production and beam lattice extensions, and the volumes of PrusaSlicer and Bambu Studio (Orca).
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
from manifold3d import Manifold

from vamgpu.errors import EmptyMesh, MeshError
from vamgpu.storage.memory import afford, size
from vamgpu.storage.zips import open_zip, unpacked
from vamgpu.targets.beam_lattice import BeamLattice
from vamgpu.targets.shapes import csg

WORK = 12  # bytes of memory that reading takes, by byte of a model's text
DENSEST, SMALL = 200, 1 << 24  # largest compression of a model above `SMALL` bytes; meshes as text compress to a tenth
DOCTYPES = (b"<!DOCTYPE", "<!DOCTYPE".encode("utf-16-le")[:-1])
"""Contents forbidden in a 3MF file (3MF core, 2.3): entities that multiply, and names of other files."""


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
                        f"{size(member.file_size)}; no mesh compresses that much: export the part again"
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
PRINTED = ("model", "solidsupport")  # types of objects that are printed; "support", "surface" and "other" are not
KNOWN = ("production/2015/06", "material/2015/02", "slice/2015/07", "core/2015/02", "trianglesets/2021/07",
         "beamlattice/2017/02", "beamlattice/balls/2020/07")  # fmt: skip
"""Ends of the namespaces of extensions that may be required: they are read, or do not change the solids."""
MOST_INSTANCES, MOST_LEVELS = 10_000, 16
"""Largest number of meshes that a package may place, and of levels of components."""
TRIANGLE = 300  # bytes of memory that a triangle takes until it is repaired
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
    names: tuple[str, ...]
    vertices: Array
    faces: npt.NDArray[np.integer[Any]]
    components: list[tuple[str, str, Array]] = field(default_factory=list)  # file, number, transform


@dataclass(frozen=True)
class _Volume:
    """Role and names of an object or of a part of it."""

    role: str
    names: tuple[str, ...]

    def containing(self, role: str, names: tuple[str, ...]) -> _Volume:
        return _Volume(role or self.role, (*names, *self.names))


@dataclass(frozen=True)
class Placed:
    """A mesh [mm] where it is printed. names: of its volume, its object and those around it, the innermost first."""

    vertices: Array
    faces: npt.NDArray[np.integer[Any]]
    names: tuple[str, ...]


def read_3mf(data: bytes, name: str, part: int | None = None) -> trimesh.Trimesh:
    """The printed parts of a package [mm], or one, minus negative volumes. Raises `MeshError`, `EmptyMesh`."""
    # metadata["parts"]: number of triangles and names of each part
    import trimesh

    solid, cut = _Package(name, members_of(data, name, (PRUSA, BAMBU))).placed()
    if not solid:
        raise EmptyMesh(f"{name} places no triangles that are printed; expected an <item> of a model with a mesh")
    if part is not None and part > len(solid):
        raise MeshError(f"{name!r} has {len(solid)} parts; expected part 1 to {len(solid)}, not {part}: correct it")
    solid = solid if part is None else solid[part - 1 : part]
    if cut:
        tool = csg.union(_closed(each.vertices, each.faces, name) for each in cut)
        left = (csg.triangles(_closed(each.vertices, each.faces, name) - tool) for each in solid)
        solid = [Placed(*some, each.names) for some, each in zip(left, solid, strict=True)]
        if not any(len(each.faces) for each in solid):
            raise MeshError(f"{name!r} has negative volumes that leave nothing; expected a part beyond them: correct "
                            "them in the slicer and export again")  # fmt: skip
    mesh: Any = trimesh.util.concatenate([trimesh.Trimesh(each.vertices, each.faces, process=False) for each in solid])
    mesh.units = "millimeter"
    mesh.metadata["parts"] = [(len(each.faces), each.names) for each in solid]
    return mesh


def _closed(vertices: Array, faces: Any, name: str) -> Manifold:
    """A mesh as a body. Raises `MeshError`."""
    import trimesh

    mesh: Any = trimesh.Trimesh(vertices, faces, process=False)
    mesh.merge_vertices()
    body = csg.from_triangles(mesh.vertices, mesh.faces)
    if body.is_empty():
        raise MeshError(f"{name!r} has negative volumes or beams, and surfaces that are not closed; expected closed "
                        "parts: repair them in the slicer and export again")  # fmt: skip
    return body


class _Package:
    """The objects of a package by file and number, and the roles of volumes."""

    def __init__(self, name: str, files: dict[str, bytes]) -> None:
        self.name, self.triangles, self.instances = name, 0, 0
        models = {path: _parsed(text) for path, text in files.items() if path.lower().endswith(".model")}
        root = next((path for path in models if path.lower().endswith("3d/3dmodel.model")), next(iter(models), None))
        if root is None:
            raise MeshError(f"{name!r} holds no model; expected 3D/3dmodel.model: export the part again as 3MF")
        self.root, self.build = root, models[root].findall("{*}build/{*}item")
        self.scale = {path: self._unit(model) for path, model in models.items()}
        self.objects = {
            (path, each.get("id", "")): self._object(each, path)
            for path, model in models.items() if self._is_known(model) for each in model.iter("{*}object")
        }  # fmt: skip
        self.ranges, self.parts = _ranges(files.get(PRUSA)), _parts(files.get(BAMBU))

    def placed(self) -> tuple[list[Placed], list[Placed]]:
        """The solid volumes, and the negative ones."""
        solid: list[Placed] = []
        cut: list[Placed] = []
        for item in self.build:
            if item.get("printable", "1") not in ("0", "false"):
                path, whole = self._path(item, self.root), _Volume("", ())
                for role, mesh in self._meshes(path, item.get("objectid", ""), _transform(item), whole, 0):
                    (cut if role == CUT else solid).append(mesh)
        return solid, cut

    def _meshes(self, path: str, number: str, move: Array, around: _Volume, level: int) -> Any:
        """Roles and meshes of an object and its components, transformed; without those that are ignored."""
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
        around = around.containing("", found.names)
        ranges = self.ranges.get(number) if path == self.root else None
        for some, own in ranges or ((slice(None), _Volume("", ())),):
            yield from self._mesh(found, some, move, self.scale[path], around.containing(own.role, own.names))
        for where, other, way in found.components:
            own = self.parts.get((number, other), _Volume("", ()))
            inner = around.containing(own.role, own.names)
            if inner.role != LEFT_OUT:
                yield from self._meshes(where, other, way @ move, inner, level + 1)

    def _mesh(self, found: _Object, some: slice, move: Array, scale: float, own: _Volume) -> Any:
        faces = found.faces[some]
        if own.role != LEFT_OUT and len(faces):
            self.triangles += len(faces)
            afford(self.triangles * TRIANGLE, f"{self.name!r} with {self.triangles:,} triangles", MeshError)
            vertices = (found.vertices @ move[:3, :3] + move[3, :3]) * scale
            turned = faces if np.linalg.det(move[:3, :3]) > 0.0 else faces[:, ::-1]
            yield own.role, Placed(vertices, turned, own.names)

    def _object(self, element: _Element, path: str) -> _Object:
        mesh = element.find("{*}mesh")
        none: Any = ()
        corners = none if mesh is None else mesh.iterfind("{*}vertices/{*}vertex")
        vertices = np.array([[v.get(k) for k in "xyz"] for v in corners], float).reshape(-1, 3)
        triangles = none if mesh is None else mesh.iterfind("{*}triangles/{*}triangle")
        faces = np.array([[t.get(k) for k in ("v1", "v2", "v3")] for t in triangles], np.int64).reshape(-1, 3)
        if faces.size and not 0 <= faces.min() <= faces.max() < len(vertices):
            raise MeshError(f"{self.name!r} has triangles of vertices that do not exist; it is damaged: export again")
        if mesh is not None and (lattice := mesh.find("{*}beamlattice")) is not None:
            beams = BeamLattice(lattice, vertices, self.scale[path], self.name).bodies()
            whole = csg.union([*beams, *([_closed(vertices, faces, self.name)] if len(faces) else ())])
            vertices, faces = csg.triangles(whole)
        parts = element.iterfind("{*}components/{*}component")
        inner = [(self._path(each, path), each.get("objectid", ""), _transform(each)) for each in parts]
        said = [data.text for data in element.iterfind("{*}metadatagroup/{*}metadata")
                if str(data.get("name")).lower().endswith("role")]  # fmt: skip
        names = tuple(filter(None, (*said, element.get("name"))))
        return _Object(element.get("type", "model"), names, vertices, faces, inner)

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


def _ranges(text: bytes | None) -> dict[str, list[tuple[slice, _Volume]]]:
    """PrusaSlicer's volumes: the triangles of each, by object."""
    found: dict[str, list[tuple[slice, _Volume]]] = {}
    for each in _parsed(text).iter("object") if text else ():
        for volume in each.iter("volume"):
            some = slice(int(volume.get("firstid", 0)), int(volume.get("lastid", -1)) + 1)
            role = next((ROLES[word] for word in _said(volume, "volume_type") if word in ROLES), "")
            names = *_said(volume, "name"), *_said(each, "name")
            found.setdefault(each.get("id", ""), []).append((some, _Volume(role, names)))
    return found


def _parts(text: bytes | None) -> dict[tuple[str, str], _Volume]:
    """Parts of Bambu Studio and Orca, by the number of the object and that of the component."""
    return {
        (each.get("id", ""), part.get("id", "")):
            _Volume(ROLES.get(part.get("subtype", ""), ""), (*_said(part, "name"), *_said(each, "name")))
        for each in (_parsed(text).iter("object") if text else ()) for part in each.iter("part")
    }  # fmt: skip


def _said(element: _Element, key: str) -> tuple[str, ...]:
    """What both programs say about an object or a volume."""
    return tuple(data.get("value", "") for data in element.iterfind("metadata") if data.get("key") == key)
