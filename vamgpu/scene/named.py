"""Bodies of a 3MF file, with roles by the names of its objects."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Literal

from vamgpu.errors import BadInput, MeshWarning
from vamgpu.scene.body import Body
from vamgpu.targets.mesh import load_parts
from vamgpu.targets.role_names import WORDS, resembles_role, role_in


def named_bodies(
    path: str | Path, roles: Literal["names"] | None, *, dose: float | None = None, weight: float = 1.0
) -> list[Body]:
    """Bodies where they were drawn; arguments and errors as for `Scene.from_3mf`."""
    if roles != "names":
        raise BadInput(f"roles is {roles!r}; expected 'names', which begin with the roles: give roles=\"names\"")
    parts, file = load_parts(path), Path(path).name
    found = [role_in(names) for _, names in parts]
    if not any(found):
        listed = ", ".join(repr(solid.name) for solid, _ in parts)
        raise BadInput(f"no object of {file!r} has a role in its name: {listed}; expected names that begin with one of "
                       f"{', '.join(WORDS)}: rename them, or write a [[body]] with part for each")  # fmt: skip
    unclear = [solid.name for (solid, names), role in zip(parts, found, strict=True)
               if role is None and resembles_role(names)]  # fmt: skip
    if unclear:
        warnings.warn(f"{file} has objects named {', '.join(map(repr, unclear))}, which print because their names do "
                      "not begin with a role; if they are not to print, begin the names with insert, zero dose or "
                      "don't care", MeshWarning, stacklevel=3)  # fmt: skip
    made = []
    for (solid, _), role in zip(parts, found, strict=True):
        kept = role == "keep out"
        if kept and dose is None:
            raise BadInput(f"object {solid.name!r} of {file!r} is to be kept out without a limit of its dose; give "
                           "dose = 0.7, say, a share of the dose that prints")  # fmt: skip
        made.append(Body(solid, role or "print", solid.name, dose if kept else None, weight=weight))
    return made
