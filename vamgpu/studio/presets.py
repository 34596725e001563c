"""Vials, projectors and resins to begin with: bundled ones with their sources, and a lab's own."""

from __future__ import annotations

import re
from importlib.resources import files
from pathlib import Path
from threading import Lock
from typing import Any

from vamgpu.jobs.keys import toml_of
from vamgpu.storage.atomic import replacing
from vamgpu.storage.reading import load_toml, parse_toml
from vamgpu.studio.workspace import Refused

FAMILIES = ("vials", "projectors", "resins")
MOST = 500  # own presets of a workspace


class Presets:
    """Presets by family; own ones are in a TOML file."""

    def __init__(self, file: Path) -> None:
        self._file, self._lock = file, Lock()
        bundled = parse_toml(files("vamgpu.studio").joinpath("presets.toml").read_text("utf-8"))
        self._bundled = {family: [one | {"own": False} for one in bundled[family]] for family in FAMILIES}

    def all(self) -> dict[str, list[dict[str, Any]]]:
        own = self._own()
        return {family: [*self._bundled[family], *own.get(family, [])] for family in FAMILIES}

    def named(self, family: str, name: str | None) -> list[dict[str, Any]]:
        """The values of a preset, as a list; empty for None. Raises `Refused`."""
        found = [one["set"] for one in self.all()[family] if one["id"] == name]
        if name is not None and not found:
            raise Refused(404, f"there is no preset {name!r} among the {family}; reload the list")
        return found[:1]

    def add(self, family: str, name: str, source: str, values: dict[str, Any]) -> dict[str, Any]:
        """Store an own preset; one of the same name is replaced. Raises `Refused`."""
        made = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-") or "preset"
        found = {"id": f"own-{made}", "name": name, "source": source, "own": True, "set": values}
        with self._lock:
            own = self._own()
            kept = [one for one in own.get(family, []) if one["id"] != found["id"]]
            if sum(map(len, own.values())) >= MOST:
                raise Refused(409, f"the workspace has {MOST} presets of its own; delete some")
            self._write(own | {family: [*kept, found]})
        return found

    def remove(self, family: str, name: str) -> None:
        """Delete an own preset. Raises `Refused`."""
        with self._lock:
            own = self._own()
            kept = [one for one in own.get(family, []) if one["id"] != name]
            if len(kept) == len(own.get(family, [])):
                raise Refused(404, f"there is no own preset {name!r} among the {family}; bundled ones stay")
            self._write(own | {family: kept})

    def _own(self) -> dict[str, list[dict[str, Any]]]:
        return load_toml(self._file, "the presets") if self._file.is_file() else {}

    def _write(self, own: dict[str, list[dict[str, Any]]]) -> None:
        lines = [f"[[{family}]]\n" + "".join(f"{key} = {toml_of(value)}\n" for key, value in one.items())
                 for family, some in own.items() for one in some]  # fmt: skip
        with replacing(self._file, overwrite=True) as draft:
            draft.write_text("\n".join(lines), encoding="utf-8")
