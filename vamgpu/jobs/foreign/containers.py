"""Containers of Dr.TVAM as vessels and bodies of a job: what is not round about its axis turns with the resin."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from math import ceil, inf, sqrt
from pathlib import Path
from typing import Any

from manifold3d import Manifold

from vamgpu.errors import BadInput
from vamgpu.schema.registry import nearest_of
from vamgpu.targets.mesh import load_mesh
from vamgpu.targets.shapes import csg
from vamgpu.targets.solid import Solid

FACETS = 256  # sides of a round wall: at a radius of 10 mm they are within a micrometer of the circle
RIM = 3  # voxels around a container that is not round, beyond its widest point
MOST_ACROSS = 512  # voxels across a container that is not round: more would take gigabytes for parts as high as wide
NOT_ROUND = "its container turns with the resin: light is traced through its walls, without their reflections"

Body = tuple[dict[str, Any], Solid]


@dataclass(frozen=True)
class Container:
    """Tables of a job for a vial, bodies that stand in its resin, and notes on what is left out."""

    tables: dict[str, Any]
    bodies: tuple[Body, ...] = ()
    across: int | None = None
    voxel: float | None = None
    notes: tuple[str, ...] = field(default=())


def check_keys(said: Any, known: Iterable[str], place: str) -> None:
    """Raises `BadInput` for a key that is not among the known ones; those that begin with _ are remarks."""
    known = list(known)
    for key in said if isinstance(said, dict) else ():
        if key not in known and not key.startswith("_"):
            near = nearest_of(key, known)
            remedy = f"did you mean {near}?" if near else f"expected one of {', '.join(known)}: correct or remove it"
            raise BadInput(f"its key {f'{place}.{key}'.lstrip('.')} is unknown; {remedy}")


def file_of(folder: Path, name: Any) -> Path:
    """A file of a configuration, beside it or, as Dr.TVAM searches for it, in the working directory."""
    beside, here = folder / str(name), Path(str(name))
    return here if here.is_file() and not beside.is_file() else beside


def mm(value: float) -> str:
    """A length in a job file, without the rounding error of its conversion."""
    return f"{round(value, 9):.15g} mm"


def number(said: Mapping[str, Any], name: str, default: float | None = None, *, least: float = 0.0,
           zero: bool = False) -> float:  # fmt: skip
    """A number above ``least`` (with ``zero``: at least ``least``)."""
    value = said[name] if default is None else said.get(name, default)
    real = isinstance(value, int | float) and not isinstance(value, bool)
    if not real or value == inf or not (value > least or (zero and value == least)):
        raise ValueError(f"{name}, which is {value!r}; expected a number {'from' if zero else 'above'} {least:g}")
    return float(value)


def index(said: Mapping[str, Any], name: str, default: float | None = None) -> float:
    """A refractive index."""
    return number(said, name, default, least=1.0, zero=True)


def container(said: Mapping[str, Any], folder: Path, voxel: float, absorption: float) -> Container:
    """The container of a configuration, without its occlusions. Raises `BadInput` if there is no model of it."""
    kind, resin = said.get("type"), index(said["medium"], "ior")
    makers = {"index_matched": _matched, "cylindrical": _round, "double_cylindrical": _tube}
    if kind in makers:
        return makers[kind](said, resin, f"{absorption:.12g} 1/mm")
    if kind not in ("square", "custom"):
        raise BadInput(f"its vial is {kind!r}; expected one of {', '.join((*makers, 'square', 'custom'))}: correct it")
    outer, inner = _cuvette(said) if kind == "square" else _meshed(said, folder)
    return _turned(said, outer, inner, resin, absorption, voxel)


def _matched(said: Mapping[str, Any], resin: float, absorption: str) -> Container:
    radius = number(said, "r")
    return Container({"vat": {"width": mm(2.0 * radius), "radius": mm(radius), "absorption": absorption}})


def _round(said: Mapping[str, Any], resin: float, absorption: str, which: str = "") -> Container:
    inner = number(said, f"r_int{which}")
    outer = number(said, f"r_ext{which}", least=inner)
    return Container({
        "vial": {"radius": mm(outer), "wall": mm(round(outer - inner, 12)), "resin_index": resin,
                 "wall_index": index(said, f"ior{which}"), "bath_index": index(said, "ior_surrounding", 1.0),
                 "absorption": absorption}
    })  # fmt: skip


def _tube(said: Mapping[str, Any], resin: float, absorption: str) -> Container:
    """A tube that stands in the resin of a round vial: two clear inserts."""
    vial = _round(said, resin, absorption, "_outer")
    inner = number(said, "r_int_inner")
    outer, half = number(said, "r_ext_inner", least=inner), 0.5 * number(said, "height", 40.0)
    if outer >= number(said, "r_int_outer"):
        raise ValueError(f"r_ext_inner, which is {outer:g}; expected a tube inside r_int_outer")
    wall, core = (csg.rod((0.0, 0.0, -half), (0.0, 0.0, half), radius, segments=FACETS) for radius in (outer, inner))
    bodies = (
        _clear("tube", wall - core, index(said, "ior_inner")),
        _clear("core", core, index(said, "ior_inside_inner")),
    )
    return Container(vial.tables, bodies, notes=("reflections at its inner tube are ignored",))


def _cuvette(said: Mapping[str, Any]) -> tuple[Manifold, Manifold]:
    half = 0.5 * number(said, "height", 100.0)
    inner = 0.5 * number(said, "w_int")
    outer = 0.5 * number(said, "w_ext", least=2.0 * inner)
    found = [csg.box((-side, -side, -half), (side, side, half)) for side in (outer, inner)]
    return found[0], found[1]


def _meshed(said: Mapping[str, Any], folder: Path) -> tuple[Manifold, Manifold]:
    solids = [load_mesh(file_of(folder, said[f"filename_vial_{side}"]), center=False) for side in ("outer", "inner")]
    found = [csg.from_triangles(each.vertices, each.faces) for each in solids]
    return found[0], found[1]


def _turned(said: Mapping[str, Any], outer: Manifold, inner: Manifold, resin: float, absorption: float, voxel: float
            ) -> Container:  # fmt: skip
    """A wall and what surrounds it as clear inserts, in a round vat that reflects and bends nothing."""
    low_x, low_y, low, high_x, high_y, high = outer.bounding_box()
    corner = sqrt(max(-low_x, high_x) ** 2 + max(-low_y, high_y) ** 2)
    edge = max(voxel, 2.0 * corner / (MOST_ACROSS - 2 * RIM))
    n = 2 * (ceil(corner / edge - 1e-9) + RIM)
    far, radius = (0.5 * n + RIM) * edge, round(0.5 * n * edge, 9)
    around = csg.box((-far, -far, low), (far, far, high)) - outer
    notes = (NOT_ROUND,)
    if edge > voxel:
        notes += (f"its voxels are {edge:.3g} mm wide, not {voxel:.3g}, because they hold the whole container; "
                  "target.pitch and target.shape_of_grid change them",)  # fmt: skip
    vat = {"width": mm(2.0 * radius), "radius": mm(radius), "absorption": f"{absorption:.12g} 1/mm"}
    vat |= dict.fromkeys(("resin_index", "wall_index", "bath_index"), resin)
    bodies = (_clear("surroundings", around, index(said, "ior_surrounding", 1.0)),
              _clear("wall", outer - inner, index(said, "ior")))  # fmt: skip
    return Container({"vat": vat}, bodies, n, edge, notes)


def _clear(name: str, body: Manifold, ior: float) -> Body:
    if body.is_empty():
        raise BadInput(f"its container has no {name}, or surfaces that are not closed; expected closed meshes, one "
                       "inside the other: correct them")  # fmt: skip
    return {"role": "insert", "name": name, "index": ior}, Solid(*csg.triangles(body), name)
