"""Results of a job: verdict, numbers, slices, volumes, surfaces and frames, from the folders as they are."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import ceil
from typing import Any

import numpy as np

from vamgpu.errors import StorageError
from vamgpu.geometry import Grid
from vamgpu.jobs.web import is_web_folder
from vamgpu.methods.plan_folder import PlanRecord
from vamgpu.metrics.parts import IN, OUT
from vamgpu.printing import pictures, surface
from vamgpu.storage.folder import Folder
from vamgpu.storage.reading import read_bytes
from vamgpu.studio import films
from vamgpu.studio.tasks import thinned
from vamgpu.studio.volumes import Arrays, Volumes, png
from vamgpu.studio.workspace import PROOF, RESULT, Refused, Workspace, record_of, stamp

AXES = {"x": 0, "y": 1, "z": 2}
SLAB = 1 << 22  # voxels that are counted at a time
NO_PROOF = "has no proof yet; prove it first"


class Results:
    def __init__(self, workspace: Workspace) -> None:
        self._workspace, self._volumes = workspace, Volumes()

    def _proof(self, name: str, proof: str | None) -> tuple[Folder, float, Grid]:
        """A result's proof, or one with errors, its threshold and grid. Raises `Refused`, `StorageError`."""
        place = self._workspace.existing(name, RESULT)
        if proof is not None and not proof.startswith(f"{place.stem}.off-"):
            raise Refused(404, f"there is no exposure {proof!r} of {name}; reload the result")
        found = self._workspace.proof_of(place) if proof is None else self._workspace.existing(proof, PROOF)
        if found is None:
            raise Refused(404, f"{name} {NO_PROOF}")
        folder = self._workspace.manifest(found)
        try:
            table = next(_grids(folder.manifest.inputs["geometry"]))
            grid = Grid(tuple(table["shape"]), float(table["pitch"]))
            return folder, float(folder.manifest.details["proof"]["scores"]["threshold"]) or 1.0, grid
        except (KeyError, TypeError, ValueError, StopIteration) as error:
            raise StorageError(f"the proof {folder.path.name!r} lacks {error}; prove the job again") from error

    def described(self, name: str, proof: str | None = None) -> dict[str, Any]:
        """All data of a result that are small."""
        place = self._workspace.existing(name, RESULT)
        state, verdict = self._workspace.state(place)
        found: dict[str, Any] = {
            "id": name, "state": state, "kind": "vial", "job": None, "modified": stamp(record_of(place))[1] / 1e9,
            "verdict": None, "lines": [], "scores": None, "seconds": None, "pitch": None, "shape": None,
            "radius": None, "outer": None, "tolerances": None, "frames": None, "history": thinned([]),
            "exposed": [{"proof": name, "off": name.removeprefix(f"{place.stem}.off-").removesuffix(PROOF)}
                        for name in sorted(each.name for each in place.parent.glob(f"{place.stem}.off-*{PROOF}"))],
            "report": None,
        }  # fmt: skip
        if (place.with_suffix(".toml")).is_file():
            found["job"] = place.with_suffix(".toml").name
        if place.with_suffix(".html").is_file():
            found["report"] = f"/api/v1/results/{name}/report"
        if state == "damaged":
            return found
        if is_web_folder(place):
            return found | films.described(self._workspace.web(place)) | {"kind": "web", "verdict": verdict}
        folder = self._workspace.manifest(place)
        record = folder.manifest.inputs.get("plan")
        found["history"] = thinned([dict(step) for step in PlanRecord.read(record).history] if record else [])
        found["frames"] = self._frames(folder)
        if state == "proved" or proof is not None:
            found |= self._judged(*self._proof(name, proof))
        return found

    @staticmethod
    def _judged(folder: Folder, threshold: float, grid: Grid) -> dict[str, Any]:
        details = folder.manifest.details
        judged, numbers = details.get("judged") or {}, details["proof"]
        scores, outer, exposure = numbers["scores"], numbers.get("outer"), numbers.get("exposure")
        kept = ("threshold", "peak", "missing", "excess", "in_voxels", "out_voxels", "iou")
        return {
            "verdict": judged.get("verdict"), "lines": judged.get("lines", []), "tolerances": judged.get("tolerances"),
            "scores": {key: scores.get(key) for key in kept} | {"window": scores.get("windows", {}).get("strict")},
            "seconds": exposure and exposure.get("seconds"), "pitch": grid.pitch, "shape": list(grid.shape),
            "radius": grid.inscribed_radius,
            "outer": outer and {"share": float(outer["dose"]) / threshold, "place": outer["place"]},
        }  # fmt: skip

    def _frames(self, folder: Folder) -> dict[str, Any]:
        (count, rows, columns), details = folder.record("frames").shape, folder.manifest.details.get("frames") or {}
        return {"count": count, "rows": details.get("rows", rows), "columns": details.get("columns", columns),
                "bits": details.get("bits"), "scale": details.get("scale")}  # fmt: skip

    def compare(self, first: str, second: str) -> dict[str, Any]:
        """Numbers and keys of two results beside each other."""
        both = [self.described(name) for name in (first, second)]
        values = [{line["name"]: line for line in each["lines"]} for each in both]
        names = dict.fromkeys([*values[0], *values[1]])
        rows = [{"name": name, "meaning": (values[0].get(name) or values[1][name])["meaning"],
                 **{key: some.get(name, {}).get("value") for key, some in zip("ab", values, strict=True)}}
                for name in names]  # fmt: skip
        keys = [dict(_keys(self._workspace.manifest(self._workspace.existing(name, RESULT)).manifest.inputs.get("job")))
                for name in (first, second)]  # fmt: skip
        other = [key for key in dict.fromkeys([*keys[0], *keys[1]]) if keys[0].get(key) != keys[1].get(key)]
        return {"rows": rows, "keys": [{"key": key, "a": keys[0].get(key), "b": keys[1].get(key)} for key in other]}

    def report(self, name: str) -> bytes:
        """The report of a result. Raises `Refused`."""
        place = self._workspace.existing(name, RESULT).with_suffix(".html")
        if not place.is_file() or place.is_symlink():
            raise Refused(404, f"{name} has no report; prove it first")
        return read_bytes(place)

    def slice(self, name: str, proof: str | None, of: str, axis: str, index: int, dose: float) -> Arrays:
        """A slice as it is drawn."""
        (folder, threshold, grid), along = self._proof(name, proof), AXES[axis]
        if index >= grid.shape[along]:
            raise Refused(400, f"got slice {index} along {axis}; expected 0 to {grid.shape[along] - 1}")
        plane = {what: np.take(self._volumes.of(folder, what), index, along) for what in ("dose", "target")
                 if of in (what, "printed")}  # fmt: skip
        values = plane.get(of)
        if values is None:
            cylinder = grid.cylinder()
            inside = cylinder if axis == "z" else np.take(cylinder, index, along)[:, None]
            inside = np.broadcast_to(inside, plane["dose"].shape)
            values = pictures.verdicts(plane["target"], plane["dose"] * dose >= threshold, inside)
        elif of == "dose":
            values = np.asarray(values / threshold, np.float32)
        places, across = grid.axes(), {"z": (0, 1), "x": (1, 2), "y": (0, 2)}[axis]
        ends = [(float(places[k][0]) - 0.5 * grid.pitch, float(places[k][-1]) + 0.5 * grid.pitch) for k in across]
        return Arrays({"values": pictures.upright(values)}, {
            "left": ends[0][0], "right": ends[0][1], "bottom": ends[1][0], "top": ends[1][1], "index": index,
            "count": grid.shape[along], "place": float(places[along][index]),
        })  # fmt: skip

    def volume(self, name: str, proof: str | None, of: str, most: int, dtype: str) -> Arrays:
        """A volume for the page, at most ``most`` voxels along an edge."""
        folder, threshold, grid = self._proof(name, proof)
        block = ceil(max(grid.shape) / most)
        whole = self._volumes.of(folder, of)
        parts = [surface.block_mean(np.asarray(whole[k : k + block], np.float32), block)
                 for k in range(0, len(whole), block)]  # fmt: skip
        values = np.concatenate(parts).transpose(2, 1, 0) / (threshold if of == "dose" else 1.0)
        full = float(values.max()) or 1.0 if dtype == "uint8" else 1.0
        stored = np.round(np.clip(values / full, 0.0, 1.0) * 255.0) if dtype == "uint8" else values
        low = [float(axis[0]) - 0.5 * grid.pitch for axis in grid.axes()]
        return Arrays({"values": stored.astype(dtype)}, {"pitch": block * grid.pitch, "left": low[0], "bottom": low[1],
                                                         "low": low[2], "full": full})  # fmt: skip

    def _classes(self, folder: Folder, grid: Grid) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Dose of the judged voxels outside the part and in it, some planes at a time."""
        dose, target = self._volumes.of(folder, "dose"), self._volumes.of(folder, "target")
        cylinder, step = grid.cylinder(), max(1, SLAB // (grid.shape[1] * grid.shape[2]))
        for first in range(0, grid.shape[0], step):
            judged = cylinder[first : first + step]
            some, inside = dose[first : first + step][judged], target[first : first + step][judged] >= 0.5
            yield some[~inside], some[inside]

    def histogram(self, name: str, proof: str | None, bins: int) -> Arrays:
        """Voxels per bin of dose."""
        folder, threshold, grid = self._proof(name, proof)
        edges = np.linspace(0.0, float(self._volumes.of(folder, "dose").max()) or 1.0, bins + 1)
        counts = np.zeros((2, bins), np.uint32)
        for some in self._classes(folder, grid):
            for k in (OUT, IN):
                counts[k] += np.histogram(some[k], edges)[0].astype(np.uint32)
        return Arrays({"edges": (edges / threshold).astype(np.float32), "outside": counts[OUT], "inside": counts[IN]},
                      {})  # fmt: skip

    def exposure(self, name: str, proof: str | None, dose: float) -> dict[str, Any]:
        """What would print with another exposure."""
        folder, threshold, grid = self._proof(name, proof)
        missing = excess = inside = 0
        for out, part in self._classes(folder, grid):
            missing += int((part * dose < threshold).sum())
            excess += int((out * dose >= threshold).sum())
            inside += part.size
        times = folder.manifest.details["proof"].get("exposure")
        return {"dose": dose, "missing": missing, "excess": excess, "iou": (inside - missing) / max(inside + excess, 1),
                "seconds": times and float(times["seconds"]) * dose}  # fmt: skip

    def surface(self, name: str, proof: str | None, of: str, dose: float) -> Arrays:
        """The surface of the part, of its print, or of resin that also prints beyond the judged cylinder."""
        folder, threshold, grid = self._proof(name, proof)
        part = surface.iso_surface(np.asarray(self._volumes.of(folder, "target")), 0.5, grid.pitch)
        found, far = part, np.zeros(len(part.points))
        if of == "printed":
            cylinder = grid.cylinder()[:, :, None]
            found = surface.iso_surface(
                np.where(cylinder, self._volumes.of(folder, "dose"), 0.0), threshold / dose, grid.pitch
            )
            far = surface.deviation(found, part)
        elif of == "stray":
            if "stray_points" not in folder.manifest.arrays:
                raise Refused(404, "no resin beyond the judged cylinder prints")
            points, faces = folder.array("stray_points"), folder.array("stray_faces")
            found, far = surface.Surface(points, surface.vertex_normals(points, faces), faces), np.zeros(len(points))
        arrays = {"positions": found.points, "normals": found.normals, "deviation": far}
        return Arrays({key: values.astype(np.float32) for key, values in arrays.items()}
                      | {"indices": found.faces.astype(np.uint32)}, {"pitch": grid.pitch})  # fmt: skip

    def frame(self, name: str, index: int, plane: int | None = None) -> bytes:
        """One frame as PNG; of a web also the columns that one focus plane shows."""
        place = self._workspace.existing(name, RESULT)
        if is_web_folder(place):
            return png(films.frame(self._workspace.web(place), index, plane))
        folder = self._workspace.manifest(place)
        count = folder.record("frames").shape[0]
        if index >= count:
            raise Refused(400, f"got frame {index}; expected 0 to {count - 1}")
        return png(_shown(folder, folder.one("frames", index)))

    def sinogram(self, name: str, row: int | None) -> bytes:
        """One row of all frames as PNG [angle, column]."""
        folder = self._workspace.manifest(self._workspace.existing(name, RESULT))
        _, rows, _ = folder.record("frames").shape
        row = rows // 2 if row is None else row
        if row >= rows:
            raise Refused(400, f"got row {row}; expected 0 to {rows - 1}")
        return png(_shown(folder, self._volumes.of(folder, "frames")[:, row]))


def _grids(geometry: Any) -> Iterator[Mapping[str, Any]]:
    """The grids in a described operator, the outermost first."""
    if isinstance(geometry, Mapping):
        if isinstance(geometry.get("grid"), Mapping):
            yield geometry["grid"]
        for part in geometry.values():
            yield from _grids(part)


def _keys(table: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Keys and values of a job as written."""
    for key, value in table.items() if isinstance(table, Mapping) else ():
        if isinstance(value, Mapping):
            yield from _keys(value, f"{path}{key}.")
        else:
            yield f"{path}{key}", value


def _shown(folder: Folder, rows: np.ndarray) -> np.ndarray:
    """Stored rows of frames as gray levels."""
    details = folder.manifest.details.get("frames") or {}
    if rows.dtype == np.uint8:
        columns = details.get("columns") or rows.shape[-1]
        return 255 * np.unpackbits(rows, axis=-1)[..., :columns] if details.get("bits") == 1 else rows
    full = float(details.get("scale") or rows.max()) or 1.0
    return np.round(255.0 * np.clip(rows / full, 0.0, 1.0) ** (1.0 / pictures.GAMMA)).astype(np.uint8)
