"""Job files as text and as fields: check, edit, make, and what surrounds the part in the vial."""

from __future__ import annotations

import hashlib
import warnings
from contextlib import suppress
from pathlib import Path
from threading import Lock
from types import SimpleNamespace
from typing import Any

import numpy as np

from vamgpu.errors import BadInput, JobError, VamError
from vamgpu.geometry import Beam
from vamgpu.jobs.build import covering, light_of, pitch_of
from vamgpu.jobs.demo import JOB as DEMO
from vamgpu.jobs.edit import edited
from vamgpu.jobs.model import JobFile
from vamgpu.jobs.read import Job, checked_toml, read_text
from vamgpu.jobs.web import WebJob
from vamgpu.optics.sampling import resin_pixel
from vamgpu.storage.atomic import replacing
from vamgpu.studio import films
from vamgpu.studio.parts import SHOWN, Drawn, Mesh, Part, drawn, drawn_bodies
from vamgpu.studio.workspace import JOB, READERS, Refused, Workspace, kind_of_tables, stamp
from vamgpu.targets import shapes

MESHES = 4  # parts whose meshes are kept in memory


def etag_of(text: str) -> str:
    """A tag that changes with a text."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]


class Texts:
    """The job files of a workspace."""

    def __init__(self, workspace: Workspace) -> None:
        self._workspace, self._lock = workspace, Lock()
        self._parts: dict[tuple[Any, ...], Part] = {}

    def checked(self, text: str, name: str = "job") -> dict[str, Any]:
        """A text with its fields, and everything that is wrong with it."""
        errors: list[dict[str, Any]] = []
        fields: dict[str, Any] = {}
        try:
            fields = checked_toml(text, name)
            reader = READERS.get(kind_of_tables(fields), Job)
            reader.parse(text, source=name, folder=self._workspace.folder, files=True)
        except JobError as error:
            found = [{"field": each.key, "line": each.line, "message": each.message} for each in error.wrong]
            errors = found or [{"field": "", "line": None, "message": str(error)}]
        except (VamError, ValueError) as error:
            errors = [{"field": "", "line": None, "message": str(error)}]
        return {"text": text, "fields": fields, "errors": errors}

    def read(self, name: str) -> dict[str, Any]:
        text = read_text(self._workspace.existing(name, JOB))
        return {"id": name, "etag": etag_of(text), **self.checked(text, name)}

    def save(self, name: str, text: str, etag: str | None) -> dict[str, Any]:
        """Write a job file, if it is still the one with that tag, or new without one. Raises `Refused`."""
        path = self._workspace.place(name, JOB)
        with self._lock:
            there = path.exists() or path.is_symlink()
            if there != (etag is not None) or (there and etag_of(read_text(self._workspace.existing(name))) != etag):
                why = "was changed or removed by another page or program" if etag is not None else "exists"
                raise Refused(409, f"{name} {why}; load it again, or save under another name")
            with replacing(path, overwrite=there) as draft:
                draft.write_text(text, encoding="utf-8")
        return self.read(name)

    def new(self, name: str, part: str | None, height: str | None, presets: list[dict[str, Any]]) -> dict[str, Any]:
        """Write the file of a new job from presets; without a part, for the bundled boat."""
        text = "\n".join(line for line in DEMO.splitlines() if not line.startswith("#")).lstrip() + "\n"
        changes: dict[str, Any] = {}
        removed: list[str] = []
        if part is not None:
            self._workspace.existing(part)
            changes |= {"target.mesh": part} | ({} if height else {"target.factor": 1.0})
            removed += ["target.shape"] + ([] if height else ["target.height"])
        changes |= {"target.height": height} if height else {}
        for preset in presets:
            removed += ["vial"] if any(key.startswith("vat.") for key in preset) else []
            changes |= preset
        text = edited(text, changes, removed)
        if wrong := [each["message"] for each in self.checked(text)["errors"] if each["field"] == "target.height"]:
            raise Refused(400, wrong[0])
        return self.save(name + ("" if name.endswith(JOB) else JOB), text, None)

    def part(self, path: Path, most: int = SHOWN) -> Part:
        """A part; the last few stay in memory."""
        key = (stamp(path), path.name, most)  # the same after the file was moved to its place
        with self._lock:
            if key not in self._parts:
                while len(self._parts) >= MESHES:
                    del self._parts[next(iter(self._parts))]
                self._parts[key] = Part.load(path, most)
            return self._parts[key]

    def _part_of(self, section: Any, most: int) -> Part | None:
        """The part that a table names."""
        if not isinstance(section, dict):
            return None
        if isinstance(section.get("mesh"), str):
            part = self.part(self._workspace.existing(section["mesh"]), most)
            number = section.get("part")
            return part.only(number) if isinstance(number, int) else part
        if section.get("shape") in shapes.names():
            solid = shapes.build(section["shape"])
            points, faces = solid.vertices.astype(np.float32), solid.faces.astype(np.uint32)
            ends = np.stack([points.min(axis=0), points.max(axis=0)]).astype(float)
            mesh = Mesh(points, faces, np.zeros(len(faces), np.uint32), 0.0)
            return Part(section["shape"], mesh, solid.vertices, ends, len(solid.faces), ())
        return None

    def _drawn(self, fields: dict[str, Any], most: int = SHOWN) -> Drawn | None:
        """The part or the bodies of a job where it places them; None if it names none."""
        bodies, target = fields.get("body"), _scale(fields)
        if not isinstance(bodies, list) or not bodies:
            part = self._part_of(target, most)
            return None if part is None else drawn(part, target)
        parts: list[Part] = []
        said: list[dict[str, Any]] = []
        for n, body in enumerate(bodies):
            part = self._part_of(body, max(1000, most // len(bodies)))
            if part is None:
                raise BadInput(f"body {n + 1} names no mesh in the workspace and no bundled shape; add it")
            if "roles" in body:
                for k in np.unique(part.mesh.owner).tolist():
                    named = part.bodies[k]
                    parts.append(part.only(k + 1))
                    said.append({"name": named["name"] or part.name, "entry": n, "role": named["role"] or "print"})
            else:
                parts.append(part)
                said.append({"name": part.name, "entry": n, "role": body.get("role", "print")})
        return drawn_bodies(parts, said, target)

    def mesh(self, name: str, most: int = SHOWN) -> Drawn:
        """The bodies of a job where it places them. Raises `Refused`."""
        found = self._drawn(checked_toml(read_text(self._workspace.existing(name, JOB))), most)
        if found is None:
            raise Refused(404, f"{name} has no part to draw; set target.mesh or target.shape")
        return found

    def scene(self, name: str) -> dict[str, Any]:
        """What surrounds the part: vessel, grid and beam, as far as the file is valid, and what does not fit."""
        text = read_text(self._workspace.existing(name, JOB))
        found: dict[str, Any] = dict.fromkeys(("vessel", "part", "grid", "beam", "web"))
        said, doubts, solid = self.checked(text, name), [], None
        problems, fields = said["errors"], said["fields"]
        try:
            part = self._drawn(fields)
            if part is not None:
                hull = part.hull
                low, high = hull.min(axis=0), hull.max(axis=0)
                radius = float(np.hypot(hull[:, 0], hull[:, 1]).max())
                found["part"] = {"triangles": part.triangles, "low": low.tolist(), "high": high.tolist(),
                                 "extents": (high - low).tolist(), "radius": radius}  # fmt: skip
                doubts += part.doubts
                solid = SimpleNamespace(radius=radius, height=float(high[2] - low[2]))
        except VamError as error:
            problems.append({"field": "target", "message": str(error)})
        with suppress(JobError), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if kind_of_tables(fields) == "web":
                found["web"] = films.machine_of(WebJob.parse(text, folder=self._workspace.folder).file)
            else:
                self._surround(Job.parse(text, folder=self._workspace.folder).file, solid, found, problems)
        return {**found, "problems": problems, "doubts": doubts}

    @staticmethod
    def _surround(file: JobFile, solid: Any, found: dict[str, Any], problems: list[dict[str, Any]]) -> None:
        """Add vessel, grid and beam of a valid job, and what does not fit."""
        light = light_of(file)
        table = next((name for name in ("vial", "vat", "vessel", "light") if getattr(file, name) is not None), None)
        inside = next((each for each in (light, getattr(light, "vessel", None)) if hasattr(each, "radius")), None)
        if inside is not None:
            inner = float(getattr(inside, "inner_radius", inside.radius - getattr(inside, "wall", 0.0)))
            found["vessel"] = {"table": table, "kind": type(light).__name__, "shape": "cylinder",
                               "radius": float(inside.radius), "inner": inner}  # fmt: skip
        elif hasattr(light, "width") and light.width:
            found["vessel"] = {"table": table, "kind": type(light).__name__, "shape": "box",
                               "radius": 0.5 * float(light.width), "inner": 0.5 * float(light.width)}  # fmt: skip
        if found["vessel"] is not None and np.isfinite(lit := getattr(light, "lit_radius", np.inf)):
            found["vessel"]["lit"] = float(lit)
        pixels, pitch = file.beam.pixels, file.beam.pitch
        if solid is None:
            return
        try:
            if hasattr(light, "check_fits"):
                light.check_fits(solid.radius)
            edge = pitch_of(file)
            across = 2.0 * (solid.radius + file.target.margin * edge)
            count = [4 * int(np.ceil(length / edge / 4.0)) for length in (across, across, solid.height)]
            found["grid"] = {"shape": count, "pitch": edge, "radius": 0.5 * across}
            needed = covering(solid, light, pitch, None)
        except BadInput as error:
            problems.append({"field": "target", "message": str(error)})
            return
        pixels = pixels or needed
        found["beam"] = {
            "pixels": list(pixels),
            "pitch": pitch,
            "width": pixels[0] * pitch,
            "height": pixels[1] * pitch,
            "reach": 0.5 * pixels[0] * resin_pixel(Beam((1, 1), pitch), light)[0],  # in the resin
        }
        for k, (axis, side) in enumerate((("columns", "wide"), ("rows", "high"))):
            if pixels[k] + 4 < needed[k]:
                said = f"got {pixels[k]} {axis}, and the part is {needed[k]} pixels {side}; expected more {axis}, or a "
                problems.append({"field": "beam.pixels", "message": f"{said}smaller part"})


def _scale(fields: dict[str, Any]) -> dict[str, Any]:
    """How a job places its part, with the height in mm; as drawn if that is invalid."""
    from vamgpu.quantity import parse

    target = dict(fields.get("slices" if "printer" in fields else "target") or {})
    try:
        height = target.get("height")
        target["height"] = None if height is None else parse(height, "a length")
        if target.get("orientation") is not None and np.shape(target["orientation"]) != (3, 3):
            target["orientation"] = None
        if not isinstance(target.get("factor", 1.0), (int, float)):
            target["factor"] = None
    except ValueError:
        target["height"] = None
    return target
