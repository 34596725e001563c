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
from vamgpu.optics.sampling import resin_pixel
from vamgpu.storage.atomic import replacing
from vamgpu.studio.parts import SHOWN, Mesh, Part, placed
from vamgpu.studio.workspace import JOB, Refused, Workspace, stamp
from vamgpu.targets import shapes

MESHES = 4
"""Parts whose meshes are kept in memory."""


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
            if "roller" not in fields:
                Job.parse(text, source=name, folder=self._workspace.folder, files=True)
        except JobError as error:
            found = [{"field": each.key, "line": each.line, "message": each.message} for each in error.wrong]
            errors = found or [{"field": "", "line": None, "message": str(error)}]
        except (VamError, ValueError) as error:
            errors = [{"field": "", "line": None, "message": str(error)}]
        return {"text": text, "fields": fields, "errors": errors}

    def read(self, name: str) -> dict[str, Any]:
        """A job file."""
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

    def edit(self, text: str, changes: dict[str, Any], removed: list[str]) -> dict[str, Any]:
        """A text with other values."""
        return self.checked(edited(text, changes, removed))

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

    def _drawn(self, fields: dict[str, Any], most: int = SHOWN) -> Part | None:
        """The part of a job, in one piece; None for several bodies."""
        target = fields.get("target")
        if not isinstance(target, dict):
            return None
        if isinstance(target.get("mesh"), str):
            return self.part(self._workspace.existing(target["mesh"]), most)
        if target.get("shape") in shapes.names():
            solid = shapes.build(target["shape"])
            points = solid.vertices.astype(np.float32)
            ends = np.stack([points.min(axis=0), points.max(axis=0)]).astype(float)
            mesh = Mesh(points, solid.faces.astype(np.uint32), 0.0)
            return Part(target["shape"], mesh, solid.vertices, ends, len(solid.faces), ())
        return None

    def mesh(self, name: str, most: int = SHOWN) -> tuple[Part, np.ndarray]:
        """The part of a job and its corners where the job places it. Raises `Refused`."""
        fields = checked_toml(read_text(self._workspace.existing(name, JOB)))
        part = self._drawn(fields, most)
        if part is None:
            raise Refused(404, f"{name} has no part to draw; set target.mesh or target.shape")
        return part, placed(part.mesh.positions.astype(float), part.hull, _scale(fields))[0]

    def scene(self, name: str) -> dict[str, Any]:
        """What surrounds the part: vessel, grid and beam, as far as the file is right, and what does not fit."""
        text = read_text(self._workspace.existing(name, JOB))
        found: dict[str, Any] = dict.fromkeys(("vessel", "part", "grid", "beam"))
        problems, doubts = list(self.checked(text, name)["errors"]), []
        fields: dict[str, Any] = {}
        with suppress(JobError):
            fields = checked_toml(text)
        solid = None
        try:
            part = self._drawn(fields)
            if part is not None:
                hull = placed(part.hull, part.hull, _scale(fields))[1]
                low, high = hull.min(axis=0), hull.max(axis=0)
                radius = float(np.hypot(hull[:, 0], hull[:, 1]).max())
                found["part"] = {"triangles": part.triangles, "low": low.tolist(), "high": high.tolist(),
                                 "extents": (high - low).tolist(), "radius": radius}  # fmt: skip
                doubts += part.described()["doubts"]
                solid = SimpleNamespace(radius=radius, height=float(high[2] - low[2]))
        except VamError as error:
            problems.append({"field": "target", "message": str(error)})
        with suppress(JobError), warnings.catch_warnings():
            warnings.simplefilter("ignore")
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

    target = dict(fields.get("target") or {})
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
